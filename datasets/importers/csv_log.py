"""Any delimited log: its columns, units, signs and clocks are named by flags or by a small TOML file.

``gyro = "gx,gy,gz:deg/s"`` names three columns and their unit; a leading ``-`` turns a sign; ``0.061*mg`` is a unit
per count. Columns go by their names in the header, or by numbers from 1.
"""

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from stillpoint.datasets.errors import BadParameter, BadSource
from stillpoint.datasets.frames import local_from_enu, quaternion, rotation
from stillpoint.datasets.importers.clock import Clock
from stillpoint.datasets.importers.columns import (
    ANGLE,
    FIELD,
    FORCE,
    LENGTH,
    RATE,
    parse_columns,
    parse_quaternion,
)
from stillpoint.datasets.importers.delimited import Table
from stillpoint.datasets.importers.delimited_log import (
    LogOptions,
    apply_config,
    order_series,
    read_clock,
    read_sensor,
    read_table,
    shift_to_zero,
)
from stillpoint.datasets.importers.files import hash_files
from stillpoint.datasets.importers.imported import Imported
from stillpoint.datasets.importers.options import make_info
from stillpoint.datasets.importers.series import Log, Series, find_finite_rows, make_gps, merge_imu
from stillpoint.datasets.importers.trajectories import read_poses
from stillpoint.datasets.recording import Floats, Info, Mag, Recording, Truth

_SENSORS = {"gyro": (RATE, "rad/s"), "accel": (FORCE, "m/s^2"), "mag": (FIELD, "uT")}
_FARTHEST_NORM = 0.01  # a quaternion with three decimals is still one; other columns are not
_EULER_ORDER = re.compile(r"[XYZ]{3}|[xyz]{3}")
_GPS_COLUMNS = ("latitude", "longitude", "altitude", "speed", "course")
_GPS_FORM = "LAT,LON[,ALT[,SPEED[,COURSE]]]"


@dataclass(frozen=True)
class CsvOptions(LogOptions):
    """The columns of a log and their units."""

    gyro: str | None = None  # "X,Y,Z:UNIT"
    accel: str | None = None
    mag: str | None = None
    gyro_time: str | None = None  # "COLUMN:UNIT", where a sensor has a time column of its own
    accel_time: str | None = None
    mag_time: str | None = None
    gps: str | None = None  # "LAT,LON[,ALT[,SPEED[,COURSE]]]" in deg, deg, m, m/s, deg
    gps_time: str | None = None
    truth: str | None = None  # "W,X,Y,Z", or a file that read_poses reads
    truth_time: str | None = None  # "COLUMN:UNIT" of the truth, in its own file or in the log
    truth_columns: str | None = None  # "W,X,Y,Z" in the truth's own file
    truth_euler: str | None = None  # "A,B,C:UNIT" in the order of truth_order
    truth_order: str = "ZYX"  # capitals turn about moving axes, small letters about fixed ones
    truth_frame: Literal["enu", "nwu", "ned"] = "enu"  # the local frame that the truth leads to
    truth_inverse: bool = False  # the truth takes the local frame to the body
    position: str | None = None  # "X,Y,Z:UNIT" in the truth's local frame
    moving: str | None = None  # a column that is 0 where the truth is not to be scored


def read_csv(file: Path, options: CsvOptions) -> Imported:
    """Return the recording of a log.

    Raises :class:`BadSource` for the file, :class:`BadParameter` for an option.
    """
    options = apply_config(options)
    log = Log()
    recording = read_csv_table(read_table(file, options.delimiter, log), file, options, log)
    files = [file]
    if recording.truth is None and (truth_file := _find_truth_file(options, file)) is not None:
        recording = replace(recording, truth=_read_truth_file(truth_file, options, log))
        files += [truth_file] if truth_file.is_file() else []
    assert recording.imu is not None
    sha256 = {name: digest for one in files for name, digest in hash_files([one], one.parent).items()}
    info = make_info(f"delimited log {file.name}", options, recording.imu.t_ns, sha256, log)
    return Imported(replace(recording, info=info))


