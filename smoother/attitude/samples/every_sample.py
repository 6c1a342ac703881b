"""From states to samples: attitude, covariance and gyro bias at every IMU sample of a window.

The calibrated gyro is integrated from each state to the next, and the remaining difference is spread in proportion to
time: the error redistribution of Elmi Aziz and Mohseni Araste (2021), over 0.1 s. Covariances are interpolated.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, H, L, M, V, X
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation

from stillpoint.datasets.compiled import compiled
from stillpoint.datasets.frames import quaternion, rotation
from stillpoint.datasets.quaternion import Quaternion, conjugate, exp, log, multiply
from stillpoint.datasets.recording import Floats, Times
from stillpoint.datasets.trajectory import Calibration
from stillpoint.smoother.attitude.covariance import Accuracy, compute_accuracy
from stillpoint.smoother.attitude.evidence import Evidence
from stillpoint.smoother.attitude.factors import bias_steps
from stillpoint.smoother.attitude.keys import Keys
from stillpoint.smoother.attitude.magnetometer import field_matrix
from stillpoint.smoother.attitude.params import GraphParams
from stillpoint.smoother.attitude.solve import Solution, rotations_of

_COVARIANCE_STEP_S = 0.3


@dataclass(frozen=True, eq=False)
class Track:
    """Position and velocity at the N samples of a window, with covariances, in East-North-Up of the first fix."""

    position_n_m: Floats  # (N, 3)
    velocity_n_mps: Floats  # (N, 3)
    position_cov_n_m2: Floats  # (N, 3, 3)
    velocity_cov_n_m2ps2: Floats  # (N, 3, 3)


@dataclass(frozen=True, eq=False)
class Piece:
    """The answer at the N samples of a window, with covariances before the variance factor."""

    samples: slice
    q_nb: Floats  # (N, 4)
    cov_b_rad2: Floats  # (N, 3, 3) relative to the mean heading and the mean mounting
    gyro_bias_b_radps: Floats  # (N, 3)
    heading_rad2: float  # variance of the mean heading
    mounting_b_rad2: Floats  # (3, 3) covariance of the mean mounting
    closing_squares: tuple[float, ...]  # of the returns, see returns.py
    common_q_nb: Floats | None  # (4,) common attitude of the rests in the base pose; None without returns
    calibration: Calibration
    late_sd_s: float  # of the accelerometer's delay
    field_widening: float  # factor on the sd of the magnetometer, whose errors last
    iterations: int
    cost: float
    track: Track | None  # where there are satellites


def sample_solution(window: Evidence, solution: Solution, until: int, name: str, params: GraphParams) -> Piece:
    """Return a window's solution at every sample; of its returns, only those before state ``until`` are its own."""
    keys, motion, values = window.keys, window.motion, solution.values
    held = np.array(keys.held)
    chosen = _choose_covariance_states(keys)
    resting = np.append(keys.at_rest, keys.at_rest[-1])[held]
    counted = held if resting.all() else held[~resting]
    own = tuple(state for state in window.return_states()[1] if state < until)
    placed = window.fixes is not None
    accuracy = compute_accuracy(solution, chosen, counted, own, name, params, with_velocity=placed)

    gyro_matrix = np.eye(3) - values.atVector(M(0))[9:18].reshape(3, 3)
    samples = slice(keys.row[held[0]], keys.row[held[-1]] + 1)
    t_s, dt_s = motion.t_s[samples], motion.dt_s[samples]
    step = bias_steps(keys, params)[held]
    found = np.array([values.atConstantBias(B(k)).gyroscope() for k in range(step[0], step[-1] + 1)])
    biases = np.linalg.solve(gyro_matrix, found.T).T
    of_sample = step[np.clip(np.searchsorted(keys.t_s[held], t_s, side="right") - 1, 0, len(held) - 1)] - step[0]
    rate = (motion.gyro_b_radps[samples] - biases[of_sample]) @ gyro_matrix.T
    key_q = quaternion(Rotation.from_matrix(rotations_of(values, held)))
    q_nb = _interpolate_attitudes(keys.row[held] - samples.start, key_q, rate, dt_s)
    cov = _interpolate_covariances(t_s, q_nb, keys.t_s[chosen], accuracy.attitude_b_rad2, key_q[chosen - held[0]])
    return Piece(
        samples=samples,
        q_nb=q_nb,
        cov_b_rad2=cov,
        gyro_bias_b_radps=biases[of_sample],
        heading_rad2=accuracy.heading_rad2,
        mounting_b_rad2=accuracy.mounting_b_rad2,
        closing_squares=accuracy.closing_squares,
        common_q_nb=_read_common_pose(values),
        calibration=_read_calibration(solution, int(step[0]), accuracy.calibration),
        late_sd_s=float(np.sqrt(accuracy.calibration[18, 18])),
        field_widening=solution.field_widening,
        iterations=len(solution.q_steps_rad),
        cost=solution.cost,
        track=_sample_track(t_s, keys, solution, chosen, accuracy) if placed else None,
    )


