"""The options of an import, and the facts about a recording that follow from it.

The fields of a kind's options are the flags that the kind takes.
"""

from dataclasses import dataclass, replace
from datetime import UTC, date, datetime
from typing import Any, Literal

import numpy as np

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.importers.clock import UNIX_FROM_NS
from stillpoint.datasets.importers.series import Log
from stillpoint.datasets.recording import Info, Recording, Times


@dataclass(frozen=True)
class Options:
    """Options of every kind."""

    units_unchecked: bool = False  # keep a recording whose sizes are implausible, for the doctor to look at
    place: str | None = None  # "LAT,LON" or "LAT,LON,ALT", deg and m
    date: str | None = None  # ISO date of the recording


@dataclass(frozen=True)
class OwnOptions(Options):
    """Options of the kinds that hold the user's own recordings: what only the user knows about them."""

    licence: str = ""
    citation: str = ""
    sensor: str = ""
    mag_uncalibrated: bool = False  # the size of the field has no meaning (hard iron, raw counts)


@dataclass(frozen=True)
class PhoneOptions(OwnOptions):
    """Options of the logging apps for phones."""

    mag: Literal["raw", "calibrated"] = "raw"  # the sensor's own field where it was logged, or the system's
    platform: Literal["ios", "android"] | None = None  # where the log does not say it


@dataclass(frozen=True)
class TyrexOptions(Options):
    """Options of the Tyrex trials."""

    mag: Literal["raw", "calibrated"] = "raw"


def parse_place(text: str) -> tuple[float, float, float]:
    """Return latitude and longitude in deg and altitude in m of ``LAT,LON[,ALT]``; raises :class:`BadParameter`."""
    try:
        numbers = [float(part) for part in text.split(",")]
        latitude, longitude, altitude = numbers if len(numbers) == 3 else (*numbers, 0.0)
    except ValueError:
        raise BadParameter(f"--place {text!r}: is not LAT,LON or LAT,LON,ALT in deg and m") from None
    if not (abs(latitude) <= 90 and abs(longitude) <= 360 and abs(altitude) < 100_000):
        raise BadParameter(
            f"--place {text!r}: lies outside +-90, +-360 deg; give LAT,LON in deg, south and west negative"
        )
    return latitude, longitude, altitude


def parse_date(text: str) -> str:
    """Return an ISO date as it is written; raises :class:`BadParameter`."""
    try:
        return date.fromisoformat(text).isoformat()
    except ValueError:
        raise BadParameter(f"--date {text!r}: is not a date; write it as 2025-08-31") from None


def apply_place_and_date(recording: Recording, options: Options) -> Info:
    """Return the facts of a recording with the place and the date that the user gave, else the place of its fixes."""
    info = recording.info
    if options.place is not None:
        info = replace(info, place_lat_lon_alt=parse_place(options.place))
    elif info.place_lat_lon_alt is None and recording.gps is not None and recording.gps.valid.any():
        gps, valid = recording.gps, recording.gps.valid
        height_m = gps.alt_m[valid][np.isfinite(gps.alt_m[valid])]
        place = (float(np.median(gps.lat_deg[valid])), float(np.median(gps.lon_deg[valid])))
        line = f"place from the median of {int(valid.sum())} fixes: {place[0]:.4f}, {place[1]:.4f} deg"
        height = float(np.median(height_m)) if len(height_m) else 0.0
        info = replace(info, place_lat_lon_alt=(*place, height), conversions=(*info.conversions, line))
    return info if options.date is None else replace(info, date=parse_date(options.date))


def make_info(source: str, options: OwnOptions, t_ns: Times, sha256: dict[str, str], log: Log, **known: Any) -> Info:
    """Return the :class:`Info` of a recording whose stamps are ``t_ns``; ``known`` fields come from the log itself."""
    unix = t_ns[0] >= UNIX_FROM_NS
    given: dict[str, Any] = {
        "licence": options.licence,
        "citation": options.citation,
        "sensor": options.sensor,
        "epoch": "unix" if unix else "source",
        "date": datetime.fromtimestamp(t_ns[0] / 1e9, UTC).date().isoformat() if unix else "",
        "mag_uncalibrated": options.mag_uncalibrated,
        "units_unchecked": options.units_unchecked,
        "conversions": tuple(log.conversions),
        "notes": tuple(log.notes),
    }
    return Info(source=source, sha256=sha256, **given | known)
