"""Factors of the attitude graph: what is known about a moving sensor, one small generator for each idea.

    X pose (attitude in n, place)   V velocity   C effective IMU bias of an interval
    B bias, one every 10 s          M calibration, one per recording   H field and hard iron (magnetometer.py)

      H ----+----------+               B0 ------- B1
            |          |              / |        /          C_i = B + M [w, a, da/dt]    (linear)
           X0 -- C0 -- X1 -- C1 -- X2 ...
           V0 --------- V1 -------- V2 ...      M touches every C_i
            |           |           |
        bounded     at rest:    X0 = L = X2 at a return to the base pose
        motion      V = 0, X1 = X2

All factors are gtsam's own. The calibration enters the preintegrated IMU factor through its bias.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, C, M, V, X

from stillpoint.datasets.frames import rotation
from stillpoint.datasets.recording import Floats
from stillpoint.smoother.attitude.keys import Keys, Motion
from stillpoint.smoother.attitude.params import GraphParams
from stillpoint.smoother.attitude.samples.compound import compound_samples

CALIBRATION = 19  # unknowns: 9 of the accelerometer matrix, 9 of the gyro matrix, 1 delay of the accelerometer
_EFFECTIVE_BIAS_SD = np.concatenate([np.full(3, 1e-3), np.full(3, 1e-4)])  # keeps C = B + M z soft enough to factorise
_FREE = gtsam.imuBias.ConstantBias()

_isotropic = gtsam.noiseModel.Isotropic.Sigma
_diagonal = gtsam.noiseModel.Diagonal.Sigmas


@dataclass(frozen=True, eq=False)
class Anchors:
    """The links of states to known attitudes or to each other; None where the window has no such state."""

    base: int | None  # index of the state in the base pose
    base_q_nb: Floats | None  # (4,) its attitude, if the recording carries one
    base_sd_rad: float
    first_q_nb: Floats | None  # (4,) weak prior of the first state's attitude
    first_cov_b_rad2: Floats  # (3, 3) its covariance


def bias_steps(keys: Keys, params: GraphParams) -> np.ndarray:
    """Return the number of the bias that holds at each state, (n,)."""
    return ((keys.t_s - keys.t_s[0]) / params.inertial.bias_step_s).astype(np.int64)


def imu_factors(motion: Motion, keys: Keys, bias_b_radps: Floats, g_mps2: float, params: GraphParams) -> Iterator:
    """Tie neighbouring states by what gyro and accelerometer measured between them, less the bias C."""
    start = gtsam.imuBias.ConstantBias(np.zeros(3), bias_b_radps)
    p, eye = params.inertial, np.eye(3)
    sizes = {
        "moving": (p.gyro_radps_rthz, p.accel_mps2_rthz),
        "rest": (p.gyro_rest_radps_rthz, p.accel_rest_mps2_rthz),
    }
    summed = {
        kind: gtsam.PreintegratedImuMeasurements(_noise(gyro**2 * eye, accel**2 * eye, g_mps2, params), start)
        for kind, (gyro, accel) in sizes.items()
    }
    intervals = keys.intervals(~keys.gap)
    measured = compound_samples(motion, keys.row, intervals, bias_b_radps)
    own_noise = keys.clipped | (keys.gyro_sampling_rad > 0).any(axis=1)
    parts = list(zip(measured.accel_b_mps2, measured.gyro_b_radps, measured.length_s.tolist(), strict=True))
    for i, (accel, gyro, length_s) in zip(intervals.tolist(), parts, strict=True):
        if own_noise[i]:
            between = gtsam.PreintegratedImuMeasurements(_interval_noise(keys, i, g_mps2, params), start)
        else:
            between = summed["rest" if keys.at_rest[i] else "moving"]
        between.resetIntegration()
        for part, seconds in enumerate(length_s):
            if seconds > 0:
                between.integrateMeasurement(accel[part], gyro[part], seconds)
        yield gtsam.ImuFactor(X(i), V(i), X(i + 1), V(i + 1), C(i), between)


def _noise(gyro_rad2ps: Floats, accel_m2ps3: Floats, g_mps2: float, params: GraphParams) -> gtsam.PreintegrationParams:
    """Return gtsam's parameters for the squared noise densities (3, 3) of both sensors."""
    noise = gtsam.PreintegrationParams.MakeSharedU(g_mps2)
    noise.setGyroscopeCovariance(gyro_rad2ps)
    noise.setAccelerometerCovariance(accel_m2ps3)
    noise.setIntegrationCovariance(params.motion.integration_sd_m_rts**2 * np.eye(3))
    return noise


