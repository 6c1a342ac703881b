"""What a flag says about columns of a log: ``gx,-gy,gz:deg/s`` -> names, signs and the factor of the unit."""

from dataclasses import dataclass

import numpy as np

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.importers.delimited import Table
from stillpoint.datasets.importers.units import Scale, plain, scale
from stillpoint.datasets.recording import Floats


@dataclass(frozen=True)
class Columns:
    """Columns of a table that make one vector."""

    written: str  # as the user wrote them, without the unit
    names: tuple[str, ...]
    signs: Floats
    unit: Scale

    def values(self, table: Table) -> Floats:
        """(N, k) in the vocabulary's unit; NaN where a cell is empty."""
        return table.floats(self.names) * self.signs * self.unit.factor

    @property
    def flipped(self) -> str:
        """The end of a line about a conversion: which axes were turned."""
        axes = [axis for axis, sign in zip("xyz", self.signs, strict=False) if sign < 0]
        return f", sign of {', '.join(axes)} flipped" if axes else ""


def vector(text: str, flag: str, units: dict[str, float], count: int = 3) -> Columns:
    """``X,Y,Z:UNIT``, or as many columns as ``count`` says; raises :class:`BadParameter` that names the flag."""
    columns, unit = split(text, "")
    if not unit:
        form = ",".join("XYZ"[:count] if count <= 3 else "ABCDEFGHIJKLMNOPQRSTUVWXYZ"[:count])
        raise BadParameter(f"{flag} {text!r}: has no unit; write {form}:UNIT with one of {', '.join(units)}")
    return _columns(columns, count, flag, scale(unit, units, flag))


def quaternion_columns(text: str, flag: str) -> Columns:
    """``W,X,Y,Z``; raises :class:`BadParameter` that names the flag."""
    return _columns(text, 4, flag, Scale(1.0, ""))


def split(text: str, default: str) -> tuple[str, str]:
    """Columns and unit of ``COLUMNS:UNIT``."""
    columns, colon, unit = text.rpartition(":")
    return (columns.strip(), plain(unit)) if colon else (text.strip(), default)


def _columns(written: str, count: int, flag: str, unit: Scale) -> Columns:
    parts = [part.strip() for part in written.split(",")]
    if len(parts) != count or not all(part.lstrip("-") for part in parts):
        raise BadParameter(f"{flag} {written!r}: names {len(parts)} columns, not {count}; write them as A,B,C")
    names = tuple(part.removeprefix("-") for part in parts)
    doubled = next((name for name in names if names.count(name) > 1), None)
    if doubled is not None:
        raise BadParameter(f"{flag} {written!r}: names the column {doubled!r} twice")
    return Columns(written, names, np.array([-1.0 if part.startswith("-") else 1.0 for part in parts]), unit)
