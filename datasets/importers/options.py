"""What a user may set about an import; the fields of a kind's options are the flags that the kind takes."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Options:
    """Options of every kind."""

    units_unchecked: bool = False  # keep a recording whose sizes are implausible, for the doctor to look at


@dataclass(frozen=True)
class OwnOptions(Options):
    """Options of the kinds that hold the user's own recordings: what only the user knows about them."""

    licence: str = ""
    citation: str = ""
    sensor: str = ""
    mag_uncalibrated: bool = False  # the size of the field says nothing (hard iron, raw counts)


@dataclass(frozen=True)
class PhoneOptions(OwnOptions):
    """Options of the logging apps for phones."""

    mag: Literal["raw", "calibrated"] = "raw"  # the sensor's own field where it was logged, or the system's
    platform: Literal["ios", "android"] | None = None  # where the log does not say it


@dataclass(frozen=True)
class TyrexOptions(Options):
    """Options of the Tyrex trials."""

    mag: Literal["raw", "calibrated"] = "raw"
