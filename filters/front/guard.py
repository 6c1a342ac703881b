"""Detect samples that are no measurement, and decide what an estimator gets in their place.

docs/streaming.md has the full table: time that does not rise, vectors that are not finite or larger than any sensor
reads, readings at the end of a sensor's range, readings that repeat. Each is counted.

**Clock.** A stamp that does not rise is left out. Stamps that keep rising among themselves before the last one taken
show that the clock was set, or that the last stamp was wrong: after more than ``GAP_S`` of them the new clock is
adopted, and the time that they took is a gap.
"""

from dataclasses import dataclass
from math import nan
from typing import NamedTuple

from stillpoint.datasets.compiled import compiled_inside, like
from stillpoint.datasets.measurements import LARGEST_MPS2, LARGEST_RADPS, LARGEST_UT
from stillpoint.datasets.settings import Settings, number
from stillpoint.filters.rotation import Vector
from stillpoint.filters.sample import GAP_S, Sample

# The last good rate stands in for broken ones that long; after it the body is taken to rest.
_HOLD_NS = 1_000_000_000
# How fast a body may turn otherwise than it did (sd, each axis), where the gyro says nothing.
_UNSEEN_RADPS = 1.0
# The stamp of what has not been: any clock begins later.
_NEVER_NS = -(2**63)
_LONGEST_NS = 2**63 - 1
# So many stamps in a row, at least, show another clock.
_CLOCK_SAMPLES = 10
_CLOCK_NS = round(GAP_S * 1e9)


@dataclass(frozen=True)
class Ranges(Settings):
    """Full scale of each sensor: a component that reaches it is saturated. The default means unknown."""

    gyro_radps: float = number(LARGEST_RADPS, 0.0, LARGEST_RADPS, "full scale of the gyro, rad/s")
    accel_mps2: float = number(LARGEST_MPS2, 0.0, LARGEST_MPS2, "full scale of the accelerometer, m/s^2")
    mag_ut: float = number(LARGEST_UT, 0.0, LARGEST_UT, "full scale of the magnetometer, uT")


class Fix(NamedTuple):
    """The motion that a satellite receiver measures."""

    course_rad: float  # clockwise from true north
    speed_mps: float  # over ground


class Raw(NamedTuple):
    """One stamp of the IMU as the sensors bring it, with the newest field and fix not brought before. Doubles."""

    t_ns: int
    gyro_b_radps: Vector
    accel_b_mps2: Vector
    mag_b_ut: Vector
    has_mag: bool
    fix: Fix
    has_fix: bool


class Coefficients(NamedTuple):
    """Full scales, in the precision of the run."""

    gyro_radps: float
    accel_mps2: float
    mag_ut: float


class Gyro(NamedTuple):
    """The guard's memory of the gyro."""

    last_b_radps: Vector  # good one
    last_ns: int  # its stamp, _NEVER_NS before the first
    n_bad_gyro: int  # not finite, or beyond any sensor: the last good one stands in, then rest
    n_saturated_gyro: int  # used as they are: no better rate is known. The sample says by how much they may be off
    n_same_gyro: int  # bit for bit the one before; used


class Accel(NamedTuple):
    """The guard's memory of the accelerometer."""

    last_b_mps2: Vector
    n_bad_accel: int  # left out
    n_saturated_accel: int  # left out: a clipped vector points elsewhere
    n_same_accel: int  # used


class Mag(NamedTuple):
    """The guard's memory of the magnetometer."""

    last_b_ut: Vector
    n_bad_mag: int  # left out
    n_saturated_mag: int  # left out
    n_same_mag: int  # used


class Late(NamedTuple):
    """Consecutive stamps before the last one taken that rise among themselves."""

    first_ns: int
    last_ns: int
    in_row: int


class Guard(NamedTuple):
    """The state of the guard between two samples, and its counts."""

    t_ns: int  # of the last sample taken, _NEVER_NS before the first
    late: Late
    gyro: Gyro
    accel: Accel
    mag: Mag
    n_imu_gaps: int  # intervals too long for one rate to describe them
    n_out_of_order: int  # samples left out: their time does not rise
    n_clock_steps: int  # how often another clock was taken over


class Reading(NamedTuple):
    """One vector in the precision of the run, and whether it can be used."""

    vector: Vector
    is_usable: bool
    is_saturated: bool
    is_same: bool


def coefficients(ranges: Ranges) -> Coefficients:
    """Return the full scales as constants."""
    return Coefficients(ranges.gyro_radps, ranges.accel_mps2, ranges.mag_ut)


@compiled_inside
def _no_late_stamps() -> Late:
    """Return an empty record of late stamps."""
    return Late(_NEVER_NS, _NEVER_NS, 0)


@compiled_inside
def start(c: Coefficients) -> Guard:
    """Return the state before the first sample."""
    none = nan  # the same as no vector
    last = (none, none, none)
    gyro = Gyro(last, _NEVER_NS, 0, 0, 0)
    return Guard(_NEVER_NS, _no_late_stamps(), gyro, Accel(last, 0, 0, 0), Mag(last, 0, 0, 0), 0, 0, 0)


@compiled_inside
def _check_vector(v: Vector, last: Vector, limit: float, largest: float) -> Reading:
    """Judge a vector as it came. NaN is not usable: no comparison with it is true."""
    is_usable = abs(v[0]) < largest and abs(v[1]) < largest and abs(v[2]) < largest
    vector = like(limit, v[0]), like(limit, v[1]), like(limit, v[2])
    reaches = abs(vector[0]) >= limit or abs(vector[1]) >= limit or abs(vector[2]) >= limit
    return Reading(vector, is_usable, is_usable and reaches, is_usable and vector == last)


