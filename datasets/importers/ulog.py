"""Logs of the PX4 autopilot (``.ulg``), read by the package ``pyulog``.

The body is forward-right-down, the world of attitudes North-East-Down. ``sensor_combined`` gives rad/s and m/s^2
(specific force: -9.8 on the axis that points down), ``vehicle_magnetometer`` gauss.
``vehicle_attitude`` is the autopilot's own estimate; only a simulator logs a truth, ``vehicle_attitude_groundtruth``.
"""

from contextlib import redirect_stdout
from datetime import UTC, datetime
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from pyulog import ULog

from stillpoint.datasets.errors import BadSource
from stillpoint.datasets.frames import local_from_enu, quaternion, rotation
from stillpoint.datasets.importers.columns import FIELD
from stillpoint.datasets.importers.device_attitude import read_device_attitude
from stillpoint.datasets.importers.files import hash_files, reading, require_existing
from stillpoint.datasets.importers.imported import Imported, make_mag
from stillpoint.datasets.importers.options import OwnOptions, make_info
from stillpoint.datasets.importers.series import (
    Log,
    Series,
    drop_incomplete_rows,
    find_finite_rows,
    make_gps,
    merge_imu,
    sort_by_time,
)
from stillpoint.datasets.recording import Floats, Gps, Mag, Recording, Truth
from stillpoint.datasets.trajectory import Estimate

_NOT_VALID = 2**31 - 1  # of a relative stamp: the accelerometer gave nothing
_TOPICS = (
    *("sensor_combined", "vehicle_magnetometer", "vehicle_attitude", "vehicle_attitude_groundtruth"),
    *("vehicle_gps_position", "sensor_gps"),
)


def find_ulog(source: Path) -> list[Path]:
    """Return a log, or the ``.ulg`` files of a folder. Raises :class:`BadSource`."""
    require_existing(source)
    files = sorted(source.glob("*.ulg")) if source.is_dir() else [source]
    if not files:
        raise BadSource(f"{source}: holds no .ulg file; name a log of PX4")
    return files


def read_ulog(file: Path, options: OwnOptions) -> Imported:
    """Return the recording of a log. Raises :class:`BadSource`."""
    log = Log()
    with reading(file, "a log of PX4 (ULog)"):
        with redirect_stdout(StringIO()):  # the package prints what it finds damaged
            ulog = ULog(str(file), list(_TOPICS))
        data = {one.name: one.data for one in ulog.data_list if one.multi_id == 0}
        if ulog.file_corruption:
            log.add_note("the log is damaged; what could be read was read")
        imu = _read_imu(file, data, log)
        mag, uncalibrated = _read_mag(data, options, log)
        gps, date = _read_gps(data, log)
        sha256 = hash_files([file], file.parent)
        estimates: tuple[Estimate, ...] = ()
        if (attitude := _read_vectors(data, "vehicle_attitude", "q", 4)) is not None:
            attitude = sort_by_time(drop_incomplete_rows(attitude, "vehicle_attitude", log), "vehicle_attitude", log)
            estimates = read_device_attitude(attitude, imu, False, file.stem, "vehicle_attitude", sha256, log)
        truth = _read_truth(data, log)
    known = {"mag_uncalibrated": uncalibrated, "sensor": options.sensor or "PX4"} | ({"date": date} if date else {})
    info = make_info(f"PX4 log {file.name}", options, imu.t_ns, sha256, log, **known)
    return Imported(Recording(file.stem, imu=imu, mag=mag, gps=gps, truth=truth, info=info), estimates)


def _read_vectors(data: dict[str, Any], topic: str, field: str, width: int) -> Series | None:
    """Return an array field (N, width) of a topic on its stamps in ns; None where it is not logged."""
    if topic not in data or f"{field}[0]" not in data[topic]:
        return None
    values = np.column_stack([np.asarray(data[topic][f"{field}[{k}]"], np.float64) for k in range(width)])
    return Series(np.asarray(data[topic]["timestamp"]).astype(np.int64) * 1000, values)


