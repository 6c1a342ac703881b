"""Read samples from lines of text: NDJSON or CSV, as the first line shows (docs/streaming.md)."""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from reprlib import repr as short
from typing import Any, NamedTuple

from stillpoint.datasets.errors import BadParameter

_NAN = float("nan")
_IMU = ("gx", "gy", "gz", "ax", "ay", "az")
_MAG = ("mx", "my", "mz")
_FIX = ("course_rad", "speed_mps")
_TIME = ("t_ns", "t_s")

Vector = tuple[float, ...]


class Arrival(NamedTuple):
    """The sample of one line, as :meth:`stillpoint.filters.Stream.update` takes it."""

    t_ns: int
    gyro_b_radps: Vector
    accel_b_mps2: Vector
    mag_b_ut: Vector | None
    course: tuple[float, float] | None


class SpinArrival(NamedTuple):
    """The sample of one line, as :meth:`stillpoint.filters.SpinStream.update` takes it."""

    t_ns: int
    accel_mps2: Vector
    gyro_radps: Vector


@dataclass(frozen=True)
class Layout:
    """The fields that a line may have, and the sample that they make."""

    required: tuple[str, ...]
    optional: tuple[str, ...]
    says: str  # the fields with their units, for who gave others
    arrival: Callable[[Mapping[str, Any]], Arrival | SpinArrival]


class Malformed(ValueError):
    """A line that is not a sample, and the reason."""


class Lines:
    """Reads one line after the other; the first that is not empty says which format and which fields there are.

    Raises :class:`BadParameter` when the first line names no samples, :class:`Malformed` for any other bad line.
    """

    def __init__(self, layout: Layout | None = None) -> None:
        self.ignored: tuple[str, ...] = ()
        self._layout = ATTITUDE if layout is None else layout
        self._values: Callable[[str], Mapping[str, Any]] | None = None

    def read(self, raw: bytes) -> Arrival | SpinArrival | None:
        """Return the sample of a line; None for an empty line and for the header."""
        try:
            text = raw.decode("utf-8-sig" if self._values is None else "utf-8").strip()
        except UnicodeDecodeError:
            raise Malformed("it is not UTF-8 text") from None
        if not text:
            return None
        if self._values is None:
            return self._read_first(text)
        return self._layout.arrival(self._values(text))

    def _read_first(self, text: str) -> Arrival | SpinArrival | None:
        """Take the first line: a JSON object is a sample already, a CSV header names the columns."""
        if text.startswith("{"):
            values = _parse_object(text)
            self._require_names(list(values))
            self._values = _parse_object
            return self._layout.arrival(values)
        names = [name.strip() for name in text.split(",")]
        self._require_names(names)

        def row(line: str) -> Mapping[str, Any]:
            """Return the cells of a line by their names; raises :class:`Malformed` for another number of cells."""
            cells = line.split(",")
            if len(cells) != len(names):
                raise Malformed(f"it has {len(cells)} values, the header {len(names)} names")
            return {name: cell.strip() for name, cell in zip(names, cells, strict=True)}

        self._values = row
        return None

    def _require_names(self, names: list[str]) -> None:
        """Raise :class:`BadParameter` where a required name is missing, and note the names that are ignored."""
        missing = [name for name in self._layout.required if name not in names]
        if not set(_TIME) & set(names):
            missing.insert(0, "t_ns")
        if missing:
            given = ", ".join(names)[:100]
            raise BadParameter(
                f"the first line names {given}, but not {', '.join(missing)}; give t_ns or t_s, {self._layout.says}"
            )
        known = {*_TIME, *self._layout.required, *self._layout.optional}
        self.ignored = tuple(name for name in names if name not in known)


def _make_arrival(values: Mapping[str, Any]) -> Arrival:
    """Return the sample that these fields make; a missing field is NaN, which the guard of a stream handles."""
    gyro, accel, mag, fix = (
        tuple(_parse_number(values, name) for name in names) for names in (_IMU[:3], _IMU[3:], _MAG, _FIX)
    )
    return Arrival(
        _parse_stamp(values),
        gyro,
        accel,
        mag if _has_any(values, _MAG) else None,
        (fix[0], fix[1]) if _has_any(values, _FIX) else None,
    )


