"""Remedies change what they say and nothing else, and can be undone."""

from dataclasses import replace

import numpy as np
import pytest
from resting import FIELD_UT, NO_RESTS, RNG, stamps, still
from scipy.spatial.transform import Rotation

from stillpoint.datasets import BadParameter, Mag
from stillpoint.datasets.doctor import Remedy, apply, diagnose
from stillpoint.datasets.doctor.remedy import fit_even_stamps
from stillpoint.datasets.doctor.witness import CANDIDATES
from stillpoint.datasets.simulate import simulate


def test_a_line_leaves_even_stamps_and_spreads_bursts():
    even = stamps(1000) + 10**9
    assert np.abs(fit_even_stamps(even) - even).max() <= 1
    bursts = even[np.minimum(np.arange(1000) // 25 * 25 + 24, 999)] + np.arange(1000) % 25 * 10**6
    steps = np.diff(fit_even_stamps(bursts))
    assert np.ptp(steps) <= 1
    assert abs(steps.mean() - 1e7) < 1e4


def test_a_line_does_not_bridge_a_gap():
    t_ns = stamps(1000)
    t_ns[500:] += 3 * 10**9
    assert np.abs(fit_even_stamps(t_ns) - t_ns).max() <= 1


def test_a_shift_of_one_sensor_moves_it_against_the_other():
    recording = simulate("phone-3", seed=2, minutes=1.5)
    shifted = apply(recording, [Remedy("shift", "accel", "accel shifted by +20.0 ms", (0.02,))])
    back = apply(shifted, [Remedy("shift", "accel", "accel shifted by -20.0 ms", (-0.02,))])
    inside = np.isin(recording.imu.t_ns, back.imu.t_ns)
    assert np.array_equal(back.imu.gyro_b_radps, recording.imu.gyro_b_radps[inside])
    start_ns = recording.imu.t_ns[0]
    t_s, at_s = (recording.imu.t_ns - start_ns) / 1e9, (shifted.imu.t_ns - start_ns) / 1e9 - 0.02
    moved = [np.interp(at_s, t_s, column) for column in recording.imu.accel_b_mps2.T]
    assert np.allclose(shifted.imu.accel_b_mps2, np.transpose(moved), atol=1e-9)
    assert "samples at the ends dropped" in shifted.info.conversions[-1]


@pytest.mark.parametrize("matrix", CANDIDATES[[1, 5, 20, 47]])
def test_a_matrix_and_its_inverse_cancel_for_the_truth_as_well(matrix):
    matrix = matrix * np.linalg.det(matrix)
    recording = simulate("phone-3", seed=2, minutes=1.5)
    there = Remedy("matrix", "truth", "there", tuple(matrix.ravel()))
    back = Remedy("matrix", "truth", "back", tuple(matrix.T.ravel()))
    changed = apply(recording, [there])
    # A vector of the body's old axes, taken to the new ones, points to the same side of the world.
    old = Rotation.from_quat(recording.truth.q_nb[9], scalar_first=True).apply([1.0, 2.0, 3.0])
    new = Rotation.from_quat(changed.truth.q_nb[9], scalar_first=True).apply(matrix @ [1.0, 2.0, 3.0])
    assert np.allclose(old, new)
    assert np.allclose(np.abs((apply(changed, [back]).truth.q_nb * recording.truth.q_nb).sum(axis=1)), 1)


@pytest.mark.slow
def test_units_count_as_checked_again_once_they_fit():
    recording = still()
    in_g = replace(recording, imu=replace(recording.imu, accel_b_mps2=recording.imu.accel_b_mps2 / 9.80665))
    remedies = diagnose(in_g, NO_RESTS).remedies
    assert apply(in_g, ()).info.units_unchecked
    assert not apply(in_g, remedies).info.units_unchecked


@pytest.mark.parametrize(
    ("remedy", "words"),
    [
        (Remedy("paint", "gyro", "paint it"), "no remedy 'paint'"),
        (Remedy("shift", "mag", "mag shifted", (0.1,)), "needs the stream mag"),
        (Remedy("offset", "truth", "truth less 1", (1.0, 1.0, 1.0)), "needs the stream truth"),
        (Remedy("drop", "imu", "all dropped", (0, 10**12)), "drop every sample"),
    ],
)
def test_a_remedy_that_cannot_be_applied_is_refused_in_one_line(remedy, words):
    with pytest.raises(BadParameter, match=words):
        apply(still(), [remedy])


def test_shifting_before_time_zero_counts_what_is_lost():
    recording = still(mag=Mag(stamps(3000), RNG.normal(0, 1, (3000, 3)) + FIELD_UT))
    shifted = apply(recording, [Remedy("shift", "mag", "mag shifted by -100.0 ms", (-0.1,))])
    assert len(shifted.mag.t_ns) == 2990
    assert "10 samples before time 0 dropped" in shifted.info.conversions[-1]
