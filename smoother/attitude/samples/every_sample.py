"""The answer of a window: at its states, and from these at every IMU sample.

The calibrated gyro is integrated from each state to the next, and the remaining difference is spread in proportion to
time: the error redistribution of Elmi Aziz and Mohseni Araste (2021), over 0.1 s. Covariances are interpolated.
"""

from dataclasses import dataclass

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
from stillpoint.smoother.attitude.keys import Keys, Motion
from stillpoint.smoother.attitude.magnetometer import field_matrix
from stillpoint.smoother.attitude.params import GraphParams
from stillpoint.smoother.attitude.solve import Solution, rotations_of

_COVARIANCE_STEP_S = 0.3


@dataclass(frozen=True, eq=False)
class Track:
    """Position and velocity at N samples, with covariances, in East-North-Up of the first fix."""

    position_n_m: Floats  # (N, 3)
    velocity_n_mps: Floats  # (N, 3)
    position_cov_n_m2: Floats  # (N, 3, 3)
    velocity_cov_n_m2ps2: Floats  # (N, 3, 3)


@dataclass(frozen=True, eq=False)
class Samples:
    """The answer at N neighbouring samples, with covariances before the variance factor."""

    rows: slice
    q_nb: Floats  # (N, 4)
    cov_b_rad2: Floats  # (N, 3, 3) relative to the mean heading and the mean mounting
    gyro_bias_b_radps: Floats  # (N, 3)
    track: Track | None  # where there are satellites


@dataclass(frozen=True, eq=False)
class Path:
    """Position and velocity at states, with covariances at the states at which those of a piece are known."""

    t_s: Floats  # (p,)
    position_n_m: Floats  # (p, 3)
    velocity_n_mps: Floats  # (p, 3)
    position_cov_n_m2: Floats  # (m, 3, 3)
    velocity_cov_n_m2ps2: Floats  # (m, 3, 3)


@dataclass(frozen=True, eq=False)
class Piece:
    """The answer at the n states of a window, with covariances before the variance factor.

    It takes a tenth of the memory of the answer at the samples, which :func:`sample_piece` makes from it.
    """

    row: NDArray[np.int64]  # (n,) the sample at which a state stands
    t_s: Floats  # (n,)
    q_nb: Floats  # (n, 4)
    bias_step: NDArray[np.int64]  # (n,) which bias holds from the state on
    gyro_bias_b_radps: Floats  # (k, 3)
    chosen: NDArray[np.int64]  # (m,) the states whose covariances are known
    cov_b_rad2: Floats  # (m, 3, 3) relative to the mean heading and the mean mounting
    path: Path | None  # where there are satellites
    heading_rad2: float  # variance of the mean heading
    mounting_b_rad2: Floats  # (3, 3) covariance of the mean mounting
    closing_squares: tuple[float, ...]  # of the returns, see returns.py
    common_q_nb: Floats | None  # (4,) common attitude of the rests in the base pose; None without returns
    calibration: Calibration
    late_sd_s: float  # of the accelerometer's delay
    field_widening: float  # factor on the sd of the magnetometer, whose errors last
    iterations: int
    cost: float

    @property
    def rows(self) -> slice:
        """Return the samples of the window."""
        return slice(int(self.row[0]), int(self.row[-1]) + 1)


