"""Any delimited log: its columns, units, signs and clock are said by flags or by a small TOML file.

``gyro = "gx,gy,gz:deg/s"`` names three columns and their unit; a leading ``-`` turns a sign; ``0.061*mg`` is a unit
per count. Columns go by their names in the header, or by numbers from 1 where there is none.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from stillpoint.datasets.errors import BadParameter, BadSource
from stillpoint.datasets.frames import local_from_enu, quaternion, rotation
from stillpoint.datasets.importers.bundle import digests
from stillpoint.datasets.importers.clock import Log, Series, finite, merge, rising
from stillpoint.datasets.importers.columns import quaternion_columns, vector
from stillpoint.datasets.importers.delimited import Table
from stillpoint.datasets.importers.log_options import LogOptions, clock_of, log_files, table_of, with_config
from stillpoint.datasets.importers.provenance import own_info
from stillpoint.datasets.importers.units import FIELD, FORCE, LENGTH, RATE
from stillpoint.datasets.recording import Mag, Recording, Times, Truth

SENSORS = {"gyro": (RATE, "rad/s"), "accel": (FORCE, "m/s^2"), "mag": (FIELD, "uT")}
FARTHEST_NORM = 0.01  # a quaternion with three decimals is still one; other columns are not


@dataclass(frozen=True)
class CsvOptions(LogOptions):
    """Where the log keeps what."""

    gyro: str | None = None  # "X,Y,Z:UNIT"
    accel: str | None = None
    mag: str | None = None
    truth: str | None = None  # "W,X,Y,Z"
    truth_frame: Literal["enu", "nwu", "ned"] = "enu"  # the local frame that the truth's quaternion leads to
    position: str | None = None  # "X,Y,Z:UNIT" in the truth's local frame
    moving: str | None = None  # a column that is 0 where the truth is not to be scored


def read_csv(source: Path, options: CsvOptions) -> Iterator[Recording]:
    """The recording of one file, or of each .csv, .tsv and .txt file of a folder.

    Raises :class:`BadSource` for the file, :class:`BadParameter` for an option.
    """
    files = log_files(source)
    options = with_config(options)
    for file in files:
        yield _recording(file, options)


def _recording(file: Path, options: CsvOptions) -> Recording:
    reading = Reading(table_of(file, options), options, Log())
    t_ns = clock_of(reading.table, options, reading.log)
    gyro = reading.series("gyro", t_ns)
    accel = reading.series("accel", t_ns)
    if gyro is None or accel is None:
        raise BadParameter(
            f"{file}: name the columns of gyro and accelerometer: --gyro X,Y,Z:UNIT --accel X,Y,Z:UNIT; "
            f"the file has {reading.table.listed}"
        )
    mag = reading.series("mag", t_ns)
    imu = merge(gyro, accel, str(file), reading.log)
    truth = reading.truth(t_ns)
    info = own_info(f"delimited log {file.name}", options, t_ns, digests([file], file.parent), reading.log)
    mag_stream = None if mag is None else Mag(mag.t_ns, mag.values)
    return Recording(file.stem, imu=imu, mag=mag_stream, truth=truth, info=info)


@dataclass(frozen=True)
class Reading:
    """One table, read as the options say."""

    table: Table
    options: CsvOptions
    log: Log

    def series(self, what: str, t_ns: Times) -> Series | None:
        """One sensor in SI on the stamps of its rows; a row without numbers for it is no sample of it."""
        text = getattr(self.options, what)
        if text is None:
            return None
        units, target = SENSORS[what]
        columns = vector(text, f"--{what}", units)
        series = finite(Series(t_ns, columns.values(self.table)), what, self.log)
        if len(series.t_ns) == 0:
            raise BadSource(f"{self.table.where}: no row has numbers in all columns of --{what}; check the columns")
        self.log.converted(f"{what} {columns.written} {columns.unit.written} -> {target}{columns.flipped}")
        return rising(series, what, self.log) if self.options.drop_disordered else series

    def truth(self, t_ns: Times) -> Truth | None:
        """Quaternions w, x, y, z that take the body to the local frame; rows without one are gaps."""
        options, table = self.options, self.table
        if options.truth is None:
            return None
        values = quaternion_columns(options.truth, "--truth").values(table)
        norm = np.linalg.norm(values, axis=1)
        known = np.isfinite(norm) & (norm > 0.5)
        if options.drop_disordered:
            known &= np.diff(np.maximum.accumulate(t_ns), prepend=-1) > 0
        if not known.all():
            self.log.noted(f"truth: {int((~known).sum())} of {len(known)} rows without an attitude (gaps)")
        if not known.any():
            raise BadSource(f"{table.where}: no row has a quaternion in {options.truth}; check the columns of --truth")
        off = np.where(known, np.abs(norm - 1), 0.0)
        if off.max() > FARTHEST_NORM:
            line = table.first_line + int(off.argmax())
            raise BadSource(f"{table.where}, line {line}: {options.truth} is no unit quaternion; check the columns")
        to_enu = local_from_enu(options.truth_frame).inv()
        frame = options.truth_frame.upper()
        self.log.converted(f"truth {options.truth} as w,x,y,z, body -> {frame} -> East-North-Up")
        moving = np.ones(int(known.sum()), dtype=np.bool_)
        if options.moving is not None:
            moving = table.floats((options.moving,))[known, 0] > 0
        position_n_m = None
        if options.position is not None:
            local_m = vector(options.position, "--position", LENGTH).values(table)[known]
            position_n_m = local_m @ to_enu.as_matrix().T
        return Truth(t_ns[known], quaternion(to_enu * rotation(values[known])), moving, position_n_m)
