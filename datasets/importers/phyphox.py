"""Exports of the phone app phyphox: its zip of CSV files, the folder inside, or one CSV file.

Columns say what they are by their unit: ``Gyroscope x (rad/s)``, ``Acceleration x (m/s^2)``,
``Magnetic field x (uT)``, after a time in s since the start. phyphox gives Android's signs on iOS too, and leaves
pauses out of its time; ``meta/time.csv`` says when each start was. Separator and decimal sign follow the user's
settings, and the words follow the user's language.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillpoint.datasets.errors import BadSource
from stillpoint.datasets.importers.columns import FIELD, FORCE, RATE, normalise_unit
from stillpoint.datasets.importers.delimited import Table, parse
from stillpoint.datasets.importers.files import Bundle, hash_files, open_bundle, read_text
from stillpoint.datasets.importers.imported import Imported, make_mag
from stillpoint.datasets.importers.options import OwnOptions, make_info
from stillpoint.datasets.importers.series import (
    Log,
    Series,
    drop_before_zero,
    drop_incomplete_rows,
    find_finite_rows,
    make_gps,
    merge_imu,
    seconds_to_ns,
    sort_by_time,
)
from stillpoint.datasets.recording import Floats, Gps, Recording, Times

_SENSORS = {"gyro": RATE, "accel": FORCE, "mag": FIELD}
_TARGET = {"gyro": "rad/s", "accel": "m/s^2", "mag": "uT"}
_AXIS = re.compile(r"^(?P<what>.*?)\b(?P<axis>[xyz])\s*\((?P<unit>[^)]*)\)\s*$", re.IGNORECASE)
_WITHOUT_GRAVITY = re.compile(r"lin[eéi]a", re.IGNORECASE)
_PLACE = (("latitude", "°"), ("longitude", "°"), ("height", "m"), ("direction", "°"), ("velocity", "m/s"))


@dataclass(frozen=True)
class _Found:
    """One sensor's columns in one file."""

    sensor: str
    table: Table
    columns: tuple[str, str, str]
    unit: str


def read_phyphox(source: Path, options: OwnOptions) -> Imported:
    """Return the one recording of an export. Raises :class:`BadSource`."""
    bundle = _open_source(source)
    log = Log()
    tables = [
        parse(text, bundle.where(name))
        for name, text in bundle.texts.items()
        if not name.lower().startswith("meta/") and text.strip()
    ]
    found = [sensor for table in tables for sensor in _find_sensors(table, log)]
    starts = _read_starts(bundle, log)
    streams = {sensor: _read_series(source, sensor, found, starts, log) for sensor in _SENSORS}
    gyro, accel, mag = streams["gyro"], streams["accel"], streams["mag"]
    if gyro is None or accel is None:
        missing = "gyroscope (rad/s)" if gyro is None else "acceleration with gravity (m/s^2)"
        raise BadSource(f"{source}: has no columns x, y, z of the {missing}; record it with phyphox and export again")
    imu = merge_imu(gyro, accel, str(source), log)
    device = _read_properties(bundle)
    gps = _read_gps(tables, starts, log)
    field, uncalibrated = (None, options.mag_uncalibrated)
    if mag is not None:
        field, uncalibrated = make_mag(mag, options.mag_uncalibrated, log)
    info = make_info(
        "phyphox",
        options,
        imu.t_ns,
        bundle.sha256,
        log,
        sensor=options.sensor or device.get("deviceModel", ""),
        mag_uncalibrated=uncalibrated,
        extra={key: device[key] for key in ("version", "deviceBrand", "deviceRelease") if key in device},
    )
    return Imported(Recording(bundle.name, imu=imu, mag=field, gps=gps, info=info))


def _open_source(source: Path) -> Bundle:
    """Return a folder, a ZIP or one CSV file as a bundle of texts."""
    if source.suffix.lower() == ".csv" and source.is_file():
        text = read_text(source)
        return Bundle(source, {source.name: text}, hash_files([source], source.parent))
    return open_bundle(source)


