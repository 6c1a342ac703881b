"""CSV files of the iOS app SensorLog, one row per tick of its logger.

Each sensor has its own stamp (``gyroTimestamp_sinceReboot(s)``), and rows repeat a sample until the next one comes.
Accelerations are in g with Apple's sign (-1 g on the axis that points up); ``motionQuaternion`` takes the body to its
reference frame. Body: x right, y to the top, z out of the screen.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from stillpoint.datasets.errors import BadSource
from stillpoint.datasets.importers.clock import ISO
from stillpoint.datasets.importers.columns import STANDARD_GRAVITY_MPS2
from stillpoint.datasets.importers.delimited import Table
from stillpoint.datasets.importers.delimited_log import read_table
from stillpoint.datasets.importers.device_attitude import read_device_attitude
from stillpoint.datasets.importers.files import hash_files
from stillpoint.datasets.importers.imported import Imported, make_mag
from stillpoint.datasets.importers.options import OwnOptions, make_info
from stillpoint.datasets.importers.series import Log, Series, make_gps, merge_imu, sort_by_time
from stillpoint.datasets.recording import Gps, Mag, Recording
from stillpoint.datasets.trajectory import Estimate

_XYZ = "XYZ"
_MOTION_TIME = "motionTimestamp_sinceReboot(s)"
_GYROS = (
    ("gyroTimestamp_sinceReboot(s)", "gyroRotation{}(rad/s)"),
    (_MOTION_TIME, "motionRotationRate{}(rad/s)"),
)
_ACCEL = ("accelerometerTimestamp_sinceReboot(s)", "accelerometerAcceleration{}(G)")
_USER, _GRAVITY = (_MOTION_TIME, "motionUserAcceleration{}(G)"), (_MOTION_TIME, "motionGravity{}(G)")
_MAGS = {
    "raw": ("magnetometerTimestamp_sinceReboot(s)", "magnetometer{}(µT)"),
    "calibrated": (_MOTION_TIME, "motionMagneticField{}(µT)"),
}
_LOCATION = ("Latitude(WGS84)", "Longitude(WGS84)", "Altitude(m)", "Course(°)", "Speed(m/s)")


@dataclass(frozen=True)
class SensorLogOptions(OwnOptions):
    """Options of SensorLog files."""

    mag: Literal["raw", "calibrated"] = "raw"


def read_sensorlog(file: Path, options: SensorLogOptions) -> Imported:
    """Return the recording of a file. Raises :class:`BadSource`."""
    log = Log()
    table = read_table(file, None, log)
    gyro = next((one for names in _GYROS if (one := _read(table, *names, _XYZ, "gyro", log)) is not None), None)
    accel = _read(table, *_ACCEL, _XYZ, "accelerometer", log)
    if accel is None:
        user, gravity = (_read(table, *names, _XYZ, "accelerometer", log) for names in (_USER, _GRAVITY))
        if user is not None and gravity is not None and np.array_equal(user.t_ns, gravity.t_ns):
            accel = Series(user.t_ns, user.values + gravity.values)
            log.add_conversion("accelerometer = motionUserAcceleration + motionGravity")
    if gyro is None or accel is None:
        what = "gyro or motion rotation rate" if gyro is None else "accelerometer, or motion with gravity"
        raise BadSource(f"{file}: has no columns of the {what}; log it with SensorLog; it has {table.listed}")
    accel = Series(accel.t_ns, -STANDARD_GRAVITY_MPS2 * accel.values)
    log.add_conversion(
        "accelerometer g -> m/s^2 (x 9.80665), all signs flipped (iOS reads -1 g on the axis that points up)"
    )
    imu = merge_imu(gyro, accel, str(file), log)
    mag, uncalibrated = _read_mag(table, options, log)
    gps = _read_gps(table, gyro, log)
    sha256 = hash_files([file], file.parent)
    attitude = _read(table, _MOTION_TIME, "motionQuaternion{}(R)", "WXYZ", "attitude", log)
    estimates: tuple[Estimate, ...] = ()
    if attitude is not None:
        estimates = read_device_attitude(attitude, imu, False, file.stem, "motionQuaternion", sha256, log)
    known = {"mag_uncalibrated": uncalibrated, "extra": {"platform": "ios"}}
    info = make_info(f"SensorLog {file.name}", options, imu.t_ns, sha256, log, **known)
    return Imported(Recording(file.stem, imu=imu, mag=mag, gps=gps, info=info), estimates)


def _read(table: Table, time: str, columns: str, axes: str, what: str, log: Log) -> Series | None:
    """Return one sensor on its own stamps, each sample once; None where the log does not have it."""
    names = tuple(columns.format(axis) for axis in axes)
    if time not in table.columns or any(name not in table.columns for name in names):
        return None
    clock, values = table.clock(time, "s"), table.read_floats(names)
    keep = clock.known & np.isfinite(values).all(axis=1)
    t_ns, values = clock.t_ns[keep], values[keep]
    fresh = np.diff(t_ns, prepend=-1) != 0
    if not fresh.any():
        return None
    log.add_conversion(f"{what} from {names[0]} ..., one sample per stamp ({int(fresh.sum())} of {len(keep)} rows)")
    return sort_by_time(Series(t_ns[fresh], values[fresh]), what, log)


def _read_mag(table: Table, options: SensorLogOptions, log: Log) -> tuple[Mag | None, bool]:
    """Return the magnetometer that the options name, else another that was logged, and whether it is uncalibrated."""
    others = [kind for kind in _MAGS if kind != options.mag]
    for kind in (options.mag, *others):
        series = _read(table, *_MAGS[kind], _XYZ, "mag", log)
        if series is not None:
            return make_mag(series, kind == "raw" or options.mag_uncalibrated, log)
    log.add_note("no magnetometer was logged")
    return None, options.mag_uncalibrated


def _read_gps(table: Table, gyro: Series, log: Log) -> Gps | None:
    """Return the fixes on the clock of the sensors; their own stamps count from 1970 and the others' from the start."""
    names = tuple(f"location{name}" for name in _LOCATION)
    stamp = "locationTimestamp_since1970(s)"
    gyro_time = next((time for time, _ in _GYROS if time in table.columns), None)
    needed = (*names, stamp, "loggingTime(txt)", gyro_time)
    if any(name is None or name not in table.columns for name in needed):
        return None
    logged, since_boot = table.clock("loggingTime(txt)", ISO), table.clock(str(gyro_time), "s")
    both = logged.known & since_boot.known
    booted_ns = int(np.median(logged.t_ns[both] - since_boot.t_ns[both]))
    clock, values = table.clock(stamp, "s"), table.read_floats(names)
    keep = clock.known & np.isfinite(values[:, :2]).all(axis=1)
    t_ns = clock.t_ns[keep] - booted_ns
    fresh = (np.diff(t_ns, prepend=-1) != 0) & (t_ns >= 0)
    if not fresh.any():
        return None
    log.add_conversion("gps: stamps since 1970 -> since reboot by the median of loggingTime")
    return make_gps(Series(t_ns[fresh], values[keep][fresh]), log)
