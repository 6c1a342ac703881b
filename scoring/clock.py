"""Find how late one attitude is against another from when they turn: no heading, mounting or drift can hide it.

The search has three steps. The rate of turning, a scalar that knows nothing of axes, is correlated over every offset at
which the two trajectories overlap by enough motion. Around the best of these offsets, and around zero, the turns
themselves are compared, with the mounting that fits best (Kabsch). Least squares in the best valley gives the offset.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from stillpoint.datasets.errors import Unobservable
from stillpoint.datasets.frames import compose, rotation
from stillpoint.datasets.recording import Floats, Times
from stillpoint.scoring.match import Mask, Track, interpolate_attitude, is_sparser, match

_USUAL_RANGE_S = 0.5  # clocks of one recording differ by less; a larger offset must be clearly better
_TURN_S = 0.1  # a turn is the rotation over this time: long against noise, under half a turn at 1800 deg/s
_COARSE_STEP_S = 0.02  # short against any swing of an arm
_COARSE_TURNS = 2_000  # enough to find the right valley
_FINE_TURNS = 20_000  # enough for 0.1 ms
_FINE_STEPS = 20
_FINE_ENOUGH_S = 1e-8
_FEWEST_TURNS = 10
_COMMON_MOTION = 0.5  # share of the shorter trajectory's motion that must overlap at an offset
_CANDIDATES = 12  # valleys of the correlation of rates that are looked into
_CLEARLY_BETTER = 0.8  # an offset is clear when its misfit is below this share of every other's
_GOOD = 0.75  # a misfit below which the best of all offsets needs no margin when it lies in the usual range
_TIE = 0.01  # misfits that differ by less are equal


@dataclass(frozen=True, eq=False)
class _Turns:
    """Turns of the sparser trajectory, and the denser one that is interpolated at their ends."""

    dense: Track
    pairs_ns: Times  # (2, N) first and last time of each turn
    turn: Floats  # (N, 3) rotation vectors in the body
    change: Floats  # (N, 3) their time derivative
    width_s: float  # the usual duration of a turn


def find_clock_offset_ns(estimated: Track, truth: Track, moving: Mask) -> int:
    """Return how late the estimate is against the moving samples (N,) of the truth, in ns; positive when late.

    Raises :class:`Unobservable` when they turn together by too little, or when no offset fits clearly better.
    """
    swap = is_sparser(estimated, truth)
    sparse, dense = (estimated, truth) if swap else (truth, estimated)
    turns = _list_turns(sparse, dense, None if swap else moving)
    if len(turns.turn) < _FEWEST_TURNS:
        raise Unobservable(
            f"{estimated.label}: overlaps the truth's motion by too little to align the clocks; align heading+mounting "
            "instead"
        )
    start_s = _find_valley(turns, estimated.label)
    offset_ns = round(_descend(turns, start_s) * 1e9)
    return -offset_ns if swap else offset_ns


def _list_turns(sparse: Track, dense: Track, moving: Mask | None) -> _Turns:
    """Return the turns of the sparser track, and the denser track to compare them with."""
    kept = ~sparse.unready if moving is None else moving & ~sparse.unready
    t_ns, q_nb = sparse.t_ns[kept], sparse.q_nb[kept]
    first, last = _find_pairs(t_ns, sparse.step_ns, _TURN_S)
    turn = _compute_rotation_vectors(q_nb[first], q_nb[last])
    pairs_ns = np.stack([t_ns[first], t_ns[last]])
    return _Turns(dense, pairs_ns, turn, _differentiate(t_ns[first], turn), max(_TURN_S, sparse.step_ns / 1e9))


def _find_pairs(t_ns: Times, step_ns: float, width_s: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return indices of samples about ``width_s`` apart, or one step apart where that is longer, without a gap."""
    if len(t_ns) < 2:
        return np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp)
    width = max(round(width_s * 1e9 / step_ns), 1)
    first = np.arange(max(len(t_ns) - width, 0))
    first = first[t_ns[first + width] - t_ns[first] < (width + 1.0) * step_ns]
    return first, first + width


def _compute_rotation_vectors(q_first: Floats, q_second: Floats) -> Floats:
    """Return rotation vectors (N, 3) from one attitude to the other, in the body."""
    return np.asarray(compose(rotation(q_first).inv(), rotation(q_second)).as_rotvec(), dtype=np.float64)


def _differentiate(t_ns: Times, turn: Floats) -> Floats:
    """Return the time derivative (N, 3) of a series of turns; 0 beside a gap, where it has no effect."""
    change = np.zeros_like(turn)
    if len(turn) < 3:
        return change
    wide_ns = t_ns[2:] - t_ns[:-2]
    whole = np.flatnonzero(wide_ns <= 2.5 * np.median(np.diff(t_ns)))
    change[whole + 1] = (turn[whole + 2] - turn[whole]) / (wide_ns[whole, None] / 1e9)
    return change


