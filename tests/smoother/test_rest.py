"""Rests are found by change: known spans in, the same spans out, for any bias, noise, rate and stamps."""

import numpy as np
import pytest

from stillpoint.datasets import BadParameter, Imu
from stillpoint.datasets.importers.table import IMPORTERS
from stillpoint.datasets.simulate import simulate
from stillpoint.smoother import RestParams, find_rests

UP_B = np.array([0.0, 0.6, 0.8]) * 9.81
BREAKS = "04_undisturbed_slow_rotation_with_breaks_A.mat"  # rest at both ends, and three breaks


def make_imu(spans_s, rate_of=None, rate_hz=100.0, bias_dps=(0, 0, 0), noise_dps=0.05, jitter=0.0, seed=0):
    """30 s, at rest within ``spans_s``, turned by a hand elsewhere; ``rate_of(t)`` replaces the hand's motion."""
    rng = np.random.default_rng(seed)
    n = int(30 * rate_hz)
    t_s = (np.arange(n) + jitter * rng.uniform(-0.5, 0.5, n)) / rate_hz
    t_s -= t_s[0]
    resting = np.any([(t_s >= start) & (t_s <= end) for start, end in spans_s], axis=0)
    hand = 0.5 * np.sin(2 * np.pi * t_s[:, None] * [0.7, 1.1, 1.3])
    gyro = np.where(resting[:, None], 0.0, hand if rate_of is None else rate_of(t_s))
    sway = np.zeros((n, 3)) if rate_of is not None else 1.5 * np.sin(2 * np.pi * t_s[:, None] * [0.9, 1.2, 0.8])
    accel = UP_B + np.where(resting[:, None], 0.0, sway)
    gyro = gyro + np.deg2rad(np.asarray(bias_dps)) + np.deg2rad(noise_dps) * rng.standard_normal((n, 3))
    accel = accel + 0.03 * rng.standard_normal((n, 3))
    return Imu(np.round(t_s * 1e9).astype(np.int64), gyro, accel)


@pytest.mark.parametrize("rate_hz", [25.0, 100.0, 285.714, 1000.0])
@pytest.mark.parametrize("bias_dps", [(0, 0, 0), (5.7, -1.0, 0.3)])
def test_known_rests_are_found_at_any_rate_and_bias(rate_hz, bias_dps):
    spans = np.array([[0.0, 8.0], [14.0, 17.0], [25.0, 30.0]])
    imu = make_imu(spans, rate_hz=rate_hz, bias_dps=bias_dps, jitter=0.5)
    found = (find_rests(imu) - imu.t_ns[0]) / 1e9
    assert found.shape == (3, 2)
    np.testing.assert_allclose(found, spans, atol=0.25)
    assert found[0, 0] == 0.0  # the recording's own ends are not cut
    assert found[-1, 1] == (imu.t_ns[-1] - imu.t_ns[0]) / 1e9


def test_a_constant_bias_changes_nothing():
    spans = [[0.0, 8.0], [20.0, 30.0]]
    np.testing.assert_array_equal(find_rests(make_imu(spans)), find_rests(make_imu(spans, bias_dps=(-4.0, 2.0, 5.0))))


def test_a_noisy_sensor_still_rests():
    imu = make_imu([[0.0, 8.0], [20.0, 30.0]], noise_dps=1.5)  # its smoothed noise is above the bare threshold
    assert len(find_rests(imu)) == 2
    assert len(find_rests(imu, RestParams(noise_limit=1.0))) == 0


@pytest.mark.parametrize(("sway_dps", "rests"), [(0.2, True), (0.42, False)])
def test_what_sways_more_than_three_times_the_noise_does_not_rest(sway_dps, rests):
    """0.2 deg/s white on three axes at 100 Hz are 0.2 sqrt(3/10) = 0.11 over 0.1 s: the limit is at 0.33."""
    up = UP_B / np.linalg.norm(UP_B)

    def swaying(t_s):
        return np.deg2rad(sway_dps) * np.sqrt(2) * np.sin(2 * np.pi * t_s)[:, None] * up

    found = find_rests(make_imu([[11.0, 19.0]], rate_of=swaying, noise_dps=0.2)) / 1e9
    np.testing.assert_allclose(found, [[0.0, 29.99]] if rests else [[11.0, 19.0]], atol=1.0)


def test_rests_with_a_slow_bump_between_them_share_no_sample():
    """Only the windows on the bump's slopes see motion, so that those beside them reach into each other."""
    t_s = np.arange(3000) / 100
    gyro = np.zeros((3000, 3))
    gyro[:, 0] = np.deg2rad(0.75) * np.maximum(1 - np.abs(t_s - 15.0), 0.0)  # sd 0.75 / sqrt(12) = 0.217 on a slope
    imu = Imu(np.arange(3000) * 10_000_000, gyro, np.tile(UP_B, (3000, 1)))
    found = find_rests(imu, RestParams(edge_s=0.0, bias_change_radps=np.deg2rad(2.0), min_rest_s=0.2)) / 1e9
    assert len(found) == 3
    np.testing.assert_allclose(found[1:, 0] - found[:-1, 1], 0.01)  # the next sample


