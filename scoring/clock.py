"""How late one attitude is against another, told from when they turn: no heading, mounting or drift can hide it."""

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.errors import Unobservable
from stillpoint.datasets.frames import rotation
from stillpoint.datasets.recording import Floats, Times
from stillpoint.scoring.match import Track, attitude_at, match

TIME_RANGE_S = 0.5  # clocks are searched within +- this
TURN_S = 0.1  # a turn is the rotation over this time: long against noise, under half a turn at 1800 deg/s
COARSE_STEP_S = 0.02  # of the first search: short against any swing of an arm
COARSE_TURNS = 2_000  # enough to find the right valley
FINE_TURNS = 20_000  # enough for 0.1 ms
FINE_STEPS = 20
FINE_ENOUGH_S = 1e-8


def clock_offset_ns(estimated: Track, t_ns: Times, q_true: Floats) -> int:
    """How late the estimate is against the given samples of the truth, (N,) and (N, 4), in ns; positive when late.

    A coarse search over +-0.5 s, then least squares in the best valley; samples nearer than 0.5 s to an end of the
    estimate are left out. Raises :class:`Unobservable` when too few are left.
    """
    margin = round(TIME_RANGE_S * 1e9)
    first, second = _pairs(t_ns)
    inside = (t_ns[first] - margin >= estimated.t_ns[0]) & (t_ns[second] + margin <= estimated.t_ns[-1])
    if inside.sum() < 10:
        raise Unobservable(
            f"{estimated.label}: overlaps the truth's motion by too little to align the clocks within "
            f"+-{TIME_RANGE_S} s; align heading+mounting instead"
        )
    pairs = np.stack([first[inside], second[inside]])
    turn_b = _turns(q_true[pairs[0]], q_true[pairs[1]])

    def misfit(offset_s: float, some: NDArray[np.intp]) -> float:
        rows, turn_e = _turns_at(estimated, t_ns[pairs[:, some]], offset_s)
        return _mounting_of_turns(turn_e, turn_b[some[rows]])[1] if len(rows) > 1 else np.inf

    some, more = _evenly(len(turn_b), COARSE_TURNS), _evenly(len(turn_b), FINE_TURNS)
    grid = np.linspace(-TIME_RANGE_S, TIME_RANGE_S, round(2 * TIME_RANGE_S / COARSE_STEP_S) + 1)
    start = float(grid[int(np.argmin([misfit(offset_s, some) for offset_s in grid]))])
    bounds = max(start - COARSE_STEP_S, -TIME_RANGE_S), min(start + COARSE_STEP_S, TIME_RANGE_S)
    change_b = _changes(t_ns[pairs[0]], turn_b)[more]
    offset_s = start
    for _ in range(FINE_STEPS):
        step_s = _clock_step(estimated, t_ns[pairs[:, more]], turn_b[more], change_b, offset_s)
        closer_s = float(np.clip(offset_s + step_s, *bounds))
        moved_s, offset_s = abs(closer_s - offset_s), closer_s
        if moved_s < FINE_ENOUGH_S:
            break
    return round(offset_s * 1e9)


def _evenly(n: int, most: int) -> NDArray[np.intp]:
    """At most so many of n rows, evenly spread."""
    return np.unique(np.linspace(0, n - 1, min(most, n)).astype(np.intp))


def _pairs(t_ns: Times) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices of samples about 0.1 s apart with no gap between."""
    if len(t_ns) < 2:
        return np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp)
    step_ns = float(np.median(np.diff(t_ns)))
    width = max(round(TURN_S * 1e9 / step_ns), 1)
    first = np.arange(max(len(t_ns) - width, 0))
    first = first[t_ns[first + width] - t_ns[first] < (width + 1.0) * step_ns]
    return first, first + width


def _turns(q_first: Floats, q_second: Floats) -> Floats:
    """Rotation vectors (N, 3) from one attitude to the other, in the body."""
    return np.asarray((rotation(q_first).inv() * rotation(q_second)).as_rotvec(), dtype=np.float64)


def _turns_at(estimated: Track, pairs_ns: Times, offset_s: float) -> tuple[NDArray[np.intp], Floats]:
    """Which of the pairs of times (2, N) the estimate covers, and its turns over these (M, 3)."""
    first_ns, second_ns = pairs_ns + round(offset_s * 1e9)
    rows = np.flatnonzero(match(estimated, first_ns).found & match(estimated, second_ns).found)
    return rows, _turns(attitude_at(estimated, first_ns[rows]), attitude_at(estimated, second_ns[rows]))


def _changes(t_ns: Times, turn: Floats) -> Floats:
    """Time derivative (N, 3) of a series of turns, 0 where a gap lies beside a sample: it then counts for nothing."""
    change = np.zeros_like(turn)
    wide_ns = t_ns[2:] - t_ns[:-2]
    whole = np.flatnonzero(wide_ns <= 2.5 * np.median(np.diff(t_ns)))
    change[whole + 1] = (turn[whole + 2] - turn[whole]) / (wide_ns[whole, None] / 1e9)
    return change


def _mounting_of_turns(turn_e: Floats, turn_b: Floats) -> tuple[Floats, float]:
    """The matrix M with ``turn_e ~ M' turn_b`` (Kabsch), and the mean square of what is left."""
    u, s, vt = np.linalg.svd(turn_b.T @ turn_e)
    sign = np.sign(np.linalg.det(u @ vt))
    left = np.sum(turn_e**2) + np.sum(turn_b**2) - 2 * (s[0] + s[1] + sign * s[2])
    return u @ np.diag([1.0, 1.0, sign]) @ vt, float(left) / len(turn_e)


def _clock_step(estimated: Track, pairs_ns: Times, turn_b: Floats, change_b: Floats, offset_s: float) -> float:
    """The change of the offset that leaves no error along the truth's own change, jointly with the mounting.

    The least misfit would be drawn half a sample aside, as interpolation between two samples averages their noise;
    the truth's change has no part in that noise.
    """
    rows, turn_e = _turns_at(estimated, pairs_ns, offset_s)
    if len(rows) < 2:
        return 0.0
    mounting, _ = _mounting_of_turns(turn_e, turn_b[rows])
    expected, change = turn_b[rows] @ mounting, change_b[rows] @ mounting
    counts = np.any(change != 0, axis=1)
    expected, change, left = expected[counts], change[counts], (turn_e - expected)[counts]
    # left ~ expected x d(mounting) - change * d(offset)
    x, y, z = expected.T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    design = np.concatenate([cross, -change[..., None]], axis=2)
    normal = np.einsum("nki,nkj->ij", design, design)
    return float(np.linalg.lstsq(normal, np.einsum("nki,nk->i", design, left), rcond=1e-12)[0][3])