def _find_valley(turns: _Turns, label: str) -> float:
    """Return the offset in s of the valley with the smallest misfit; raises :class:`Unobservable` when none is clear.

    The misfit is relative: 0 when the turns agree, about 1 when they have nothing to do with each other. An offset
    within the usual range is taken when no other fits better, so that a periodic motion keeps its nearest period.
    """
    some = _choose_evenly(len(turns.turn), _COARSE_TURNS)
    usual = np.linspace(-_USUAL_RANGE_S, _USUAL_RANGE_S, round(2 * _USUAL_RANGE_S / _COARSE_STEP_S) + 1)
    around = np.arange(-turns.width_s, turns.width_s + _COARSE_STEP_S / 2, _COARSE_STEP_S)
    grids = [usual, *(centre_s + around for centre_s in _correlate_rates(turns))]
    found = [_find_lowest([_compute_misfit(turns, some, float(offset_s)) for offset_s in grid], grid) for grid in grids]
    near, near_s = found[0]
    best, offset_s = min(found)
    if near <= best + _TIE and abs(near_s) < _USUAL_RANGE_S - _COARSE_STEP_S / 2:
        best, offset_s = near, near_s
    rival = min((misfit for misfit, other_s in found if abs(other_s - offset_s) > 2 * turns.width_s), default=np.inf)
    usual_and_good = abs(offset_s) < _USUAL_RANGE_S and best < _GOOD
    if not usual_and_good and best > _CLEARLY_BETTER * min(rival, 1.0) - _TIE:
        raise Unobservable(
            f"{label}: no clock offset fits clearly better than all others (best {offset_s:+.2f} s, which leaves "
            f"{100 * min(best, 1.0):.0f} % of the turning unexplained); align heading+mounting instead, or check that "
            "both are of one recording"
        )
    return offset_s


def _find_lowest(misfits: list[float], grid: Floats) -> tuple[float, float]:
    place = int(np.argmin(misfits))
    return misfits[place], float(grid[place])


def _compute_misfit(turns: _Turns, some: NDArray[np.intp], offset_s: float) -> float:
    """Return the share of the turning that is unexplained at an offset, infinite where hardly any turns overlap."""
    rows, turn_e = _interpolate_turns(turns, some, offset_s)
    if len(rows) < _FEWEST_TURNS:
        return np.inf
    expected = turns.turn[rows]
    left = _fit_mounting(turn_e, expected)[1]
    return max(left, 0.0) * len(rows) / (float(np.sum(expected**2)) + float(np.sum(turn_e**2)) + 1e-300)


def _correlate_rates(turns: _Turns) -> Floats:
    """Return the offsets in s, at most :data:`_CANDIDATES`, at which the rates of turning correlate best.

    Pearson's correlation over the overlap, for every offset on a grid at once by FFT. Offsets at which less than half
    of the motion of the shorter trajectory overlaps are left out: there a few samples agree with anything.
    """
    sparse_s, sparse = turns.pairs_ns.mean(axis=0) / 1e9, np.linalg.norm(turns.turn, axis=1)
    dense_s, dense = _compute_rates(turns.dense, turns.width_s)
    if len(dense) < _FEWEST_TURNS:
        return np.empty(0)
    a_s, a, a_known = _resample_on_grid(sparse_s, sparse / (np.diff(turns.pairs_ns, axis=0)[0] / 1e9), turns.width_s)
    b_s, b, b_known = _resample_on_grid(dense_s, dense, turns.width_s)
    size = next_fast_len(len(a) + len(b), real=True)

    def correlate(x: Floats, y: Floats) -> Floats:  # at [k]: sum of x[i] y[i + k]
        """Return the circular cross-correlation of two padded series at every lag."""
        return np.asarray(irfft(np.conj(rfft(x, size)) * rfft(y, size), size))

    count = np.maximum(correlate(a_known, b_known), 1.0)
    sum_a, sum_b = correlate(a, b_known), correlate(a_known, b)
    square_a, square_b = correlate(a**2, b_known), correlate(a_known, b**2)
    covariance = correlate(a, b) - sum_a * sum_b / count
    spread = np.maximum(square_a - sum_a**2 / count, 0) * np.maximum(square_b - sum_b**2 / count, 0)
    enough = _COMMON_MOTION * min(float(np.sum(a**2)), float(np.sum(b**2)))
    valid = (count >= _FEWEST_TURNS) & (np.minimum(square_a, square_b) >= enough)
    score = np.where(valid, covariance / np.sqrt(spread + 1e-12 * spread.max() + 1e-300), -np.inf)
    peaks = np.flatnonzero((score >= np.roll(score, 1)) & (score > np.roll(score, -1)) & (score > 0))
    best = peaks[np.argsort(-score[peaks], kind="stable")[:_CANDIDATES]]
    lag = np.where(best > len(b), best - size, best)
    return np.asarray(lag * _COARSE_STEP_S + (b_s - a_s))