def _sample_track(t_s: Floats, keys: Keys, solution: Solution, chosen: NDArray[np.int64], accuracy: Accuracy) -> Track:
    """Return position and velocity at the samples ``t_s`` (N,): cubic polynomials from state to state."""
    held = np.array(keys.held)
    held = held[[solution.values.exists(V(int(i))) for i in held]]
    place = np.array([solution.values.atPose3(X(int(i))).translation() for i in held])
    velocity = np.array([solution.values.atVector(V(int(i))) for i in held])
    path = CubicHermiteSpline(keys.t_s[held], place, velocity)
    assert accuracy.velocity_n_m2ps2 is not None
    return Track(
        position_n_m=path(t_s),
        velocity_n_mps=path(t_s, 1),
        position_cov_n_m2=_interpolate(t_s, keys.t_s[chosen], accuracy.position_n_m2),
        velocity_cov_n_m2ps2=_interpolate(t_s, keys.t_s[chosen], accuracy.velocity_n_m2ps2),
    )


def _interpolate(t_s: Floats, key_t_s: Floats, values: Floats) -> Floats:
    """Return values (N, ...) linear in time between those at keys (m, ...)."""
    right = np.clip(np.searchsorted(key_t_s, t_s, side="right"), 1, len(key_t_s) - 1)
    left = right - 1
    share = ((t_s - key_t_s[left]) / (key_t_s[right] - key_t_s[left])).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray((1 - share) * values[left] + share * values[right])


def join_pieces(pieces: Sequence[Piece], t_s: Floats) -> Piece:
    """Return one piece of all; in an overlap the answer goes over linearly in time from one window to the next.

    The mean heading is as well known as in the best window; the excess variance of another window's mean heading is
    added to its own covariance. Mounting and calibration are those of the last window, which has seen all data.
    """
    if len(pieces) == 1:
        return pieces[0]
    best = min(piece.heading_rad2 for piece in pieces)
    n = len(t_s)
    q_nb, cov, bias = np.empty((n, 4)), np.empty((n, 3, 3)), np.empty((n, 3))
    done = 0
    for piece in pieces:
        here = piece.samples
        common, fresh = slice(here.start, done), slice(max(done, here.start), here.stop)
        old, new = done - here.start, slice(max(done - here.start, 0), None)
        up_b = rotation(piece.q_nb).as_matrix()[:, 2]
        cov_piece = piece.cov_b_rad2 + (piece.heading_rad2 - best) * up_b[:, :, None] * up_b[:, None, :]
        if old > 0:
            span_s = t_s[common] - t_s[here.start]
            share = (span_s / span_s[-1])[:, None]
            before = rotation(q_nb[common])
            step = (before.inv() * rotation(piece.q_nb[:old])).as_rotvec()
            q_nb[common] = quaternion(before * Rotation.from_rotvec(share * step))
            cov[common] = (1 - share[:, None]) * cov[common] + share[:, None] * cov_piece[:old]
            bias[common] = (1 - share) * bias[common] + share * piece.gyro_bias_b_radps[:old]
        q_nb[fresh], cov[fresh], bias[fresh] = piece.q_nb[new], cov_piece[new], piece.gyro_bias_b_radps[new]
        done = here.stop
    return replace(
        pieces[-1],
        samples=slice(0, n),
        q_nb=q_nb,
        cov_b_rad2=cov,
        gyro_bias_b_radps=bias,
        heading_rad2=best,
        iterations=max(piece.iterations for piece in pieces),
        cost=sum(piece.cost for piece in pieces),
        track=_join_tracks(pieces, t_s),
    )


