"""Clocks of logs: text becomes exact nanoseconds; wrong units, wraps and wild stamps are recognised."""

import re
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from decimal import Decimal
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from stillpoint.datasets.errors import BadParameter, BadSource
from stillpoint.datasets.recording import LAST_T_NS, Recording, Times, rate_hz

TIME_EXPONENT: dict[str, int] = {"s": 0, "ms": -3, "us": -6, "ns": -9}
_TIME_NAMES = {"s": "seconds", "ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}
ISO = "iso"  # the unit of ISO 8601 dates and times
_TIME_OF_DAY = re.compile(r"([0-2]?\d):([0-5]\d):([0-5]\d)(?:\.(\d+))?")
_DAY_NS = 86_400_000_000_000
UNIX_FROM_NS = 10**17  # stamps beyond 1973 count from 1970; no device runs for three years
_EPOCHS_S = (6e8, 2**31)  # 1989 to 2038: a number in this range of seconds is a date
BLANK = ("", "nan", "null", "none", "na", "n/a", "-nan")

# Rates outside are no inertial sensor's: the slowest loggers give 5 Hz, the fastest accelerometers 27 kHz.
_RATES_HZ = (2.0, 30_000.0)
_LONGEST_S = 31 * 86_400.0
_USUAL_HZ = (10.0, 2000.0)  # where a proposed unit should lead
_DISORDER_NS = 1_000_000_000  # packets overtake each other by less; a larger step back is a clock that was set
_COUNTER_BITS = (16, 24, 32)  # widths of the counters that wrap
_WILD_NS = 1_000_000_000  # a stamp that lies this far from its neighbours, between which it does not fit, is an error
_WILD_EDGE_NS = 86_400_000_000_000  # a first or last stamp has neighbours on one side only: a day
_MEDIAN_OF = 9  # stamps; up to four wild ones in a row are recognised


class Notes(Protocol):
    """Where the changes are counted; see :class:`stillpoint.datasets.importers.series.Log`."""

    def add_note(self, line: str) -> None:
        """Add a note."""


@dataclass(frozen=True, eq=False)
class Clock:
    """The stamps of all rows of a table; a row without a usable stamp is not ``known``."""

    name: str  # the column, for messages
    unit: str
    t_ns: Times  # (N,)
    known: NDArray[np.bool_]  # (N,)


def parse_times(
    cells: list[str], unit: str, where: str, lines: list[int], column: str = "time", flag: str = ""
) -> Clock:
    """Return exact nanoseconds of text stamps; a double keeps only 0.2 us of epoch seconds.

    ``unit`` is s, ms, us, ns or iso; ``lines`` are the line numbers of the cells; ``flag`` is what the user may set the
    unit by, "" where the format fixes it. An empty cell is an unknown stamp.
    Raises :class:`BadSource` for a cell that is no time, and names the unit that fits where one does.
    """
    known = np.ones(len(cells), dtype=np.bool_)
    if unit != ISO and len(cells) and (plain_ns := _parse_plain(cells, 9 + TIME_EXPONENT[unit])) is not None:
        return Clock(column, unit, plain_ns, known)
    t_ns = np.zeros(len(cells), dtype=np.int64)
    for row, cell in enumerate(cells):
        if cell.strip().lower() in BLANK:
            known[row] = False
            continue
        try:
            t_ns[row] = _parse_iso(cell) if unit == ISO else _parse_number(cell, TIME_EXPONENT[unit])
        except (ArithmeticError, ValueError):
            usual = "write 2021-06-12T08:00:00.5 or 08:00:00.5" if unit == ISO else "remove this line"
            advice = _propose_unit(cell, column, unit, flag) or usual
            raise BadSource(f"{where}, line {lines[row]}: {cell[:40]!r} is not a time in {unit}; {advice}") from None
    if not known.any():
        raise BadSource(f"{where}: column {column!r} holds no time; name another column")
    return Clock(column, unit, t_ns, known)


def _parse_plain(cells: list[str], places: int) -> Times | None:
    """Return ns of numbers with at most ``places`` digits behind the point; None where a cell is anything else.

    Gives what :func:`_parse_number` gives, in a tenth of the time.
    """
    zeros = "0" * places
    parts = [cell.partition(".") for cell in cells]
    if any(
        not (tail.isdigit() and len(tail) <= places if point else whole[-1:].isdigit()) for whole, point, tail in parts
    ):
        return None
    try:
        t_ns = np.array([int(f"{whole}{tail}{zeros[len(tail) :]}") for whole, _, tail in parts], dtype=np.int64)
    except (ValueError, OverflowError):
        return None
    last_ns = LAST_T_NS + 1_000_000_000
    return t_ns if -last_ns <= t_ns.min() and t_ns.max() <= last_ns else None


def _parse_number(cell: str, exponent: int) -> int:
    """Return a cell as whole nanoseconds, exactly; raises ``ValueError`` for text, and beyond 2038."""
    value = Decimal(cell.strip()).scaleb(9 + exponent)
    if not abs(value) <= LAST_T_NS + 1_000_000_000:  # also NaN; the size is tested before a long integer is made
        raise ValueError("beyond 2038")
    return int(value.to_integral_value())


def _parse_iso(cell: str) -> int:
    """Return ns since 1970 of ``2025-08-31T12:00:00.123456789+02:00``, or since midnight of ``12:00:00.5``.

    A date without a zone is taken as UTC.
    """
    text = cell.strip().replace(",", ".")
    if match := _TIME_OF_DAY.fullmatch(text):
        hours, minutes, seconds, digits = match.groups()
        whole_s = 3600 * int(hours) + 60 * int(minutes) + int(seconds)
        return whole_s * 1_000_000_000 + int(((digits or "") + "0" * 9)[:9])
    head, point, tail = text.partition(".")
    digits = tail[: len(tail) - len(tail.lstrip("0123456789"))]
    moment = datetime.fromisoformat(head + (tail[len(digits) :] if point else ""))
    moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    return round(moment.timestamp()) * 1_000_000_000 + int((digits + "0" * 9)[:9] if point else 0)


def _propose_unit(cell: str, column: str, declared: str, flag: str) -> str:
    """Return advice on the unit that makes this cell a date, or nothing."""
    try:
        _parse_iso(cell)
        return "this looks like dates" + (f": {flag} {column}:iso" if flag else "")
    except ValueError:
        pass
    try:
        value = float(cell)
    except ValueError:
        return ""
    for unit, exponent in TIME_EXPONENT.items():
        if unit != declared and _EPOCHS_S[0] < value * 10.0**exponent < _EPOCHS_S[1]:
            return f"this looks like {_TIME_NAMES[unit]}" + (f": {flag} {column}:{unit}" if flag else "")
    return ""


def check_rate(clock: Clock, where: str) -> None:
    """Raise :class:`BadParameter` where the unit gives a rate that no inertial sensor has, with the unit that fits."""
    t_ns = clock.t_ns[clock.known]
    steps = np.diff(t_ns)
    rising = steps[steps > 0]
    if len(t_ns) < 5 or (steps < 0).all():
        return
    _check_resolution(steps, where, clock.name)
    if len(rising) == 0:
        return
    rate_hz = 1e9 / float(np.median(rising))
    if _RATES_HZ[0] <= rate_hz <= _RATES_HZ[1]:
        return
    advice = "check its unit, or give --units-unchecked"
    for unit, exponent in TIME_EXPONENT.items():
        if clock.unit in TIME_EXPONENT and exponent != TIME_EXPONENT[clock.unit]:
            proposed_hz = rate_hz * 10.0 ** (TIME_EXPONENT[clock.unit] - exponent)
            if _USUAL_HZ[0] <= proposed_hz <= _USUAL_HZ[1]:
                advice = f"this looks like {_TIME_NAMES[unit]} ({proposed_hz:.4g} Hz): --time {clock.name}:{unit}"
                break
    raise BadParameter(
        f"{where}: --time {clock.name}:{clock.unit} gives {rate_hz:.4g} Hz over {np.ptp(t_ns) / 1e9:.4g} s, "
        f"which no inertial sensor has; {advice}"
    )


def _check_resolution(steps_ns: NDArray[np.int64], where: str, column: str) -> None:
    """Raise where most stamps equal the one before and the others are whole steps apart, as in a float32 epoch."""
    equal = float((steps_ns == 0).mean())
    smallest_ns = int(steps_ns[steps_ns > 0].min(initial=LAST_T_NS))
    if equal == 1.0 or (equal > 0.7 and (steps_ns % smallest_ns == 0).all()):
        rounded = "" if equal == 1.0 else f"to {smallest_ns / 1e9:g} s, "
        raise BadSource(
            f"{where}: {equal:.0%} of the stamps in {column!r} equal the one before; time was rounded {rounded}"
            "as a float32 rounds dates; log it as integers or float64, or import with --rate HZ"
        )


def check_clock(recording: Recording) -> None:
    """Raise :class:`BadSource` where the IMU of a recording has a rate or a span that no recording has."""
    stream = recording.imu if recording.imu is not None else recording.spin
    if stream is None or len(stream.t_ns) < 5:
        return
    hz = rate_hz(stream.t_ns)
    if not _RATES_HZ[0] <= hz <= _RATES_HZ[1]:
        raise BadSource(f"{recording.name}: has {hz:.4g} Hz, which no inertial sensor has; check the unit of its time")
    if recording.duration_s > _LONGEST_S:
        raise BadSource(
            f"{recording.name}: lasts {recording.duration_s / 86_400:.4g} days; a stamp or a clock is wrong: "
            "correct it, or give --units-unchecked"
        )


def note_disjoint_clocks(recording: Recording) -> Recording:
    """Return the recording with a note for every stream that does not overlap with the IMU in time."""
    clocks = dict(recording.streams())
    main = clocks.get("imu", clocks.get("spin"))
    if main is None:
        return recording
    apart = [name for name, t_ns in clocks.items() if t_ns[0] > main[-1] or t_ns[-1] < main[0]]
    notes = tuple(f"{name}: its stamps do not overlap with those of the IMU; its clock is another" for name in apart)
    return (
        replace(recording, info=replace(recording.info, notes=(*recording.info.notes, *notes))) if notes else recording
    )


def repair_clock(clock: Clock, log: Notes) -> Clock:
    """Unwrap a counter that overflowed and drop single stamps that fit nowhere; both are noted."""
    t_ns, known = clock.t_ns.copy(), clock.known.copy()
    t_ns[known] = unwrap_counter(t_ns[known], clock.name, log)
    wild = find_wild_stamps(t_ns[known])
    if wild.any():
        first = int(np.flatnonzero(wild)[0])
        log.add_note(
            f"time {clock.name!r}: {int(wild.sum())} stamps far from their neighbours dropped, first sample {first}"
        )
        known[np.flatnonzero(known)[wild]] = False
    return Clock(clock.name, clock.unit, t_ns, known)


def unwrap_counter(t_ns: Times, what: str, log: Notes) -> Times:
    """Add what a counter of 16, 24 or 32 bits (of s, ms, us or ns) lost where it overflowed, with a note.

    The time of day overflows at midnight.
    """
    steps = np.diff(t_ns)
    if not (steps < 0).any() or not (steps > 0).any():
        return t_ns
    usual_ns = float(np.median(steps[steps > 0]))
    added = np.zeros(len(t_ns), dtype=np.int64)
    for k in np.flatnonzero(steps < 0):
        span = _find_wrap(int(t_ns[k]), int(t_ns[k + 1]), usual_ns)
        if span is not None:
            span_ns, name = span
            added[k + 1 :] += span_ns
            log.add_note(f"time {what!r}: counter of {name} wrapped after sample {k}; unwrapped")
    return t_ns + added


def _find_wrap(before_ns: int, after_ns: int, usual_ns: float) -> tuple[int, str] | None:
    """Return size in ns and name of the counter whose overflow explains a step back, or None."""
    if 0 < after_ns + _DAY_NS - before_ns <= 10 * usual_ns and before_ns <= _DAY_NS:
        return _DAY_NS, "a day"
    for unit, exponent in TIME_EXPONENT.items():
        for bits in _COUNTER_BITS:
            span_ns = (1 << bits) * 10 ** (9 + exponent)
            step_ns = after_ns + span_ns - before_ns
            if not 0 < step_ns <= 10 * usual_ns or span_ns < 20 * usual_ns:
                continue
            from_its_end = before_ns < span_ns <= before_ns + 10 * usual_ns and after_ns >= 0
            if from_its_end or span_ns > 1000 * usual_ns:
                return span_ns, f"2^{bits} {unit}"
    return None


def find_wild_stamps(t_ns: Times) -> NDArray[np.bool_]:
    """Return a mask (N,) of the stamps that lie far ahead of or behind both neighbours.

    The running median of a rising sequence is the sequence itself, so that gaps are not touched. At the ends, where
    neighbours stand on one side only, the distance must exceed a day and ten times the span of all others.
    """
    wild = np.zeros(len(t_ns), dtype=np.bool_)
    if len(t_ns) < _MEDIAN_OF:
        return wild
    steps = np.abs(np.diff(t_ns))
    usual_ns = float(np.median(steps))
    off = np.abs(t_ns - median_filter(t_ns, _MEDIAN_OF, mode="mirror"))
    wild = off > max(_WILD_NS, 50 * usual_ns)
    half = _MEDIAN_OF // 2
    inner = t_ns[half:-half][~wild[half:-half]]
    far_ns = max(_WILD_EDGE_NS, 10 * int(np.ptp(inner)) if len(inner) else 0)
    wild[:half] &= off[:half] > far_ns
    wild[-half:] &= off[-half:] > far_ns
    return np.asarray(wild)


def describe_disorder(t_ns: Times, lines: list[int], clock: Clock, where: str) -> str:
    """Return the message about stamps that do not rise: how many, how far back, and what to do about it."""
    falls = np.flatnonzero(np.diff(t_ns) <= 0)
    back_ns = int((np.maximum.accumulate(t_ns) - t_ns).max())
    at = f"{where}, line {lines[int(falls[0]) + 1]}, column {clock.name!r}: time does not rise ({len(falls)} such lines"
    if back_ns <= _DISORDER_NS:
        return f"{at}, at most {back_ns / 1e6:g} ms back); correct the log, or import it with --drop-disordered"
    return (
        f"{at}, up to {back_ns / 1e9:.6g} s back); the clock was set or a second log begins: "
        "split the file where the time steps back, and import the parts"
    )
