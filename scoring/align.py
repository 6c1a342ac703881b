"""Align two trajectories that differ in conventions without either being wrong: heading, mounting and clock.

The model is ``q_est(t + time) ~ Rz(heading) * q_true(t) * M(mounting)``. Signs: ``heading_rad`` > 0 when the estimate
is turned counter-clockwise (seen from above) of the truth; ``mounting_rotvec_rad`` is the rotation M that takes
vectors of the estimate's body to the truth's body; ``time_offset_s`` > 0 when the estimate is *late*: what it shows
at t + time happened at t. Late stamps of a gyro make a late estimate: BROAD's gyro reads 4.2 ms late, and an estimator
that takes a sample for the interval before its stamp (half of it: 1.75 ms) comes out 2.4 ms late.

The clock is found first, from turns over 0.1 s, so that a heading that drifts cannot pull it. Heading and mounting
are then fitted to the chordal distance, ``sum |R_est - R_fit|^2 = 4 sum (1 - cos angle)``: the square of the angle
where it is small, bounded where it is large, with an optimum that is found from any start.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from stillpoint.datasets.errors import BadParameter, Unobservable
from stillpoint.datasets.frames import compose, heading_rotation, quaternion, rotation
from stillpoint.datasets.recording import Floats
from stillpoint.scoring.blocks import split_rows, sum_blocks
from stillpoint.scoring.clock import find_clock_offset_ns
from stillpoint.scoring.errors import compute_heading_offset
from stillpoint.scoring.match import Mask, Pairs, Track, match, pair_up, require_some

AlignKind = Literal["none", "heading", "heading+mounting", "heading+mounting+time"]
ALIGN_KINDS: tuple[AlignKind, ...] = get_args(AlignKind)

_LEVEL_SPREAD_RAD = 1e-4  # rms tilt change below which heading and mounting are one angle: rounding decides the rest


@dataclass(frozen=True, eq=False)
class Alignment:
    """The alignment found; a part that was not asked for is 0. Signs as in the module's first lines."""

    kind: AlignKind
    heading_rad: float = 0.0
    mounting_rotvec_rad: Floats = field(default_factory=lambda: np.zeros(3))  # (3,)
    time_offset_s: float = 0.0

    @property
    def time_offset_ns(self) -> int:
        """The offset on the clocks' grid."""
        return round(self.time_offset_s * 1e9)

    def found(self) -> dict[str, float | list[float]]:
        """Return heading and size of the mounting in deg, its rotation vector, and the clock in s, for tables and
        machines.
        """
        rotvec_deg = np.rad2deg(self.mounting_rotvec_rad)
        return {
            "heading_deg": float(np.rad2deg(self.heading_rad)),
            "mounting_deg": float(np.linalg.norm(rotvec_deg)),
            "mounting_rotvec_deg": rotvec_deg.tolist(),
            "time_s": self.time_offset_s,
        }

    @property
    def mounting(self) -> Rotation:
        """M: vectors of the estimate's body to the truth's."""
        return Rotation.from_rotvec(self.mounting_rotvec_rad)

    def attitude(self, q_est: Floats) -> Floats:
        """Return the estimate (N, 4) without heading and mounting, as the truth shows it: ``Rz(-h) * q_est * M^-1``."""
        turned = compose(heading_rotation(-self.heading_rad), rotation(q_est))
        return quaternion(compose(turned, self.mounting.inv()))

    def covariance(self, cov_b_rad2: Floats) -> Floats:
        """Return covariances (N, 3, 3) of the estimate, turned into the truth's body axes."""
        turn = self.mounting.as_matrix()
        return turn @ cov_b_rad2 @ turn.T


def pair_and_align(estimated: Track, truth: Track, moving: Mask, kind: AlignKind) -> tuple[Pairs, Alignment]:
    """Return both trajectories in pairs, and the alignment of this kind with the smallest error over the moving ones.

    ``moving`` (N,) belongs to the truth's samples. ``heading`` is the circular mean of the heading error.
    Raises :class:`BadParameter` for another kind, :class:`Unobservable` when no moving sample has an estimate, or when
    the clock is to be found and the motion does not show it.
    """
    if kind not in ALIGN_KINDS:
        raise BadParameter(f"align: {kind!r} is not one of {', '.join(ALIGN_KINDS)}")
    offset_ns = find_clock_offset_ns(estimated, truth, moving) if kind == "heading+mounting+time" else 0
    pairs = pair_up(estimated, truth, moving, offset_ns)
    if not pairs.moving.any():
        require_some(estimated, match(estimated, truth.t_ns[moving] + offset_ns))
        raise Unobservable(f"{estimated.label}: none of its poses lies in a moving stretch of the truth")
    return pairs, align_pairs(pairs.q_est[pairs.moving], pairs.q_true[pairs.moving], kind, offset_ns / 1e9)


