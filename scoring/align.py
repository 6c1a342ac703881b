"""What two trajectories may differ in without either being wrong: heading, mounting and clock.

The model is ``q_est(t + time) ~ Rz(heading) * q_true(t) * M(mounting)``. Signs: ``heading_rad`` > 0 when the estimate
is turned counter-clockwise (seen from above) of the truth; ``mounting_rotvec_rad`` is the rotation M that takes
vectors of the estimate's body to the truth's body; ``time_offset_s`` > 0 when the estimate is *late*: what it shows
at t + time happened at t. Late stamps of a gyro make a late estimate: BROAD's gyro reads 4.2 ms late, and an estimator
that takes a sample for the interval before its stamp (half of it: 1.75 ms) comes out 2.4 ms late.

Mounting and clock are fitted to the chordal distance, ``sum |R_est - R_fit|^2 = 4 sum (1 - cos angle)``: the square of
the angle where it is small, bounded where it is large, and with an optimum that is found from any start.
"""

from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation
from stillpoint.datasets.errors import BadParameter, Unobservable
from stillpoint.datasets.frames import heading_rotation, quaternion, rotation
from stillpoint.datasets.recording import Times
from stillpoint.scoring.errors import heading_offset
from stillpoint.scoring.match import GAP_STEPS, Track, attitude_at, match, require_some

Floats = NDArray[np.float64]
AlignKind = Literal["none", "heading", "heading+mounting", "heading+mounting+time"]
ALIGN_KINDS: tuple[AlignKind, ...] = get_args(AlignKind)

TIME_RANGE_S = 0.5  # clocks are searched within +- this
COARSE_STEP_S = 0.02  # of the first search: short against any swing of an arm
COARSE_SAMPLES = 2_000  # enough to find the right valley
FINE_STEPS = 20
FINE_ENOUGH_S = 1e-8
SMALLEST_MOUNTING = 1e-9  # weight of "no mounting": decides only where heading and mounting cannot be told apart


@dataclass(frozen=True, eq=False)
class Alignment:
    """What was found, and what was not asked for at 0. Signs as in the module's first lines."""

    kind: AlignKind
    heading_rad: float = 0.0
    mounting_rotvec_rad: Floats = field(default_factory=lambda: np.zeros(3))  # (3,)
    time_offset_s: float = 0.0

    @property
    def time_offset_ns(self) -> int:
        """The offset on the clocks' grid."""
        return round(self.time_offset_s * 1e9)

    def found(self) -> dict[str, float | list[float]]:
        """For tables and machines: heading and size of the mounting in deg, its rotation vector, the clock in s."""
        rotvec_deg = np.rad2deg(self.mounting_rotvec_rad)
        return {
            "heading_deg": float(np.rad2deg(self.heading_rad)),
            "mounting_deg": float(np.linalg.norm(rotvec_deg)),
            "mounting_rotvec_deg": rotvec_deg.tolist(),
            "time_s": self.time_offset_s,
        }

    @property
    def time_at_limit(self) -> bool:
        """Whether the clock was found at an end of the searched range, where no minimum is."""
        return abs(self.time_offset_s) >= TIME_RANGE_S

    @property
    def mounting(self) -> Rotation:
        """M: vectors of the estimate's body to the truth's."""
        return Rotation.from_rotvec(self.mounting_rotvec_rad)

    def attitude(self, q_est: Floats) -> Floats:
        """The estimate (N, 4) as the truth would show it, without heading and mounting: ``Rz(-h) * q_est * M^-1``."""
        return quaternion(heading_rotation(-self.heading_rad) * rotation(q_est) * self.mounting.inv())

    def covariance(self, cov_b_rad2: Floats) -> Floats:
        """Covariances (N, 3, 3) of the estimate, turned into the truth's body axes."""
        turn = self.mounting.as_matrix()
        return turn @ cov_b_rad2 @ turn.T


def find_alignment(estimated: Track, truth_t_ns: Times, truth_q_nb: Floats, kind: AlignKind) -> Alignment:
    """The alignment of this kind with the smallest error over the given truth samples (N,), (N, 4): the moving ones.

    ``heading`` is the circular mean of the heading error, as in BROAD's evaluation. With ``time`` the clock is
    searched within +-0.5 s; the samples nearer than that to an end of the estimate are left out of the search.
    Raises :class:`BadParameter` for another kind, :class:`Unobservable` when no sample has an estimate.
    """
    if kind not in ALIGN_KINDS:
        raise BadParameter(f"align: {kind!r} is not one of {', '.join(ALIGN_KINDS)}")
    offset_ns = _clock_offset(estimated, truth_t_ns, truth_q_nb) if kind == "heading+mounting+time" else 0
    at_ns = truth_t_ns + offset_ns
    found = require_some(estimated, match(estimated, at_ns))
    if kind == "none":
        return Alignment(kind)
    q_est, q_true = attitude_at(estimated, at_ns[found]), truth_q_nb[found]
    if kind == "heading":
        return Alignment(kind, heading_rad=_circular_mean(heading_offset(q_est, q_true)))
    heading_rad, mounting, _ = _fit(q_est, q_true)
    return Alignment(kind, heading_rad, mounting.as_rotvec(), offset_ns / 1e9)


def _circular_mean(angle_rad: Floats) -> float:
    return float(np.angle(np.mean(np.exp(1j * angle_rad))))


