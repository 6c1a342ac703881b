"""Scenes: what a disturbance adds to a recording."""

from dataclasses import replace

import numpy as np
import pytest

from stillpoint.datasets.errors import BadRecording
from stillpoint.datasets.frames import rotation, slerp
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.simulate.scenes import let_field_wander


@pytest.fixture(scope="module")
def phone():
    return simulate("phone-1", minutes=3)


def test_wandering_field_has_its_size_and_correlation_time_in_world_axes(phone):
    """360 correlation times of three axes: the sd is known to 5 %, the correlation at one time to about 0.05."""
    changed = let_field_wander(phone, sd_ut=8.0, time_s=0.5, seed=3)
    added_b_ut = changed.mag.mag_b_ut - phone.mag.mag_b_ut
    truth = phone.truth
    q_nb = slerp(truth.t_ns, truth.q_nb, phone.mag.t_ns.clip(truth.t_ns[0], truth.t_ns[-1]))
    added_n_ut = rotation(q_nb).apply(added_b_ut)
    assert added_n_ut.std() == pytest.approx(8.0, rel=0.15)
    lag = round(0.5e9 / float(np.median(np.diff(phone.mag.t_ns))))
    correlation = (added_n_ut[lag:] * added_n_ut[:-lag]).mean() / (added_n_ut**2).mean()
    assert correlation == pytest.approx(np.exp(-1), abs=0.15)


def test_wandering_field_depends_on_the_seed_only(phone):
    again = [let_field_wander(phone, 8.0, 4.0, seed).mag.mag_b_ut for seed in (3, 3, 4)]
    np.testing.assert_array_equal(again[0], again[1])
    assert np.abs(again[0] - again[2]).max() > 1.0


@pytest.mark.parametrize("missing", ["mag", "truth"])
def test_field_cannot_wander_without_magnetometer_or_truth(phone, missing):
    with pytest.raises(BadRecording, match="choose a recording"):
        let_field_wander(replace(phone, **{missing: None}), 8.0, 4.0, seed=3)
