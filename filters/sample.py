"""The input and the output of one step of an estimator, as single values and as columns.

An estimator is a ``Params``, a ``Coefficients`` derived from it once, a ``State``, and two compiled functions::

    start(coefficients) -> State
    step(state, sample, coefficients) -> (State, Output)

:mod:`stillpoint.filters.loop` makes the loop over columns from them.

The first sample of a run has ``dt_s`` = 0. Arrays inside a state (a moving window) are handed over: ``step`` may write
into those that it was given, so a caller who wants to return to a state keeps a copy.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.extending import overload
from numpy.typing import NDArray

from stillpoint.datasets.compiled import compiled, compiled_inside
from stillpoint.datasets.recording import Floats
from stillpoint.filters.rotation import Quaternion, Vector

# A longer interval between two samples is a gap: one rate does not describe it.
GAP_S = 1.0


class Sample(NamedTuple):
    """One stamp of the IMU, with the newest field that has not been used before. SI units, field in uT, body axes."""

    dt_s: float  # since the sample before; the gyro describes this interval
    gyro_b_radps: Vector
    accel_b_mps2: Vector
    mag_b_ut: Vector
    has_accel: bool  # False: this sample's accelerometer is to be left out
    has_mag: bool
    hidden_b_radps: Vector  # by how much the rate may be off as it was clipped or missing (sd); 0: it was measured


class Output(NamedTuple):
    """The output of an estimator after a sample; None for a quantity that it does not estimate."""

    q_nb: Quaternion
    gyro_bias_b_radps: Vector | None
    cov_b_rad2: tuple[float, ...] | None  # nine values, rows of the 3 x 3
    innovation: tuple[float, ...] | None  # normalised, NaN where there was no update
    ready: bool  # False while it is starting


class Log(NamedTuple):
    """N samples as columns."""

    dt_s: Floats  # (N,)
    gyro_b_radps: Floats  # (N, 3)
    accel_b_mps2: Floats  # (N, 3)
    mag_b_ut: Floats  # (N, 3)
    has_accel: NDArray[np.bool_]  # (N,)
    has_mag: NDArray[np.bool_]  # (N,)
    hidden_b_radps: Floats  # (N, 3)


class Track(NamedTuple):
    """Columns for the outputs of a batch run; None for what is not estimated."""

    q_nb: Floats  # (N, 4)
    gyro_bias_b_radps: Floats | None  # (N, 3)
    cov_b_rad2: Floats | None  # (N, 9)
    innovation: Floats | None  # (N, m)
    ready: NDArray[np.bool_]  # (N,)


@compiled
def read_sample(log: Log, k: int) -> Sample:
    """Return sample ``k`` of the columns."""
    gyro, accel, mag, hidden = log.gyro_b_radps, log.accel_b_mps2, log.mag_b_ut, log.hidden_b_radps
    return Sample(
        log.dt_s[k],
        (gyro[k, 0], gyro[k, 1], gyro[k, 2]),
        (accel[k, 0], accel[k, 1], accel[k, 2]),
        (mag[k, 0], mag[k, 1], mag[k, 2]),
        log.has_accel[k],
        log.has_mag[k],
        (hidden[k, 0], hidden[k, 1], hidden[k, 2]),
    )


@compiled_inside
def write_output(track: Track, k: int, output: Output) -> None:
    """Write output ``k`` into the columns."""
    write_row(track.q_nb, k, output.q_nb)
    write_row(track.gyro_bias_b_radps, k, output.gyro_bias_b_radps)
    write_row(track.cov_b_rad2, k, output.cov_b_rad2)
    write_row(track.innovation, k, output.innovation)
    track.ready[k] = output.ready


def collect_counts(state: Any) -> dict[str, int]:
    """Return an estimator's counts: the fields of a state, and of states within it, whose names begin with ``n_``."""
    found: dict[str, int] = {}
    for name, value in state._asdict().items():
        if hasattr(value, "_asdict"):
            found |= collect_counts(value)
        elif name.startswith("n_"):
            found[name] = int(value)
    return found


def write_row(column: Any, k: int, values: Any) -> None:
    """Write a tuple into row ``k``; do nothing where there is no column."""
    if column is not None:
        column[k] = values


@overload(write_row)
def _put(column: Any, k: Any, values: Any) -> Any:
    def skip(column: Any, k: Any, values: Any) -> None:
        return None

    def write(column: Any, k: Any, values: Any) -> None:
        for i in range(len(values)):
            column[k, i] = values[i]

    absent = isinstance(column, types.NoneType) or isinstance(values, types.NoneType)
    return skip if absent else write
