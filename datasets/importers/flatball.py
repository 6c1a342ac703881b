"""Flights of the instrumented disc of misc-protolabs/flatball-ins: one IMU beside the spin axis, and a magnetometer.

The log has no time; the firmware samples at 100 Hz. The IMU is an ISM330DHCX: steps of 0.488 mg and 0.14 deg/s say
+-16 g and +-4000 deg/s. Where on the disc it sits is not published, so its lever arm is NaN in the geometry: to be
found from the flight. In the frame of the recording x is the spin axis (the IMU's z), y the IMU's x, z the IMU's y.
"""

from pathlib import Path

import numpy as np

from stillpoint.datasets.errors import BadSource
from stillpoint.datasets.importers.columns import FIELD, FORCE, RATE
from stillpoint.datasets.importers.delimited_log import read_table
from stillpoint.datasets.importers.files import hash_files
from stillpoint.datasets.importers.imported import Imported
from stillpoint.datasets.importers.options import Options
from stillpoint.datasets.importers.series import Log
from stillpoint.datasets.recording import Info, Mag, Recording, Spin, SpinGeometry

_RATE_HZ = 100
_RANGE_G = 16.0
# Columns in the recording's order: along the spin axis, then the IMU's x and y.
_ACCEL, _GYRO, _MAG = ("acc-z", "acc-x", "acc-y"), ("gz", "gx", "gy"), ("mag-z", "mag-x", "mag-y")
_GEOMETRY = SpinGeometry(
    accel_r_b_m=np.full((3, 3), np.nan),
    accel_axis_b=np.eye(3),
    gyro_axis_b=np.eye(3),
    accel_range_mps2=np.full(3, _RANGE_G * FORCE["g"]),
)


def read_flatball(file: Path, options: Options) -> Imported:
    """Return the flight of a log. Raises :class:`BadSource`."""
    log = Log()
    table = read_table(file, None, log)
    missing = [name for name in (*_ACCEL, *_GYRO, *_MAG) if name not in table.columns]
    if missing:
        raise BadSource(f"{file}: no column {', '.join(missing)}; name a log of the flatball firmware")
    t_ns = np.arange(len(table.rows), dtype=np.int64) * (1_000_000_000 // _RATE_HZ)
    log.add_conversion(f"stamps from the row number at {_RATE_HZ} Hz, the rate of the firmware")
    log.add_conversion("accelerometer g -> m/s^2; gyro deg/s -> rad/s; axes z, x, y of the IMU -> x (spin axis), y, z")
    log.add_note("the place of the IMU on the disc is not published: its lever arm is NaN")
    log.add_note("the attitude of the on-board filter and what it derived (fe-acc, fl-acc) are not imported")
    spin = Spin(t_ns, FORCE["g"] * table.read_floats(_ACCEL), RATE["deg/s"] * table.read_floats(_GYRO), _GEOMETRY)
    info = Info(
        source="misc-protolabs/flatball-ins",
        licence="Apache 2.0",
        citation="misc-protolabs: flatball-ins, https://github.com/misc-protolabs/flatball-ins",
        sensor="ISM330DHCX, MMC5983MA",
        mag_uncalibrated=True,
        units_unchecked=options.units_unchecked,
        sha256=hash_files([file], file.parent),
        conversions=tuple(log.conversions),
        notes=tuple(log.notes),
    )
    return Imported(Recording(file.stem, spin=spin, mag=Mag(t_ns, FIELD["uT"] * table.read_floats(_MAG)), info=info))