ATTITUDE = Layout(
    _IMU,
    (*_MAG, *_FIX),
    "gx, gy, gz (rad/s), ax, ay, az (m/s^2), where there are some mx, my, mz (uT), course_rad, speed_mps",
    _make_arrival,
)


def format_csv_header(has_mag: bool, has_fix: bool) -> str:
    """Return the first line of samples as CSV; field and fix are optional columns."""
    return ",".join(("t_ns", *_IMU, *(_MAG if has_mag else ()), *(_FIX if has_fix else ())))


def format_csv_lines(samples: Iterable[Arrival], has_mag: bool, has_fix: bool) -> Iterator[str]:
    """Yield lines, after the header, from which :class:`Lines` reads these samples bit for bit.

    A number that is not finite is written as it is, ``nan``: an empty cell would be no field, or no fix, at all.
    """
    for sample in samples:
        numbers: list[float | str] = [*sample.gyro_b_radps, *sample.accel_b_mps2]
        if has_mag:
            numbers += [""] * len(_MAG) if sample.mag_b_ut is None else sample.mag_b_ut
        if has_fix:
            numbers += [""] * len(_FIX) if sample.course is None else sample.course
        yield ",".join((str(sample.t_ns), *(each if isinstance(each, str) else repr(each) for each in numbers)))


def make_spin_layout(n_accels: int, n_gyros: int) -> Layout:
    """Return the layout for a spinning body: a field per accelerometer and gyro, in the order of its geometry."""
    accels, gyros = (tuple(f"{letter}{i + 1}" for i in range(n)) for letter, n in (("a", n_accels), ("g", n_gyros)))

    def make_spin_arrival(values: Mapping[str, Any]) -> SpinArrival:
        accel, gyro = (tuple(_parse_number(values, name) for name in names) for names in (accels, gyros))
        return SpinArrival(_parse_stamp(values), accel, gyro)

    units = [f"{', '.join(names)} ({unit})" for names, unit in ((accels, "m/s^2"), (gyros, "rad/s")) if names]
    return Layout((*accels, *gyros), (), ", ".join(units), make_spin_arrival)


def _parse_object(text: str) -> Mapping[str, Any]:
    """Return a line as a mapping; raises :class:`Malformed` for one that is no JSON object."""
    try:
        values = json.loads(text)
    except ValueError as error:
        raise Malformed(f"it is not JSON ({error})") from None
    except RecursionError:
        raise Malformed("it is not a sample (nested too deeply)") from None
    if not isinstance(values, dict):
        raise Malformed("it is not a JSON object")
    return values


def _has_any(values: Mapping[str, Any], names: tuple[str, ...]) -> bool:
    return any(values.get(name) not in (None, "") for name in names)


def _parse_number(values: Mapping[str, Any], name: str) -> float:
    """Return a value as a number, NaN for a missing one; raises :class:`Malformed`."""
    value = values.get(name)
    if value is None or value == "":
        return _NAN
    if isinstance(value, bool):
        raise Malformed(f"{name} is {short(value)}, not a number")
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        raise Malformed(f"{name} is {short(value)}, not a number") from None


def _parse_stamp(values: Mapping[str, Any]) -> int:
    """Return the time of a sample in ns, from ``t_ns`` or from ``t_s``; raises :class:`Malformed`."""
    given = [name for name in _TIME if values.get(name) not in (None, "")]
    if not given:
        raise Malformed(f"{' and '.join(name for name in _TIME if name in values) or 't_ns'} has no value")
    name = given[0]
    value = values[name]
    if isinstance(value, bool):
        raise Malformed(f"{name} is {short(value)}, not a time")
    try:
        t_ns = round(_parse_number(values, name) * 1e9) if name == "t_s" else int(value)
    except (TypeError, ValueError, OverflowError):
        raise Malformed(f"{name} is {short(value)}, not a time") from None
    if not -(2**63) <= t_ns < 2**63 or (isinstance(value, float) and name == "t_ns" and value != t_ns):
        raise Malformed(f"{name} is {short(value)}: give whole nanoseconds within 63 bits")
    return t_ns