def _read_imu(file: Path, data: dict[str, Any], log: Log) -> Any:
    """Return gyro and accelerometer of ``sensor_combined`` on one clock; raises :class:`BadSource` without them."""
    gyro = _read_vectors(data, "sensor_combined", "gyro_rad", 3)
    accel = _read_vectors(data, "sensor_combined", "accelerometer_m_s2", 3)
    if gyro is None or accel is None:
        raise BadSource(f"{file}: has no topic sensor_combined; log with the default profile of PX4")
    relative_us = np.asarray(data["sensor_combined"].get("accelerometer_timestamp_relative", 0 * gyro.t_ns))
    given = relative_us != _NOT_VALID
    accel = Series(accel.t_ns + relative_us.astype(np.int64) * 1000, accel.values).where(given)
    if not given.all():
        log.add_note(f"accelerometer: {int((~given).sum())} samples marked as not valid dropped")
    log.add_conversion("gyro and accelerometer from sensor_combined, rad/s and m/s^2; body forward-right-down")
    gyro = sort_by_time(drop_incomplete_rows(gyro, "gyro", log), "gyro", log)
    accel = sort_by_time(drop_incomplete_rows(accel, "accelerometer", log), "accelerometer", log)
    return merge_imu(gyro, accel, str(file), log)


def _read_mag(data: dict[str, Any], options: OwnOptions, log: Log) -> tuple[Mag | None, bool]:
    """Return the magnetometer, or None with a note, and whether it is uncalibrated."""
    series = _read_vectors(data, "vehicle_magnetometer", "magnetometer_ga", 3)
    if series is None:
        log.add_note("no magnetometer: there is no topic vehicle_magnetometer")
        return None, options.mag_uncalibrated
    log.add_conversion("mag gauss -> uT (x 100)")
    series = sort_by_time(drop_incomplete_rows(series, "mag", log), "mag", log)
    return make_mag(Series(series.t_ns, FIELD["gauss"] * series.values), options.mag_uncalibrated, log)


def _read_gps(data: dict[str, Any], log: Log) -> tuple[Gps | None, str]:
    """Return the fixes and the UTC date; the fields changed their units in PX4 1.14."""
    fixes = data.get("vehicle_gps_position") or data.get("sensor_gps")
    if not fixes:
        return None, ""
    if "latitude_deg" in fixes:
        place = [fixes["latitude_deg"], fixes["longitude_deg"], fixes["altitude_msl_m"]]
    else:
        place = [fixes["lat"] * 1e-7, fixes["lon"] * 1e-7, fixes["alt"] * 1e-3]
    values: Floats = np.column_stack([*place, np.rad2deg(fixes["cog_rad"]) % 360, fixes["vel_m_s"]]).astype(np.float64)
    values[np.asarray(fixes["fix_type"]) < 2, :2] = np.nan
    log.add_conversion("gps altitude above mean sea level")
    utc_us = np.asarray(fixes.get("time_utc_usec", np.zeros(1)), np.float64)
    known = utc_us[utc_us > 1e15]
    date = datetime.fromtimestamp(float(known[0]) / 1e6, UTC).date().isoformat() if len(known) else ""
    return make_gps(Series(np.asarray(fixes["timestamp"]).astype(np.int64) * 1000, values), log), date


def _read_truth(data: dict[str, Any], log: Log) -> Truth | None:
    """Return the true attitude of a simulation, turned to East-North-Up; None without one."""
    series = _read_vectors(data, "vehicle_attitude_groundtruth", "q", 4)
    if series is None:
        return None
    norm = np.linalg.norm(series.values, axis=1)
    series = sort_by_time(series.where(find_finite_rows(series.values) & (norm > 0.5)), "truth", log)
    if len(series.t_ns) == 0:
        return None
    log.add_conversion("truth from vehicle_attitude_groundtruth, body -> North-East-Down -> East-North-Up")
    q_nb = quaternion(local_from_enu("ned").inv() * rotation(series.values))
    return Truth(series.t_ns, q_nb, np.ones(len(q_nb), dtype=np.bool_))