def _join_tracks(pieces: Sequence[Piece], t_s: Floats) -> Track | None:
    """Return one track of all; in an overlap it goes over linearly in time from one window to the next."""
    tracks = [piece.track for piece in pieces if piece.track is not None]
    if len(tracks) < len(pieces):
        return None
    columns: dict[str, Floats] = {}
    for each in fields(Track):
        parts = [np.asarray(getattr(track, each.name)) for track in tracks]
        whole = np.empty((len(t_s), *parts[0].shape[1:]))
        done = 0
        for piece, part in zip(pieces, parts, strict=True):
            here, old = piece.samples, max(done - piece.samples.start, 0)
            if old > 0:
                span_s = t_s[here.start : done] - t_s[here.start]
                share = (span_s / span_s[-1]).reshape(-1, *[1] * (part.ndim - 1))
                whole[here.start : done] = (1 - share) * whole[here.start : done] + share * part[:old]
            whole[here.start + old : here.stop] = part[old:]
            done = here.stop
        columns[each.name] = whole
    return Track(**columns)


@compiled
def _interpolate_attitudes(key_rows: Times, key_q_nb: Floats, rate_b_radps: Floats, dt_s: Floats) -> Floats:
    """Return the attitude (N, 4) of every sample.

    ``key_rows`` (n,) rise from the first sample to the last; ``key_q_nb`` (n, 4); ``rate_b_radps`` (N, 3) calibrated;
    ``dt_s`` (N,). The gyro is integrated from each key to the next; the difference to that key's attitude is spread in
    proportion to time, so that the result passes through every key.
    """
    q_nb = np.empty((len(dt_s), 4))
    for i in range(len(key_rows) - 1):
        first, last = key_rows[i], key_rows[i + 1]
        q = (key_q_nb[i, 0], key_q_nb[i, 1], key_q_nb[i, 2], key_q_nb[i, 3])
        _store(q_nb, first, q)
        span_s = 0.0
        for k in range(first + 1, last + 1):
            a, b, c = rate_b_radps[k, 0] * dt_s[k], rate_b_radps[k, 1] * dt_s[k], rate_b_radps[k, 2] * dt_s[k]
            q = multiply(q, exp((a, b, c)))
            _store(q_nb, k, q)
            span_s += dt_s[k]
        end = (key_q_nb[i + 1, 0], key_q_nb[i + 1, 1], key_q_nb[i + 1, 2], key_q_nb[i + 1, 3])
        a, b, c = log(multiply(conjugate(q), end))
        elapsed_s = 0.0
        for k in range(first + 1, last + 1):
            elapsed_s += dt_s[k]
            share = elapsed_s / span_s
            q = (q_nb[k, 0], q_nb[k, 1], q_nb[k, 2], q_nb[k, 3])
            _store(q_nb, k, multiply(q, exp((a * share, b * share, c * share))))
    _store(q_nb, key_rows[-1], (key_q_nb[-1, 0], key_q_nb[-1, 1], key_q_nb[-1, 2], key_q_nb[-1, 3]))
    return q_nb


@compiled
def _store(q_nb: Floats, k: int, q: Quaternion) -> None:
    """Write a quaternion to row k, normalised."""
    norm = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for axis in range(4):
        q_nb[k, axis] = q[axis] / norm


