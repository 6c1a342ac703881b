"""How a vector fixed in the world must turn in the body when the gyro turns: the physics of most tests.

Gravity and the local field obey dv/dt = v x w in body axes. Integrated over a short window, with whatever the gyro
measures as w', the change of v is *linear* in the unknowns: v x (M w' + b) for any matrix M between the true and
the measured rate (flips, swaps, scale), bias b, and (K w' T) for a constant offset h of v (hard iron: K = -h x M).
So lags, axes and scales are least squares, with no start value. Nothing is differentiated.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stillpoint.datasets.recording import Floats, Imu, Times
from stillpoint.datasets.times import find_gaps

_GRID_HZ = 100.0  # fast enough for a hand: at 1000 deg/s the midpoint rule over 10 ms errs by 0.25 %
_WINDOW_S = 0.25
FEWEST_WINDOWS, _MOST_WINDOWS = 12, 1500

_SWING_S = 2.0
_MOST_SWINGS = 120
MODES = 6  # patterns of force in a window, in order of the displacement they cause; the rest is below 0.1 %

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

    def integrate(self, start_s: Floats, end_s: Floats) -> Floats:
        """Return the integral from each start to each end, (n, 3)."""
        return self._interpolate_integral(end_s) - self._interpolate_integral(start_s)

    def smooth_between(self, start_s: Floats, end_s: Floats) -> Floats:
        """Return :meth:`between` over spans whose ends fade within one step of the stream.

        With sharp ends, noise averages out the better the further the ends lie from the stamps, and a search for a lag
        between streams of one rate would settle there, half a step beside the true one.
        """
        quarter = self.step_s / 4
        early = self.integrate(start_s - quarter, end_s - quarter)
        return 0.5 * (early + self.integrate(start_s + quarter, end_s + quarter))

    def _interpolate_integral(self, t_s: Floats) -> Floats:
        """Return the integral (n, 3) from the beginning to times (n,)."""
        return np.stack([np.interp(t_s, self.t_s, column) for column in self.integral.T], axis=1)

    def find_spans_in_gaps(self, start_s: Floats, end_s: Floats) -> NDArray[np.bool_]:
        """Return which spans overlap a gap."""
        inside = np.searchsorted(self.gaps_s[:, 1], start_s, side="right")
        return inside < np.searchsorted(self.gaps_s[:, 0], end_s, side="left")


def make_gyro_series(imu: Imu, origin_ns: int) -> Series:
    """Return the turn that the gyro measured: a sample describes the step that ends at its stamp."""
    return _make_series(imu.t_ns, imu.gyro_b_radps, origin_ns, imu.gyro_b_radps[1:])


def make_vector_series(t_ns: Times, values: Floats, origin_ns: int) -> Series:
    """Return vectors that hold at their stamps."""
    return _make_series(t_ns, values, origin_ns, 0.5 * (values[1:] + values[:-1]))


def _make_series(t_ns: Times, values: Floats, origin_ns: int, over_step: Floats) -> Series:
    """Return the running integral of values (N, 3) over steps (N - 1, 3), on seconds since the origin."""
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

    def predict_change(self, matrix: Floats, offset: Floats) -> Floats:
        """Return the integral of (v - offset) x (matrix @ w), (n, 3)."""
        turned = np.einsum("nlj,ij->nli", self.cross - offset[:, None] * self.turn[:, None, :], matrix)
        return np.einsum("kli,nli->nk", LEVI_CIVITA, turned)

    def design(self, offset: Floats) -> Floats:
        """Return the columns of M (9, row by row), b (3) and, when the offset is unknown, K (9): (n, 3, 21)."""
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
        self.step_s = max(1 / _GRID_HZ, min(vector.step_s, 2 / _GRID_HZ))
        self.width_s = max(self.step_s, vector.step_s)
        margin = reach_s + self.width_s
        begin, end = max(gyro.t_s[0], vector.t_s[0]) + margin, min(gyro.t_s[-1], vector.t_s[-1]) - margin
        self.t_s = np.arange(begin, end, self.step_s)
        self.turn = gyro.integrate(self.t_s[:-1], self.t_s[1:])
        length = max(2, round(_WINDOW_S / self.step_s))
        self.length_s = length * self.step_s
        first = np.arange(0, len(self.t_s) - length, max(1, length // 3))
        start, stop = self.t_s[first], self.t_s[first + length] if len(first) else self.t_s[:0]
        whole = ~gyro.find_spans_in_gaps(start, stop) & ~vector.find_spans_in_gaps(start - margin, stop + margin)
        self.first = first[whole]
        self.last = self.first + length
        self._turns = _sum_cumulatively(self.turn)
        turned = self._turns[self.last] - self._turns[self.first]
        size = np.linalg.norm(turned - np.median(turned, axis=0), axis=1) if len(turned) else np.zeros(0)
        self._thin_windows(find_large_sizes(size))

    def _thin_windows(self, rows: NDArray[np.bool_]) -> None:
        """Keep the windows of a mask, thinned to at most twice _MOST_WINDOWS."""
        stride = max(1, int(rows.sum()) // _MOST_WINDOWS)
        self.first, self.last = self.first[rows][::stride], self.last[rows][::stride]

    def __len__(self) -> int:
        return len(self.first)

    def make_windows(self, lag_s: float) -> Windows:
        """Return the windows for a vector whose stamps are late by ``lag_s``."""
        half = self.width_s / 2
        at = self.vector.smooth_between(self.t_s - half + lag_s, self.t_s + half + lag_s) / self.width_s
        middle = 0.5 * (at[1:] + at[:-1])
        cross = _sum_cumulatively((middle[:, :, None] * self.turn[:, None, :]).reshape(-1, 9))
        mean = _sum_cumulatively(middle * self.step_s)
        first, last = self.first, self.last
        return Windows(
            change=at[last] - at[first],
            cross=(cross[last] - cross[first]).reshape(-1, 3, 3),
            turn=self._turns[last] - self._turns[first],
            mean_dt=mean[last] - mean[first],
            length_s=self.length_s,
        )


def find_large_sizes(size: Floats) -> NDArray[np.bool_]:
    """Return which sizes are well above those at rest; all of them when few are."""
    keep = size > 0.1 * np.quantile(size, 0.95) if len(size) else np.zeros(0, dtype=np.bool_)
    return keep if keep.sum() >= FEWEST_WINDOWS else np.ones(len(size), dtype=np.bool_)


def _sum_cumulatively(values: Floats) -> Floats:
    """Return the sums (N + 1, k) of the first 0 to N rows."""
    total = np.zeros((len(values) + 1, values.shape[1]))
    np.cumsum(values, axis=0, out=total[1:])
    return total


def solve(columns: Floats, rhs: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Solve weighted least squares over n windows; return the unknowns (p,) and each window's residual length (n,).

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


def solve_robustly(columns: Floats, rhs: Floats, weight: Floats, rounds: int = 3) -> tuple[Floats, Floats, Floats]:
    """Solve as :func:`solve` with less weight on windows that fit badly; return the final weights (n,) too."""
    weights = weight
    for _ in range(rounds):
        x, residual = solve(columns, rhs, weights)
        size = 1.2 * float(np.median(residual)) + 1e-300
        weights = weight / (1 + (residual / size) ** 2) ** 2
    return x, residual, weights


# Does gravity stand still once the gyro's turning is undone? A test that translation hardly fools: within two
# seconds the specific force is carried back to the attitude of the window's start with the turn that a candidate says
# the gyro measured. What is left beside constant gravity is translation: integrated twice it must be a small
# displacement about a uniformly accelerated path. Wrong axes smear gravity and drive this displacement to metres.


@dataclass(frozen=True, eq=False)
class Seen:
    """Turns and specific forces on a grid, in n windows of L steps."""

    turn: Floats  # (n, L, 3)
    force: Floats  # (n, L, 3) in the middle of each step
    step_s: float


class Swings:
    """Where the windows lie: at most 120, those that turn most."""

    def __init__(self, gyro: Series, force: Series, bias_b_radps: Floats, reach_s: float) -> None:
        """``reach_s``: no window looks further than that over the ends, so that each lag within has the same ones."""
        self.force = force
        self.step_s = max(1 / _GRID_HZ, gyro.step_s)
        margin = reach_s + 2 * self.step_s
        t = np.arange(gyro.t_s[0] + margin, gyro.t_s[-1] - margin, self.step_s)
        length = max(round(_SWING_S / self.step_s), 1)
        starts = np.arange(0, len(t) - length, length)
        if length < 3 * MODES:  # too slow a sensor for what happens in two seconds
            starts = starts[:0]
        if len(starts):
            starts = starts[~gyro.find_spans_in_gaps(t[starts] - margin, t[starts + length] + margin)]
        turn = gyro.integrate(t[:-1], t[1:]) - bias_b_radps * self.step_s
        rows = starts[:, None] + np.arange(length)
        turned = np.linalg.norm(turn[rows], axis=2).sum(axis=1)
        most = np.sort(np.argsort(-turned, kind="stable")[:_MOST_SWINGS])
        most = most[turned[most] > 0.1 * np.quantile(turned, 0.95)] if len(most) else most
        self.rows = rows[most]
        self.turn = turn[self.rows]
        self.middle_s = 0.5 * (t[1:] + t[:-1])

    def __len__(self) -> int:
        return len(self.rows)

    def make_windows(self, lag_s: float) -> Seen:
        """Return the windows for an accelerometer whose stamps are late by ``lag_s``."""
        middle, half = self.middle_s + lag_s, self.step_s / 2
        felt = self.force.smooth_between(middle - half, middle + half) / self.step_s
        return Seen(self.turn, felt[self.rows], self.step_s)


@cache
def make_displacement_modes(length: int, step_s: float) -> tuple[Floats, Floats]:
    """Return two arrays (6, L) that give the same six numbers by a window's forces and by its displacements.

    The sum of their squares is the mean square displacement in m^2 about the parabola that fits it best.
    """
    twice = np.tril(np.ones((length, length))) @ np.tril(np.ones((length, length))) * step_s**2
    parabola = np.linalg.qr(np.vander(np.linspace(-1, 1, length), 3))[0]
    left = twice - parabola @ (parabola.T @ twice)
    shapes, size, patterns = np.linalg.svd(left)
    return patterns[:MODES] * size[:MODES, None] / np.sqrt(length), shapes[:, :MODES].T / np.sqrt(length)


def compute_displacement(seen: Seen, matrices: Floats) -> Floats:
    """Return the mean square displacement (K, n) in m^2, per matrix and window, if true rate = matrix @ measured."""
    count, n, length = len(matrices), *seen.turn.shape[:2]
    modes, _ = make_displacement_modes(length, seen.step_s)
    # One array (K, L, n) per component: numpy is several times slower on a last axis of three or four.
    half = matrices.reshape(-1, 3) @ (0.5 * seen.turn).transpose(2, 1, 0).reshape(3, -1)
    rx, ry, rz = np.moveaxis(half.reshape(count, 3, length, n), 1, 0)
    angle = np.sqrt(rx * rx + ry * ry + rz * rz)
    sine, dw = np.sinc(angle / np.pi), np.cos(angle)
    dx, dy, dz = rx * sine, ry * sine, rz * sine
    w, x, y, z = np.ones((count, n)), np.zeros((count, n)), np.zeros((count, n)), np.zeros((count, n))
    carried = np.empty((length, 3, count, n))
    for k in range(length):
        before = w, x, y, z
        aw, ax, ay, az = dw[:, k], dx[:, k], dy[:, k], dz[:, k]
        w, x, y, z = (
            w * aw - x * ax - y * ay - z * az,
            w * ax + x * aw + y * az - z * ay,
            w * ay - x * az + y * aw + z * ax,
            w * az + x * ay - y * ax + z * aw,
        )
        mw, mx, my, mz = (a + b for a, b in zip(before, (w, x, y, z), strict=True))  # in the middle, of any length
        fx, fy, fz = seen.force[:, k].T
        twice = 2 / (mw * mw + mx * mx + my * my + mz * mz + 1e-300)
        tx, ty, tz = twice * (my * fz - mz * fy), twice * (mz * fx - mx * fz), twice * (mx * fy - my * fx)
        carried[k, 0] = fx + mw * tx + my * tz - mz * ty
        carried[k, 1] = fy + mw * ty + mz * tx - mx * tz
        carried[k, 2] = fz + mw * tz + mx * ty - my * tx
    total = (modes @ carried.reshape(length, -1)).reshape(MODES, 3, count, n)
    return np.asarray((total**2).sum(axis=(0, 1)))


def integrate_attitudes(seen: Seen, matrix: Floats) -> Floats:
    """Return the attitudes (n, L, 3, 3) in the middle of each step since the start of a window, if true rate =
    matrix @ measured.
    """
    n, length = seen.turn.shape[:2]
    halves = Rotation.from_rotvec((0.5 * seen.turn @ matrix.T).reshape(-1, 3)).as_matrix().reshape(n, length, 3, 3)
    attitudes = np.empty((n, length, 3, 3))
    at_start = np.broadcast_to(np.eye(3), (n, 3, 3))
    for step in range(length):
        attitudes[:, step] = at_start @ halves[:, step]
        at_start = attitudes[:, step] @ halves[:, step]
    return attitudes


def compute_pivot_displacement(seen: Seen, attitudes: Floats) -> Floats:
    """Return :func:`compute_displacement` (n,) for attitudes (n, L, 3, 3), less what a turn about a pivot explains.

    The pivot is one fixed point of the body. A hand turns about its wrist: the sensor then swings by R r with the arm
    r, which looks like a lag of gravity.
    """
    n, length = seen.turn.shape[:2]
    of_force, of_path = make_displacement_modes(length, seen.step_s)
    felt = (attitudes @ seen.force[..., None])[..., 0]
    moved = (of_force @ felt).reshape(n, MODES * 3)
    swung = (of_path @ attitudes.reshape(n, length, 9)).reshape(n, MODES * 3, 3)
    _, residual, _ = solve_robustly(swung, moved, np.ones(n), rounds=2)
    return np.asarray(residual**2)
