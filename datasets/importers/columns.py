"""Columns and units as a user writes them: ``gx,-gy,gz:deg/s`` means names, signs and the factor of the unit."""

import math
import re
from dataclasses import dataclass

import numpy as np

from stillpoint.datasets.constants import STANDARD_GRAVITY_MPS2
from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.importers.delimited import Table
from stillpoint.datasets.recording import Floats

RATE: dict[str, float] = {
    "rad/s": 1.0,
    "deg/s": math.pi / 180,
    "mdeg/s": math.pi / 180e3,
    "mrad/s": 1e-3,
    "rev/s": 2 * math.pi,
    "rpm": 2 * math.pi / 60,
}
ANGLE: dict[str, float] = {"rad": 1.0, "deg": math.pi / 180, "rev": 2 * math.pi}
FORCE: dict[str, float] = {
    "m/s^2": 1.0,
    "g": STANDARD_GRAVITY_MPS2,
    "mg": STANDARD_GRAVITY_MPS2 / 1e3,
    "cm/s^2": 1e-2,
}
FIELD: dict[str, float] = {"uT": 1.0, "nT": 1e-3, "mT": 1e3, "T": 1e6, "gauss": 100.0, "mgauss": 0.1}
LENGTH: dict[str, float] = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}

_SPELLINGS = {
    "dps": "deg/s",
    "°/s": "deg/s",
    "degree/s": "deg/s",
    "m/s2": "m/s^2",
    "m/s²": "m/s^2",
    "m/s/s": "m/s^2",
    "gal": "cm/s^2",
    "ga": "gauss",
    "Gs": "gauss",
    "G": "gauss",
    "mG": "mgauss",
    "µT": "uT",
    "μT": "uT",
    "µs": "us",
    "μs": "us",
}


@dataclass(frozen=True)
class Scale:
    """A factor to the vocabulary's unit, and how it was written."""

    factor: float
    written: str


def normalise_unit(unit: str) -> str:
    """Return the spelling used in the tables here: ``µT`` -> ``uT``, ``dps`` -> ``deg/s``."""
    return _SPELLINGS.get(unit.strip(), unit.strip())


def parse_unit(text: str, table: dict[str, float], flag: str) -> Scale:
    """Return the factor of ``UNIT`` or ``FACTOR*UNIT`` (raw counts); raises :class:`BadParameter`."""
    match = re.fullmatch(r"\s*(?:([0-9.eE+-]+)\s*\*\s*)?(.+?)\s*", text)
    unit = normalise_unit(match[2]) if match else ""
    if match is None or unit not in table:
        raise BadParameter(f"{flag}: no unit {text!r}; there are {', '.join(table)}, or FACTOR*UNIT for raw counts")
    try:
        counts = float(match[1]) if match[1] else 1.0
    except ValueError:
        raise BadParameter(f"{flag}: {match[1]!r} is not a number; write FACTOR*UNIT, as 0.061*mg") from None
    return Scale(counts * table[unit], f"{match[1]}*{unit}" if match[1] else unit)


@dataclass(frozen=True)
class Columns:
    """Columns of a table that make one vector."""

    written: str  # as the user wrote them, without the unit
    names: tuple[str, ...]
    signs: Floats
    unit: Scale

    def values(self, table: Table) -> Floats:
        """Return (N, k) in the unit of the vocabulary; NaN where a cell is empty."""
        return table.read_floats(self.names) * self.signs * self.unit.factor

    @property
    def flipped(self) -> str:
        """The end of a line about a conversion: which axes were turned."""
        axes = [axis for axis, sign in zip("xyz", self.signs, strict=False) if sign < 0]
        return f", sign of {', '.join(axes)} flipped" if axes else ""


def parse_columns(text: str, flag: str, units: dict[str, float], count: int = 3) -> Columns:
    """Return the columns of ``X,Y,Z:UNIT``, or as many as ``count`` says; raises :class:`BadParameter`."""
    columns, unit = split(text, "")
    if not unit:
        form = ",".join("XYZ"[:count] if count <= 3 else "ABCDEFGHIJKLMNOPQRSTUVWXYZ"[:count])
        raise BadParameter(f"{flag} {text!r}: has no unit; write {form}:UNIT with one of {', '.join(units)}")
    return _parse_columns(columns, count, flag, parse_unit(unit, units, flag))


def parse_quaternion(text: str, flag: str) -> Columns:
    """Return the columns of ``W,X,Y,Z``; raises :class:`BadParameter` that names the flag."""
    return _parse_columns(text, 4, flag, Scale(1.0, ""))


def split(text: str, default: str) -> tuple[str, str]:
    """Return columns and unit of ``COLUMNS:UNIT``."""
    columns, colon, unit = text.rpartition(":")
    return (columns.strip(), normalise_unit(unit)) if colon else (text.strip(), default)


def _parse_columns(written: str, count: int, flag: str, unit: Scale) -> Columns:
    """Return the columns that a flag names, a minus for a turned axis; raises :class:`BadParameter`."""
    parts = [part.strip() for part in written.split(",")]
    if len(parts) != count or not all(part.lstrip("-") for part in parts):
        raise BadParameter(f"{flag} {written!r}: names {len(parts)} columns, not {count}; write them as A,B,C")
    names = tuple(part.removeprefix("-") for part in parts)
    doubled = next((name for name in names if names.count(name) > 1), None)
    if doubled is not None:
        raise BadParameter(f"{flag} {written!r}: names the column {doubled!r} twice")
    return Columns(written, names, np.array([-1.0 if part.startswith("-") else 1.0 for part in parts]), unit)