def read_csv_table(table: Table, file: Path, options: CsvOptions, log: Log) -> Recording:
    """Return the recording of a table, whose facts are not known and whose units are not judged yet.

    ``options`` are complete (:func:`~stillpoint.datasets.importers.delimited_log.apply_config`). Raises as
    :func:`read_csv`.
    """
    reading = _Reading(table, options, log)
    found = {what: reading.read_sensor(what) for what in _SENSORS}
    if found["gyro"] is None or found["accel"] is None:
        raise BadParameter(
            f"{file}: name the columns of gyro and accelerometer: --gyro X,Y,Z:UNIT --accel X,Y,Z:UNIT; "
            f"the file has {reading.table.listed}"
        )
    found |= {"gps": reading.read_gps(), "truth": reading.read_truth()}
    streams = shift_to_zero({what: series for what, series in found.items() if series is not None}, log)
    imu = merge_imu(streams["gyro"], streams["accel"], str(file), log)
    mag = Mag(streams["mag"].t_ns, streams["mag"].values) if "mag" in streams else None
    gps = make_gps(streams["gps"], log) if "gps" in streams else None
    truth = reading.make_truth(streams["truth"]) if "truth" in streams else None
    return Recording(file.stem, imu=imu, mag=mag, gps=gps, truth=truth, info=Info(units_unchecked=True))


def _find_truth_file(options: CsvOptions, log_file: Path) -> Path | None:
    """Return the truth's own file where ``--truth`` names one; in a folder of logs ``{name}`` stands for the log's."""
    if options.truth is None or options.truth.count(",") == 3:
        return None
    path = Path(options.truth.replace("{name}", log_file.stem))
    if not path.exists():
        raise BadParameter(f"--truth {options.truth!r}: is neither four columns W,X,Y,Z nor a file that is there")
    return path


def _read_truth_file(file: Path, options: CsvOptions, log: Log) -> Truth:
    """Return the truth of a file of its own, on its own clock."""
    truth = read_poses(
        file,
        log,
        time=options.truth_time,
        quaternion=options.truth_columns,
        frame=options.truth_frame,
        inverse=options.truth_inverse,
    )
    inverse = ", inverted" if options.truth_inverse else ""
    frame = options.truth_frame.upper()
    log.add_conversion(f"truth from {file.name}, body -> {frame} -> East-North-Up{inverse}, on its own clock")
    return truth


