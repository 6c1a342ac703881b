"""Any delimited log: its columns, units, signs and clock are said by flags or by a small TOML file.

``gyro = "gx,gy,gz:deg/s"`` names three columns and their unit; a leading ``-`` turns a sign; ``0.061*mg`` is a unit
per count. Columns go by their names in the header, or by numbers from 1 where there is none.
"""

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from stillpoint.datasets.errors import BadParameter, BadSource
from stillpoint.datasets.frames import local_from_enu, quaternion, rotation
from stillpoint.datasets.importers.bundle import digests, existing
from stillpoint.datasets.importers.clock import Log, Series, finite, merge, rising
from stillpoint.datasets.importers.columns import quaternion_columns, split, vector
from stillpoint.datasets.importers.delimited import Table, parse
from stillpoint.datasets.importers.options import OwnOptions
from stillpoint.datasets.importers.provenance import own_info
from stillpoint.datasets.importers.units import FIELD, FORCE, LENGTH, RATE, TIME_EXPONENT
from stillpoint.datasets.nearest import nearest
from stillpoint.datasets.recording import Mag, Recording, Times, Truth

SENSORS = {"gyro": (RATE, "rad/s"), "accel": (FORCE, "m/s^2"), "mag": (FIELD, "uT")}
FARTHEST_NORM = 0.01  # a quaternion with three decimals is still one; other columns are not
TIME_WORDS = ("time", "stamp", "seconds", "t", "t_s", "t_ms", "t_us", "t_ns", "sec", "ms")


@dataclass(frozen=True)
class CsvOptions(OwnOptions):
    """Where the log keeps what. Each may also stand in the TOML file ``config``; a flag wins over the file."""

    config: Path | None = None
    time: str | None = None  # "COLUMN:UNIT"
    rate: float | None = None  # Hz, where the log has no time
    gyro: str | None = None  # "X,Y,Z:UNIT"
    accel: str | None = None
    mag: str | None = None
    truth: str | None = None  # "W,X,Y,Z"
    truth_frame: Literal["enu", "nwu", "ned"] = "enu"  # the local frame that the truth's quaternion leads to
    position: str | None = None  # "X,Y,Z:UNIT" in the truth's local frame
    moving: str | None = None  # a column that is 0 where the truth is not to be scored
    delimiter: str | None = None
    drop_disordered: bool = False  # sort by time and drop equal stamps, counted, instead of refusing


def read_csv(source: Path, options: CsvOptions) -> Iterator[Recording]:
    """The recording of one file, or of each .csv, .tsv and .txt file of a folder.

    Raises :class:`BadSource` for the file, :class:`BadParameter` for an option.
    """
    existing(source)
    options = _with_config(options)
    suffixes = (".csv", ".tsv", ".txt")
    files = sorted(f for f in source.iterdir() if f.suffix.lower() in suffixes) if source.is_dir() else [source]
    if not files:
        raise BadSource(f"{source}: holds no .csv, .tsv or .txt file; name the log")
    for file in files:
        yield _recording(file, options)


def _with_config(options: CsvOptions) -> CsvOptions:
    """The options with what the TOML file says where no flag was given."""
    if options.config is None:
        return options
    try:
        said: dict[str, Any] = tomllib.loads(options.config.read_text(encoding="utf-8"))
    except OSError as error:
        raise BadParameter(f"{options.config}: cannot be read ({error.strerror}); name a TOML file") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise BadParameter(f"{options.config}: is not TOML ({error})") from None
    said = {key.replace("-", "_"): value for key, value in said.items()}
    default = CsvOptions()
    known = {field.name: type(getattr(default, field.name)) for field in fields(CsvOptions) if field.name != "config"}
    for key, value in said.items():
        if key not in known:
            raise BadParameter(f"{options.config}: no setting {key!r}; {nearest(key, known)}")
        wanted = (int, float) if key == "rate" else bool if known[key] is bool else str
        if not isinstance(value, wanted) or (wanted is not bool and isinstance(value, bool)):
            raise BadParameter(f"{options.config}: {key} = {value!r} is of the wrong kind; see docs/importing.md")
    unset = {key: value for key, value in said.items() if getattr(options, key) == getattr(default, key)}
    return replace(options, **unset)


def _recording(file: Path, options: CsvOptions) -> Recording:
    try:
        text = file.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        text = file.read_text(encoding="latin-1")
    reading = Reading(parse(text, str(file), options.delimiter), options, Log())
    t_ns = reading.clock()
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

    def clock(self) -> Times:
        """The stamp of every row; raises for no clock, two clocks, and a clock that does not rise."""
        options, table = self.options, self.table
        if options.time is not None and options.rate is not None:
            raise BadParameter(f"{table.where}: has two clocks, --time and --rate; give one of them")
        if options.rate is not None:
            if not options.rate > 0:
                raise BadParameter(f"--rate {options.rate:g}: give a positive number of Hz")
            self.log.converted(f"stamps from the row number at {options.rate:g} Hz")
            return np.asarray(np.round(np.arange(len(table.rows)) * (1e9 / options.rate)), dtype=np.int64)
        if options.time is None:
            likely = [name for name in table.columns if name.lower().split(" ")[0].rstrip(":") in TIME_WORDS]
            hint = f" ({' or '.join(likely)} looks like it)" if likely else f"; it has {table.listed}"
            raise BadParameter(f"{table.where}: name the time column{hint}: --time COLUMN:UNIT, or give --rate HZ")
        column, unit = split(options.time, "s")
        if unit not in TIME_EXPONENT:
            raise BadParameter(f"--time: no unit {unit!r}; there are {', '.join(TIME_EXPONENT)}")
        t_ns = table.times(column, TIME_EXPONENT[unit])
        falls = np.flatnonzero(np.diff(t_ns) <= 0)
        if len(falls) and not options.drop_disordered:
            line = table.first_line + int(falls[0]) + 1
            raise BadSource(
                f"{table.where}, line {line}, column {column!r}: time does not rise ({len(falls)} such lines); "
                "correct the log, or import it with --drop-disordered"
            )
        self.log.converted(f"time {column!r} in {unit}")
        if t_ns.min() < 0:
            self.log.converted(f"all times moved by {-t_ns.min() / 1e9:.9f} s so that none is negative")
            t_ns = t_ns - t_ns.min()
        return t_ns

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
