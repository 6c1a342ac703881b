"""The magnetometer in the graph: b(t) = (1 + S) R(t - d)^T m + h.

The local field m, the hard iron h, the delay d and the matrix S (scale, axes, soft iron) are unknown: H, 16 numbers.

gtsam has no factor with these unknowns. The equation is linearised here in every iteration, with Geman-McClure weights
whose scale shrinks to its final value (graduated non-convexity). During the delay the body turns at the gyro's rate:
R(t - d) = R(t) exp(-w d).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import H, X
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.spatial.transform import Rotation

from stillpoint.datasets.frames import rotation
from stillpoint.datasets.recording import Floats, Mag
from stillpoint.smoother.attitude.keys import Keys, Motion
from stillpoint.smoother.attitude.linear.rows import Rows
from stillpoint.smoother.attitude.params import FieldParams

FIRST_SCALE = 4.0  # times sd_ut, in the first iteration
_SHRINK = 0.6  # from iteration to iteration
UNKNOWNS = 16  # 3 of the local field, 3 of the hard iron, 1 delay, 9 of the matrix
_HEADING_SD_UT = 1e-3  # sd of the field across its known direction, which defines the heading
_LONGEST_S = 10.0  # over which errors of the field are compared with each other
_LEAST_CORRELATION = 0.05  # an autocorrelation below this ends the sum
_STRETCH_S = 20.0  # over which the size of the field's errors is taken
_ORDINARY = 0.5  # times ``sd_ut``: beyond it by so much, the sd of errors is still one of ordinary rooms
_MEDIAN_LENGTH = 1.538  # of a vector (3,) of independent errors of sd 1
_LATE_S = 0.04  # a phone's magnetometer is late by about this; the rate is averaged over this time before a state


@dataclass(frozen=True, eq=False)
class FieldMeasurements:
    """One measurement at each of K states."""

    state: NDArray[np.int64]  # (K,)
    field_b_ut: Floats  # (K, 3)
    gyro_b_radps: Floats  # (K, 3) mean over _LATE_S before the state
    widening: Floats  # (K,) factor on the sd, 1 where nothing but the field holds the heading and it is not disturbed

    def at(self, states: range) -> "FieldMeasurements | None":
        """Return the measurements at some of the states, None where there are none."""
        there = (self.state >= states.start) & (self.state < states.stop)
        if not there.any():
            return None
        columns = self.field_b_ut[there], self.gyro_b_radps[there], self.widening[there]
        return FieldMeasurements(self.state[there], *columns)

    def with_returns(self, rest_states: Sequence[int], params: FieldParams) -> "FieldMeasurements":
        """Return the measurements with wider sd between the rests in the base pose, which hold the heading better."""
        held = np.zeros(len(self.state), dtype=np.bool_)
        if len(rest_states) > 1:
            held = (self.state >= min(rest_states)) & (self.state <= max(rest_states))
        return replace(self, widening=np.where(held, params.widening_with_returns, 1.0))


def select_measurements(
    keys: Keys, motion: Motion, mag: Mag, t0_ns: int, params: FieldParams
) -> FieldMeasurements | None:
    """Return the field at states ``step_s`` apart, interpolated to their time; None if there are fewer than three.

    States farther than half a step from the nearest sample of the magnetometer get no measurement.
    """
    t_s = (mag.t_ns - t0_ns) / 1e9
    wanted_s = np.arange(keys.t_s[0], keys.t_s[-1], params.step_s)
    state = np.unique(np.searchsorted(keys.t_s, wanted_s))
    state = state[state < len(keys.t_s)]
    after = np.clip(np.searchsorted(t_s, keys.t_s[state]), 1, len(t_s) - 1)
    near = np.minimum(np.abs(t_s[after] - keys.t_s[state]), np.abs(keys.t_s[state] - t_s[after - 1]))
    state = state[near <= params.step_s / 2]
    if len(state) < 3:
        return None
    field = np.stack([np.interp(keys.t_s[state], t_s, axis) for axis in mag.mag_b_ut.T], axis=1)
    first = np.searchsorted(motion.t_s, keys.t_s[state] - _LATE_S)
    turned = np.concatenate([np.zeros((1, 3)), np.cumsum(motion.gyro_b_radps, axis=0)])
    count = keys.row[state] + 1 - first
    rate = (turned[keys.row[state] + 1] - turned[first]) / count[:, None]
    return FieldMeasurements(state.astype(np.int64), field, rate, np.ones(len(state)))


def start_field(measured: FieldMeasurements, q_nb: Floats, iron_b_ut: Floats) -> Floats:
    """Return the start value of H (16,): the median field in n at attitudes ``q_nb`` (K, 4), and the hard iron (3,)."""
    field_n = rotation(q_nb).apply(measured.field_b_ut - iron_b_ut)
    return np.concatenate([np.median(field_n, axis=0), iron_b_ut, np.zeros(UNKNOWNS - 6)])


def field_prior(start: Floats, azimuth_rad: float, azimuth_known: bool, params: FieldParams) -> gtsam.PriorFactorVector:
    """Return the prior of H around its start value.

    If ``azimuth_known``, the field defines the heading: it points to ``azimuth_rad`` east of north.
    """
    level = np.hypot(start[0], start[1])
    mean = np.concatenate([[level * np.sin(azimuth_rad), level * np.cos(azimuth_rad), start[2]], start[3:]])
    sizes = np.repeat([params.field_sd_ut, params.iron_sd_ut, params.late_sd_s, params.matrix_sd], [3, 3, 1, 9])
    covariance = np.diag(sizes**2)
    if azimuth_known:
        across = np.array([np.cos(azimuth_rad), -np.sin(azimuth_rad), 0.0])
        along = np.array([np.sin(azimuth_rad), np.cos(azimuth_rad), 0.0])
        level_cov = _HEADING_SD_UT**2 * np.outer(across, across) + params.field_sd_ut**2 * np.outer(along, along)
        covariance[:2, :2] = level_cov[:2, :2]
    return gtsam.PriorFactorVector(H(0), mean, gtsam.noiseModel.Gaussian.Covariance(covariance))


def compute_residuals(measured: FieldMeasurements, rotations: Floats, field: Floats) -> Floats:
    """Return (1 + S) R(t - d)^T m + h - b, (K, 3) uT, for rotation matrices (K, 3, 3) and H (16,)."""
    return _predict_field(measured, rotations, field) @ field_matrix(field).T + field[3:6] - measured.field_b_ut


def field_matrix(field: Floats) -> Floats:
    """Return 1 + S, (3, 3), of H (16,)."""
    return np.asarray(np.eye(3) + field[7:].reshape(3, 3))


def _predict_field(measured: FieldMeasurements, rotations: Floats, field: Floats) -> Floats:
    """Return R(t - d)^T m, (K, 3): the field in the body when it was measured."""
    return np.einsum("kji,j->ki", rotations @ _turn_back(measured, field[6]), field[:3])


def _turn_back(measured: FieldMeasurements, late_s: float) -> Floats:
    """Return exp(-w d), (K, 3, 3): the turn from a state's attitude back to that when its field was measured."""
    return np.asarray(Rotation.from_rotvec(-late_s * measured.gyro_b_radps).as_matrix())


