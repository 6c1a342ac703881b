"""What another sensor says about the gyro: its axes, its scale, its bias, and the lag between the two.

Three witnesses: the accelerometer (gravity), the magnetometer (local field), the truth (attitude). Each compares a
vector, or the attitude, with what the gyro's turning predicts. Every fault of axes is looked for among the 48 signed
permutations; a witness that saw too little motion says nothing.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stillpoint.datasets.doctor.candidates import CANDIDATES, Choice, choose
from stillpoint.datasets.doctor.coherence import Swings, displacement, displacement_about_pivot
from stillpoint.datasets.doctor.lag import REACH_S, Lag, find_lag
from stillpoint.datasets.doctor.turning import (
    FEWEST_WINDOWS,
    LEVI_CIVITA,
    Grid,
    Windows,
    gyro_series,
    robust_solve,
    solve,
    vector_series,
)
from stillpoint.datasets.recording import Floats, Imu, Mag

OVERLAP = 3.0  # windows start every third of their length
STEPS_OF_SCALE = np.exp(np.linspace(-0.9, 0.9, 37))
FEWEST_SWINGS = 6
HAND_TREMOR_M = 0.02  # displacements below this tell nothing
CALIBRATION = 0.05  # share of a change that misalignment may explain: a gyro axis that sees no more is not tested


@dataclass(frozen=True)
class Witness:
    """What one sensor says about the gyro; None where it cannot tell."""

    name: str  # "accel", "mag", "truth"
    choice: Choice | None  # true rate = scale * choice.matrix @ measured rate
    scale: float | None = None
    lag: Lag | None = None  # of this sensor's stamps against the gyro's (truth: of the gyro's against the truth's)
    gyro_bias_b_radps: Floats | None = None  # in the axes of the measured rate
    hard_iron_b_ut: Floats | None = None
    losses: Floats | None = None  # (48,) nats over the gyro having nothing to do with it; also when none is chosen


def ask_mag(imu: Imu, mag: Mag) -> Witness:
    """The magnetometer: insensitive to translation, and its hard iron comes out as well."""
    if len(mag.t_ns) < FEWEST_WINDOWS:
        return Witness("mag", None)
    origin = int(imu.t_ns[0])
    field = vector_series(mag.t_ns, mag.mag_b_ut, origin)
    grid = Grid(gyro_series(imu, origin), field, REACH_S)
    if len(grid) < FEWEST_WINDOWS:
        return Witness("mag", None)
    rough = find_lag(_robust_loss(grid, lambda at: at.design(np.zeros(3))))
    at = grid.at_lag(rough.lag_s if rough and rough.clear else 0.0)
    centre = sphere_centre(mag.mag_b_ut)
    weight = robust_solve(at.design(centre), at.change, np.ones(len(grid)))[2]
    fits = [_fit(at, matrix, centre, weight) for matrix in CANDIDATES]
    _, null = solve(_bias_columns(at, centre), at.change, weight)
    noise = min(float(np.median(residual)) for _, residual in fits)
    floor = noise**2 + (CALIBRATION * np.linalg.norm(at.change, axis=1)) ** 2 + 1e-300
    nothing = np.log(null**2 + floor)
    # A scale below zero is the opposite candidate with one above.
    losses = [np.log(residual**2 + floor) if found[0] > 0 else nothing for found, residual in fits]
    choice = choose(np.array(losses), nothing, OVERLAP)
    if choice is None:
        return Witness("mag", None)

    matrix = choice.matrix
    lag = find_lag(_robust_loss(grid, lambda at: _columns(at, matrix, centre)))
    at = grid.at_lag(lag.lag_s if lag and lag.clear else 0.0)
    found, _, _ = robust_solve(_columns(at, matrix, centre), at.change, np.ones(len(grid)), rounds=2)
    bias = -matrix.T @ found[1:4] / found[0]
    return Witness("mag", choice, float(found[0]), lag, bias, centre + found[4:7] / found[0])


def ask_accel(imu: Imu, bias_b_radps: Floats) -> Witness:
    """The accelerometer: carried back by the gyro, gravity must stay where it is, and translation stay small."""
    origin = int(imu.t_ns[0])
    force = vector_series(imu.t_ns, imu.accel_b_mps2, origin)
    swings = Swings(gyro_series(imu, origin), force, bias_b_radps, REACH_S)
    if len(swings) < FEWEST_SWINGS:
        return Witness("accel", None)
    seen = swings.at_lag(0.0)
    floor = HAND_TREMOR_M**2

    def loss(matrices: Floats) -> Floats:
        return np.log(displacement(seen, matrices) + floor)

    nothing = loss(np.zeros((1, 3, 3)))[0]
    usual = float(STEPS_OF_SCALE[int(loss(STEPS_OF_SCALE[:, None, None] * np.eye(3)).mean(axis=1).argmin())])
    for scale in (1.0, np.pi / 180, usual):
        losses = loss(scale * CANDIDATES)
        choice = choose(losses, nothing, overlap=1.0)
        if choice is not None:
            break
    if choice is None:
        return Witness("accel", None, losses=(loss(CANDIDATES) - nothing).sum(axis=1))
    for factors in (STEPS_OF_SCALE, STEPS_OF_SCALE**0.1):
        scales = scale * factors
        scale = float(scales[int(loss(scales[:, None, None] * choice.matrix).sum(axis=1).argmin())])
    return Witness("accel", choice, scale, losses=(losses - nothing).sum(axis=1))


def accel_lag(imu: Imu, bias_b_radps: Floats, matrix: Floats) -> Lag | None:
    """How late the accelerometer's stamps are against the gyro's, by gravity, when true rate = matrix @ measured."""
    origin = int(imu.t_ns[0])
    force = vector_series(imu.t_ns, imu.accel_b_mps2, origin)
    swings = Swings(gyro_series(imu, origin), force, bias_b_radps, REACH_S)
    usual = float(np.median(displacement_about_pivot(swings.at_lag(0.0), matrix))) + 1e-300
    return find_lag(lambda lag_s: np.log1p(displacement_about_pivot(swings.at_lag(lag_s), matrix) / usual))


def sphere_centre(vectors: Floats) -> Floats:
    """Centre of the sphere closest to the points (n, 3): the hard iron, where all directions were seen."""
    middle = vectors.mean(axis=0)
    around = vectors - middle
    columns = np.hstack([2 * around, np.full((len(around), 1), np.abs(around).mean() + 1e-300)])
    centre = np.linalg.lstsq(columns, (around**2).sum(axis=1), rcond=1e-3)[0][:3]
    return np.asarray(middle + centre)


def _robust_loss(grid: Grid, columns: Callable[[Windows], Floats]) -> Callable[[float], Floats]:
    """Loss of a lag when the vector's change is linear in ``columns``.

    Each lag weighs its windows anew. Weights found at one lag would leave out the windows that fit badly there, and so
    confirm it.
    """
    size: list[float] = []

    def loss(lag_s: float) -> Floats:
        at = grid.at_lag(lag_s)
        _, residual, _ = robust_solve(columns(at), at.change, np.ones(len(grid)), rounds=2)
        if not size:
            size.append(3 * float(np.median(residual)) + 1e-300)  # wide, so that no valley beside the true one stays
        return np.asarray(np.log1p((residual / size[0]) ** 2))

    return loss


def _bias_columns(at: Windows, centre: Floats) -> Floats:
    return np.asarray(np.einsum("kli,nl->nki", LEVI_CIVITA, at.mean_dt - centre * at.length_s))


def _columns(at: Windows, matrix: Floats, centre: Floats) -> Floats:
    """Columns (n, 3, 7) of scale, scale * bias (3) and scale * (hard iron - centre) (3), when the axes are known."""
    turned = at.predicted(matrix, centre)[:, :, None]
    iron = -np.einsum("kli,ni->nkl", LEVI_CIVITA, at.turn @ matrix.T)
    return np.concatenate([turned, _bias_columns(at, centre), iron], axis=2)


def _fit(at: Windows, matrix: Floats, centre: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """The unknowns of :func:`_columns`, and the residual of each window (n,)."""
    return solve(_columns(at, matrix, centre), at.change, weight)
