"""Find a start value for the graph without a rest and without a filter: gyro bias, hard iron, tilt and heading.

In a block of a few seconds the gyro relates all attitudes to the block's first one. In its axes the mean specific force
of every half second points up and the field is constant. The gyro's bias turns them; the hard iron makes the field's
length depend on the attitude. Both follow from least squares over all blocks,

    R_k a_k = u_block,   R_k (m_k - h) = m_block,   d(R_k v)/db = -[R_k v]x (-int R dt),

robustly weighted, first with short blocks in which even a bias of 6 deg/s does little harm, then with longer ones. Up
and field then give each block's attitude in n independently, so that no error is carried from block to block.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.compiled import compiled, compiled_apart, compiled_entry
from stillpoint.datasets.frames import heading_rotation, quaternion, rotation, wrap
from stillpoint.datasets.quaternion import Quaternion, Vector, conjugate, exp, multiply
from stillpoint.datasets.recording import Floats, Mag
from stillpoint.smoother.attitude.keys import Motion
from stillpoint.smoother.missing import LONG_GAP_S
from stillpoint.smoother.strapdown import integrate

_BLOCKS_S = (3.0, 12.0, 24.0)
_LEVEL_BLOCK_S = 12.0  # of the attitudes that are returned
_NEIGHBOURS = 5  # blocks that decide on a heading together
_WINDOW_S = 0.5  # over which specific force and field are averaged
_SAMPLE_S = 0.02  # bias and iron are fitted to means over so long: finer ones change nothing
_FORCE_SD_MPS2 = 0.3  # of such a mean of the specific force, at the least
_FIELD_SD_UT = 2.0  # of such a mean of the field, at the least
_FIELD_WEIGHT_UT = 5.0  # that counts as much as 1 m/s^2
_EARTH_FIELD_UT = 45.0  # to which the field's size tends where the motion does not tell it from hard iron
_SIZE_SHARE = 0.05  # weight of the size: 20 uT off count like 1 uT of misfit
_BIAS_STEP_RADPS = 0.05  # the most that one iteration changes it
_BIAS_SETTLED_RADPS = 1e-4  # an iteration that changes it by less is the last: the graph's prior is 170 times wider
_ITERATIONS = 12


@dataclass(frozen=True, eq=False)
class Start:
    """Start values of the optimiser."""

    q_nb: Floats  # (N, 4) north is magnetic with a magnetometer, arbitrary without
    gyro_bias_b_radps: Floats  # (3,)
    hard_iron_b_ut: Floats  # (3,) zeros without magnetometer
    misfit: float  # median of the residuals in units of their sd: about 1 when the model holds


@dataclass(frozen=True, eq=False)
class _Samples:
    """Hold the data of the fit of bias and iron: means over SAMPLE_S, or the samples where those are as far apart."""

    t_s: Floats  # (N,) at the end of each
    dt_s: Floats  # (N,) the interval that ends there
    rate: Floats  # (N, 3)
    force: Floats  # (N, 3)
    field: Floats  # (N, 3) zeros without magnetometer
    middle: float  # share of the interval at which force and field were measured: 1 at its end, 1/2 amid it


@dataclass(frozen=True, eq=False)
class _Means:
    """Half-second means in the frame of each block's first sample, and their derivatives."""

    force: Floats  # (W, 3)
    field: Floats  # (W, 3) without hard iron
    turn: Floats  # (W, 3, 3) mean rotation: derivative of the field by the hard iron
    drift: Floats  # (W, 3, 3) rotation by a unit bias since the block's start


def find_start(
    motion: Motion, mag: Mag | None, t0_ns: int, rest_bias_b_radps: Floats | None, trusted: bool = False
) -> Start:
    """Return the start value; ``rest_bias_b_radps`` (3,) is the gyro's mean at rest, None without a rest.

    A ``trusted`` bias is kept as it is where there is no magnetometer.
    """
    if trusted and mag is None and rest_bias_b_radps is not None:
        iron = np.zeros(3)
        return Start(_compute_attitudes(motion, None, rest_bias_b_radps, iron), rest_bias_b_radps, iron, 0.0)
    field_b = None if mag is None else _interpolate_field(motion, mag, t0_ns)
    bias, iron, misfit = _find_bias_and_iron(motion, field_b, rest_bias_b_radps)
    return Start(_compute_attitudes(motion, field_b, bias, iron), bias, iron, misfit)


