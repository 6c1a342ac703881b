"""Where a user's own recording comes from: what the user said, what the log knows, and when it was made."""

from datetime import UTC, datetime
from typing import Any

from stillpoint.datasets.importers.clock import UNIX_FROM_NS, Log
from stillpoint.datasets.importers.options import OwnOptions
from stillpoint.datasets.recording import Info, Times


def own_info(source: str, options: OwnOptions, t_ns: Times, sha256: dict[str, str], log: Log, **known: Any) -> Info:
    """The :class:`Info` of a recording whose IMU has the stamps ``t_ns``; ``known`` fields come from the log itself."""
    unix = t_ns[0] >= UNIX_FROM_NS
    said: dict[str, Any] = {
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
    return Info(source=source, sha256=sha256, **said | known)