def _interval_noise(keys: Keys, i: int, g_mps2: float, params: GraphParams) -> gtsam.PreintegrationParams:
    """Return the noise of an interval with readings that are replaced, wrong by a share of their excess, or slow."""
    p, seconds = params.inertial, keys.t_s[i + 1] - keys.t_s[i]
    gyro_rad2 = (p.gyro_beyond * keys.gyro_clipped_rad[i]) ** 2 + keys.gyro_sampling_rad[i] ** 2
    gyro = p.gyro_radps_rthz**2 + gyro_rad2 / seconds
    accel = p.accel_mps2_rthz**2 + (p.accel_beyond * keys.accel_clipped_mps[i]) ** 2 / seconds
    return _noise(np.diag(gyro), np.diag(accel), g_mps2, params)


def calibration_factors(keys: Keys, params: GraphParams) -> Iterator:
    """Tie the effective bias of an interval to bias and calibration: C = B + M [mean force, mean rate, jerk]."""
    noise, eye, step = _diagonal(_EFFECTIVE_BIAS_SD), np.eye(6), bias_steps(keys, params)
    # Without a linearisation point gtsam applies the factors to changes, and never sees a violation. The unknowns are
    # renamed afterwards: to make a ConstantBias for each takes longer than all else here.
    origin = gtsam.Values()
    origin.insert(C(0), _FREE)
    origin.insert(B(0), _FREE)
    origin.insert(M(0), np.zeros(CALIBRATION))
    intervals = keys.intervals(~keys.gap)
    by_matrix = np.zeros((len(intervals), 6, CALIBRATION))
    for axis in range(3):
        by_matrix[:, axis, 3 * axis : 3 * axis + 3] = keys.accel_b_mps2[intervals]
        by_matrix[:, 3 + axis, 9 + 3 * axis : 12 + 3 * axis] = keys.gyro_b_radps[intervals]
    by_matrix[:, :3, 18] = -keys.jerk_b_mps3[intervals]  # late by d: a_measured(t) = a(t - d) = a - d da/dt
    nothing, calibration = np.zeros(6), M(0)
    for i, k, each in zip(intervals.tolist(), step[intervals].tolist(), -by_matrix, strict=True):
        linear = gtsam.JacobianFactor(C(0), eye, B(0), -eye, calibration, each, nothing, noise)
        yield gtsam.LinearContainerFactor(linear, origin).rekey([C(i), B(k), calibration])


def bias_factors(keys: Keys, bias_b_radps: Floats, params: GraphParams) -> Iterator:
    """Keep the first bias near its start value, let it walk, and keep the calibration near identity."""
    p, step = params.inertial, bias_steps(keys, params)
    walk = np.concatenate([np.full(3, p.accel_bias_walk), np.full(3, p.gyro_bias_walk)]) * np.sqrt(p.bias_step_s)
    for k in range(step[keys.first], step[keys.held[-1]]):
        yield gtsam.BetweenFactorConstantBias(B(k), B(k + 1), _FREE, _diagonal(walk))
    if keys.first > 0:
        return
    start = gtsam.imuBias.ConstantBias(np.zeros(3), bias_b_radps)
    spread = np.concatenate([np.full(3, p.accel_bias_sd_mps2), np.full(3, p.gyro_bias_sd_radps)])
    yield gtsam.PriorFactorConstantBias(B(0), start, _diagonal(spread))
    sizes = [np.full(9, p.accel_matrix_sd), np.full(9, p.gyro_matrix_sd), np.full(1, p.accel_late_sd_s)]
    yield gtsam.PriorFactorVector(M(0), np.zeros(CALIBRATION), _diagonal(np.concatenate(sizes)))


