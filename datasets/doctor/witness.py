"""Judge the gyro by another sensor: its axes, its scale, its bias, and the lag between the two.

Three witnesses: the accelerometer (gravity), the magnetometer (local field), the truth (attitude). Each compares a
vector, or the attitude, with what the gyro's turning predicts. Every fault of axes is looked for among the 48 signed
permutations; a witness that saw too little motion says nothing.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stillpoint.datasets.doctor.lag import REACH_S, Lag, find_lag
from stillpoint.datasets.doctor.turning import (
    FEWEST_WINDOWS,
    LEVI_CIVITA,
    Grid,
    Swings,
    Windows,
    compute_displacement,
    compute_pivot_displacement,
    integrate_attitudes,
    make_gyro_series,
    make_vector_series,
    solve,
    solve_robustly,
)
from stillpoint.datasets.recording import Floats, Imu, Mag

# Log-likelihoods, in nats. Measured on 22 real recordings: see docs/doctor.md.
MIN_GAIN = 0.3  # per window, over "the gyro has nothing to do with it": below, nothing is said
_MIN_FAULT_GAIN = 0.6  # ... and below this no fault is claimed
MIN_ADVANTAGE = 0.15  # per window, of another candidate over the identity: below, the axes are right
_TIE_NATS, _TIE_SIGMA = 5.0, 4.0  # closer to the best than either: as good, and the simplest of them is taken
_OVERLAP = 3.0  # windows start every third of their length
_STEPS_OF_SCALE = np.exp(np.linspace(-0.9, 0.9, 37))
_FEWEST_SWINGS = 6
_HAND_TREMOR_M = 0.02  # smaller displacements are no evidence
_CALIBRATION = 0.05  # share of a change that misalignment may explain: a gyro axis that sees no more is not tested


def _list_signed_permutations() -> Floats:
    """Return the 48 signed permutations of three axes (48, 3, 3), the simplest first."""
    found = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            found.append(matrix)
    return np.array(sorted(found, key=measure_complexity))


def measure_complexity(matrix: Floats) -> tuple[int, int]:
    """Return how much a signed permutation changes: moved axes and flipped signs together, then the moved axes
    alone.
    """
    moved = int((np.abs(np.diag(matrix)) < 0.5).sum())
    flipped = int((matrix < -0.5).sum())
    return moved + flipped, moved


CANDIDATES: Floats = _list_signed_permutations()  # (48, 3, 3), the identity first, then by complexity
_IDENTITY = 0


def find_index(matrix: Floats) -> int:
    """Return the place of a signed permutation among the candidates."""
    return int(np.abs(CANDIDATES - matrix).sum(axis=(1, 2)).argmin())


def describe(sensor: str, matrix: Floats) -> str:
    """Return ``gyro x -> -x`` for each component that changes: the corrected x is minus the measured x."""
    parts = []
    for axis, row in zip("xyz", matrix, strict=True):
        source = int(np.abs(row).argmax())
        name = ("-" if row[source] < 0 else "") + "xyz"[source]
        if name != axis:
            parts.append(f"{sensor} {axis} -> {name}")
    return ", ".join(parts)


@dataclass(frozen=True)
class Choice:
    """The simplest candidate that fits as well as the best one."""

    matrix: Floats  # (3, 3) signed permutation: true = matrix @ measured, up to a factor
    gain: float  # mean log-likelihood per window over the null
    tested: tuple[bool, bool, bool]  # would a flip of this measured axis have been seen?
    excess: Floats  # (48,) nats by which a candidate fits clearly worse than the best; 0 where it does not


def choose(loss: Floats, null: Floats, overlap: float) -> Choice | None:
    """Choose from the losses (48, n) of the candidates over n windows; None when no candidate explains the data.

    ``null`` (n,) is the loss without the gyro. ``overlap``: how many windows share the same data.
    """
    mean = loss.mean(axis=1)
    best = int(mean.argmin())
    gain = float(null.mean() - mean[best])
    if gain < MIN_GAIN or not _is_worse(null - loss[best], overlap):
        return None
    chosen = next(k for k in range(len(loss)) if k == best or not _is_worse(loss[k] - loss[best], overlap))
    if mean[_IDENTITY] - mean[best] < MIN_ADVANTAGE:
        chosen = _IDENTITY
    if chosen != _IDENTITY and gain < _MIN_FAULT_GAIN:
        return None
    flips = [find_index(CANDIDATES[chosen] @ np.diag(sign)) for sign in 1 - 2 * np.eye(3)]
    tested = [_is_worse(loss[k] - loss[chosen], overlap) for k in flips]
    excess = compute_excess(loss, overlap)
    if chosen == _IDENTITY:
        excess[_IDENTITY] = 0.0
    return Choice(CANDIDATES[chosen], gain, (tested[0], tested[1], tested[2]), excess)


def compute_excess(loss: Floats, overlap: float) -> Floats:
    """Return the nats (K,) by which each of K candidates is clearly worse than the best, from losses (K, n).

    0 for a candidate that the data cannot tell from the best.
    """
    best = loss[int(loss.mean(axis=1).argmin())]
    return np.array([(one - best).sum() / overlap if _is_worse(one - best, overlap) else 0.0 for one in loss])


def _is_worse(difference: Floats, overlap: float) -> bool:
    """Return whether the first of two candidates is clearly worse, by differences (n,) of their losses."""
    error = difference.std() * np.sqrt(overlap / len(difference))
    nats = difference.sum() / overlap
    return bool(difference.mean() > _TIE_SIGMA * error or nats > _TIE_NATS)


@dataclass(frozen=True)
class Witness:
    """The judgement of the gyro by one sensor; None where it cannot decide."""

    name: str  # "accel", "mag", "truth"
    choice: Choice | None  # true rate = scale * choice.matrix @ measured rate
    scale: float | None = None
    lag: Lag | None = None  # of this sensor's stamps against the gyro's (truth: of the gyro's against the truth's)
    gyro_bias_b_radps: Floats | None = None  # in the axes of the measured rate
    hard_iron_b_ut: Floats | None = None
    losses: Floats | None = None  # (48,) nats over the gyro having nothing to do with it; also when none is chosen


def ask_mag(imu: Imu, mag: Mag) -> Witness:
    """Ask the magnetometer, which is insensitive to translation; its hard iron comes out as well."""
    if len(mag.t_ns) < FEWEST_WINDOWS:
        return Witness("mag", None)
    origin = int(imu.t_ns[0])
    field = make_vector_series(mag.t_ns, mag.mag_b_ut, origin)
    grid = Grid(make_gyro_series(imu, origin), field, REACH_S)
    if len(grid) < FEWEST_WINDOWS:
        return Witness("mag", None)
    rough = find_lag(_make_robust_loss(grid, lambda at: at.design(np.zeros(3))))
    at = grid.make_windows(rough.lag_s if rough and rough.clear else 0.0)
    centre = _find_sphere_centre(mag.mag_b_ut)
    weight = solve_robustly(at.design(centre), at.change, np.ones(len(grid)))[2]
    fits = [_fit(at, matrix, centre, weight) for matrix in CANDIDATES]
    _, null = solve(_make_bias_columns(at, centre), at.change, weight)
    noise = min(float(np.median(residual)) for _, residual in fits)
    floor = noise**2 + (_CALIBRATION * np.linalg.norm(at.change, axis=1)) ** 2 + 1e-300
    nothing = np.log(null**2 + floor)
    # A scale below zero is the opposite candidate with one above.
    losses = [np.log(residual**2 + floor) if found[0] > 0 else nothing for found, residual in fits]
    choice = choose(np.array(losses), nothing, _OVERLAP)
    if choice is None:
        return Witness("mag", None)

    matrix = choice.matrix
    lag = find_lag(_make_robust_loss(grid, lambda at: _make_columns(at, matrix, centre)))
    at = grid.make_windows(lag.lag_s if lag and lag.clear else 0.0)
    found, _, _ = solve_robustly(_make_columns(at, matrix, centre), at.change, np.ones(len(grid)), rounds=2)
    bias = -matrix.T @ found[1:4] / found[0]
    return Witness("mag", choice, float(found[0]), lag, bias, centre + found[4:7] / found[0])


def ask_accel(imu: Imu, bias_b_radps: Floats) -> Witness:
    """Ask the accelerometer: carried back by the gyro, gravity must stay where it is, and translation stay small."""
    origin = int(imu.t_ns[0])
    force = make_vector_series(imu.t_ns, imu.accel_b_mps2, origin)
    swings = Swings(make_gyro_series(imu, origin), force, bias_b_radps, REACH_S)
    if len(swings) < _FEWEST_SWINGS:
        return Witness("accel", None)
    seen = swings.make_windows(0.0)
    floor = _HAND_TREMOR_M**2

    def compute_loss(matrices: Floats) -> Floats:
        """Return the log loss (K, n) of each matrix and window."""
        return np.log(compute_displacement(seen, matrices) + floor)

    nothing = compute_loss(np.zeros((1, 3, 3)))[0]
    usual = float(_STEPS_OF_SCALE[int(compute_loss(_STEPS_OF_SCALE[:, None, None] * np.eye(3)).mean(axis=1).argmin())])
    for scale in (1.0, np.pi / 180, usual):
        losses = compute_loss(scale * CANDIDATES)
        choice = choose(losses, nothing, overlap=1.0)
        if choice is not None:
            break
    if choice is None:
        return Witness("accel", None, losses=(compute_loss(CANDIDATES) - nothing).sum(axis=1))
    for factors in (_STEPS_OF_SCALE, _STEPS_OF_SCALE**0.1):
        scales = scale * factors
        scale = float(scales[int(compute_loss(scales[:, None, None] * choice.matrix).sum(axis=1).argmin())])
    return Witness("accel", choice, scale, losses=(losses - nothing).sum(axis=1))


def find_lag_by_gravity(imu: Imu, bias_b_radps: Floats, matrix: Floats) -> Lag | None:
    """Return how late the accelerometer's stamps are against the gyro's, by gravity, when true rate = matrix @
    measured.
    """
    origin = int(imu.t_ns[0])
    force = make_vector_series(imu.t_ns, imu.accel_b_mps2, origin)
    swings = Swings(make_gyro_series(imu, origin), force, bias_b_radps, REACH_S)
    unshifted = swings.make_windows(0.0)
    attitudes = integrate_attitudes(unshifted, matrix)  # of the gyro alone, for every lag
    usual = float(np.median(compute_pivot_displacement(unshifted, attitudes))) + 1e-300
    return find_lag(lambda lag_s: np.log1p(compute_pivot_displacement(swings.make_windows(lag_s), attitudes) / usual))


def _find_sphere_centre(vectors: Floats) -> Floats:
    """Return the centre of the sphere closest to the points (n, 3): the hard iron, where all directions were seen."""
    middle = vectors.mean(axis=0)
    around = vectors - middle
    columns = np.hstack([2 * around, np.full((len(around), 1), np.abs(around).mean() + 1e-300)])
    centre = np.linalg.lstsq(columns, (around**2).sum(axis=1), rcond=1e-3)[0][:3]
    return np.asarray(middle + centre)


def _make_robust_loss(grid: Grid, columns: Callable[[Windows], Floats]) -> Callable[[float], Floats]:
    """Return the loss of a lag when the vector's change is linear in ``columns``.

    Each lag weighs its windows anew. Weights found at one lag would leave out the windows that fit badly there, and so
    confirm it.
    """
    size: list[float] = []

    def compute_loss(lag_s: float) -> Floats:
        """Return the robust loss (n,) of the best fit at this lag; the first call sets the scale of its residuals."""
        at = grid.make_windows(lag_s)
        _, residual, _ = solve_robustly(columns(at), at.change, np.ones(len(grid)), rounds=2)
        if not size:
            size.append(3 * float(np.median(residual)) + 1e-300)  # wide, so that no valley beside the true one stays
        return np.asarray(np.log1p((residual / size[0]) ** 2))

    return compute_loss


def _make_bias_columns(at: Windows, centre: Floats) -> Floats:
    """Return columns (n, 3, 3): how each component of the gyro's bias changes the turned vector."""
    return np.asarray(np.einsum("kli,nl->nki", LEVI_CIVITA, at.mean_dt - centre * at.length_s))


def _make_columns(at: Windows, matrix: Floats, centre: Floats) -> Floats:
    """Return columns (n, 3, 7) for scale, scale * bias (3) and scale * (hard iron - centre) (3), for known axes."""
    turned = at.predict_change(matrix, centre)[:, :, None]
    iron = -np.einsum("kli,ni->nkl", LEVI_CIVITA, at.turn @ matrix.T)
    return np.concatenate([turned, _make_bias_columns(at, centre), iron], axis=2)


def _fit(at: Windows, matrix: Floats, centre: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Return the unknowns of :func:`_make_columns`, and the residual of each window (n,)."""
    return solve(_make_columns(at, matrix, centre), at.change, weight)
