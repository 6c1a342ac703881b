"""Each factor generator: nothing to say at the truth, the right sign beside it."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, C, M, V, X
from scipy.spatial.transform import Rotation

from stillpoint.datasets import Imu
from stillpoint.smoother.attitude import factors
from stillpoint.smoother.attitude.keys import choose_keys, prepare_motion
from stillpoint.smoother.attitude.params import GraphParams, InertialNoise, KeyParams

G = 9.80665
PARAMS = GraphParams(inertial=InertialNoise(accel_mps2_rthz=0.2))  # the bounds below are errors over this noise
NO_RESTS = np.empty((0, 2), dtype=np.int64)


def turning(rate_b_radps, seconds=1.0, accel_late_s=0.0):
    """A sensor on the spot that turns steadily: its true attitudes and what it measures at 200 Hz."""
    t_s = np.arange(int(200 * seconds) + 1) / 200
    attitude = Rotation.from_euler("ZYX", [40, 20, -30], degrees=True) * Rotation.from_rotvec(
        np.outer(t_s, rate_b_radps)
    )
    felt = Rotation.from_euler("ZYX", [40, 20, -30], degrees=True) * Rotation.from_rotvec(
        np.outer(t_s - accel_late_s, rate_b_radps)
    )
    gyro = np.tile(rate_b_radps, (len(t_s), 1))
    imu = Imu((t_s * 1e9).astype(np.int64), gyro, felt.inv().apply([0.0, 0.0, G]))
    motion = prepare_motion(imu, NO_RESTS)
    keys = choose_keys(motion, KeyParams(moving_s=0.1))
    return motion, keys, attitude[keys.row]


def values_of(keys, attitude, tilt=None):
    values = gtsam.Values()
    for i in range(len(keys.t_s)):
        turn = attitude[i] if tilt is None or i == 0 else tilt * attitude[i]
        values.insert(X(i), gtsam.Pose3(gtsam.Rot3(turn.as_matrix()), np.zeros(3)))
        values.insert(V(i), np.zeros(3))
        values.insert(C(i), gtsam.imuBias.ConstantBias())
    values.insert(B(0), gtsam.imuBias.ConstantBias())
    values.insert(M(0), np.zeros(factors.CALIBRATION))
    return values


def miss_of(factor, values):
    """The error of a linear factor at absolute values: gtsam itself gives nought without a point of linearisation."""
    at = gtsam.VectorValues()
    for key in factor.keys():  # noqa: SIM118 - not a dict
        kind = chr(gtsam.Symbol(key).chr())
        at.insert(key, values.atVector(key) if kind == "m" else values.atConstantBias(key).vector())
    return factor.factor().error(at)


RATE = np.array([0.3, -0.5, 0.4])


def test_imu_factors_are_nought_at_the_truth_and_grow_with_tilt():
    motion, keys, attitude = turning(RATE)
    made = list(factors.imu_factors(motion, keys, np.zeros(3), G, PARAMS))
    assert len(made) == len(keys.t_s) - 1
    true, tilted = values_of(keys, attitude), values_of(keys, attitude, Rotation.from_rotvec([0.02, 0.0, 0.0]))
    assert max(factor.error(true) for factor in made) < 1e-3
    assert made[0].error(tilted) > 1.0


def test_a_gyro_sample_describes_the_interval_that_ends_at_it():
    """With a rate that changes from sample to sample, one sample of slip would be an error of 0.01 rad a key."""
    t_s = np.arange(41) / 200
    gyro = np.zeros((41, 3))
    gyro[1:, 2] = np.where(np.arange(1, 41) <= 20, 4.0, 0.0)
    turned = np.cumsum(gyro[:, 2]) / 200
    motion = prepare_motion(Imu((t_s * 1e9).astype(np.int64), gyro, np.tile([0.0, 0.0, G], (41, 1))), NO_RESTS)
    keys = choose_keys(motion, KeyParams(moving_s=0.1))
    attitude = Rotation.from_rotvec(np.outer(turned[keys.row], [0, 0, 1]))
    made = list(factors.imu_factors(motion, keys, np.zeros(3), G, PARAMS))
    assert max(factor.error(values_of(keys, attitude)) for factor in made) < 1e-6


def test_a_clipped_axis_may_have_turned_farther_the_others_not():
    """Beyond the reading about the clipped axis costs little, as much about another costs as ever."""
    motion, keys, attitude = turning(RATE)
    clipped = np.where([False, True, False], keys.span_s[:, None] * 4.4, 0.0)
    cut = replace(keys, gyro_clipped_rad=clipped)
    costs = {}
    for axis in range(3):
        farther = attitude * Rotation.from_rotvec(0.05 * np.arange(len(attitude))[:, None] * np.eye(3)[axis])
        for name, of in (("free", keys), ("cut", cut)):
            made = list(factors.imu_factors(motion, of, np.zeros(3), G, PARAMS))
            costs[name, axis] = sum(factor.error(values_of(keys, farther)) for factor in made)
    assert costs["cut", 1] < 0.05 * costs["free", 1]
    assert costs["cut", 0] > 0.2 * costs["free", 0]
    assert costs["cut", 2] > 0.2 * costs["free", 2]


@pytest.mark.slow
def test_a_gyro_that_reads_one_per_cent_too_much_has_m_plus_one_per_cent():
    """corrected = gyro_matrix (measured - bias) with gyro_matrix = 1 - M: too much is less than 1."""
    motion, keys, attitude = turning(RATE)
    large = replace(motion, gyro_b_radps=motion.gyro_b_radps * [1.01, 1.0, 1.0])
    loud = replace(keys, gyro_b_radps=keys.gyro_b_radps * [1.01, 1.0, 1.0])
    values = values_of(keys, attitude)
    vector = np.zeros(factors.CALIBRATION)
    vector[9] = 0.01 / 1.01
    values.update(M(0), vector)
    for i in range(len(keys.t_s) - 1):
        bias = gtsam.imuBias.ConstantBias(np.zeros(3), np.array([0.01 * RATE[0], 0.0, 0.0]))
        values.update(C(i), bias)
    assert max(factor.error(values) for factor in factors.imu_factors(large, loud, np.zeros(3), G, PARAMS)) < 1e-3
    assert max(miss_of(factor, values) for factor in factors.calibration_factors(loud, PARAMS)) < 1e-3
    vector[9] = -0.01 / 1.01
    values.update(M(0), vector)
    assert max(miss_of(factor, values) for factor in factors.calibration_factors(loud, PARAMS)) > 100


def test_a_late_accelerometer_has_a_positive_delay():
    motion, keys, attitude = turning(np.array([2.0, 0.5, 0.0]), accel_late_s=0.02)
    on_time, _, _ = turning(np.array([2.0, 0.5, 0.0]))
    difference = motion.accel_b_mps2[keys.row[1:]] - on_time.accel_b_mps2[keys.row[1:]]
    values = values_of(keys, attitude)
    errors = []
    for delay_s in (-0.02, 0.0, 0.02):
        vector = np.zeros(factors.CALIBRATION)
        vector[18] = delay_s
        values.update(M(0), vector)
        for i in range(len(keys.t_s) - 1):
            values.update(C(i), gtsam.imuBias.ConstantBias(difference[i], np.zeros(3)))
        errors.append(sum(miss_of(factor, values) for factor in factors.calibration_factors(keys, PARAMS)))
    assert errors[2] < 0.1 * errors[1] < 0.1 * errors[0]


def test_bias_and_calibration_begin_at_their_start():
    _, keys, attitude = turning(RATE)
    values = values_of(keys, attitude)
    made = list(factors.bias_factors(keys, np.zeros(3), PARAMS))
    assert sum(factor.error(values) for factor in made) == pytest.approx(0.0, abs=1e-12)
    values.update(B(0), gtsam.imuBias.ConstantBias(np.zeros(3), np.full(3, PARAMS.inertial.gyro_bias_sd_radps)))
    assert made[0].error(values) == pytest.approx(1.5)  # one sd on three axes


def test_motion_factors_ask_for_standstill_at_the_origin():
    _, keys, attitude = turning(RATE)
    values = values_of(keys, attitude)
    made = list(factors.motion_factors(keys, False, PARAMS))
    assert sum(factor.error(values) for factor in made) == pytest.approx(0.0, abs=1e-12)
    values.update(V(3), np.array([1.0, 0.0, 0.0]))
    assert sum(factor.error(values) for factor in made) > 0


def test_rest_factors_hold_the_attitude():
    _, keys, attitude = turning(np.zeros(3), seconds=3.0)
    still = replace(keys, at_rest=np.ones_like(keys.at_rest))
    made = list(factors.rest_factors(still, PARAMS))
    assert len(made) == len(keys.t_s) - 1
    assert sum(factor.error(values_of(keys, attitude)) for factor in made) == pytest.approx(0.0, abs=1e-12)
    tilted = values_of(keys, attitude, Rotation.from_rotvec([2e-3, 0.0, 0.0]))
    assert made[0].error(tilted) == pytest.approx((2e-3 / PARAMS.motion.rest_turn_sd_rad) ** 2 / 2, rel=0.01)
