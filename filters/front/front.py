"""The stages between the sensors and every estimator: the guard, then the source of the heading.

One compiled step serves a stream and the loop over a recording, so both give an estimator the same samples.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.compiled import compiled_entry, compiled_inside
from stillpoint.datasets.recording import Floats, Times
from stillpoint.filters.front import guard, heading_source
from stillpoint.filters.front.guard import Fix, Raw
from stillpoint.filters.sample import Log, Sample, write_row


class Coefficients(NamedTuple):
    """Constants of both stages."""

    guard: guard.Coefficients
    heading: heading_source.Coefficients | None  # None: the magnetometer as it is


class State(NamedTuple):
    """State of both stages."""

    guard: guard.Guard
    heading: heading_source.State


class RawLog(NamedTuple):
    """A recording as the sensors bring it: N samples of the IMU, and the fields and fixes that are new at each."""

    t_ns: Times  # (N,)
    gyro_b_radps: Floats  # (N, 3)
    accel_b_mps2: Floats  # (N, 3)
    mag_b_ut: Floats  # (M, 3)
    mag_row: NDArray[np.int64]  # (N,) the row of the field that this sample brings, -1 for none
    course_rad: Floats  # (F,)
    speed_mps: Floats  # (F,)
    fix_row: NDArray[np.int64]  # (N,) likewise


@compiled_entry
def start(c: Coefficients) -> State:
    """Return the state before the first sample."""
    return State(guard.start(c.guard), heading_source.start(0.0))


@compiled_inside
def step(state: State, raw: Raw, c: Coefficients) -> tuple[State, Sample, bool]:
    """Return the sample for the estimator; False if there is none because time has not risen."""
    watched, sample, is_taken = guard.step(state.guard, raw, c.guard)
    heading = state.heading
    if is_taken:
        heading, sample = heading_source.step(heading, sample, raw.fix, raw.has_fix, c.heading)
    return State(watched, heading), sample, is_taken


@compiled_inside
def _read_raw(log: RawLog, k: int) -> Raw:
    """Return sample ``k`` of the columns."""
    gyro, accel = log.gyro_b_radps, log.accel_b_mps2
    field, fix = log.mag_b_ut[max(log.mag_row[k], 0)], max(log.fix_row[k], 0)
    return Raw(
        log.t_ns[k],
        (gyro[k, 0], gyro[k, 1], gyro[k, 2]),
        (accel[k, 0], accel[k, 1], accel[k, 2]),
        (field[0], field[1], field[2]),
        log.mag_row[k] >= 0,
        Fix(log.course_rad[fix], log.speed_mps[fix]),
        log.fix_row[k] >= 0,
    )


def filter_log(raw: RawLog, state: State, c: Coefficients) -> tuple[State, Log]:
    """Run over every sample of a log whose time rises; return what the estimator gets, in the log's precision."""
    n, kind = len(raw.t_ns), raw.gyro_b_radps.dtype
    gyro, accel, mag, hidden = (np.empty((n, 3), kind) for _ in range(4))
    log = Log(np.empty(n, kind), gyro, accel, mag, np.empty(n, np.bool_), np.empty(n, np.bool_), hidden)
    return _fill_log(log, raw, state, c), log


@compiled_entry
def _fill_log(log: Log, raw: RawLog, state: State, c: Coefficients) -> State:
    """Write what the estimator gets into the columns and return the state after it."""
    for k in range(len(raw.t_ns)):
        state, sample, _ = step(state, _read_raw(raw, k), c)
        log.dt_s[k] = sample.dt_s
        write_row(log.gyro_b_radps, k, sample.gyro_b_radps)
        write_row(log.accel_b_mps2, k, sample.accel_b_mps2)
        write_row(log.mag_b_ut, k, sample.mag_b_ut)
        write_row(log.hidden_b_radps, k, sample.hidden_b_radps)
        log.has_accel[k], log.has_mag[k] = sample.has_accel, sample.has_mag
    return state