@pytest.mark.parametrize(("turned_deg", "rests"), [(0.6, 1), (1.6, 0)])
def test_gravity_may_turn_by_a_degree_during_a_rest(turned_deg, rests):
    """A table that gives way, a temperature that changes: between the means of the first and the last second."""
    t_s = np.arange(3000) / 100
    angle = np.deg2rad(turned_deg) * t_s / t_s[-1]
    accel = 9.81 * np.stack([np.zeros(3000), np.sin(angle), np.cos(angle)], axis=1)
    assert len(find_rests(Imu((t_s * 1e9).astype(np.int64), np.zeros((3000, 3)), accel))) == rests


def test_the_calmest_span_says_what_the_bias_is_and_not_the_majority():
    """A turntable that turns evenly three times, but for a little wow, and stands still once."""
    up = UP_B / np.linalg.norm(UP_B)

    def turntable(t_s):
        hand = 0.5 * np.sin(2 * np.pi * t_s[:, None] * [0.7, 1.1, 1.3])
        even = np.deg2rad(3.0 + 0.15 * np.sin(2 * np.pi * t_s))[:, None] * up
        turns = ((t_s > 10) & (t_s < 15)) | ((t_s > 17) & (t_s < 22)) | (t_s > 24)
        return np.where(turns[:, None], even, hand)

    found = find_rests(make_imu([[0.0, 8.0]], rate_of=turntable)) / 1e9
    np.testing.assert_allclose(found, [[0.0, 8.0]], atol=0.5)


@pytest.mark.parametrize("rate_dps", [1.0, 3.0, -6.0])
def test_a_steady_turn_about_the_vertical_is_no_rest(rate_dps):
    up = UP_B / np.linalg.norm(UP_B)
    imu = make_imu(
        [[0.0, 8.0], [22.0, 30.0]],
        rate_of=lambda t: np.deg2rad(rate_dps) * up * np.ones((len(t), 1)),
        bias_dps=(2.0, 0.5, -1.0),
    )
    found = (find_rests(imu) - imu.t_ns[0]) / 1e9
    np.testing.assert_allclose(found, [[0.0, 8.0], [22.0, 30.0]], atol=0.5)


def test_a_slow_tilting_is_no_rest():
    t_s = np.arange(3000) / 100
    angle = np.deg2rad(0.25) * t_s  # below the gyro's own bias tolerance, but the tilt by 7.5 deg
    accel = 9.81 * np.stack([np.zeros(3000), np.sin(angle), np.cos(angle)], axis=1)
    gyro = np.tile(np.deg2rad([0.25, 0.0, 0.0]), (3000, 1))
    assert len(find_rests(Imu((t_s * 1e9).astype(np.int64), gyro, accel))) == 0


def test_a_gap_in_the_stamps_is_no_rest():
    imu = make_imu([[0.0, 30.0]])
    keep = (imu.t_ns < 10e9) | (imu.t_ns > 16e9)
    found = find_rests(Imu(imu.t_ns[keep], imu.gyro_b_radps[keep], imu.accel_b_mps2[keep])) / 1e9
    assert len(found) == 2
    assert 9 < found[0, 1] < 10
    assert 16 < found[1, 0] < 17


def test_motion_from_end_to_end_has_no_rest():
    assert find_rests(make_imu([[-2.0, -1.0]])).shape == (0, 2)


def test_two_samples_are_no_rest():
    assert find_rests(Imu(np.array([0, 10]), np.zeros((2, 3)), np.full((2, 3), 5.0))).shape == (0, 2)


@pytest.mark.parametrize("field", [{"window_s": 0.0}, {"gyro_sd_radps": float("nan")}, {"min_rest_s": -1.0}])
def test_settings_out_of_range_are_refused(field):
    with pytest.raises(BadParameter, match="give a number"):
        RestParams(**field)


@pytest.mark.parametrize("kind", ["phone-1", "phone-3"])
def test_the_rests_of_simulated_experiments_are_found(kind):
    recording = simulate(kind, seed=5, minutes=3)
    truth = recording.truth
    found = find_rests(recording.imu)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], (~truth.moving).astype(int), [0]])))
    known = np.stack([truth.t_ns[edges[::2]], truth.t_ns[edges[1::2] - 1]], axis=1)
    assert len(found) == len(known)
    assert np.abs(found - known).max() < 0.5e9


def test_every_broad_trial_rests_at_both_ends(data_dir):
    """Facts of the data: 21-46 s of rest at the start, 20-39 s at the end; rests have no optical motion in them."""
    for recording in IMPORTERS["broad"](data_dir / "broad"):
        imu, truth = recording.imu, recording.truth
        rests = find_rests(imu)
        first_s, last_s = (rests[0, 1] - rests[0, 0]) / 1e9, (rests[-1, 1] - rests[-1, 0]) / 1e9
        assert rests[0, 0] == imu.t_ns[0]
        assert rests[-1, 1] == imu.t_ns[-1]
        assert 21 < first_s < 46.5, recording.name
        assert 20 < last_s < 40, recording.name
        inside = np.any([(truth.t_ns >= start) & (truth.t_ns <= end) for start, end in rests], axis=0)
        assert truth.moving[inside].mean() < 0.02, recording.name
        assert (~truth.moving[~inside]).mean() < 0.08, recording.name
    assert [len(find_rests(r.imu)) for r in IMPORTERS["broad"](data_dir / "broad" / BREAKS)] == [5]