def _fit(q_est: Floats, q_true: Floats) -> tuple[float, Rotation, float]:
    """Heading, mounting and the mean of ``3 - trace`` = 2 (1 - cos angle) of ``R_est ~ Rz(h) R_true M``.

    For a given heading the best mounting is a polar decomposition of ``B(h) = sum R_true' Rz(-h) R_est``, which is
    ``B_0 + cos h B_c + sin h B_s``: three sums over the data, then a search over one angle.
    """
    true, est = rotation(q_true).as_matrix(), rotation(q_est).as_matrix()
    gram = (true.reshape(-1, 9).T @ est.reshape(-1, 9)).reshape(3, 3, 3, 3) / len(q_est)  # [row, col, row', col']
    level, turned, upright = gram[0, :, 0] + gram[1, :, 1], gram[0, :, 1] - gram[1, :, 0], gram[2, :, 2]
    upright = upright + SMALLEST_MOUNTING * np.eye(3)

    def profile(heading_rad: Floats) -> Floats:
        h = np.asarray(heading_rad)[..., None, None]
        b = upright + np.cos(h) * level + np.sin(h) * turned
        s = np.linalg.svd(b, compute_uv=False)
        return s[..., 0] + s[..., 1] + np.sign(np.linalg.det(b)) * s[..., 2]

    grid = np.linspace(-np.pi, np.pi, 361)
    start = float(grid[int(np.argmax(profile(grid)))])
    step = float(grid[1] - grid[0])
    best = minimize_scalar(lambda h: -float(profile(h)), bounds=(start - step, start + step), options={"xatol": 1e-10})
    heading_rad = float(np.angle(np.exp(1j * best.x)))
    b = upright + np.cos(heading_rad) * level + np.sin(heading_rad) * turned
    u, _, vt = np.linalg.svd(b)
    mounting = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return heading_rad, Rotation.from_matrix(mounting), 3.0 + float(best.fun)


def _clock_offset(estimated: Track, t_ns: Times, q_true: Floats) -> int:
    """How late the estimate is, in ns: a coarse search over the whole range, then a fine one in the best valley."""
    margin = round(TIME_RANGE_S * 1e9)
    inside = np.flatnonzero((t_ns - margin >= estimated.t_ns[0]) & (t_ns + margin <= estimated.t_ns[-1]))
    if len(inside) < 2:
        raise Unobservable(
            f"{estimated.label}: overlaps the truth's motion by too little to align the clocks within "
            f"+-{TIME_RANGE_S} s; align heading+mounting instead"
        )

    def cost(offset_s: float, rows: NDArray[np.intp]) -> float:
        at_ns = t_ns[rows] + round(offset_s * 1e9)
        found = match(estimated, at_ns).found
        return _fit(attitude_at(estimated, at_ns[found]), q_true[rows[found]])[2] if found.any() else np.inf

    some = _spread(inside, COARSE_SAMPLES)
    grid = np.linspace(-TIME_RANGE_S, TIME_RANGE_S, round(2 * TIME_RANGE_S / COARSE_STEP_S) + 1)
    start = float(grid[int(np.argmin([cost(offset_s, some) for offset_s in grid]))])
    bounds = max(start - COARSE_STEP_S, -TIME_RANGE_S), min(start + COARSE_STEP_S, TIME_RANGE_S)
    offset_s = start
    for _ in range(FINE_STEPS):
        step_s = _clock_step(estimated, t_ns[inside], q_true[inside], offset_s)
        closer_s = float(np.clip(offset_s + step_s, *bounds))
        moved_s, offset_s = abs(closer_s - offset_s), closer_s
        if moved_s < FINE_ENOUGH_S:
            break
    return round(offset_s * 1e9)


def _clock_step(estimated: Track, t_ns: Times, q_true: Floats, offset_s: float) -> float:
    """The change of the offset that leaves no error along the motion, jointly with heading and mounting.

    Linear least squares of the error (sine of its angle, about its axis) on the truth's own rate. The minimum of the
    error itself would be drawn half a sample aside: interpolation between two samples averages their noise.
    """
    at_ns = t_ns + round(offset_s * 1e9)
    wide_ns = t_ns[2:] - t_ns[:-2]
    whole = match(estimated, at_ns).found[1:-1] & (wide_ns <= 2 * GAP_STEPS * np.median(np.diff(t_ns)))
    if whole.sum() < 2:
        return 0.0
    rows = np.flatnonzero(whole) + 1
    q_est, true = attitude_at(estimated, at_ns[rows]), rotation(q_true[rows])
    heading_rad, mounting, _ = _fit(q_est, q_true[rows])
    fit = heading_rotation(heading_rad) * true * mounting
    error = (fit.inv() * rotation(q_est)).as_quat(canonical=True, scalar_first=True)
    turn = (rotation(q_true[rows - 1]).inv() * rotation(q_true[rows + 1])).as_rotvec()
    rate_b_radps = mounting.inv().apply(turn / (wide_ns[whole] / 1e9)[:, None])
    up_b = fit.inv().apply([0.0, 0.0, 1.0])
    # error ~ up_b * d(heading) + 1 * d(mounting) - rate_b * d(offset), as the rate runs ahead with the clock
    design = np.concatenate([up_b[..., None], np.tile(np.eye(3), (len(rows), 1, 1)), -rate_b_radps[..., None]], axis=2)
    residual = 2 * error[:, :1] * error[:, 1:]
    normal = np.einsum("nki,nkj->ij", design, design)
    gradient = np.einsum("nki,nk->i", design, residual)
    return float(np.linalg.lstsq(normal, gradient, rcond=1e-12)[0][4])


def _spread(rows: NDArray[np.intp], n: int) -> NDArray[np.intp]:
    """At most n of the rows, evenly spread."""
    return rows[np.unique(np.linspace(0, len(rows) - 1, min(n, len(rows))).astype(np.intp))]
