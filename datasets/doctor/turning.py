"""How a vector fixed in the world must turn in the body when the gyro turns: the physics of most tests.

Gravity and the local field obey dv/dt = v x w in body axes. Integrated over a short window, with whatever the gyro
measures as w', the change of v is *linear* in the unknowns: v x (M w' + b) for any matrix M between the true and
the measured rate (flips, swaps, scale), bias b, and (K w' T) for a constant offset h of v (hard iron: K = -h x M).
So lags, axes and scales are least squares, with no start value. Nothing is differentiated.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.recording import Floats, Imu, Times
from stillpoint.datasets.times import find_gaps

GRID_HZ = 100.0  # fast enough for a hand: at 1000 deg/s the midpoint rule over 10 ms errs by 0.25 %
WINDOW_S = 0.25
FEWEST_WINDOWS, MOST_WINDOWS = 12, 1500

# (a x b)_k = LEVI_CIVITA[k, l, i] a_l b_i
LEVI_CIVITA = np.zeros((3, 3, 3))
for _k, _l, _i in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    LEVI_CIVITA[_k, _l, _i], LEVI_CIVITA[_k, _i, _l] = 1.0, -1.0


@dataclass(frozen=True, eq=False)
class Series:
    """A column of vectors on its clock in seconds, ready to be integrated between any two times."""

    t_s: Floats  # (N,)
    integral: Floats  # (N, 3)
    values: Floats  # (N, 3)
    step_s: float
    gaps_s: Floats  # (G, 2) start and end of each gap

    def between(self, start_s: Floats, end_s: Floats) -> Floats:
        """Integral from each start to each end, (n, 3)."""
        return self._at(end_s) - self._at(start_s)

    def smooth_between(self, start_s: Floats, end_s: Floats) -> Floats:
        """As :meth:`between`, over spans whose ends fade within one step of the stream.

        With sharp ends, noise averages out the better the further the ends lie from the stamps, and a search for a lag
        between streams of one rate would settle there, half a step beside the true one.
        """
        quarter = self.step_s / 4
        early = self.between(start_s - quarter, end_s - quarter)
        return 0.5 * (early + self.between(start_s + quarter, end_s + quarter))

    def _at(self, t_s: Floats) -> Floats:
        return np.stack([np.interp(t_s, self.t_s, column) for column in self.integral.T], axis=1)

    def touches_gap(self, start_s: Floats, end_s: Floats) -> NDArray[np.bool_]:
        """Which spans overlap a gap."""
        inside = np.searchsorted(self.gaps_s[:, 1], start_s, side="right")
        return inside < np.searchsorted(self.gaps_s[:, 0], end_s, side="left")


def gyro_series(imu: Imu, origin_ns: int) -> Series:
    """The turn that the gyro measured: a sample describes the step that ends at its stamp."""
    return _series(imu.t_ns, imu.gyro_b_radps, origin_ns, imu.gyro_b_radps[1:])


def vector_series(t_ns: Times, values: Floats, origin_ns: int) -> Series:
    """Vectors that hold at their stamps."""
    return _series(t_ns, values, origin_ns, 0.5 * (values[1:] + values[:-1]))


def _series(t_ns: Times, values: Floats, origin_ns: int, over_step: Floats) -> Series:
    t_s = (t_ns - origin_ns) / 1e9
    steps = np.diff(t_s)
    median = float(np.median(steps))
    gap = np.flatnonzero(find_gaps(t_ns))  # over which nothing is integrated
    total = np.vstack([np.zeros(3), np.cumsum(over_step * steps[:, None], axis=0)])
    return Series(t_s, total, values, median, np.stack([t_s[gap], t_s[gap + 1]], axis=1))


@dataclass(frozen=True, eq=False)
class Windows:
    """Change of a vector and what the gyro measured meanwhile, for n windows of one length."""

    change: Floats  # (n, 3)
    cross: Floats  # (n, 3, 3) integral of v_l w_j dt at [l, j]
    turn: Floats  # (n, 3) integral of w dt
    mean_dt: Floats  # (n, 3) integral of v dt
    length_s: float

    def predicted(self, matrix: Floats, offset: Floats) -> Floats:
        """Integral of (v - offset) x (matrix @ w), (n, 3)."""
        turned = np.einsum("nlj,ij->nli", self.cross - offset[:, None] * self.turn[:, None, :], matrix)
        return np.einsum("kli,nli->nk", LEVI_CIVITA, turned)

    def design(self, offset: Floats) -> Floats:
        """Columns of M (9, row by row), b (3) and, when the offset is unknown, K (9): (n, 3, 21)."""
        n = len(self.change)
        matrix = np.einsum("kli,nlj->nkij", LEVI_CIVITA, self.cross).reshape(n, 3, 9)
        bias = np.einsum("kli,nl->nki", LEVI_CIVITA, self.mean_dt - offset * self.length_s)
        iron = np.einsum("ki,nj->nkij", np.eye(3), self.turn).reshape(n, 3, 9)
        return np.concatenate([matrix, bias, iron], axis=2)


class Grid:
    """Where the windows lie: every third of their length, where the gyro turns and neither stream has a gap."""

    def __init__(self, gyro: Series, vector: Series, reach_s: float) -> None:
        """``reach_s``: no window looks further than that over the ends, so that each lag within has the same ones."""
        self.vector = vector
        self.step_s = max(1 / GRID_HZ, min(vector.step_s, 2 / GRID_HZ))
        self.width_s = max(self.step_s, vector.step_s)
        margin = reach_s + self.width_s
        begin, end = max(gyro.t_s[0], vector.t_s[0]) + margin, min(gyro.t_s[-1], vector.t_s[-1]) - margin
        self.t_s = np.arange(begin, end, self.step_s)
        self.turn = gyro.between(self.t_s[:-1], self.t_s[1:])
        length = max(2, round(WINDOW_S / self.step_s))
        self.length_s = length * self.step_s
        first = np.arange(0, len(self.t_s) - length, max(1, length // 3))
        start, stop = self.t_s[first], self.t_s[first + length] if len(first) else self.t_s[:0]
        whole = ~gyro.touches_gap(start, stop) & ~vector.touches_gap(start - margin, stop + margin)
        self.first = first[whole]
        self.last = self.first + length
        self._turns = _running(self.turn)
        turned = self._turns[self.last] - self._turns[self.first]
        size = np.linalg.norm(turned - np.median(turned, axis=0), axis=1) if len(turned) else np.zeros(0)
        self._keep(stands_out(size))

    def _keep(self, rows: NDArray[np.bool_]) -> None:
        stride = max(1, int(rows.sum()) // MOST_WINDOWS)
        self.first, self.last = self.first[rows][::stride], self.last[rows][::stride]

    def __len__(self) -> int:
        return len(self.first)

    def at_lag(self, lag_s: float) -> Windows:
        """The windows for a vector whose stamps are late by ``lag_s``."""
        half = self.width_s / 2
        at = self.vector.smooth_between(self.t_s - half + lag_s, self.t_s + half + lag_s) / self.width_s
        middle = 0.5 * (at[1:] + at[:-1])
        cross = _running((middle[:, :, None] * self.turn[:, None, :]).reshape(-1, 9))
        mean = _running(middle * self.step_s)
        first, last = self.first, self.last
        return Windows(
            change=at[last] - at[first],
            cross=(cross[last] - cross[first]).reshape(-1, 3, 3),
            turn=self._turns[last] - self._turns[first],
            mean_dt=mean[last] - mean[first],
            length_s=self.length_s,
        )


def stands_out(size: Floats) -> NDArray[np.bool_]:
    """Which sizes are well above those at rest; all of them when few are."""
    keep = size > 0.1 * np.quantile(size, 0.95) if len(size) else np.zeros(0, dtype=np.bool_)
    return keep if keep.sum() >= FEWEST_WINDOWS else np.ones(len(size), dtype=np.bool_)


def _running(values: Floats) -> Floats:
    total = np.zeros((len(values) + 1, values.shape[1]))
    np.cumsum(values, axis=0, out=total[1:])
    return total


def solve(columns: Floats, rhs: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Weighted least squares over n windows: unknowns (p,), and the length of each window's residual (n,).

    ``columns`` (n, m, p), ``rhs`` (n, m). A trace of damping keeps unknowns that nothing excites at zero.
    """
    scale = np.sqrt(np.einsum("nap,nap->p", columns, columns)) + 1e-300
    # einsum, as a threaded BLAS is slower on products this small, and much slower on a busy machine
    scaled = columns / scale
    weighted = scaled * weight[:, None, None]
    normal = np.einsum("nap,naq->pq", weighted, scaled)
    normal += (1e-9 * np.trace(normal) + 1e-300) * np.eye(len(normal))
    x = np.linalg.solve(normal, np.einsum("nap,na->p", weighted, rhs)) / scale
    return x, np.linalg.norm(rhs - np.einsum("nap,p->na", columns, x), axis=1)


def robust_solve(columns: Floats, rhs: Floats, weight: Floats, rounds: int = 3) -> tuple[Floats, Floats, Floats]:
    """As :func:`solve`, with windows that fit badly weighted down; also the final weights (n,)."""
    weights = weight
    for _ in range(rounds):
        x, residual = solve(columns, rhs, weights)
        size = 1.2 * float(np.median(residual)) + 1e-300
        weights = weight / (1 + (residual / size) ** 2) ** 2
    return x, residual, weights