def _find_bias_and_iron(
    motion: Motion, field_b: Floats | None, rest_bias_b_radps: Floats | None
) -> tuple[Floats, Floats, float]:
    """Return gyro bias, hard iron and misfit of the best fit, from the rest bias or from two guesses."""
    guesses = [rest_bias_b_radps] if rest_bias_b_radps is not None else [np.median(motion.gyro_b_radps, axis=0)]
    if rest_bias_b_radps is None:
        guesses.append(np.zeros(3))
    samples = _average_samples(motion, field_b)
    found = [_fit_bias_and_iron(samples, guess, field_b is not None) for guess in guesses]
    return min(found, key=lambda each: each[2])


def _interpolate_field(motion: Motion, mag: Mag, t0_ns: int) -> Floats:
    t_s = (mag.t_ns - t0_ns) / 1e9
    field_b = np.empty((len(motion.t_s), 3))
    for axis in range(3):
        field_b[:, axis] = np.interp(motion.t_s, t_s, mag.mag_b_ut[:, axis])
    return field_b


def _average_samples(motion: Motion, field_b: Floats | None) -> _Samples:
    """Return the means of neighbouring samples over SAMPLE_S; none reaches across a long gap."""
    count = max(1, round(_SAMPLE_S / max(float(np.median(motion.dt_s)), 1e-9)))
    n = len(motion.t_s)
    first = np.union1d(np.arange(0, n, count), np.flatnonzero(motion.dt_s > LONG_GAP_S))
    size = np.diff(np.append(first, n))[:, None]
    dt_s = np.add.reduceat(motion.dt_s, first)
    turned = np.add.reduceat(motion.gyro_b_radps * motion.dt_s[:, None], first, axis=0)
    force = np.add.reduceat(motion.accel_b_mps2, first, axis=0) / size
    field = np.zeros_like(force) if field_b is None else np.add.reduceat(field_b, first, axis=0) / size
    last = np.append(first[1:], n) - 1
    rate = turned / np.maximum(dt_s, 1e-12)[:, None]
    return _Samples(motion.t_s[last], dt_s, rate, force, field, (count + 1) / (2 * count))


def _split_blocks(t_s: Floats, dt_s: Floats, length_s: float) -> NDArray[np.int64]:
    """Return the first of the samples (N,) of each block; a gap ends a block."""
    starts = [0]
    pieces = np.concatenate([[0], np.flatnonzero(dt_s > LONG_GAP_S), [len(t_s)]])
    for first, last in pairwise(pieces):
        if last > first:
            span_s = t_s[last - 1] - t_s[first]
            count = max(1, round(span_s / length_s))
            edges_s = t_s[first] + span_s * np.arange(count) / count
            starts.extend(np.searchsorted(t_s, edges_s - 1e-9).tolist())
    return np.unique(np.array(starts, dtype=np.int64))


def _fit_bias_and_iron(samples: _Samples, bias: Floats, magnetic: bool) -> tuple[Floats, Floats, float]:
    """Return gyro bias, hard iron and misfit by Gauss-Newton over blocks of growing length."""
    iron, misfit = np.zeros(3), np.inf
    bias = np.array(bias, dtype=np.float64)
    columns = samples.force, samples.field, samples.dt_s
    for length_s in _BLOCKS_S:
        starts = _split_blocks(samples.t_s, samples.dt_s, length_s)
        windows, block = _split_half_seconds(samples.t_s, starts)
        for _ in range(_ITERATIONS):
            means = _Means(*_block_means(samples.rate - bias, *columns, starts, windows, samples.middle))
            step, misfit = _solve_step(means, iron, block, magnetic)
            bias = bias + np.clip(step[:3], -_BIAS_STEP_RADPS, _BIAS_STEP_RADPS)
            iron = iron + step[3:]
            if np.abs(step[:3]).max() < _BIAS_SETTLED_RADPS:
                break
    return bias, iron, misfit