@compiled_inside
def _bound_clipped_part(rate: float, limit: float) -> float:
    """Return what a component at the end of its range may hide: as much again."""
    return limit if abs(rate) >= limit else 0.0


@compiled_inside
def _elapsed_ns(t_ns: int, before_ns: int) -> int:
    """Return the time from the second stamp to the first, which is later; at most the largest int64."""
    elapsed = t_ns - before_ns
    return elapsed if elapsed >= 0 else _LONGEST_NS


@compiled_inside
def _add_late_stamp(late: Late, t_ns: int) -> tuple[Late, bool]:
    """Add a stamp that does not rise; True once such stamps have risen among themselves for long enough."""
    first_ns, last_ns, in_row = late
    if in_row == 0 or t_ns <= last_ns:
        return Late(t_ns, t_ns, 1), False
    late = Late(first_ns, t_ns, in_row + 1)
    return late, in_row + 1 >= _CLOCK_SAMPLES and _elapsed_ns(t_ns, first_ns) > _CLOCK_NS


@compiled_inside
def _choose_rate(gyro: Gyro, reading: Reading, t_ns: int, limit: float) -> tuple[Gyro, Vector, Vector]:
    """Return the rate to use (read, else the last good one for a while, else rest) and what it may hide."""
    last, last_ns, n_bad, n_saturated, n_same = gyro
    n_same += 1 if reading.is_same else 0
    n_saturated += 1 if reading.is_saturated else 0
    if reading.is_usable:
        x, y, z = reading.vector
        hidden = _bound_clipped_part(x, limit), _bound_clipped_part(y, limit), _bound_clipped_part(z, limit)
        return Gyro(reading.vector, t_ns, n_bad, n_saturated, n_same), reading.vector, hidden
    unseen = _UNSEEN_RADPS
    rate, hidden = (0.0, 0.0, 0.0), (unseen, unseen, unseen)
    if last_ns != _NEVER_NS and _elapsed_ns(t_ns, last_ns) <= _HOLD_NS:
        rate = last
    elif last_ns != _NEVER_NS:  # it may still turn as it did
        hidden = max(unseen, abs(last[0])), max(unseen, abs(last[1])), max(unseen, abs(last[2]))
    return Gyro(last, last_ns, n_bad + 1, n_saturated, n_same), rate, hidden


@compiled_inside
def _is_left_out(reading: Reading) -> bool:
    """Return whether the direction of an accelerometer or magnetometer vector is meaningless."""
    return reading.is_saturated or not reading.is_usable


@compiled_inside
def _count_reading(reading: Reading) -> tuple[int, int, int]:
    """Return whether a reading is bad, saturated, or the same as before: 1 or 0 each."""
    return 0 if reading.is_usable else 1, 1 if reading.is_saturated else 0, 1 if reading.is_same else 0


@compiled_inside
def step(guard: Guard, raw: Raw, c: Coefficients) -> tuple[Guard, Sample, bool]:
    """Return the sample that an estimator gets; False if there is none because time has not risen."""
    t_ns, late, gyro, accel, mag, n_gaps, n_out_of_order, n_clock_steps = guard
    none = (0.0, 0.0, 0.0)
    if raw.t_ns <= t_ns:
        late, is_clock = _add_late_stamp(late, raw.t_ns)
        if not is_clock:
            guard = Guard(t_ns, late, gyro, accel, mag, n_gaps, n_out_of_order + 1, n_clock_steps)
            return guard, Sample(0.0, none, none, none, False, False, none), False
        # What was left out took that long; a rate from before it is no longer held.
        t_ns, n_clock_steps = late.first_ns, n_clock_steps + 1
        gyro = Gyro(gyro.last_b_radps, _NEVER_NS, gyro.n_bad_gyro, gyro.n_saturated_gyro, gyro.n_same_gyro)
    dt_s = like(0.0, _elapsed_ns(raw.t_ns, t_ns) / 1e9) if t_ns != _NEVER_NS else 0.0
    n_gaps += 1 if dt_s > GAP_S else 0
    reading = _check_vector(raw.gyro_b_radps, gyro.last_b_radps, c.gyro_radps, LARGEST_RADPS)
    gyro, rate, hidden = _choose_rate(gyro, reading, raw.t_ns, c.gyro_radps)
    force = _check_vector(raw.accel_b_mps2, accel.last_b_mps2, c.accel_mps2, LARGEST_MPS2)
    n_bad, n_saturated, n_same = _count_reading(force)
    last = force.vector if force.is_usable else accel.last_b_mps2
    accel = Accel(last, accel.n_bad_accel + n_bad, accel.n_saturated_accel + n_saturated, accel.n_same_accel + n_same)
    field = _check_vector(raw.mag_b_ut, mag.last_b_ut, c.mag_ut, LARGEST_UT)
    if raw.has_mag:
        n_bad, n_saturated, n_same = _count_reading(field)
        last = field.vector if field.is_usable else mag.last_b_ut
        mag = Mag(last, mag.n_bad_mag + n_bad, mag.n_saturated_mag + n_saturated, mag.n_same_mag + n_same)
    has_accel, has_mag = not _is_left_out(force), raw.has_mag and not _is_left_out(field)
    accel_b, mag_b = force.vector if has_accel else none, field.vector if has_mag else none
    sample = Sample(dt_s, rate, accel_b, mag_b, has_accel, has_mag, hidden)
    return Guard(raw.t_ns, _no_late_stamps(), gyro, accel, mag, n_gaps, n_out_of_order, n_clock_steps), sample, True