def align_pairs(q_est: Floats, q_true: Floats, kind: AlignKind, time_offset_s: float = 0.0) -> Alignment:
    """Find heading and mounting, as far as ``kind`` has them, between pairs of attitudes (N, 4) at equal times."""
    return align_blocks(zip(split_rows(q_est), split_rows(q_true), strict=True), kind, time_offset_s)


def align_blocks(blocks: Iterable[tuple[Floats, Floats]], kind: AlignKind, time_offset_s: float = 0.0) -> Alignment:
    """Find the alignment of :func:`align_pairs` between blocks of pairs (:mod:`stillpoint.scoring.blocks`)."""
    if kind == "none":
        return Alignment(kind)
    if kind == "heading":
        turned = sum_blocks(np.exp(1j * compute_heading_offset(q_est, q_true)) for q_est, q_true in blocks)
        return Alignment(kind, heading_rad=float(np.angle(turned)))
    heading_rad, mounting = _fit_heading_and_mounting(blocks)
    return Alignment(kind, heading_rad, mounting.as_rotvec(), time_offset_s)


def _fit_heading_and_mounting(blocks: Iterable[tuple[Floats, Floats]]) -> tuple[float, Rotation]:
    """Return heading h and mounting M of ``R_est ~ Rz(h) R_true M`` with the smallest mean of 2 (1 - cos angle).

    For a given heading the best mounting is a polar decomposition of ``B(h) = sum R_true' Rz(-h) R_est``, which is
    ``B_0 + cos h B_c + sin h B_s``: three sums over the data, then a search over one angle. If the truth never tilts,
    every heading fits equally well, and the one with the smallest mounting is returned.
    """
    count, together, up_sum = 0, np.zeros((9, 9)), np.zeros(3)
    for q_est, q_true in blocks:
        true, est = rotation(q_true).as_matrix(), rotation(q_est).as_matrix()
        together += true.reshape(-1, 9).T @ est.reshape(-1, 9)
        up_sum += true[:, 2].sum(axis=0)
        count += len(q_est)
    gram = together.reshape(3, 3, 3, 3) / count  # [row, col, row', col']
    level, turned, upright = gram[0, :, 0] + gram[1, :, 1], gram[0, :, 1] - gram[1, :, 0], gram[2, :, 2]
    mean_up_b = up_sum / count  # of the vertical in the truth's body axes, unit vectors: their variance is 1 - |mean|^2
    if 1 - mean_up_b @ mean_up_b < _LEVEL_SPREAD_RAD**2:
        return _split_off_mounting(_find_nearest_rotation(upright + level), mean_up_b / np.linalg.norm(mean_up_b))

    def compute_profile(heading_rad: Floats) -> Floats:
        """Return the largest trace that a mounting reaches at each heading in rad; its maximum is the best fit."""
        h = np.asarray(heading_rad)[..., None, None]
        b = upright + np.cos(h) * level + np.sin(h) * turned
        s = np.linalg.svd(b, compute_uv=False)
        return s[..., 0] + s[..., 1] + np.sign(np.linalg.det(b)) * s[..., 2]

    grid = np.linspace(-np.pi, np.pi, 361)
    start = float(grid[int(np.argmax(compute_profile(grid)))])
    step = float(grid[1] - grid[0])
    best = minimize_scalar(
        lambda h: -float(compute_profile(h)), bounds=(start - step, start + step), options={"xatol": 1e-10}
    )
    heading_rad = float(np.angle(np.exp(1j * best.x)))
    mounting = _find_nearest_rotation(upright + np.cos(heading_rad) * level + np.sin(heading_rad) * turned)
    return heading_rad, Rotation.from_matrix(mounting)


def _find_nearest_rotation(b: Floats) -> Floats:
    """Return the rotation (3, 3) nearest to a matrix b (3, 3)."""
    u, _, vt = np.linalg.svd(b)
    nearest: Floats = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return nearest


def _split_off_mounting(mounting: Floats, up_b: Floats) -> tuple[float, Rotation]:
    """Split a rotation M (3, 3) of a body that only turns about up_b (3,) into a heading and the smallest mounting.

    Heading h with mounting ``R_up(-h) M`` fits equally well for every h. ``trace(R_up(-h) M)`` is
    ``constant + a cos h + b sin h``, which is largest at ``atan2(b, a)``.
    If a and b vanish, every mounting is a half turn, and h is 0.
    """
    a = float(np.trace(mounting) - up_b @ mounting @ up_b)
    b = float(-np.trace(np.cross(up_b, mounting.T)))  # of [up_b]x M
    heading_rad = float(np.arctan2(b, a)) if np.hypot(a, b) > _LEVEL_SPREAD_RAD else 0.0
    return heading_rad, Rotation.from_rotvec(-heading_rad * up_b) * Rotation.from_matrix(mounting)
