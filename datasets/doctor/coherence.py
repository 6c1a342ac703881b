"""Does gravity stand still once the gyro's turning is undone? A test that translation hardly fools.

Within two seconds the specific force is carried back to the attitude of the window's start with the turn that a
candidate says the gyro measured. What is left beside constant gravity is translation: integrated twice it must be a
small displacement about a uniformly accelerated path. Wrong axes smear gravity and drive this displacement to metres.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from stillpoint.datasets.doctor.turning import GRID_HZ, Series, robust_solve
from stillpoint.datasets.recording import Floats

WINDOW_S = 2.0
MOST_WINDOWS = 120
MODES = 6  # patterns of force in a window, in order of the displacement they cause; the rest is below 0.1 %


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
        self.step_s = max(1 / GRID_HZ, gyro.step_s)
        margin = reach_s + 2 * self.step_s
        t = np.arange(gyro.t_s[0] + margin, gyro.t_s[-1] - margin, self.step_s)
        length = round(WINDOW_S / self.step_s)
        starts = np.arange(0, len(t) - length, length)
        if length < 3 * MODES:  # too slow a sensor for what happens in two seconds
            starts = starts[:0]
        if len(starts):
            starts = starts[~gyro.touches_gap(t[starts] - margin, t[starts + length] + margin)]
        turn = gyro.between(t[:-1], t[1:]) - bias_b_radps * self.step_s
        rows = starts[:, None] + np.arange(length)
        turned = np.linalg.norm(turn[rows], axis=2).sum(axis=1)
        most = np.sort(np.argsort(-turned, kind="stable")[:MOST_WINDOWS])
        most = most[turned[most] > 0.1 * np.quantile(turned, 0.95)] if len(most) else most
        self.rows = rows[most]
        self.turn = turn[self.rows]
        self.middle_s = 0.5 * (t[1:] + t[:-1])

    def __len__(self) -> int:
        return len(self.rows)

    def at_lag(self, lag_s: float) -> Seen:
        """The windows for an accelerometer whose stamps are late by ``lag_s``."""
        middle, half = self.middle_s + lag_s, self.step_s / 2
        felt = self.force.smooth_between(middle - half, middle + half) / self.step_s
        return Seen(self.turn, felt[self.rows], self.step_s)


@cache
def displacement_modes(length: int, step_s: float) -> tuple[Floats, Floats]:
    """Two (6, L): products with a window's forces, and with its displacements, that give the same six numbers.

    The sum of their squares is the mean square displacement in m^2 about the parabola that fits it best.
    """
    twice = np.tril(np.ones((length, length))) @ np.tril(np.ones((length, length))) * step_s**2
    parabola = np.linalg.qr(np.vander(np.linspace(-1, 1, length), 3))[0]
    left = twice - parabola @ (parabola.T @ twice)
    shapes, size, patterns = np.linalg.svd(left)
    return patterns[:MODES] * size[:MODES, None] / np.sqrt(length), shapes[:, :MODES].T / np.sqrt(length)


def displacement(seen: Seen, matrices: Floats) -> Floats:
    """Mean square displacement in m^2 when true rate = matrix @ measured, for each matrix and window, (K, n)."""
    count, n, length = len(matrices), *seen.turn.shape[:2]
    modes, _ = displacement_modes(length, seen.step_s)
    q = np.zeros((count, n, 4))
    q[..., 0] = 1.0
    total = np.zeros((MODES, count, n, 3))
    for step in range(length):
        half = 0.5 * np.einsum("kij,nj->kni", matrices, seen.turn[:, step])
        angle = np.linalg.norm(half, axis=-1, keepdims=True)
        following = _times(q, np.concatenate([np.cos(angle), half * np.sinc(angle / np.pi)], axis=-1))
        between = q + following
        between /= np.linalg.norm(between, axis=-1, keepdims=True) + 1e-300
        total += modes[:, step, None, None, None] * _turn(between, seen.force[None, :, step])
        q = following
    return np.asarray((total**2).sum(axis=(0, 3)))


def displacement_about_pivot(seen: Seen, matrix: Floats) -> Floats:
    """As :func:`displacement` for one matrix, (n,), less what a turn about one fixed pivot in the body explains.

    A hand turns about its wrist: the sensor then swings by R r with the arm r, which looks like a lag of gravity.
    """
    n, length = seen.turn.shape[:2]
    of_force, of_path = displacement_modes(length, seen.step_s)
    attitude = np.broadcast_to(np.eye(3), (n, 3, 3))
    moved = np.zeros((n, MODES, 3))
    swung = np.zeros((n, MODES, 3, 3))
    for step in range(length):
        half = rotation_matrices(0.5 * seen.turn[:, step] @ matrix.T)
        attitude = attitude @ half
        moved += of_force[:, step, None] * np.einsum("nij,nj->ni", attitude, seen.force[:, step])[:, None]
        swung += of_path[:, step, None, None] * attitude[:, None]
        attitude = attitude @ half
    _, residual, _ = robust_solve(swung.reshape(n, MODES * 3, 3), moved.reshape(n, MODES * 3), np.ones(n), rounds=2)
    return np.asarray(residual**2)


def rotation_matrices(rotvec: Floats) -> Floats:
    """(n, 3, 3) of rotation vectors (n, 3)."""
    return np.asarray(Rotation.from_rotvec(rotvec).as_matrix())


def _times(a: Floats, b: Floats) -> Floats:
    """Hamilton product of arrays of quaternions wxyz; scipy's cannot broadcast (K, n)."""
    aw, av, bw, bv = a[..., :1], a[..., 1:], b[..., :1], b[..., 1:]
    scalar = aw * bw - (av * bv).sum(axis=-1, keepdims=True)
    return np.concatenate([scalar, aw * bv + bw * av + _cross(av, bv)], axis=-1)


def _turn(q: Floats, vector: Floats) -> Floats:
    """Rotate vectors by quaternions."""
    twice = 2 * _cross(q[..., 1:], vector)
    return np.asarray(vector + q[..., :1] * twice + _cross(q[..., 1:], twice))


def _cross(a: Floats, b: Floats) -> Floats:
    """Cross product that broadcasts; numpy's is several times slower."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)