def _split_half_seconds(t_s: Floats, starts: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first sample of each half second within each block, (W + 1,) with the end, and its block."""
    block_of = np.repeat(np.arange(len(starts)), np.diff(np.append(starts, len(t_s))))
    number = np.floor((t_s - t_s[starts][block_of]) / _WINDOW_S).astype(np.int64)
    first = np.flatnonzero(np.diff(number, prepend=-1) | np.diff(block_of, prepend=-1))
    return np.append(first, len(t_s)).astype(np.int64), block_of[first].astype(np.int64)


@compiled_entry
def _block_means(
    rate: Floats,
    force: Floats,
    field: Floats,
    dt_s: Floats,
    starts: NDArray[np.int64],
    windows: NDArray[np.int64],
    middle: float,
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the four arrays of :class:`_Means` in one pass over the samples.

    Force and field are turned by the attitude at the share ``middle`` of the interval of their sample.
    """
    n_windows = len(windows) - 1
    mean_force, mean_field = np.zeros((n_windows, 3)), np.zeros((n_windows, 3))
    mean_turn, drift = np.zeros((n_windows, 3, 3)), np.zeros((n_windows, 3, 3))
    turn, swept, step, turned = np.eye(3), np.zeros((3, 3)), np.eye(3), np.eye(3)
    block = 0
    for w in range(n_windows):
        share = 1.0 / (windows[w + 1] - windows[w])
        for k in range(windows[w], windows[w + 1]):
            before_s, after_s = middle * dt_s[k], (1.0 - middle) * dt_s[k]
            if block < len(starts) and k == starts[block]:
                block += 1
                for i in range(3):  # assigning an array to a slice would take numba seconds to compile
                    for j in range(3):
                        turn[i, j] = 1.0 if i == j else 0.0
                swept[:] = 0.0
            else:
                _rotate_by(rate[k, 0] * before_s, rate[k, 1] * before_s, rate[k, 2] * before_s, step)
                _multiply(turn, step, turned)
                turn, turned = turned, turn
                for i in range(3):
                    for j in range(3):
                        swept[i, j] -= turn[i, j] * before_s
            for i in range(3):
                for j in range(3):
                    mean_force[w, i] += share * turn[i, j] * force[k, j]
                    mean_field[w, i] += share * turn[i, j] * field[k, j]
                    mean_turn[w, i, j] += share * turn[i, j]
                    drift[w, i, j] += share * swept[i, j]
            if middle < 1.0 and k > starts[block - 1]:
                _rotate_by(rate[k, 0] * after_s, rate[k, 1] * after_s, rate[k, 2] * after_s, step)
                _multiply(turn, step, turned)
                turn, turned = turned, turn
                for i in range(3):
                    for j in range(3):
                        swept[i, j] -= turn[i, j] * after_s
    return mean_force, mean_field, mean_turn, drift


@compiled_apart
def _multiply(left: Floats, right: Floats, out: Floats) -> None:
    """Write the product of two matrices (3, 3) to ``out``."""
    for i in range(3):
        for j in range(3):
            out[i, j] = left[i, 0] * right[0, j] + left[i, 1] * right[1, j] + left[i, 2] * right[2, j]


@compiled_apart
def _rotate_by(x: float, y: float, z: float, out: Floats) -> None:
    """Write the rotation matrix of a rotation vector (Rodrigues) to ``out``."""
    angle = np.sqrt(x * x + y * y + z * z)
    s = 1.0 if angle < 1e-9 else np.sin(angle) / angle
    c = 0.5 if angle < 1e-9 else (1.0 - np.cos(angle)) / (angle * angle)
    out[0, 0], out[0, 1], out[0, 2] = 1 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y
    out[1, 0], out[1, 1], out[1, 2] = c * x * y + s * z, 1 - c * (x * x + z * z), c * y * z - s * x
    out[2, 0], out[2, 1], out[2, 2] = c * x * z - s * y, c * y * z + s * x, 1 - c * (x * x + y * y)


def _solve_step(means: _Means, iron: Floats, block: NDArray[np.int64], magnetic: bool) -> tuple[Floats, float]:
    """Return one weighted least-squares step of (bias, hard iron), (6,), and the misfit before it."""
    force, force_by_bias = means.force, -_cross(means.force) @ means.drift
    weight, size = _compute_robust_weights(_subtract_block_mean(force, block), block, _FORCE_SD_MPS2)
    residual = _subtract_block_mean(force, block, weight)
    design = np.concatenate([_subtract_block_mean(force_by_bias, block, weight), np.zeros((len(force), 3, 3))], axis=2)
    rows, values = [np.sqrt(weight)[:, None, None] * design], [np.sqrt(weight)[:, None] * residual]
    misfit = size / _FORCE_SD_MPS2
    if magnetic:
        field = means.field - means.turn @ iron
        field_by_bias = -_cross(field) @ means.drift
        weight, size = _compute_robust_weights(_subtract_block_mean(field, block), block, _FIELD_SD_UT)
        both = np.concatenate([field_by_bias, -means.turn], axis=2)
        scale = np.sqrt(weight) / _FIELD_WEIGHT_UT
        rows.append(scale[:, None, None] * _subtract_block_mean(both, block, weight))
        values.append(scale[:, None] * _subtract_block_mean(field, block, weight))
        size_row, size_value = _pull_to_earth_size(field, means.turn, scale)
        rows.append(size_row)
        values.append(size_value)
        misfit += size / _FIELD_SD_UT
    design = np.concatenate([row.reshape(-1, 6) for row in rows])
    target = -np.concatenate([value.ravel() for value in values])
    normal = design.T @ design + np.diag([0.1] * 3 + [1e-3] * 3) ** 2
    return np.linalg.solve(normal, design.T @ target), misfit


def _pull_to_earth_size(field: Floats, turn: Floats, scale: Floats) -> tuple[Floats, Floats]:
    """Return rows (W, 6) and values (W,) that pull the field's size to that of the earth.

    Motion about the vertical alone does not separate the vertical parts of field and hard iron.
    """
    size = np.linalg.norm(field, axis=1)
    along = -np.einsum("wi,wij->wj", field / np.maximum(size, 1e-9)[:, None], turn)
    weight = _SIZE_SHARE * scale
    return np.concatenate([np.zeros_like(along), weight[:, None] * along], axis=1), weight * (size - _EARTH_FIELD_UT)


def _subtract_block_mean(values: Floats, block: NDArray[np.int64], weight: Floats | None = None) -> Floats:
    """Return values minus the weighted mean of their block."""
    weight = np.ones(len(values)) if weight is None else weight
    flat = values.reshape(len(values), -1)
    edges = np.flatnonzero(np.diff(block, prepend=-1))
    total = np.add.reduceat(flat * weight[:, None], edges, axis=0) / np.add.reduceat(weight, edges)[:, None]
    return (flat - total[block]).reshape(values.shape)


def _compute_robust_weights(residual: Floats, block: NDArray[np.int64], least: float) -> tuple[Floats, float]:
    """Return Geman-McClure weights, and the median size of the residuals."""
    length = np.linalg.norm(residual, axis=1)
    size = float(np.median(length))
    return 1 / (1 + (length / (2 * max(least, 1.48 * size))) ** 2) ** 2, size


def _cross(v: Floats) -> Floats:
    """Return cross-product matrices (W, 3, 3)."""
    x, y, z = v.T
    o = np.zeros_like(x)
    return np.stack([np.stack([o, -z, y], -1), np.stack([z, o, -x], -1), np.stack([-y, x, o], -1)], axis=1)


def _compute_attitudes(motion: Motion, field_b: Floats | None, bias: Floats, iron: Floats) -> Floats:
    """Return the attitude of every sample from the gyro, up over a block, and the field over neighbouring blocks.

    The gyro carries the heading from block to block; the field corrects it by the angle on which most of the
    neighbouring blocks agree, so that a passing magnet does not turn a block.
    """
    starts = _split_blocks(motion.t_s, motion.dt_s, _LEVEL_BLOCK_S)
    ends = np.append(starts[1:], len(motion.t_s))
    # Within a block, medians over _SAMPLE_S are as good as those over all samples.
    stride = max(1, int(_SAMPLE_S / max(float(np.median(motion.dt_s)), 1e-9)))
    step_s = motion.dt_s.copy()
    step_s[starts] = 0.0
    turn = np.empty((len(motion.t_s), 4))
    levels = []
    offsets = np.zeros(len(starts))
    before: Quaternion | None = None
    for block, (first, last) in enumerate(zip(starts, ends, strict=True)):
        rate = motion.gyro_b_radps[first:last] - bias
        turn[first:last] = integrate(np.array([1.0, 0.0, 0.0, 0.0]), rate, step_s[first:last])
        rows = slice(first, last, stride)
        some = rotation(turn[rows])
        up = np.median(some.apply(motion.accel_b_mps2[rows].copy()), axis=0)
        level = _level_block(up, before, rate[0], motion.dt_s[first])
        levels.append(level)
        before = multiply(level, tuple(turn[last - 1].tolist()))
        if field_b is not None:
            east, north, _ = _rotate(level, np.median(some.apply(field_b[rows] - iron), axis=0))
            offsets[block] = np.arctan2(east, north)
    if field_b is not None:
        piece = np.cumsum(motion.dt_s[starts] > LONG_GAP_S)
        offsets = np.concatenate([_take_circular_median(offsets[piece == number]) for number in np.unique(piece)])
    _turn_blocks(quaternion(heading_rotation(offsets) * rotation(levels)), starts, turn)
    return turn


@compiled
def _turn_blocks(of_block: Floats, starts: NDArray[np.int64], turn: Floats) -> None:
    """Make attitudes with w >= 0 of what samples have turned since their block began, in place (N, 4)."""
    block = -1
    for k in range(len(turn)):
        if block + 1 < len(starts) and k == starts[block + 1]:
            block += 1
        left = (of_block[block, 0], of_block[block, 1], of_block[block, 2], of_block[block, 3])
        q = multiply(left, (turn[k, 0], turn[k, 1], turn[k, 2], turn[k, 3]))
        sign = 1.0 if q[0] >= 0 else -1.0
        for axis in range(4):
            turn[k, axis] = sign * q[axis]


def _take_circular_median(angles: Floats) -> Floats:
    """Return each angle replaced by the circular median of its neighbours."""
    half = _NEIGHBOURS // 2
    agreed = np.empty(len(angles))
    for k in range(len(angles)):
        around = angles[max(0, k - half) : k + half + 1]
        agreed[k] = around[np.abs(wrap(around[:, None] - around[None, :])).sum(axis=1).argmin()]
    return agreed


def _level_block(up: Floats, before: Quaternion | None, rate: Floats, dt_s: float) -> Quaternion:
    """Return the rotation that levels a block and continues the heading of the attitude before it."""
    predicted: Quaternion = (1.0, 0.0, 0.0, 0.0)
    if before is not None:
        x, y, z = (rate * min(dt_s, LONG_GAP_S)).tolist()
        predicted = multiply(before, exp((x, y, z)))
    if not up.any():
        return predicted  # a sensor that reads nothing but zeros
    x, y, z = _rotate(predicted, up / np.linalg.norm(up))
    if z <= -1 + 1e-12:
        return multiply((0.0, 1.0, 0.0, 0.0), predicted)  # straight down: half a turn about x
    size = float(np.sqrt((1 + z) ** 2 + x**2 + y**2))
    return multiply(((1 + z) / size, y / size, -x / size, 0.0), predicted)  # the smallest rotation to (0, 0, 1)


def _rotate(q: Quaternion, vector: Floats) -> Vector:
    """Return a vector (3,) rotated by a quaternion, which takes scipy a hundred times as long."""
    x, y, z = vector.tolist()
    _, x, y, z = multiply(multiply(q, (0.0, x, y, z)), conjugate(q))
    return x, y, z
