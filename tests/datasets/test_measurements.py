"""Zeros, sentinels and frozen values of a sensor that is not working are dropped and counted; nothing else is."""

from dataclasses import replace

import numpy as np
import pytest
from quick import mark_slow_except

from stillpoint.datasets import Imu, Mag
from stillpoint.datasets.measurements import FROZEN_S, drop_non_measurements
from stillpoint.datasets.simulate import simulate
from stillpoint.filters import estimate
from stillpoint.scoring import score
from stillpoint.smoother import reference

PEERS = {"madgwick": "ahrs", "mahony": "ahrs", "ahrs-ekf": "ahrs", "vqf": "vqf", "fusion": "imufusion"}


@pytest.fixture(scope="module")
def hand():
    return simulate("phone-3", seed=1, minutes=1.5, rate_hz=50)


def with_field(recording, field_b_ut):
    info = replace(recording.info, units_unchecked=True)
    return replace(recording, mag=Mag(recording.mag.t_ns, field_b_ut), info=info)


def first_20_s(recording, value):
    field = recording.mag.mag_b_ut.copy()
    rows = recording.mag.t_ns < recording.mag.t_ns[0] + 20e9
    field[rows] = value
    return with_field(recording, field), int(rows.sum())


def test_a_sound_recording_is_returned_as_it_is(hand):
    same, dropped = drop_non_measurements(hand)
    assert same is hand
    assert dropped.counts() == {}


@pytest.mark.parametrize(("value", "name"), [(0.0, "n_no_field"), (-32768.0, "n_bad_mag"), (5000.0, "n_bad_mag")])
def test_values_of_a_driver_that_is_not_ready_are_dropped_and_counted(hand, value, name):
    broken, count = first_20_s(hand, value)
    left, dropped = drop_non_measurements(broken)
    assert dropped.counts() == {name: count}
    assert len(left.mag.t_ns) == len(hand.mag.t_ns) - count


def test_a_magnetometer_of_zeros_is_removed(hand):
    left, dropped = drop_non_measurements(with_field(hand, np.zeros_like(hand.mag.mag_b_ut)))
    assert left.mag is None
    assert dropped.mag_zero == len(hand.mag.t_ns)


def frozen(recording, start_s, length_s):
    t_s = (recording.mag.t_ns - recording.mag.t_ns[0]) / 1e9
    field = recording.mag.mag_b_ut.copy()
    rows = (t_s >= start_s) & (t_s < start_s + length_s)
    field[rows] = field[rows][0]
    return with_field(recording, field), int(rows.sum())


def test_a_field_that_stands_still_while_the_body_turns_is_frozen(hand):
    """The phone is in the hand, in violent motion, from the second half of the recording on."""
    moving_s = (hand.truth.t_ns[hand.truth.moving][0] - hand.mag.t_ns[0]) / 1e9
    broken, count = frozen(hand, moving_s + 1, 10.0)
    _, dropped = drop_non_measurements(broken)
    assert dropped.counts() == {"n_frozen_mag": count}
    shorter, _ = frozen(hand, moving_s + 1, 0.8 * FROZEN_S)
    assert drop_non_measurements(shorter)[1].counts() == {}


def test_a_field_that_stands_still_at_rest_is_no_fault(hand):
    resting, _ = frozen(hand, 1.0, 10.0)
    assert drop_non_measurements(resting)[1].counts() == {}


def test_samples_of_the_imu_beyond_any_sensor_are_dropped(hand):
    accel = hand.imu.accel_b_mps2.copy()
    accel[100] = 1e5
    left, dropped = drop_non_measurements(replace(hand, imu=Imu(hand.imu.t_ns, hand.imu.gyro_b_radps, accel)))
    assert dropped.counts() == {"n_bad_imu": 1}
    assert len(left.imu.t_ns) == len(hand.imu.t_ns) - 1


@pytest.mark.slow
@pytest.mark.parametrize("value", [0.0, -32768.0])
def test_the_reference_is_as_good_with_a_magnetometer_that_starts_late(hand, value):
    broken, count = first_20_s(hand, value)
    made = reference(broken)
    assert count in made.diagnostics.values()
    assert score(made, hand.truth).total_rmse_deg < score(reference(hand), hand.truth).total_rmse_deg + 0.1


@pytest.mark.parametrize("name", mark_slow_except(PEERS, "vqf"))
def test_peers_start_with_the_first_field_that_is_one(hand, name):
    pytest.importorskip(PEERS[name])
    broken, count = first_20_s(hand, 0.0)
    made = estimate(broken, name)
    assert made.diagnostics["n_no_field"] == count
    whole = score(estimate(hand, name), hand.truth).total_rmse_deg
    assert score(made, hand.truth).total_rmse_deg == pytest.approx(whole, abs=1.0)
