"""A log of single-axis accelerometers on a spinning body, with or without a shaft encoder (Asghari et al. 2018).

Without flags the columns are ``t_s``, ``F4_mps2``, ``F5_mps2`` (or ``F1_mps2`` to ``F5_mps2`` and ``g1_degps``,
``g2_degps``), ``angle_deg`` and ``rate_degps``. Where the accelerometers sit is a preset with its two lever arms, or a
TOML file.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from stillpoint.datasets.constants import STANDARD_GRAVITY_MPS2
from stillpoint.datasets.errors import BadParameter, BadRecording, BadSource, nearest
from stillpoint.datasets.importers.clock import Clock
from stillpoint.datasets.importers.columns import ANGLE, FORCE, RATE, Columns, parse_columns
from stillpoint.datasets.importers.delimited import Table
from stillpoint.datasets.importers.delimited_log import (
    LogOptions,
    apply_config,
    order_series,
    read_clock,
    read_sensor,
    read_table,
    read_toml,
    shift_to_zero,
)
from stillpoint.datasets.importers.files import hash_files
from stillpoint.datasets.importers.imported import Imported
from stillpoint.datasets.importers.options import make_info
from stillpoint.datasets.importers.series import Log, Series
from stillpoint.datasets.recording import Encoder, Floats, Recording, Spin, SpinGeometry
from stillpoint.datasets.spin import bench, make_five_accelerometers

_PRESETS = {"bench": bench, "five": make_five_accelerometers}
_COLUMNS = {
    "bench": ("F4_mps2,F5_mps2:m/s^2", None),
    "five": ("F1_mps2,F2_mps2,F3_mps2,F4_mps2,F5_mps2:m/s^2", "g1_degps,g2_degps:deg/s"),
}
_CLOCK, _ANGLES, _RATES = "t_s:s", "angle_deg:deg", "rate_degps:deg/s"
_GEOMETRY_KEYS = {"accel_r_m": 3, "accel_axis": 3, "gyro_axis": 3, "range_g": 0, "fixed_axis": 0}


@dataclass(frozen=True)
class SpinOptions(LogOptions):
    """Where the log keeps what, and where the accelerometers sit."""

    geometry: str = "bench"  # bench, five, or a TOML file
    d1_m: float | None = None  # lever arm of F4 in the presets
    d2_m: float | None = None  # of F5
    range_g: float | None = None  # of all accelerometers; 16 in the presets
    accels: str | None = None  # "F4,F5:UNIT", in the order of the geometry
    gyros: str | None = None  # "g1,g2:UNIT"
    encoder_angle: str | None = None  # "COLUMN:UNIT"
    encoder_rate: str | None = None  # "COLUMN:UNIT"


def find_geometry(options: SpinOptions) -> SpinGeometry:
    """Return the geometry that the options name; raises :class:`BadParameter`."""
    if options.range_g is not None and not options.range_g > 0:
        raise BadParameter(f"--range-g {options.range_g:g}: give a positive number of g")
    if options.geometry in _PRESETS:
        arms = {"d1_m": options.d1_m, "d2_m": options.d2_m}
        for name, arm in arms.items():
            if arm is not None and not arm > 0:
                raise BadParameter(f"--{name.replace('_', '-')} {arm:g}: give a positive length in m")
        given: dict[str, Any] = {name: arm for name, arm in arms.items() if arm is not None}
        if options.range_g is not None:
            given["accel_range_mps2"] = options.range_g * STANDARD_GRAVITY_MPS2
        return _PRESETS[options.geometry](**given)
    if options.d1_m is not None or options.d2_m is not None:
        raise BadParameter("--d1-m, --d2-m: belong to the geometries bench and five; a file states its own arms")
    if not options.geometry.endswith(".toml"):
        raise BadParameter(f"--geometry: no preset {options.geometry!r}; give bench, five or a .toml file")
    return _read_geometry(Path(options.geometry), options.range_g)


def _read_geometry(file: Path, range_g: float | None) -> SpinGeometry:
    """Read arms, axes and ranges of the accelerometers from a TOML file; raises :class:`BadParameter`."""
    given = read_toml(file)
    for key in given:
        if key not in _GEOMETRY_KEYS:
            raise BadParameter(f"{file}: no setting {key!r}; {nearest(key, _GEOMETRY_KEYS)}")
    range_g = given.get("range_g") if range_g is None else range_g
    try:
        arms, axes, gyros = (
            np.array(given.get(key, []), dtype=np.float64).reshape(-1, 3)
            for key in ("accel_r_m", "accel_axis", "gyro_axis")
        )
        limits = None if range_g is None else np.full(len(arms), float(range_g) * STANDARD_GRAVITY_MPS2)
        return SpinGeometry(arms, _normalise(axes), _normalise(gyros), limits, bool(given.get("fixed_axis", False)))
    except (ValueError, TypeError, BadRecording) as error:
        raise BadParameter(f"{file}: {error}; give accel_r_m and accel_axis as rows of three numbers") from None


def _normalise(axes: Floats) -> Floats:
    """Return axes (k, 3) of length 1; zeros stay zeros."""
    size = np.linalg.norm(axes, axis=1, keepdims=True)
    return np.asarray(axes / np.where(size > 0, size, 1.0))


def read_spin(file: Path, options: SpinOptions) -> Imported:
    """Return the recording of a log.

    Raises :class:`BadSource` for the file, :class:`BadParameter` for an option.
    """
    options = apply_config(options)
    geometry = find_geometry(options)
    log = Log()
    table = read_table(file, options.delimiter, log)
    if options.time is None and options.rate is None and "t_s" in table.columns:
        options = replace(options, time=_CLOCK)
    clock = read_clock(table, options, log)
    accels, gyros = _COLUMNS.get(options.geometry, (None, None))
    accel = _read_columns(table, options.accels or accels, "--accels", FORCE, len(geometry.accel_r_b_m), log, "m/s^2")
    gyro = _read_columns(table, options.gyros or gyros, "--gyros", RATE, len(geometry.gyro_axis_b), log, "rad/s")
    streams = {"spin": _keep_samples(table, clock, np.column_stack([accel, gyro]), options, log)}
    angle = _read_encoder_column(table, clock, options, "encoder_angle", _ANGLES, ANGLE, log)
    rate = _read_encoder_column(table, clock, options, "encoder_rate", _RATES, RATE, log)
    streams |= {"angle": angle} if angle is not None else {}
    streams |= {"rate": rate} if rate is not None else {}
    streams = shift_to_zero(streams, log)
    both, k = streams["spin"], len(geometry.accel_r_b_m)
    spin = Spin(both.t_ns, both.values[:, :k], both.values[:, k:], geometry)
    encoder = _make_encoder(streams.get("angle"), streams.get("rate"), log, table.where)
    info = make_info(f"delimited log {file.name}", options, spin.t_ns, hash_files([file], file.parent), log)
    return Imported(Recording(file.stem, spin=spin, encoder=encoder, info=info))


def _read_columns(
    table: Table, text: str | None, flag: str, units: dict[str, float], count: int, log: Log, target: str
) -> Floats:
    """Return columns in SI (N, count); NaN where a cell is empty."""
    if count == 0 and text is None:
        return np.empty((len(table.rows), 0))
    if text is None:
        raise BadParameter(f"{table.where}: name the {count} columns: {flag} A,B:UNIT; the file has {table.listed}")
    columns = parse_columns(text, flag, units, count)
    log.add_conversion(f"{flag.removeprefix('--')} {columns.written} {columns.unit.written} -> {target}")
    return columns.values(table)


def _keep_samples(table: Table, clock: Clock, values: Floats, options: SpinOptions, log: Log) -> Series:
    """Return the rows with a time in which any sensor gave a number; the others are counted."""
    some = np.asarray(np.isfinite(values).any(axis=1))
    if not some.any():
        raise BadSource(f"{table.where}: no row has a number of any accelerometer; check the columns of --accels")
    if not some.all():
        log.add_note(f"spin: {int((~some).sum())} of {len(some)} rows without a number dropped")
    keep = some & clock.known
    series = Series(clock.t_ns[keep], values[keep])
    lost = int((~np.isfinite(series.values)).any(axis=1).sum())
    if lost:
        log.add_note(f"spin: {lost} rows lack some sensors; kept as NaN")
    lines = [table.lines[k] for k in np.flatnonzero(keep).tolist()]
    return order_series(series, lines, clock, table.where, "spin", options, log)


def _read_encoder_column(
    table: Table, clock: Clock, options: SpinOptions, what: str, usual: str, units: dict[str, float], log: Log
) -> Series | None:
    """Return one column of the encoder in SI, or None where the log has none."""
    text = getattr(options, what)
    if text is None and usual.partition(":")[0] not in table.columns:
        return None
    flag, target = f"--{what.replace('_', '-')}", "rad" if units is ANGLE else "rad/s"
    columns: Columns = parse_columns(text or usual, flag, units, 1)
    series = read_sensor(table, clock, columns, what, flag, options, log)
    log.add_conversion(f"{flag.removeprefix('--')} {columns.written} {columns.unit.written} -> {target}")
    return series


def _make_encoder(angle: Series | None, rate: Series | None, log: Log, where: str) -> Encoder | None:
    """Return angle and rate of the shaft; what the log lacks of the two is made from the other, and noted."""
    if angle is not None:
        turned = np.unwrap(angle.values[:, 0])
        if not np.array_equal(turned, angle.values[:, 0]):
            log.add_conversion(f"encoder angle unwrapped over {np.ptp(turned) / (2 * np.pi):.1f} turns")
        angle = Series(angle.t_ns, turned[:, None])
    if angle is not None and rate is not None:
        t_ns, at, by = np.intersect1d(angle.t_ns, rate.t_ns, return_indices=True)
        return Encoder(t_ns, angle.values[at, 0], rate.values[by, 0])
    if angle is not None:
        if len(angle.t_ns) < 2:
            raise BadSource(f"{where}: one angle of the encoder gives no rate; check its column")
        log.add_conversion("encoder rate: difference of the angle over the step that ends at the stamp")
        steps = np.diff(angle.values[:, 0]) / (np.diff(angle.t_ns) / 1e9)
        return Encoder(angle.t_ns, angle.values[:, 0], np.concatenate([steps[:1], steps]))
    if rate is None:
        return None
    log.add_conversion("encoder angle: integral of the rate from 0 (trapezoidal rule)")
    speed = rate.values[:, 0]
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(rate.t_ns) / 1e9)])
    return Encoder(rate.t_ns, turned, speed)
