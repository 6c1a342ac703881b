"""Few measurements that stand for the samples of an interval: gtsam must preintegrate them to the same motion."""

import gtsam
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stillpoint.smoother.attitude.keys import Motion
from stillpoint.smoother.attitude.samples.compound import PARTS, compound_samples

BIAS = np.array([0.02, -0.05, 0.03])
RATE_HZ = 286.0


def shaken(n: int, turn_radps: float, rate_hz: float = RATE_HZ) -> Motion:
    """Return n samples of a motion that turns about changing axes."""
    t = np.arange(n) / rate_hz
    gyro = turn_radps * np.stack([np.sin(9 * t), np.cos(7 * t), np.sin(5 * t + 1)], axis=1)
    accel = np.stack([5 * np.sin(31 * t), 9.8 + 3 * np.cos(23 * t), 4 * np.sin(11 * t)], axis=1)
    nothing = np.zeros((n, 3))
    return Motion(t, np.full(n, 1 / rate_hz), gyro, accel, np.zeros(n, dtype=bool), nothing, nothing, nothing)


def integrate_exactly(motion: Motion, first: int, last: int, bias: np.ndarray):
    """Return turn, velocity and place with the rate constant in each interval and the force at its beginning."""
    turn, speed, place = Rotation.identity(), np.zeros(3), np.zeros(3)
    for k in range(first + 1, last + 1):
        dt, force = motion.dt_s[k], turn.apply(motion.accel_b_mps2[k])
        place = place + speed * dt + 0.5 * force * dt**2
        speed = speed + force * dt
        turn = turn * Rotation.from_rotvec((motion.gyro_b_radps[k] - bias) * dt)
    return turn, speed, place


def preintegrate(motion: Motion, rows: np.ndarray, bias: np.ndarray = BIAS):
    """Return gtsam's sum of the interval between two samples."""
    noise = gtsam.PreintegrationParams.MakeSharedU(9.81)
    between = gtsam.PreintegratedImuMeasurements(noise, gtsam.imuBias.ConstantBias(np.zeros(3), bias))
    made = compound_samples(motion, rows, np.array([0]), bias)
    for accel, gyro, seconds in zip(made.accel_b_mps2[0], made.gyro_b_radps[0], made.length_s[0], strict=True):
        if seconds > 0:
            between.integrateMeasurement(accel, gyro, seconds)
    return between


@pytest.mark.parametrize("n", [1, 2, 3, PARTS, PARTS + 1, 29])
@pytest.mark.parametrize("turn_radps", [0.0, 1e-3, 2.0, 12.0])
def test_the_parts_end_where_the_samples_end(n, turn_radps):
    motion = shaken(40, turn_radps)
    turn, speed, place = integrate_exactly(motion, 5, 5 + n, BIAS)
    made = preintegrate(motion, np.array([5, 5 + n]))
    assert (Rotation.from_matrix(made.deltaRij().matrix()).inv() * turn).magnitude() < 1e-8
    np.testing.assert_allclose(made.deltaVij(), speed, atol=1e-8)
    np.testing.assert_allclose(made.deltaPij(), place, atol=1e-8)
    assert made.deltaTij() == pytest.approx(n / RATE_HZ)


def test_a_turn_of_more_than_half_a_circle_stays_one_turn():
    """4.5 rad in an interval: the shorter way round would jump between two parts."""
    n = 29
    motion = shaken(40, 0.0)
    motion.gyro_b_radps[:, 2] = 4.5 * RATE_HZ / n
    rows = np.array([5, 5 + n])
    made = compound_samples(motion, rows, np.array([0]), np.zeros(3))
    np.testing.assert_allclose(made.gyro_b_radps[0], np.tile([0, 0, 4.5 * RATE_HZ / n], (PARTS, 1)), atol=1e-9)
    turn, _, _ = integrate_exactly(motion, 5, 5 + n, np.zeros(3))
    found = Rotation.from_matrix(preintegrate(motion, rows, np.zeros(3)).deltaRij().matrix())
    assert (found.inv() * turn).magnitude() < 1e-8


def test_a_change_of_the_bias_turns_and_pushes_as_the_samples_say():
    """gtsam corrects the sums to first order. Off by a fifth of a degree per second, what is left must not count.

    Sd of an interval in the graph: 1e-3 rad and 3e-2 m/s.
    """
    motion, rows = shaken(40, 3.0), np.array([5, 34])
    change = np.array([0.004, -0.003, 0.002])
    moved = gtsam.imuBias.ConstantBias(np.zeros(3), BIAS + change)
    end = preintegrate(motion, rows).predict(gtsam.NavState(), moved)
    turn, speed, _ = integrate_exactly(motion, 5, 34, BIAS + change)
    fallen = np.array([0, 0, -9.81]) * 29 / RATE_HZ
    assert (Rotation.from_matrix(end.attitude().matrix()).inv() * turn).magnitude() < 1e-5
    np.testing.assert_allclose(end.velocity(), speed + fallen, atol=3e-4)


def test_intervals_are_those_that_were_asked_for():
    motion, rows = shaken(100, 2.0), np.array([0, 20, 45, 99])
    one = compound_samples(motion, rows, np.array([0, 1, 2]), BIAS)
    two = compound_samples(motion, rows, np.array([0, 2]), BIAS)
    np.testing.assert_array_equal(two.gyro_b_radps, one.gyro_b_radps[[0, 2]])
    np.testing.assert_allclose(one.length_s.sum(axis=1), np.diff(rows) / RATE_HZ)