def motion_factors(keys: Keys, placed: bool, params: GraphParams) -> Iterator:
    """Bound place and speed, as those of a hand, a table or a vehicle are; at rest the speed is zero.

    Where satellites show the place (``placed``), only rests are bounded.
    """
    p, zero = params.motion, np.zeros(3)
    span_s = np.append(keys.span_s, keys.span_s[-1])
    resting = np.concatenate([[False], keys.at_rest]) | np.concatenate([keys.at_rest, [False]])
    for i in keys.states:
        share = 1 / np.sqrt(min(span_s[i], 1.0))
        if resting[i]:
            yield gtsam.PriorFactorVector(V(i), zero, _isotropic(3, p.rest_velocity_sd_mps))
        elif not placed:
            yield gtsam.PriorFactorVector(V(i), zero, _isotropic(3, p.velocity_sd_mps * share))
        if not placed:
            yield gtsam.GPSFactor(X(i), zero, _isotropic(3, p.position_sd_m * share))


def rest_factors(keys: Keys, params: GraphParams) -> Iterator:
    """Keep neighbouring states equal during a rest."""
    p = params.motion
    still = _diagonal(np.concatenate([np.full(3, p.rest_turn_sd_rad), np.full(3, 1e-3)]))
    for i in keys.intervals(keys.at_rest & ~keys.gap):
        yield gtsam.BetweenFactorPose3(X(i), X(i + 1), gtsam.Pose3(), still)


def gap_factors(keys: Keys, params: GraphParams) -> Iterator:
    """Tie the states beside a gap loosely: it may hide a turn at ``gap_rate_sd`` and a move at the usual speed."""
    rate, speed = params.inertial.gap_rate_sd_radps, params.motion.velocity_sd_mps
    for i in keys.intervals(keys.gap):
        seconds = keys.span_s[i]
        loose = _diagonal(np.concatenate([np.full(3, min(rate * seconds, np.pi)), np.full(3, speed * seconds)]))
        yield gtsam.BetweenFactorPose3(X(i), X(i + 1), gtsam.Pose3(), loose)


def anchor_factors(anchors: Anchors, params: GraphParams) -> Iterator:
    """Tie the first state to its start attitude, and the base pose to a known one."""
    if anchors.first_q_nb is not None:
        first = gtsam.Pose3(_make_rot3(anchors.first_q_nb), np.zeros(3))
        covariance = np.zeros((6, 6))
        covariance[:3, :3], covariance[3:, 3:] = anchors.first_cov_b_rad2, np.diag([100.0] * 3)
        yield gtsam.PriorFactorPose3(X(0), first, gtsam.noiseModel.Gaussian.Covariance(covariance))
    if anchors.base is not None and anchors.base_q_nb is not None:
        noise = _diagonal(np.concatenate([np.full(3, anchors.base_sd_rad), np.full(3, 100.0)]))
        yield gtsam.PriorFactorPose3(X(anchors.base), gtsam.Pose3(_make_rot3(anchors.base_q_nb), np.zeros(3)), noise)


def start_values(
    keys: Keys, q_nb: Floats, place_n_m: Floats, velocity_n_mps: Floats, bias_b_radps: Floats, params: GraphParams
) -> gtsam.Values:
    """Return start values of a window's unknowns from attitudes (n, 4), places and velocities (n, 3)."""
    values = gtsam.Values()
    bias = gtsam.imuBias.ConstantBias(np.zeros(3), bias_b_radps)
    step = bias_steps(keys, params)
    for i, matrix in zip(keys.held, rotation(q_nb[keys.held]).as_matrix(), strict=True):
        values.insert(X(i), gtsam.Pose3(gtsam.Rot3(matrix), place_n_m[i]))
        values.insert(V(i), velocity_n_mps[i])
    for i in keys.intervals(~keys.gap):
        values.insert(C(i), bias)
    for k in range(step[keys.first], step[keys.held[-1]] + 1):
        values.insert(B(k), bias)
    values.insert(M(0), np.zeros(CALIBRATION))
    return values


def _make_rot3(q_nb: Floats) -> gtsam.Rot3:
    """Return gtsam's rotation for a quaternion wxyz."""
    return gtsam.Rot3.Quaternion(*(float(x) for x in q_nb))
