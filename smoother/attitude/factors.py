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

The factors here are gtsam's own. IMU, calibration and bounds of the motion, of which each tenth of a second has one,
stand as arrays in chain.py. The calibration enters the preintegrated IMU factor through its bias.
"""

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import pairwise

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, C, M, V, X

from stillpoint.datasets.frames import rotation
from stillpoint.datasets.recording import Floats
from stillpoint.smoother.attitude.keys import Keys
from stillpoint.smoother.attitude.params import GraphParams

CALIBRATION = 19  # unknowns: 9 of the accelerometer matrix, 9 of the gyro matrix, 1 delay of the accelerometer
_FREE = gtsam.imuBias.ConstantBias()

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
    """Return the number of the bias that holds at each state, (n,).

    A new one begins where rest and motion change, and every ``bias_step_s`` after that.
    """
    changes = np.diff(keys.at_rest)
    begun_s = keys.t_s[np.maximum.accumulate(np.where(np.append(False, changes), np.arange(len(changes) + 1), 0))]
    within = ((keys.t_s[: len(begun_s)] - begun_s) / params.inertial.bias_step_s).astype(np.int64)
    begins = np.zeros(len(keys.t_s), dtype=np.int64)
    begins[1:-1] = changes | (np.diff(within) > 0)
    return np.cumsum(begins)


def bias_factors(keys: Keys, bias_b_radps: Floats, params: GraphParams) -> Iterator:
    """Keep the first bias near its start value, let it walk, and keep the calibration near identity.

    Between rest and motion the gyro's bias shifts: vibration and a changed specific force act on it.
    """
    p, step = params.inertial, bias_steps(keys, params)
    begins = np.searchsorted(step, np.arange(step[keys.first], step[keys.held[-1]] + 1))
    for k, (begin, end) in enumerate(pairwise(begins.tolist()), step[keys.first]):
        seconds = keys.t_s[end] - keys.t_s[begin]
        shift = p.gyro_bias_shift_radps if keys.at_rest[end] != keys.at_rest[end - 1] else 0.0
        accel, gyro = p.accel_bias_walk * np.sqrt(seconds), np.hypot(p.gyro_bias_walk * np.sqrt(seconds), shift)
        change = _diagonal(np.repeat([accel, gyro], 3))
        yield gtsam.BetweenFactorConstantBias(B(k), B(k + 1), _FREE, change)
    if keys.first > 0:
        return
    start = gtsam.imuBias.ConstantBias(np.zeros(3), bias_b_radps)
    spread = np.concatenate([np.full(3, p.accel_bias_sd_mps2), np.full(3, p.gyro_bias_sd_radps)])
    yield gtsam.PriorFactorConstantBias(B(0), start, _diagonal(spread))
    known = np.diag(np.concatenate([np.full(18, p.accel_matrix_sd), [p.accel_late_sd_s]]) ** 2)
    known[9:18, 9:18] = p.gyro_matrix_covariance
    yield gtsam.PriorFactorVector(M(0), np.zeros(CALIBRATION), gtsam.noiseModel.Gaussian.Covariance(known))


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
    keys: Keys,
    q_nb: Floats,
    place_n_m: Floats,
    velocity_n_mps: Floats,
    bias_b_radps: Floats,
    effective: Collection[int],
    params: GraphParams,
) -> gtsam.Values:
    """Return start values of a window's unknowns from attitudes (n, 4), places and velocities (n, 3).

    Of the effective biases only those of the intervals ``effective`` are among them: those that gtsam's factors need.
    """
    values = gtsam.Values()
    bias = gtsam.imuBias.ConstantBias(np.zeros(3), bias_b_radps)
    step = bias_steps(keys, params)
    # By the names of its arguments gtsam finds the kind of a value at once; without, it tries to convert it to each.
    for i, matrix in zip(keys.held, rotation(q_nb[keys.held]).as_matrix(), strict=True):
        values.insert(j=X(i), pose3=gtsam.Pose3(gtsam.Rot3(matrix), place_n_m[i]))
        values.insert(V(i), velocity_n_mps[i])
    for i in effective:
        values.insert(j=C(i), constant_bias=bias)
    for k in range(step[keys.first], step[keys.held[-1]] + 1):
        values.insert(j=B(k), constant_bias=bias)
    values.insert(M(0), np.zeros(CALIBRATION))
    return values


def _make_rot3(q_nb: Floats) -> gtsam.Rot3:
    """Return gtsam's rotation for a quaternion wxyz."""
    return gtsam.Rot3.Quaternion(*(float(x) for x in q_nb))