def _compute_rates(track: Track, width_s: float) -> tuple[Floats, Floats]:
    """Return middle times in s and rates of turning in rad/s of a trajectory, over turns of about ``width_s``."""
    t_ns, q_nb = track.t_ns[~track.unready], track.q_nb[~track.unready]
    first, last = _find_pairs(t_ns, track.step_ns, width_s)
    duration_s = (t_ns[last] - t_ns[first]) / 1e9
    rate = np.linalg.norm(_compute_rotation_vectors(q_nb[first], q_nb[last]), axis=1) / duration_s
    return (t_ns[first] + t_ns[last]) / 2e9, rate


def _resample_on_grid(t_s: Floats, values: Floats, longest_s: float) -> tuple[float, Floats, Floats]:
    """Return the start of an even grid, the values on it, and 1 where they are known and 0 in gaps."""
    grid = np.arange(t_s[0], t_s[-1] + _COARSE_STEP_S / 2, _COARSE_STEP_S)
    right = np.clip(np.searchsorted(t_s, grid), 1, max(len(t_s) - 1, 1))
    known = (t_s[right] - t_s[right - 1] <= 2 * longest_s).astype(np.float64)
    return float(t_s[0]), np.interp(grid, t_s, values) * known, known


def _interpolate_turns(turns: _Turns, some: NDArray[np.intp], offset_s: float) -> tuple[NDArray[np.intp], Floats]:
    """Return which of the turns the dense trajectory covers at an offset, and its own turns (M, 3) there."""
    first_ns, last_ns = turns.pairs_ns[:, some] + round(offset_s * 1e9)
    found = np.flatnonzero(match(turns.dense, first_ns).found & match(turns.dense, last_ns).found)
    q_first, q_last = (
        interpolate_attitude(turns.dense, first_ns[found]),
        interpolate_attitude(turns.dense, last_ns[found]),
    )
    return some[found], _compute_rotation_vectors(q_first, q_last)


def _choose_evenly(n: int, most: int) -> NDArray[np.intp]:
    """Return at most so many of n rows, evenly spread."""
    return np.unique(np.linspace(0, n - 1, min(most, n)).astype(np.intp))


def _fit_mounting(turn_e: Floats, turn_b: Floats) -> tuple[Floats, float]:
    """Return the matrix M with ``turn_e ~ M' turn_b`` (Kabsch), and the mean square of what is left."""
    u, s, vt = np.linalg.svd(turn_b.T @ turn_e)
    sign = np.sign(np.linalg.det(u @ vt))
    left = np.sum(turn_e**2) + np.sum(turn_b**2) - 2 * (s[0] + s[1] + sign * s[2])
    return u @ np.diag([1.0, 1.0, sign]) @ vt, float(left) / len(turn_e)


def _descend(turns: _Turns, start_s: float) -> float:
    """Return the offset in s at the bottom of the valley around ``start_s``."""
    some = _choose_evenly(len(turns.turn), _FINE_TURNS)
    bounds = start_s - _COARSE_STEP_S, start_s + _COARSE_STEP_S
    offset_s = start_s
    for _ in range(_FINE_STEPS):
        closer_s = float(np.clip(offset_s + _compute_clock_step(turns, some, offset_s), *bounds))
        moved_s, offset_s = abs(closer_s - offset_s), closer_s
        if moved_s < _FINE_ENOUGH_S:
            break
    return offset_s


def _compute_clock_step(turns: _Turns, some: NDArray[np.intp], offset_s: float) -> float:
    """Return the change of the offset that leaves no error along the sparse turns' own change, with the mounting.

    The least misfit would lie half a sample aside, as interpolation between two samples averages their noise; the
    change of the turns that are not interpolated has no part in that noise.
    """
    rows, turn_e = _interpolate_turns(turns, some, offset_s)
    if len(rows) < 2:
        return 0.0
    mounting, _ = _fit_mounting(turn_e, turns.turn[rows])
    expected, change = turns.turn[rows] @ mounting, turns.change[rows] @ mounting
    counts = np.any(change != 0, axis=1)
    expected, change, left = expected[counts], change[counts], (turn_e - expected)[counts]
    # left ~ expected x d(mounting) - change * d(offset)
    x, y, z = expected.T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    design = np.concatenate([cross, -change[..., None]], axis=2)
    normal = np.einsum("nki,nkj->ij", design, design)
    return float(np.linalg.lstsq(normal, np.einsum("nki,nk->i", design, left), rcond=1e-12)[0][3])