@dataclass(frozen=True)
class _Reading:
    """One table, read as the options say."""

    table: Table
    options: CsvOptions
    log: Log

    def read_sensor(self, what: str) -> Series | None:
        """Return one sensor in SI; a row without numbers for it is no sample of it."""
        text = getattr(self.options, what)
        if text is None:
            return None
        units, target = _SENSORS[what]
        columns = parse_columns(text, f"--{what}", units)
        clock = self._read_clock(what)
        series = read_sensor(self.table, clock, columns, what, f"--{what}", self.options, self.log)
        self.log.add_conversion(f"{what} {columns.written} {columns.unit.written} -> {target}{columns.flipped}")
        return series

    def read_gps(self) -> Series | None:
        """Return fixes (N, 5): latitude, longitude, altitude, course, speed; a row without a position is no fix."""
        if self.options.gps is None:
            return None
        names = tuple(name.strip() for name in self.options.gps.split(","))
        if not 2 <= len(names) <= len(_GPS_COLUMNS) or not all(names):
            raise BadParameter(f"--gps {self.options.gps!r}: write the columns as {_GPS_FORM}")
        values = np.full((len(self.table.rows), 5), np.nan)
        values[:, : len(names)] = self.table.read_floats(names)
        values = values[:, [0, 1, 2, 4, 3]]
        clock = self._read_clock("gps")
        keep = np.isfinite(values[:, :2]).all(axis=1) & clock.known
        # Loggers repeat the last fix on the rows between two fixes.
        changed = np.ones(int(keep.sum()), dtype=np.bool_)
        found = values[keep]
        changed[1:] = (np.diff(np.nan_to_num(found), axis=0) != 0).any(axis=1)
        if not len(found):
            raise BadSource(f"{self.table.where}: no row has a position in {self.options.gps}; check --gps")
        self.log.add_conversion(f"gps {self.options.gps} as {','.join(_GPS_COLUMNS[: len(names)])}")
        if not changed.all():
            self.log.add_note(f"gps: {int((~changed).sum())} rows repeat the fix before them; dropped")
        series = Series(clock.t_ns[keep][changed], found[changed])
        lines = [self.table.lines[k] for k in np.flatnonzero(keep)[changed].tolist()]
        return order_series(series, lines, clock, self.table.where, "gps", self.options, self.log)

    def read_truth(self) -> Series | None:
        """Return rows (N, 8) of the truth in the log: quaternion wxyz body to ENU, position (NaN if none), moving."""
        options, table = self.options, self.table
        if options.truth_euler is not None and options.truth is not None:
            raise BadParameter("--truth, --truth-euler: name the truth twice; give one of them")
        if options.truth_euler is not None:
            q_nl = self._read_euler(options.truth_euler)
        elif options.truth is not None and options.truth.count(",") == 3:
            q_nl = self._read_quaternions(options.truth)
        else:
            return None
        known = find_finite_rows(q_nl)
        clock = self._read_clock("truth")
        if not known.all():
            self.log.add_note(f"truth: {int((~known).sum())} of {len(known)} rows without an attitude (gaps)")
        known &= clock.known
        turned = rotation(q_nl[known])
        to_enu = local_from_enu(options.truth_frame).inv()
        values = np.full((int(known.sum()), 8), np.nan)
        values[:, :4] = quaternion(to_enu * (turned.inv() if options.truth_inverse else turned))
        values[:, 7] = 1.0
        if options.position is not None:
            local_m = parse_columns(options.position, "--position", LENGTH).values(table)[known]
            values[:, 4:7] = local_m @ to_enu.as_matrix().T
        if options.moving is not None:
            values[:, 7] = table.read_floats((options.moving,))[known, 0] > 0
        lines = [table.lines[k] for k in np.flatnonzero(known).tolist()]
        series = Series(clock.t_ns[known], values)
        return order_series(series, lines, clock, table.where, "truth", options, self.log)

    def make_truth(self, series: Series) -> Truth:
        """Return the truth of rows (N, 8); see :meth:`read_truth`."""
        position_n_m = series.values[:, 4:7] if self.options.position is not None else None
        return Truth(series.t_ns, series.values[:, :4], series.values[:, 7] > 0, position_n_m)

    def _read_clock(self, what: str) -> Clock:
        """Return the clock of a sensor: its own time column, else the common one."""
        time = getattr(self.options, f"{what}_time")
        return read_clock(self.table, self.options, self.log, time, f"--{what}-time" if time else "--time")

    def _read_quaternions(self, columns: str) -> Floats:
        """Return (N, 4) wxyz as the file has them, NaN where there is none."""
        values = parse_quaternion(columns, "--truth").values(self.table)
        norm = np.linalg.norm(values, axis=1)
        known = np.isfinite(norm) & (norm > 0.5)
        if not known.any():
            raise BadSource(f"{self.table.where}: no row has a quaternion in {columns}; check the columns of --truth")
        off = np.where(known, np.abs(norm - 1), 0.0)
        if off.max() > _FARTHEST_NORM:
            line = self.table.lines[int(off.argmax())]
            raise BadSource(f"{self.table.where}, line {line}: {columns} is not a unit quaternion; check the columns")
        values[~known] = np.nan
        frame = self.options.truth_frame.upper()
        way = f"{frame} -> body, inverted" if self.options.truth_inverse else f"body -> {frame}"
        self.log.add_conversion(f"truth {columns} as w,x,y,z, {way} -> East-North-Up")
        return values

    def _read_euler(self, text: str) -> Floats:
        """Return (N, 4) wxyz of Euler angles, NaN where one is missing."""
        order = self.options.truth_order
        if not _EULER_ORDER.fullmatch(order):
            raise BadParameter(f"--truth-order {order!r}: give three letters, ZYX about moving or zyx about fixed axes")
        columns = parse_columns(text, "--truth-euler", ANGLE)
        angles_rad = columns.values(self.table)
        known = np.isfinite(angles_rad).all(axis=1)
        if not known.any():
            raise BadSource(
                f"{self.table.where}: no row has numbers in all columns of --truth-euler; check the columns"
            )
        largest = float(np.abs(angles_rad[known]).max())
        if largest > 20 * np.pi:
            raise BadSource(
                f"{self.table.where}: {text} reaches {largest / (2 * np.pi):.3g} turns; check the unit (rad or deg)"
            )
        q = np.full((len(angles_rad), 4), np.nan)
        q[known] = quaternion(Rotation.from_euler(order, angles_rad[known]))
        axes = "moving" if order.isupper() else "fixed"
        self.log.add_conversion(
            f"truth {columns.written} {columns.unit.written}: turns about the {axes} axes {order} in this order"
        )
        return q
