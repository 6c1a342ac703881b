"""The parts that all delimited logs share: options, settings file, table, and sensors on their clocks."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

import numpy as np

from stillpoint.datasets.errors import BadParameter, BadSource, nearest
from stillpoint.datasets.importers.clock import (
    ISO,
    TIME_EXPONENT,
    Clock,
    check_rate,
    describe_disorder,
    repair_clock,
)
from stillpoint.datasets.importers.columns import Columns, split
from stillpoint.datasets.importers.delimited import Table, parse
from stillpoint.datasets.importers.files import read_text, require_existing
from stillpoint.datasets.importers.options import OwnOptions
from stillpoint.datasets.importers.series import Log, Series, find_finite_rows, sort_by_time

_SUFFIXES = (".csv", ".tsv", ".txt")
_TIME_WORDS = ("time", "stamp", "timestamp", "seconds", "t", "t_s", "t_ms", "t_us", "t_ns", "sec", "ms", "date")


@dataclass(frozen=True)
class LogOptions(OwnOptions):
    """Options of delimited logs. Each may also stand in the TOML file ``config``; a flag wins over the file."""

    config: Path | None = None
    time: str | None = None  # "COLUMN:UNIT"
    rate: float | None = None  # Hz, where the log has no time
    delimiter: str | None = None
    drop_disordered: bool = False  # sort small disorder by time and drop equal stamps, counted, instead of refusing


AnyOptions = TypeVar("AnyOptions", bound=LogOptions)


def list_logs(source: Path) -> list[Path]:
    """Return the file itself, or the logs of a folder; raises :class:`BadSource` when there is none."""
    require_existing(source)
    files = sorted(f for f in source.iterdir() if f.suffix.lower() in _SUFFIXES) if source.is_dir() else [source]
    if not files:
        raise BadSource(f"{source}: holds no .csv, .tsv or .txt file; name the log")
    return files


def read_table(file: Path, delimiter: str | None, log: Log) -> Table:
    """Return the table in a file and note the lines before its header."""
    table = parse(read_text(file), str(file), delimiter)
    note_skipped(table, file, log)
    return table


def note_skipped(table: Table, file: Path, log: Log) -> None:
    """Note the lines before the header of a table."""
    if table.skipped:
        log.add_note(f"{table.skipped} lines beside the header of {file.name} skipped (device data or units)")


def read_toml(file: Path) -> dict[str, Any]:
    """Return the content of a TOML file; raises :class:`BadParameter`."""
    try:
        return tomllib.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise BadParameter(f"{file}: cannot be read ({error.strerror}); name a TOML file") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise BadParameter(f"{file}: is not TOML ({error})") from None
    except RecursionError:
        raise BadParameter(f"{file}: is not TOML for settings (it is nested too deeply)") from None


def apply_config(options: AnyOptions) -> AnyOptions:
    """Return the options completed by their TOML file; a flag that was given wins over the file."""
    if options.config is None:
        return options
    given = {key.replace("-", "_"): value for key, value in read_toml(options.config).items()}
    kinds = _find_toml_kinds(type(options))
    for key, value in given.items():
        if key not in kinds:
            raise BadParameter(f"{options.config}: no setting {key!r}; {nearest(key, kinds)}")
        if not isinstance(value, kinds[key]) or (kinds[key] is not bool and isinstance(value, bool)):
            raise BadParameter(f"{options.config}: {key} = {value!r} is of the wrong kind; see docs/importing.md")
    default = type(options)()
    unset = {key: value for key, value in given.items() if getattr(options, key) == getattr(default, key)}
    return replace(options, **unset)


def _find_toml_kinds(options: type[LogOptions]) -> Mapping[str, Any]:
    """Return what the value of each setting must be in TOML; a path and a choice are text."""
    hints = get_type_hints(options)
    allowed: dict[str, Any] = {}
    for name in (each.name for each in fields(options) if each.name != "config"):
        kinds = (hints[name], *get_args(hints[name]))
        allowed[name] = bool if bool in kinds else (int, float) if float in kinds else str
    return allowed


def read_clock(table: Table, options: LogOptions, log: Log, time: str | None = None, flag: str = "--time") -> Clock:
    """Return the stamps of all rows, repaired where a counter wrapped or a single stamp is wild.

    ``time`` is COLUMN:UNIT of a sensor with a column of its own, else ``options.time``. Raises for no clock, two
    clocks, an unknown unit, and a rate that no sensor has.
    """
    time = time or options.time
    if options.time is not None and options.rate is not None:
        raise BadParameter(f"{table.where}: has two clocks, --time and --rate; give one of them")
    if options.rate is not None and time is None:
        if not 0 < options.rate < float("inf"):
            raise BadParameter(f"--rate {options.rate:g}: give a positive number of Hz")
        log.add_conversion(f"stamps from the row number at {options.rate:g} Hz")
        t_ns = np.asarray(np.round(np.arange(len(table.rows)) * (1e9 / options.rate)), dtype=np.int64)
        return Clock("row", "row", t_ns, np.ones(len(t_ns), dtype=np.bool_))
    if time is None:
        likely = [name for name in table.columns if name.lower().split(" ")[0].rstrip(":") in _TIME_WORDS]
        hint = f" ({' or '.join(likely)} looks like it)" if likely else f"; it has {table.listed}"
        raise BadParameter(f"{table.where}: name the time column{hint}: --time COLUMN:UNIT, or give --rate HZ")
    column, unit = _split_time(table, time, flag)
    clock = repair_clock(table.clock(column, unit, flag), log)
    log.add_conversion(f"time {column!r} in {unit}")
    unknown = int((~clock.known).sum())
    if unknown:
        log.add_note(f"{unknown} of {len(table.rows)} rows without a usable time in {column!r} skipped")
    if not options.units_unchecked:
        check_rate(clock, table.where)
    return clock


def _split_time(table: Table, time: str, flag: str) -> tuple[str, str]:
    """Return column and unit of COLUMN:UNIT; without a unit, dates are iso and numbers are seconds."""
    if time in table.columns:
        column, unit = time, "s"
        cell = next((row[table.place(time)] for row in table.rows if len(row) > table.place(time)), "")
        if "-" in cell[1:] and ":" in cell:
            unit = ISO
    else:
        column, unit = split(time, "s")
    if unit not in (*TIME_EXPONENT, ISO):
        raise BadParameter(f"{flag}: no unit {unit!r}; there are {', '.join(TIME_EXPONENT)}, {ISO}")
    return column, unit


def read_sensor(
    table: Table, clock: Clock, columns: Columns, what: str, flag: str, options: LogOptions, log: Log
) -> Series:
    """Return one sensor in SI on the stamps of its rows; a row without its numbers or without a time is no sample.

    Raises :class:`BadSource` where no row has numbers, and where time does not rise and may not be sorted.
    """
    values = columns.values(table)
    finite = find_finite_rows(values)
    if not finite.any():
        raise BadSource(f"{table.where}: no row has numbers in all columns of {flag}; check the columns")
    log.count_dropped_rows(what, int((~finite).sum()), len(finite))
    keep = finite & clock.known
    if not keep.any():
        raise BadSource(f"{table.where}: no row with numbers of {flag} has a time in {clock.name!r}; check the columns")
    lines = table.lines if keep.all() else [table.lines[k] for k in np.flatnonzero(keep).tolist()]
    return order_series(Series(clock.t_ns[keep], values[keep]), lines, clock, table.where, what, options, log)


def order_series(
    series: Series, lines: list[int], clock: Clock, where: str, what: str, options: LogOptions, log: Log
) -> Series:
    """Return a series whose time rises; raises :class:`BadSource` unless it does or --drop-disordered may sort it."""
    steps = np.diff(series.t_ns)
    if not len(steps) or (steps > 0).all():
        return series
    message = describe_disorder(series.t_ns, lines, clock, where)
    if not options.drop_disordered or "--drop-disordered" not in message:
        raise BadSource(message)
    return sort_by_time(series, what, log)


def shift_to_zero(streams: Mapping[str, Series], log: Log) -> dict[str, Series]:
    """Move the common clock of all streams so that no stamp is negative, with a line that says so."""
    early_ns = min((int(series.t_ns.min()) for series in streams.values()), default=0)
    if early_ns >= 0:
        return dict(streams)
    log.add_conversion(f"all times moved by {-early_ns / 1e9:.9f} s so that none is negative")
    return {name: Series(series.t_ns - early_ns, series.values) for name, series in streams.items()}
