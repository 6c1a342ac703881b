"""The ablation: each variant changes what its name says, and nothing that is not there."""

import pytest

from stillpoint.datasets.settings import choose_settings
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.trajectory import Estimate
from stillpoint.scripts.pages.ablation import VARIANTS, solve_variant
from stillpoint.smoother.attitude.params import HANDHELD

BY_NAME = {variant.name: variant for variant in VARIANTS}


@pytest.fixture(scope="module")
def recording():
    return simulate("phone-3", seed=2, minutes=1.4)


@pytest.mark.parametrize("variant", VARIANTS, ids=lambda variant: variant.name)
def test_every_variant_differs_from_the_whole_in_settings_that_are_there(variant):
    changed = choose_settings(HANDHELD, variant.settings, "graph") != HANDHELD
    others = not (variant.magnetometer and variant.returns and variant.optimised)
    assert (changed or others) == (variant.name != "everything")


@pytest.mark.slow
def test_without_returns_the_heading_is_known_less(recording):
    """The returns of the recording are used by the whole graph, and by no means in the variant."""
    whole, without = (solve_variant(recording, BY_NAME[name]) for name in ("everything", "no returns"))
    assert any(back.accepted for back in whole.returns)
    assert not without.returns
    assert len(whole.diagnostics["closing_squares"]) > len(without.diagnostics["closing_squares"]) == 0


@pytest.mark.slow
def test_start_value_is_an_estimate_of_every_sample(recording):
    begun = solve_variant(recording, BY_NAME["the start value alone"])
    assert isinstance(begun, Estimate)
    assert len(begun.q_nb) == len(recording.imu.t_ns)
