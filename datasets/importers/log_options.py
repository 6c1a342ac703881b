"""What every delimited log needs said: its clock and its settings file."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

import numpy as np

from stillpoint.datasets.errors import BadParameter, BadSource
from stillpoint.datasets.importers.bundle import existing
from stillpoint.datasets.importers.clock import Log
from stillpoint.datasets.importers.columns import split
from stillpoint.datasets.importers.delimited import Table, parse
from stillpoint.datasets.importers.options import OwnOptions
from stillpoint.datasets.importers.units import TIME_EXPONENT
from stillpoint.datasets.nearest import nearest
from stillpoint.datasets.recording import Times

SUFFIXES = (".csv", ".tsv", ".txt")
TIME_WORDS = ("time", "stamp", "seconds", "t", "t_s", "t_ms", "t_us", "t_ns", "sec", "ms")


@dataclass(frozen=True)
class LogOptions(OwnOptions):
    """Options of delimited logs. Each may also stand in the TOML file ``config``; a flag wins over the file."""

    config: Path | None = None
    time: str | None = None  # "COLUMN:UNIT"
    rate: float | None = None  # Hz, where the log has no time
    delimiter: str | None = None
    drop_disordered: bool = False  # sort by time and drop equal stamps, counted, instead of refusing


AnyOptions = TypeVar("AnyOptions", bound=LogOptions)


def log_files(source: Path) -> list[Path]:
    """The file itself, or the logs of a folder; raises :class:`BadSource` when there is none."""
    existing(source)
    files = sorted(f for f in source.iterdir() if f.suffix.lower() in SUFFIXES) if source.is_dir() else [source]
    if not files:
        raise BadSource(f"{source}: holds no .csv, .tsv or .txt file; name the log")
    return files


def table_of(file: Path, options: LogOptions) -> Table:
    """The table in a file, in UTF-8 or else Latin-1."""
    try:
        text = file.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        text = file.read_text(encoding="latin-1")
    return parse(text, str(file), options.delimiter)


def read_toml(file: Path) -> dict[str, Any]:
    """What a TOML file says; raises :class:`BadParameter`."""
    try:
        return tomllib.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise BadParameter(f"{file}: cannot be read ({error.strerror}); name a TOML file") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise BadParameter(f"{file}: is not TOML ({error})") from None


def with_config(options: AnyOptions) -> AnyOptions:
    """The options with what their TOML file says where no flag was given."""
    if options.config is None:
        return options
    said = {key.replace("-", "_"): value for key, value in read_toml(options.config).items()}
    kinds = _kinds(type(options))
    for key, value in said.items():
        if key not in kinds:
            raise BadParameter(f"{options.config}: no setting {key!r}; {nearest(key, kinds)}")
        if not isinstance(value, kinds[key]) or (kinds[key] is not bool and isinstance(value, bool)):
            raise BadParameter(f"{options.config}: {key} = {value!r} is of the wrong kind; see docs/importing.md")
    default = type(options)()
    unset = {key: value for key, value in said.items() if getattr(options, key) == getattr(default, key)}
    return replace(options, **unset)


def _kinds(options: type[LogOptions]) -> Mapping[str, Any]:
    """What the value of each setting must be in TOML; a path and a choice are text."""
    hints = get_type_hints(options)
    allowed: dict[str, Any] = {}
    for name in (each.name for each in fields(options) if each.name != "config"):
        kinds = (hints[name], *get_args(hints[name]))
        allowed[name] = bool if bool in kinds else (int, float) if float in kinds else str
    return allowed


def clock_of(table: Table, options: LogOptions, log: Log) -> Times:
    """The stamp of every row; raises for no clock, two clocks, and a clock that does not rise."""
    if options.time is not None and options.rate is not None:
        raise BadParameter(f"{table.where}: has two clocks, --time and --rate; give one of them")
    if options.rate is not None:
        if not options.rate > 0:
            raise BadParameter(f"--rate {options.rate:g}: give a positive number of Hz")
        log.converted(f"stamps from the row number at {options.rate:g} Hz")
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
    log.converted(f"time {column!r} in {unit}")
    if t_ns.min() < 0:
        log.converted(f"all times moved by {-t_ns.min() / 1e9:.9f} s so that none is negative")
        t_ns = t_ns - t_ns.min()
    return t_ns
