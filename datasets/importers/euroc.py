"""Folders in the ASL format: EuRoC MAV, TUM-VI, and what other tools write in it.

``mav0/imu0/data.csv`` holds ns, rad/s and m/s^2; ``state_groundtruth_estimate0`` (or ``mocap0``) the pose of the body
in a frame with z up, quaternion w first. ``sensor.yaml`` gives the rotation T_BS of a sensor in the body.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from stillpoint.datasets.errors import BadSource
from stillpoint.datasets.importers.columns import FIELD, FORCE, RATE, normalise_unit
from stillpoint.datasets.importers.delimited import Table
from stillpoint.datasets.importers.delimited_log import read_table
from stillpoint.datasets.importers.files import hash_files, read_text, reading, require_existing
from stillpoint.datasets.importers.imported import Imported, make_mag
from stillpoint.datasets.importers.options import OwnOptions, make_info
from stillpoint.datasets.importers.series import Log, Series, drop_incomplete_rows, make_gps, sort_by_time
from stillpoint.datasets.importers.trajectories import read_poses
from stillpoint.datasets.recording import Gps, Imu, Mag, Recording, Truth

_TRUTHS = (
    "state_groundtruth_estimate0",
    "mocap0",
)  # in the frame of the IMU; vicon0 and leica0 have frames of their own
_UNIT = re.compile(r"\[([^\]]*)\]\s*$")
_MATRIX = re.compile(r"T_BS:.*?data:\s*\[([^\]]*)\]", re.DOTALL)
_UNITS = {"rad s^-1": "rad/s", "m s^-2": "m/s^2"}


def find_euroc(source: Path) -> list[Path]:
    """Return the folders with ``imu0/data.csv`` at or below a source. Raises :class:`BadSource`."""
    require_existing(source)
    files = sorted(source.rglob("imu0/data.csv")) if source.is_dir() else []
    if not files:
        raise BadSource(f"{source}: holds no imu0/data.csv; name a folder in the ASL format, as MH_01_easy")
    return [file.parents[1] for file in files]


@dataclass(frozen=True)
class _Sensor:
    """The table of one sensor, and its rotation in the body."""

    table: Table
    turn: Rotation
    file: Path

    def series(self, columns: slice, units: dict[str, float], default: str, what: str, log: Log) -> Series:
        """Return three columns in SI in the body's axes, on their stamps; the header names the unit."""
        names = self.table.columns[columns]
        match = _UNIT.search(names[0])
        unit = normalise_unit(_UNITS.get(match[1].strip(), match[1])) if match else default
        if unit not in units:
            raise BadSource(f"{self.file}: {what} is in {unit!r}; there are {', '.join(units)}")
        series = Series(self.table.times(self.table.columns[0], "ns"), units[unit] * self.table.read_floats(names))
        series = sort_by_time(drop_incomplete_rows(series, what, log), what, log)
        log.add_conversion(f"{what} from {self.file.parent.name}/data.csv, {unit}")
        return Series(series.t_ns, self.turn.apply(series.values))


def read_euroc(folder: Path, options: OwnOptions) -> Imported:
    """Return the recording of a folder that holds ``imu0``. Raises :class:`BadSource`."""
    log = Log()
    imu_file = _open_sensor(folder / "imu0", log)
    if len(imu_file.table.columns) < 7:
        raise BadSource(
            f"{imu_file.file}: has {len(imu_file.table.columns)} columns; 7 are needed: ns, gyro, accelerometer"
        )
    gyro = imu_file.series(slice(1, 4), RATE, "rad/s", "gyro", log)
    accel = imu_file.series(slice(4, 7), FORCE, "m/s^2", "accelerometer", log)
    common, at_gyro, at_accel = np.intersect1d(gyro.t_ns, accel.t_ns, return_indices=True)
    files = [imu_file.file]
    mag, uncalibrated = _read_mag(folder, options, files, log)
    gps = _read_gps(folder, files, log)
    truth = _read_truth(folder, files, log)
    name = folder.parent.name if folder.name == "mav0" and folder.parent.name else folder.name
    sha256 = hash_files(files, folder)
    info = make_info(f"ASL folder {name}", options, common, sha256, log, mag_uncalibrated=uncalibrated)
    imu = Imu(common, gyro.values[at_gyro], accel.values[at_accel])
    return Imported(Recording(name, imu=imu, mag=mag, gps=gps, truth=truth, info=info))


def _open_sensor(folder: Path, log: Log) -> _Sensor:
    """Return the table of a sensor, and the rotation of its ``sensor.yaml`` into the body."""
    file, description = folder / "data.csv", folder / "sensor.yaml"
    turn = Rotation.identity()
    if description.is_file():
        match = _MATRIX.search(read_text(description))
        if match:
            with reading(description, "a sensor.yaml of the ASL format", "correct its T_BS"):
                matrix = np.array([float(part) for part in match[1].split(",")]).reshape(4, 4)[:3, :3]
                turn = Rotation.from_matrix(matrix)
            if turn.magnitude() > 1e-9:
                log.add_conversion(
                    f"{folder.name} turned into the body by T_BS, {np.rad2deg(turn.magnitude()):.2f} deg"
                )
    return _Sensor(read_table(file, ",", log), turn, file)


def _read_mag(folder: Path, options: OwnOptions, files: list[Path], log: Log) -> tuple[Mag | None, bool]:
    """Return the magnetometer, or None with a note, and whether it is uncalibrated."""
    if not (folder / "mag0" / "data.csv").is_file():
        return None, options.mag_uncalibrated
    try:
        sensor = _open_sensor(folder / "mag0", log)
        series = sensor.series(slice(1, 4), FIELD, "T", "mag", log)
    except BadSource as error:
        log.add_note(f"mag left out: {error}")
        return None, options.mag_uncalibrated
    files.append(sensor.file)
    return make_mag(series, options.mag_uncalibrated, log)


def _read_gps(folder: Path, files: list[Path], log: Log) -> Gps | None:
    """Return the fixes of ``gps0``; None without it."""
    file = folder / "gps0" / "data.csv"
    if not file.is_file():
        return None
    table = read_table(file, ",", log)
    values = np.full((len(table.rows), 5), np.nan)
    values[:, :3] = table.read_floats(table.columns[1:4])
    files.append(file)
    return make_gps(Series(table.times(table.columns[0], "ns"), values), log)


def _read_truth(folder: Path, files: list[Path], log: Log) -> Truth | None:
    """Return the first truth that is there; None with a note without one."""
    for name in _TRUTHS:
        file = folder / name / "data.csv"
        if file.is_file():
            files.append(file)
            log.add_conversion(f"truth from {name}, body -> its frame with z up, taken as East-North-Up")
            return read_poses(file, log, format="euroc")
    log.add_note(f"no truth: there is no {' or '.join(_TRUTHS)}")
    return None
