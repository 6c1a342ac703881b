"""Folders of x-io Technologies' devices: NGIMU (``sensors.csv``) and x-IMU3 (``Inertial.csv``).

NGIMU: ``Time (s)``, deg/s, g and uT in one file; ``quaternion.csv`` takes the Earth to the sensor, which its public
sample session confirms. x-IMU3: ``Timestamp (us)``, deg/s and g; ``Magnetometer.csv`` in arbitrary units;
``Quaternion.csv`` takes the sensor to the Earth. Both have accelerometers of +1 g on the axis that points up.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillpoint.datasets.errors import BadSource
from stillpoint.datasets.importers.columns import FIELD, FORCE, RATE
from stillpoint.datasets.importers.delimited import Table
from stillpoint.datasets.importers.delimited_log import read_table
from stillpoint.datasets.importers.device_attitude import read_device_attitude
from stillpoint.datasets.importers.files import find_folders, hash_files
from stillpoint.datasets.importers.imported import Imported, make_mag
from stillpoint.datasets.importers.options import OwnOptions, make_info
from stillpoint.datasets.importers.series import Log, Series, drop_incomplete_rows, sort_by_time
from stillpoint.datasets.recording import Imu, Mag, Recording
from stillpoint.datasets.trajectory import Estimate

_XYZ = "XYZ"
_NAME_A_FOLDER = "name a folder as the device's software logs it"
_ARBITRARY_UT = 50.0  # size that a field in arbitrary units is given; nothing may be concluded from it


@dataclass(frozen=True)
class _Device:
    """How the folders of one device look."""

    name: str
    imu: str  # file
    time: tuple[str, str]  # column and its unit
    mag: tuple[str, str, str]  # file, column with the axis as {}, unit or "" for arbitrary ones
    attitude: str
    inverse: bool  # the quaternion takes the Earth to the sensor


_NGIMU = _Device(
    "NGIMU", "sensors.csv", ("Time (s)", "s"), ("sensors.csv", "Magnetometer {} (uT)", "uT"), "quaternion.csv", True
)
_XIMU3 = _Device(
    "x-IMU3", "Inertial.csv", ("Timestamp (us)", "us"), ("Magnetometer.csv", "{} (a.u.)", ""), "Quaternion.csv", False
)


def find_ngimu(source: Path) -> list[Path]:
    """Return the NGIMU folders at or below a source. Raises :class:`BadSource`."""
    return find_folders(source, _NGIMU.imu, _NAME_A_FOLDER)


def read_ngimu(folder: Path, options: OwnOptions) -> Imported:
    """Return the recording of an NGIMU folder. Raises :class:`BadSource`."""
    return _read_folder(folder, _NGIMU, options)


def find_ximu3(source: Path) -> list[Path]:
    """Return the x-IMU3 folders at or below a source. Raises :class:`BadSource`."""
    return find_folders(source, _XIMU3.imu, _NAME_A_FOLDER)


def read_ximu3(folder: Path, options: OwnOptions) -> Imported:
    """Return the recording of an x-IMU3 folder. Raises :class:`BadSource`."""
    return _read_folder(folder, _XIMU3, options)


def _read_folder(folder: Path, device: _Device, options: OwnOptions) -> Imported:
    """Read the files of one device: IMU, magnetometer and the device's own attitude."""
    log = Log()
    table = read_table(folder / device.imu, ",", log)
    log.add_conversion(f"gyro deg/s -> rad/s; accelerometer g -> m/s^2 (x 9.80665), from {device.imu}")
    columns = [
        f"{what} {axis} ({unit})" for what, unit in (("Gyroscope", "deg/s"), ("Accelerometer", "g")) for axis in _XYZ
    ]
    inertial = _read_columns(table, device, tuple(columns), "imu", log)
    imu = Imu(inertial.t_ns, RATE["deg/s"] * inertial.values[:, :3], FORCE["g"] * inertial.values[:, 3:])
    files = [folder / device.imu]
    mag, uncalibrated = _read_mag(folder, device, options, files, log)
    estimates: tuple[Estimate, ...] = ()
    file = folder / device.attitude
    if file.is_file():
        attitude = _read_columns(read_table(file, ",", log), device, tuple("WXYZ"), "attitude", log)
        files.append(file)
    sha256 = hash_files(dict.fromkeys(files), folder)
    if file.is_file():
        estimates = read_device_attitude(attitude, imu, device.inverse, folder.name, device.attitude, sha256, log)
    info = make_info(
        f"{device.name} {folder.name}",
        options,
        imu.t_ns,
        sha256,
        log,
        sensor=options.sensor or f"x-io {device.name}",
        mag_uncalibrated=uncalibrated,
    )
    return Imported(Recording(folder.name, imu=imu, mag=mag, info=info), estimates)


def _read_columns(table: Table, device: _Device, columns: tuple[str, ...], what: str, log: Log) -> Series:
    """Return columns on the device's clock without incomplete rows, sorted by time."""
    series = Series(table.times(*device.time), table.read_floats(columns))
    return sort_by_time(drop_incomplete_rows(series, what, log), what, log)


def _read_mag(
    folder: Path, device: _Device, options: OwnOptions, files: list[Path], log: Log
) -> tuple[Mag | None, bool]:
    """Return the magnetometer, or None with a note, and whether it is uncalibrated."""
    name, column, unit = device.mag
    if not (folder / name).is_file():
        log.add_note(f"no magnetometer: there is no {name}")
        return None, options.mag_uncalibrated
    try:
        table = read_table(folder / name, ",", Log())
        series = _read_columns(table, device, tuple(column.format(axis) for axis in _XYZ), "mag", log)
    except BadSource as error:
        log.add_note(f"mag left out: {error}")
        return None, options.mag_uncalibrated
    files.append(folder / name)
    if unit:
        return make_mag(Series(series.t_ns, FIELD[unit] * series.values), options.mag_uncalibrated, log)
    return scale_arbitrary_field(series, log)


def scale_arbitrary_field(series: Series, log: Log) -> tuple[Mag | None, bool]:
    """Return a field in arbitrary units with the median size ``_ARBITRARY_UT``, marked as uncalibrated."""
    size = float(np.median(np.linalg.norm(series.values, axis=1))) if len(series.t_ns) else 0.0
    if not np.isfinite(size) or size == 0:
        return make_mag(Series(series.t_ns, 0 * series.values), True, log)
    log.add_note(f"mag: in arbitrary units, scaled to a median of {_ARBITRARY_UT:g} uT; only its direction counts")
    return make_mag(Series(series.t_ns, _ARBITRARY_UT / size * series.values), True, log)