def make_piece(window: Evidence, solution: Solution, until: int, name: str, params: GraphParams) -> Piece:
    """Return a window's solution at its states; of its returns, only those before state ``until`` are its own."""
    keys, values = window.keys, solution.values
    held = np.array(keys.held)
    chosen = _choose_covariance_states(keys)
    resting = np.append(keys.at_rest, keys.at_rest[-1])[held]
    counted = held if resting.all() else held[~resting]
    own = tuple(state for state in window.return_states()[1] if state < until)
    placed = window.fixes is not None
    accuracy = compute_accuracy(solution, chosen, counted, own, name, params, with_velocity=placed)
    step = bias_steps(keys, params)[held]
    found = np.array([values.atConstantBias(B(k)).gyroscope() for k in range(step[0], step[-1] + 1)])
    calibration = _read_calibration(solution, int(step[0]), accuracy.calibration)
    assert calibration.gyro_matrix is not None
    return Piece(
        row=keys.row[held],
        t_s=keys.t_s[held],
        q_nb=quaternion(Rotation.from_matrix(rotations_of(values, held))),
        bias_step=step - step[0],
        gyro_bias_b_radps=np.linalg.solve(calibration.gyro_matrix, found.T).T,
        chosen=chosen - held[0],
        cov_b_rad2=accuracy.attitude_b_rad2,
        path=_read_path(keys, solution, accuracy) if placed else None,
        heading_rad2=accuracy.heading_rad2,
        mounting_b_rad2=accuracy.mounting_b_rad2,
        closing_squares=accuracy.closing_squares,
        common_q_nb=_read_common_pose(values),
        calibration=calibration,
        late_sd_s=float(np.sqrt(accuracy.calibration[18, 18])),
        field_widening=solution.field_widening,
        iterations=len(solution.q_steps_rad),
        cost=solution.cost,
    )


def sample_attitudes(piece: Piece, motion: Motion) -> tuple[Floats, Floats]:
    """Return attitude (N, 4) and gyro bias (N, 3) of a window at each of its samples."""
    rows, gyro_matrix = piece.rows, piece.calibration.gyro_matrix
    assert gyro_matrix is not None
    state = np.clip(np.searchsorted(piece.t_s, motion.t_s[rows], side="right") - 1, 0, len(piece.t_s) - 1)
    bias = piece.gyro_bias_b_radps[piece.bias_step[state]]
    rate = (motion.gyro_b_radps[rows] - bias) @ gyro_matrix.T
    return _interpolate_attitudes(piece.row - rows.start, piece.q_nb, rate, motion.dt_s[rows]), bias


def sample_piece(piece: Piece, motion: Motion) -> Samples:
    """Return the answer of a window at each of its samples."""
    rows = piece.rows
    q_nb, bias = sample_attitudes(piece, motion)
    t_s, cov_t_s = motion.t_s[rows], piece.t_s[piece.chosen]
    return Samples(
        rows=rows,
        q_nb=q_nb,
        cov_b_rad2=_interpolate_covariances(t_s, q_nb, cov_t_s, piece.cov_b_rad2, piece.q_nb[piece.chosen]),
        gyro_bias_b_radps=bias,
        track=None if piece.path is None else _sample_path(t_s, piece.path, cov_t_s),
    )


def _read_path(keys: Keys, solution: Solution, accuracy: Accuracy) -> Path:
    """Return position and velocity at the states that have both, and their covariances."""
    held = np.array(keys.held)
    held = held[[solution.values.exists(V(int(i))) for i in held]]
    assert accuracy.velocity_n_m2ps2 is not None
    return Path(
        t_s=keys.t_s[held],
        position_n_m=np.array([solution.values.atPose3(X(int(i))).translation() for i in held]),
        velocity_n_mps=np.array([solution.values.atVector(V(int(i))) for i in held]),
        position_cov_n_m2=accuracy.position_n_m2,
        velocity_cov_n_m2ps2=accuracy.velocity_n_m2ps2,
    )


def _sample_path(t_s: Floats, path: Path, cov_t_s: Floats) -> Track:
    """Return position and velocity at the samples ``t_s`` (N,): cubic polynomials from state to state."""
    spline = CubicHermiteSpline(path.t_s, path.position_n_m, path.velocity_n_mps)
    return Track(
        position_n_m=spline(t_s),
        velocity_n_mps=spline(t_s, 1),
        position_cov_n_m2=_interpolate(t_s, cov_t_s, path.position_cov_n_m2),
        velocity_cov_n_m2ps2=_interpolate(t_s, cov_t_s, path.velocity_cov_n_m2ps2),
    )


def _interpolate(t_s: Floats, key_t_s: Floats, values: Floats) -> Floats:
    """Return values (N, ...) linear in time between those at keys (m, ...)."""
    right = np.clip(np.searchsorted(key_t_s, t_s, side="right"), 1, len(key_t_s) - 1)
    left = right - 1
    share = ((t_s - key_t_s[left]) / (key_t_s[right] - key_t_s[left])).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray((1 - share) * values[left] + share * values[right])


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