def compute_weights(residual: Floats, scale_ut: float, params: FieldParams) -> Floats:
    """Return the square roots of the Geman-McClure weights, (K,)."""
    return 1 / (1 + np.sum(residual**2, axis=1) / (params.robust * scale_ut) ** 2)


def find_inliers(residual: Floats, params: FieldParams) -> NDArray[np.bool_]:
    """Return which residuals (K, 3) in uT keep more than half of the root of their weight, (K,)."""
    return compute_weights(residual, params.sd_ut, params) > 0.5


def linearise_measurements(
    measured: FieldMeasurements,
    rotations: Floats,
    field: Floats,
    scale_ut: float,
    params: FieldParams,
) -> Rows:
    """Return the measurement equation linearised at the given attitudes and H (16,), weighted and whitened.

    The widening of a measurement multiplies its sd, but leaves the robust weights as they are.
    With s = R(t - d)^T m: a pose that turns by R exp(e) changes s by [s]x exp(w d) e, a longer delay by w x s.
    """
    residual, seen = compute_residuals(measured, rotations, field), _predict_field(measured, rotations, field)
    matrix = field_matrix(field)
    root = compute_weights(residual, scale_ut, params) / (scale_ut * measured.widening)
    back = _turn_back(measured, field[6])
    cross = np.zeros((len(seen), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2] = -seen[:, 2], seen[:, 1]
    cross[:, 1, 0], cross[:, 1, 2] = seen[:, 2], -seen[:, 0]
    cross[:, 2, 0], cross[:, 2, 1] = -seen[:, 1], seen[:, 0]
    by_pose = np.concatenate([matrix @ cross @ back.transpose(0, 2, 1), np.zeros_like(cross)], axis=2)
    by_late = np.cross(measured.gyro_b_radps, seen) @ matrix.T
    identity = np.broadcast_to(np.eye(3), rotations.shape)
    by_matrix = np.einsum("ij,kl->kijl", np.eye(3), seen).reshape(-1, 3, 9)
    by_place = matrix @ (rotations @ back).transpose(0, 2, 1)
    by_field = np.concatenate([by_place, identity, by_late[:, :, None], by_matrix], axis=2)
    by_pose, by_field = by_pose * root[:, None, None], by_field * root[:, None, None]
    target = -residual * root[:, None]
    count = len(measured.state)
    keys = np.stack([X(0) + measured.state, np.full(count, H(0))], axis=1)
    columns = np.concatenate([by_pose, by_field, target[:, :, None]], axis=2)
    return Rows(
        keys=keys.ravel(),
        key_first=2 * np.arange(count + 1),
        count=np.full(count, 3),
        data=columns.ravel(),
    )


@dataclass(frozen=True, eq=False)
class FieldErrors:
    """How large the field's errors are, and how long they last."""

    size_ut: Floats  # (K,) sd per axis in the stretch around each measurement, of errors that keep their weight
    typical_ut: Floats  # (K,) the same by the median of all errors, which no weight makes smaller
    lasting: float  # factor on the sd of a mean of many: K readings count as K / lasting^2


def measure_errors(rotations: Floats, residual_ut: Floats, params: FieldParams) -> FieldErrors:
    """Return size and duration of the field's errors by the residuals of a solution.

    Iron stands still and the sensor passes it, so errors of neighbouring readings are alike in the axes of n: K
    readings count as K / (1 + 2 sum of autocorrelation). ``rotations`` (K, 3, 3) body to n, ``residual_ut`` (K, 3).
    """
    scale_ut = max(params.sd_ut, float(np.median(np.linalg.norm(residual_ut, axis=1))))
    root = compute_weights(residual_ut, scale_ut, params)
    error = np.einsum("kij,kj->ki", rotations, residual_ut * root[:, None])
    n, total = len(error), float((error**2).sum())
    if total == 0.0:
        return FieldErrors(np.zeros(n), np.zeros(n), 1.0)
    lags = range(1, min(n // 4, int(_LONGEST_S / params.step_s)))
    alike = np.array([float((error[k:] * error[:-k]).sum()) / total * n / (n - k) for k in lags])
    ends = np.flatnonzero(alike < _LEAST_CORRELATION)
    lasting = np.sqrt(max(1.0, 1 + 2 * alike[: ends[0] if len(ends) else None].sum()))
    stretch = np.ones(min(n, 2 * int(_STRETCH_S / params.step_s / 2) + 1))
    count = np.convolve(np.ones(n), stretch, "same")
    square = np.convolve((error**2).mean(axis=1), stretch, "same") / count
    size = np.sqrt(square)
    typical = median_filter(np.linalg.norm(residual_ut, axis=1), len(stretch), mode="reflect") / _MEDIAN_LENGTH
    return FieldErrors(size, np.maximum(size, typical), float(lasting))


def widen_by_errors(measured: FieldMeasurements, errors: FieldErrors, params: FieldParams) -> FieldMeasurements:
    """Return measurements whose sd is at least what the errors of the field suggest for the estimate.

    White errors of this size and duration have the sd size x lasting. But the solution follows errors that last for a
    part of the recording, so that their residuals are too small and too short. With size x lasting^2 / 2 phones
    and BROAD trials in fields that wander by 5 uT over 15 s have the smallest errors of the rules that were tried.
    """
    widening = errors.size_ut * errors.lasting**2 / 2 / params.sd_ut - _ORDINARY
    return replace(measured, widening=np.maximum(measured.widening, widening))


def widen_for_covariance(counted: FieldMeasurements, errors: FieldErrors, params: FieldParams) -> FieldMeasurements:
    """Return measurements that count in an estimate with the sd that its covariance allows for.

    The size of the errors is their median here, because weights take a third off the rms of errors of 5 uT.
    """
    hidden = errors.typical_ut * errors.lasting**2 / params.sd_ut
    return replace(counted, widening=np.maximum(counted.widening, hidden))


def shrink_scale(scale_ut: float, residual: Floats, params: FieldParams) -> float:
    """Return the scale of the next iteration: smaller, at once the residuals' own size, and ``sd_ut`` at the least."""
    size = float(np.median(np.linalg.norm(residual, axis=1)))  # about sd for three axes
    return max(params.sd_ut, min(_SHRINK * scale_ut, max(size, params.sd_ut)))