def _find_sensors(table: Table, log: Log) -> Iterator[_Found]:
    """Yield the sensors of a file, by the units of columns that end in x, y, z."""
    groups: dict[tuple[str, str], dict[str, str]] = {}
    for column in table.columns:
        match = _AXIS.match(column)
        if match:
            groups.setdefault((match["what"].strip(), normalise_unit(match["unit"])), {})[match["axis"].lower()] = (
                column
            )
    for (what, unit), axes in groups.items():
        sensor = next((name for name, units in _SENSORS.items() if unit in units), None)
        if sensor is None or set(axes) != set("xyz"):
            continue
        if sensor == "accel" and _WITHOUT_GRAVITY.search(f"{what} {Path(table.where).name}"):
            log.add_note(f"{Path(table.where).name}: acceleration without gravity is not imported")
            continue
        yield _Found(sensor, table, (axes["x"], axes["y"], axes["z"]), unit)


def _read_series(source: Path, sensor: str, found: list[_Found], starts: Floats, log: Log) -> Series | None:
    """Return a sensor in SI on its stamps, None without one; raises :class:`BadSource` where it is there twice."""
    here = [one for one in found if one.sensor == sensor]
    if len(here) > 1:
        places = " and ".join(f"{Path(one.table.where).name} ({one.columns[0]})" for one in here)
        raise BadSource(f"{source}: {sensor} is there twice, in {places}; leave one of them in the folder")
    if not here:
        return None
    one = here[0]
    values = one.table.read_floats(one.columns) * _SENSORS[sensor][one.unit]
    log.add_conversion(f"{sensor} from {Path(one.table.where).name}, {one.unit} -> {_TARGET[sensor]}")
    series = drop_incomplete_rows(Series(_read_clock(one.table, starts), values), sensor, log)
    return sort_by_time(drop_before_zero(series, sensor, log), sensor, log)


def _find_time_column(table: Table) -> str:
    """Return the one column in seconds; raises :class:`BadSource` for none or several."""
    times = [column for column in table.columns if column.strip().lower().endswith("(s)")]
    if len(times) != 1:
        reason = f"has {len(times)} time columns ({', '.join(times)})" if times else "has no time column 'Time (s)'"
        raise BadSource(f"{table.where}: {reason}; export the raw data of one experiment")
    return times[0]


def _read_clock(table: Table, starts: Floats) -> Times:
    """Return nanoseconds: since 1970 where the starts are known, else since the start of the experiment."""
    t_ns = table.times(_find_time_column(table), "s")
    if len(starts) == 0:
        return t_ns
    experiment_ns = seconds_to_ns(starts[:, 0])
    at = np.clip(np.searchsorted(experiment_ns, t_ns, side="right") - 1, 0, len(starts) - 1)
    system_ns = np.asarray(np.round(starts[:, 1] * 1e3), dtype=np.int64) * 1_000_000
    return np.asarray(t_ns - experiment_ns[at] + system_ns[at], dtype=np.int64)


def _read_starts(bundle: Bundle, log: Log) -> Floats:
    """Return (K, 2) experiment time and system time, in s, of every start; K = 0 where they are not known."""
    name = bundle.find("meta/time.csv")
    if name is None:
        log.add_note("no meta/time.csv: times count from the start of the experiment, without its pauses")
        return np.empty((0, 2))
    table = parse(bundle.texts[name], bundle.where(name))
    event = table.place("event")
    times = table.read_floats(("experiment time", "system time"))
    starts = times[[row[event].upper() == "START" for row in table.rows]]
    if len(starts):
        log.add_conversion(f"experiment time -> system time (UTC) by meta/time.csv, {len(starts)} starts")
    return starts


def _read_properties(bundle: Bundle) -> dict[str, str]:
    """Return the properties of the device by name, empty where the export has none."""
    name = bundle.find("meta/device.csv")
    if name is None:
        return {}
    return {row[0]: row[1] for row in parse(bundle.texts[name], bundle.where(name)).rows if len(row) > 1}


def _read_gps(tables: list[Table], starts: Floats, log: Log) -> Gps | None:
    """Return the fixes of the first table that has them; None without one."""
    for table in tables:
        columns = [
            next((c for c in table.columns if c.lower().startswith(word) and c.endswith(f"({unit})")), None)
            for word, unit in _PLACE
        ]
        if all(columns):
            values = table.read_floats(tuple(str(column) for column in columns))
            series = Series(_read_clock(table, starts), values)
            keep = find_finite_rows(series.values[:, :2])
            return make_gps(series.where(keep), log) if keep.any() else None
        if any(column.endswith("(°)") for column in table.columns):
            log.add_note(f"{Path(table.where).name}: a location in other words than English is not imported")
    return None