def _choose_covariance_states(keys: Keys) -> NDArray[np.int64]:
    """Return the states of a window whose covariances are computed: the others hardly differ, and each takes long.

    One in COVARIANCE_STEP_S, the first and last of the window, those beside gaps, and those at the ends of rests.
    """
    states = np.array(keys.held)
    gap = keys.intervals(keys.gap)
    rest_end = keys.intervals(np.diff(keys.at_rest, append=keys.at_rest[-1:])) + 1
    cell = np.floor(keys.t_s[states] / _COVARIANCE_STEP_S)
    regular = states[np.flatnonzero(np.diff(cell, prepend=-1.0))]
    return np.unique(np.concatenate([regular, states[[0, -1]], gap, gap + 1, rest_end]))


def _interpolate_covariances(
    t_s: Floats, q_nb: Floats, key_t_s: Floats, key_cov_b_rad2: Floats, key_q_nb: Floats
) -> Floats:
    """Return covariances (N, 3, 3) in body axes at attitudes ``q_nb`` (N, 4), linear in time in the axes of n.

    ``key_cov_b_rad2`` (m, 3, 3) are known at attitudes ``key_q_nb`` (m, 4).
    """
    turn = rotation(key_q_nb).as_matrix()
    key_cov_n = turn @ key_cov_b_rad2 @ turn.transpose(0, 2, 1)
    right = np.clip(np.searchsorted(key_t_s, t_s, side="right"), 1, len(key_t_s) - 1)
    left = right - 1
    share = (t_s - key_t_s[left]) / (key_t_s[right] - key_t_s[left])
    return _mix_covariances(left, share, key_cov_n, rotation(q_nb).as_matrix())


@compiled
def _mix_covariances(left: Times, share: Floats, key_cov_n: Floats, turn: Floats) -> Floats:
    """Return R' C R (N, 3, 3) with C between ``key_cov_n`` (m, 3, 3) at ``left`` (N,) and the next, and R (N, 3, 3)."""
    cov_b = np.zeros_like(turn)
    mixed, half = np.empty((3, 3)), np.empty((3, 3))
    for k in range(len(left)):
        for i in range(3):
            for j in range(3):
                before, after = key_cov_n[left[k], i, j], key_cov_n[left[k] + 1, i, j]
                mixed[i, j] = (1.0 - share[k]) * before + share[k] * after
        for i in range(3):
            for j in range(3):
                half[i, j] = mixed[i, 0] * turn[k, 0, j] + mixed[i, 1] * turn[k, 1, j] + mixed[i, 2] * turn[k, 2, j]
        for i in range(3):
            for j in range(3):
                cov_b[k, i, j] = turn[k, 0, i] * half[0, j] + turn[k, 1, i] * half[1, j] + turn[k, 2, i] * half[2, j]
    return cov_b


def _read_common_pose(values: gtsam.Values) -> Floats | None:
    if not values.exists(L(0)):
        return None
    return quaternion(Rotation.from_matrix(values.atPose3(L(0)).rotation().matrix()))


def _read_calibration(solution: Solution, bias_step: int, covariance: Floats) -> Calibration:
    vector = solution.values.atVector(M(0))
    sd = np.sqrt(np.diagonal(covariance))
    field = solution.values.atVector(H(0)) if solution.values.exists(H(0)) else None
    return Calibration(
        gyro_matrix=np.eye(3) - vector[9:18].reshape(3, 3),
        gyro_matrix_sd=sd[9:18].reshape(3, 3),
        accel_matrix=np.eye(3) - vector[:9].reshape(3, 3),
        accel_matrix_sd=sd[:9].reshape(3, 3),
        matrix_covariance=covariance[:18, :18],
        accel_bias_b_mps2=solution.values.atConstantBias(B(bias_step)).accelerometer(),
        mag_matrix=None if field is None else np.asarray(np.linalg.inv(field_matrix(field)), dtype=np.float64),
        hard_iron_b_ut=None if field is None else field[3:6],
        field_n_ut=None if field is None else field[:3],
        clock_offset_s={"accel": float(vector[18])} | ({} if field is None else {"mag": float(field[6])}),
    )
