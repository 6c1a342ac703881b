"""Bench logs of an InvenSense MPU6050 and a Honeywell HMC5883L (sunsided/sensor-fusion): folders of MATLAB 7.3 files.

The log keeps what the sensors said: gyro x has the wrong sign and gravity reads -1 g on the axis that points up.
The importer changes units and clocks only; axes and signs are for the doctor to find.
"""

from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np

from stillpoint.datasets.errors import BadSource
from stillpoint.datasets.importers.bundle import digests, folders_with
from stillpoint.datasets.importers.clock import Log, Series, finite, merge, rising, seconds_to_ns, straight
from stillpoint.datasets.importers.options import Options
from stillpoint.datasets.importers.units import FIELD, FORCE, RATE
from stillpoint.datasets.recording import Floats, Info, Mag, Recording

GYRO, ACCEL, MAG = "mpu6050_gyroscope.mat", "mpu6050_accelerometer.mat", "hmc5883l_compass.mat"
WHAT = {GYRO: "gyro", ACCEL: "accelerometer", MAG: "mag"}


def read_bench(source: Path, options: Options) -> Iterator[Recording]:
    """The log of one folder, or of all folders below. Raises :class:`BadSource`."""
    for folder in folders_with(source, GYRO, "name the folder of a log"):
        yield _log_of(folder, options)


def _log_of(folder: Path, options: Options) -> Recording:
    log = Log()
    received = {name: _rows(folder / name) for name in WHAT}
    # The log starts with a backlog that drains over seconds: the first samples were taken before the first receipt.
    fitted = {name: straight(rows[0], WHAT[name], log) for name, rows in received.items()}
    early_s = max(0.0, -min(float(t_s[0]) for t_s in fitted.values()))
    if early_s:
        log.converted(f"all clocks moved by {1e3 * early_s:.3f} ms so that none starts before zero")
    series = {
        name: rising(
            finite(Series(seconds_to_ns(fitted[name] + early_s), rows[1:4].T), WHAT[name], log), WHAT[name], log
        )
        for name, rows in received.items()
    }
    gyro = Series(series[GYRO].t_ns, RATE["deg/s"] * series[GYRO].values)
    accel = Series(series[ACCEL].t_ns, FORCE["g"] * series[ACCEL].values)
    mag = Mag(series[MAG].t_ns, FIELD["gauss"] * series[MAG].values)
    log.converted("gyro deg/s -> rad/s; accelerometer g -> m/s^2 (x 9.80665); mag gauss -> uT (x 100)")
    log.noted("axes and signs are the log's own: ask the doctor about them")
    log.noted("the temperature (mpu6050_temperature.mat) is not imported")
    info = Info(
        source="sunsided/sensor-fusion, sensor data set 2",
        licence="EUPL 1.2",
        citation="sunsided: sensor-fusion, https://github.com/sunsided/sensor-fusion",
        sensor="InvenSense MPU6050, Honeywell HMC5883L",
        mag_uncalibrated=True,
        units_unchecked=options.units_unchecked,
        sha256=digests([folder / name for name in received], folder.parent),
        conversions=tuple(log.conversions),
        notes=tuple(log.notes),
    )
    return Recording(folder.name, imu=merge(gyro, accel, str(folder), log), mag=mag, info=info)


def _rows(path: Path) -> Floats:
    """The one array of a file, (4, N): time in s, x, y, z."""
    if not path.is_file():
        raise BadSource(f"{path.parent}: has no {path.name}; the log is not whole: download it again")
    try:
        with h5py.File(path) as file:
            arrays = [file[name][()] for name in file if isinstance(file[name], h5py.Dataset)]
    except OSError as error:
        raise BadSource(f"{path}: cannot be read as a MATLAB 7.3 file ({str(error).splitlines()[0]})") from None
    if len(arrays) != 1 or arrays[0].ndim != 2 or arrays[0].shape[0] != 4 or arrays[0].shape[1] < 3:
        shapes = ", ".join(str(array.shape) for array in arrays) or "nothing"
        raise BadSource(f"{path}: holds {shapes}, not one array of 4 rows (time, x, y, z); name a bench log")
    return np.asarray(arrays[0], dtype=np.float64)
