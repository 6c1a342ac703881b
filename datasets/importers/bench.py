"""Bench logs of an InvenSense MPU6050 and a Honeywell HMC5883L (sunsided/sensor-fusion): folders of MATLAB 7.3 files.

The log keeps the axes of the sensors: gyro x has the wrong sign and gravity reads -1 g on the axis that points up.
The importer changes units and clocks only; axes and signs are for the doctor to find.
"""

from pathlib import Path

import h5py
import numpy as np

from stillpoint.datasets.errors import BadSource
from stillpoint.datasets.importers.arrays import read_array
from stillpoint.datasets.importers.columns import FIELD, FORCE, RATE
from stillpoint.datasets.importers.files import find_folders, hash_files, reading
from stillpoint.datasets.importers.imported import Imported
from stillpoint.datasets.importers.options import Options
from stillpoint.datasets.importers.series import (
    Log,
    Series,
    drop_incomplete_rows,
    fit_even_times,
    merge_imu,
    seconds_to_ns,
    sort_by_time,
)
from stillpoint.datasets.recording import Floats, Info, Mag, Recording

_GYRO, _ACCEL, _MAG = "mpu6050_gyroscope.mat", "mpu6050_accelerometer.mat", "hmc5883l_compass.mat"
_WHAT = {_GYRO: "gyro", _ACCEL: "accelerometer", _MAG: "mag"}


def find_bench(source: Path) -> list[Path]:
    """Return the folders of logs at or below a source. Raises :class:`BadSource`."""
    return find_folders(source, _GYRO, "name the folder of a log")


def read_bench(folder: Path, options: Options) -> Imported:
    """Return the log of a folder. Raises :class:`BadSource`."""
    log = Log()
    received = {name: _load_rows(folder / name) for name in _WHAT}
    # The log starts with a backlog that drains over seconds: the first samples were taken before the first receipt.
    fitted = {name: fit_even_times(rows[0], _WHAT[name], log) for name, rows in received.items()}
    early_s = max(0.0, -min(float(t_s[0]) for t_s in fitted.values()))
    if early_s:
        log.add_conversion(f"all clocks moved by {1e3 * early_s:.3f} ms so that none starts before zero")
    series = {
        name: sort_by_time(drop_incomplete_rows(Series(t_ns, rows[1:4].T), _WHAT[name], log), _WHAT[name], log)
        for name, rows in received.items()
        for t_ns in [seconds_to_ns(fitted[name] + early_s)]
    }
    gyro = Series(series[_GYRO].t_ns, RATE["deg/s"] * series[_GYRO].values)
    accel = Series(series[_ACCEL].t_ns, FORCE["g"] * series[_ACCEL].values)
    mag = Mag(series[_MAG].t_ns, FIELD["gauss"] * series[_MAG].values)
    log.add_conversion("gyro deg/s -> rad/s; accelerometer g -> m/s^2 (x 9.80665); mag gauss -> uT (x 100)")
    log.add_note("axes and signs are the log's own: ask the doctor about them")
    log.add_note("the temperature (mpu6050_temperature.mat) is not imported")
    info = Info(
        source="sunsided/sensor-fusion, sensor data set 2",
        licence="EUPL 1.2",
        citation="sunsided: sensor-fusion, https://github.com/sunsided/sensor-fusion",
        sensor="InvenSense MPU6050, Honeywell HMC5883L",
        mag_uncalibrated=True,
        units_unchecked=options.units_unchecked,
        sha256=hash_files([folder / name for name in received], folder.parent),
        conversions=tuple(log.conversions),
        notes=tuple(log.notes),
    )
    return Imported(Recording(folder.name, imu=merge_imu(gyro, accel, str(folder), log), mag=mag, info=info))


def _load_rows(path: Path) -> Floats:
    """Return the one array of a file, (4, N): time in s, x, y, z."""
    if not path.is_file():
        raise BadSource(f"{path.parent}: has no {path.name}; the log is not whole: download it again")
    with reading(path, "a MATLAB 7.3 file"), h5py.File(path) as file:
        arrays = [read_array(file[name], path) for name in file if isinstance(file[name], h5py.Dataset)]
    if len(arrays) != 1 or arrays[0].ndim != 2 or arrays[0].shape[0] != 4 or arrays[0].shape[1] < 3:
        shapes = ", ".join(str(array.shape) for array in arrays) or "nothing"
        raise BadSource(f"{path}: holds {shapes}, not one array of 4 rows (time, x, y, z); name a bench log")
    if not np.isfinite(arrays[0][0]).all() or np.ptp(arrays[0][0]) == 0:
        raise BadSource(f"{path}: its first row, the time, is not finite or does not change; download the log again")
    return arrays[0]
