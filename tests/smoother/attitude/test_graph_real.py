"""The calibrating graph against optical truth: BROAD and phones in the hand (Tyrex)."""

from dataclasses import replace

import numpy as np
import pytest

from stillpoint.datasets import Imu, Unobservable
from stillpoint.datasets.importers.table import IMPORTERS
from stillpoint.scoring import score
from stillpoint.scripts.pages.planted import make_raw, turn_last_return
from stillpoint.smoother import reference

# Total error after heading, mounting and time are aligned, deg. BROAD: no trial above 0.70. Tyrex: what was seen and a
# third, far below the 10 deg that a wrong minimum exceeds.
BOUNDS = {
    "04_undisturbed_slow_rotation_with_breaks_A": ("broad", 0.70),
    "15_undisturbed_fast_translation_A": ("broad", 0.70),
    "21_undisturbed_fast_combined": ("broad", 0.70),
    "Guillaume_Nexus5_NoDist_Texting": ("tyrex", 2.0),
    "Guillaume_iPhone5_Dist_AR": ("tyrex", 2.0),
}


@pytest.fixture(scope="module")
def recordings(data_dir):
    found = (one for source in ("broad", "tyrex") for one in IMPORTERS[source](data_dir / source))
    return {one.name: one for one in found if one.name in BOUNDS}


@pytest.mark.parametrize("name", BOUNDS)
def test_errors_against_motion_capture_stay_within_the_stated_limits(recordings, name):
    recording = recordings[name]
    made = reference(recording)
    found = score(made, recording.truth, "heading+mounting+time")
    assert found.total_rmse_deg < BOUNDS[name][1]
    assert 0.8 <= found.coverage95 <= 1.0
    assert made.diagnostics["residuals"]["imu"] < 0.005  # a fifth of what is refused


def test_a_lone_return_that_was_turned_by_5_deg_is_left_out(recordings):
    """Kept, it makes 1.4 deg, of which 0.63 of the samples were within the 95 % ellipsoid."""
    turned = turn_last_return(recordings["21_undisturbed_fast_combined"], 5.0)
    made = reference(turned)
    assert [each.accepted for each in made.returns] == [False]
    assert "put back turned" in made.returns[0].reason
    found = score(made, turned.truth, "heading+mounting+time")
    assert found.total_rmse_deg < 0.7
    assert found.coverage95 > 0.9


def test_a_gyro_8_percent_off_in_fast_motion(recordings):
    """Without the second solve 1.5 deg, with 0.72 of the samples within the 95 % ellipsoid."""
    raw = make_raw(recordings["21_undisturbed_fast_combined"])
    made = reference(raw)
    np.testing.assert_allclose(np.diagonal(made.calibration.gyro_matrix), 1 / np.array([1.08, 0.94, 1.05]), atol=0.01)
    found = score(made, raw.truth, "heading+mounting+time")
    assert found.total_rmse_deg < 0.7
    assert found.coverage95 > 0.9


@pytest.mark.parametrize("name", ["15_undisturbed_fast_translation_A", "21_undisturbed_fast_combined"])
def test_swapped_gyro_axes_are_refused_on_real_data_too(recordings, name):
    imu = recordings[name].imu
    swapped = replace(recordings[name], imu=Imu(imu.t_ns, imu.gyro_b_radps[:, [1, 0, 2]], imu.accel_b_mps2))
    with pytest.raises(Unobservable, match=r"contradict|would have to be off"):
        reference(swapped)
