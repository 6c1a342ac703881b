"""Units that logs come in, as factors to the units of the vocabulary."""

import math
import re
from dataclasses import dataclass

from stillpoint.datasets.errors import BadParameter

STANDARD_GRAVITY_MPS2 = 9.80665  # the g of data sheets and of phones

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
TIME_EXPONENT: dict[str, int] = {"s": 0, "ms": -3, "us": -6, "ns": -9}
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


def plain(unit: str) -> str:
    """The spelling used in the tables here: ``µT`` -> ``uT``, ``dps`` -> ``deg/s``."""
    return _SPELLINGS.get(unit.strip(), unit.strip())


def scale(text: str, table: dict[str, float], flag: str) -> Scale:
    """Read ``UNIT`` or ``FACTOR*UNIT`` (raw counts); raises :class:`BadParameter` with the units there are."""
    match = re.fullmatch(r"\s*(?:([0-9.eE+-]+)\s*\*\s*)?(.+?)\s*", text)
    unit = plain(match[2]) if match else ""
    if match is None or unit not in table:
        raise BadParameter(f"{flag}: no unit {text!r}; there are {', '.join(table)}, or FACTOR*UNIT for raw counts")
    try:
        counts = float(match[1]) if match[1] else 1.0
    except ValueError:
        raise BadParameter(f"{flag}: {match[1]!r} is not a number; write FACTOR*UNIT, as 0.061*mg") from None
    return Scale(counts * table[unit], f"{match[1]}*{unit}" if match[1] else unit)
