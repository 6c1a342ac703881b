"""A log of single-axis accelerometers on a spinning body, with or without a shaft encoder: paper 000's bench.

Without flags the columns are ``t_s``, ``F4_mps2``, ``F5_mps2`` (or ``F1_mps2`` to ``F5_mps2`` and ``g1_degps``,
``g2_degps``), ``angle_deg`` and ``rate_degps``. Where the accelerometers sit is a preset with its two lever arms, or a
TOML file.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stillpoint.datasets.errors import BadParameter, BadRecording, BadSource
from stillpoint.datasets.importers.bundle import digests
from stillpoint.datasets.importers.clock import Log, Series, finite, rising
from stillpoint.datasets.importers.columns import vector
from stillpoint.datasets.importers.delimited import Table
from stillpoint.datasets.importers.log_options import (
    LogOptions,
    clock_of,
    log_files,
    read_toml,
    table_of,
    with_config,
)
from stillpoint.datasets.importers.provenance import own_info
from stillpoint.datasets.importers.units import ANGLE, FORCE, RATE
from stillpoint.datasets.nearest import nearest
from stillpoint.datasets.recording import Encoder, Floats, Recording, Spin, SpinGeometry, Times
from stillpoint.datasets.spin import G_MPS2, bench, five_accelerometers

PRESETS = {"bench": bench, "five": five_accelerometers}
COLUMNS = {
    "bench": ("F4_mps2,F5_mps2:m/s^2", None),
    "five": ("F1_mps2,F2_mps2,F3_mps2,F4_mps2,F5_mps2:m/s^2", "g1_degps,g2_degps:deg/s"),
}
CLOCK, ANGLES, RATES = "t_s:s", "angle_deg:deg", "rate_degps:deg/s"
GEOMETRY_KEYS = {"accel_r_m": 3, "accel_axis": 3, "gyro_axis": 3, "range_g": 0, "fixed_axis": 0}


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


def read_spin(source: Path, options: SpinOptions) -> Iterator[Recording]:
    """The recording of one file, or of each .csv, .tsv and .txt file of a folder.

    Raises :class:`BadSource` for the file, :class:`BadParameter` for an option.
    """
    files = log_files(source)
    options = with_config(options)
    geometry = geometry_of(options)
    for file in files:
        yield _recording(file, options, geometry)


def geometry_of(options: SpinOptions) -> SpinGeometry:
    """The geometry that the options name; raises :class:`BadParameter`."""
    if options.range_g is not None and not options.range_g > 0:
        raise BadParameter(f"--range-g {options.range_g:g}: give a positive number of g")
    if options.geometry in PRESETS:
        arms = {"d1_m": options.d1_m, "d2_m": options.d2_m}
        for name, arm in arms.items():
            if arm is not None and not arm > 0:
                raise BadParameter(f"--{name.replace('_', '-')} {arm:g}: give a positive length in m")
        given: dict[str, Any] = {name: arm for name, arm in arms.items() if arm is not None}
        if options.range_g is not None:
            given["accel_range_mps2"] = options.range_g * G_MPS2
        return PRESETS[options.geometry](**given)
    if options.d1_m is not None or options.d2_m is not None:
        raise BadParameter("--d1-m, --d2-m: belong to the geometries bench and five; a file states its own arms")
    if not options.geometry.endswith(".toml"):
        raise BadParameter(f"--geometry: no preset {options.geometry!r}; give bench, five or a .toml file")
    return _geometry_file(Path(options.geometry), options.range_g)


def _geometry_file(file: Path, range_g: float | None) -> SpinGeometry:
    said = read_toml(file)
    for key in said:
        if key not in GEOMETRY_KEYS:
            raise BadParameter(f"{file}: no setting {key!r}; {nearest(key, GEOMETRY_KEYS)}")
    range_g = said.get("range_g") if range_g is None else range_g
    try:
        arms, axes, gyros = (
            np.array(said.get(key, []), dtype=np.float64).reshape(-1, 3)
            for key in ("accel_r_m", "accel_axis", "gyro_axis")
        )
        limits = None if range_g is None else np.full(len(arms), float(range_g) * G_MPS2)
        return SpinGeometry(arms, _unit(axes), _unit(gyros), limits, bool(said.get("fixed_axis", False)))
    except (ValueError, TypeError, BadRecording) as error:
        raise BadParameter(f"{file}: {error}; give accel_r_m and accel_axis as rows of three numbers") from None


def _unit(axes: Floats) -> Floats:
    size = np.linalg.norm(axes, axis=1, keepdims=True)
    return np.asarray(axes / np.where(size > 0, size, 1.0))


def _recording(file: Path, options: SpinOptions, geometry: SpinGeometry) -> Recording:
    table, log = table_of(file, options), Log()
    if options.time is None and options.rate is None and "t_s" in table.columns:
        options = _with(options, time=CLOCK)
    t_ns = clock_of(table, options, log)
    accels, gyros = COLUMNS.get(options.geometry, (None, None))
    accel = _columns(table, options.accels or accels, "--accels", FORCE, len(geometry.accel_r_b_m), log, "m/s^2")
    gyro = _columns(table, options.gyros or gyros, "--gyros", RATE, len(geometry.gyro_axis_b), log, "rad/s")
    spin = _spin(Series(t_ns, np.column_stack([accel, gyro])), geometry, options, log, table.where)
    encoder = _encoder(table, t_ns, options, log)
    info = own_info(f"delimited log {file.name}", options, t_ns, digests([file], file.parent), log)
    return Recording(file.stem, spin=spin, encoder=encoder, info=info)


def _with(options: SpinOptions, **changes: Any) -> SpinOptions:
    return SpinOptions(**{**vars(options), **changes})


def _columns(
    table: Table, text: str | None, flag: str, units: dict[str, float], count: int, log: Log, target: str
) -> Floats:
    """Columns in SI (N, count); NaN where a cell is empty."""
    if count == 0 and text is None:
        return np.empty((len(table.rows), 0))
    if text is None:
        raise BadParameter(f"{table.where}: name the {count} columns: {flag} A,B:UNIT; the file has {table.listed}")
    columns = vector(text, flag, units, count)
    values = columns.values(table)
    log.converted(f"{flag.removeprefix('--')} {columns.written} {columns.unit.written} -> {target}")
    return values


def _spin(both: Series, geometry: SpinGeometry, options: SpinOptions, log: Log, where: str) -> Spin:
    """The rows in which any sensor gave a number."""
    k = len(geometry.accel_r_b_m)
    some = np.asarray(np.isfinite(both.values).any(axis=1))
    if not some.any():
        raise BadSource(f"{where}: no row has a number of any accelerometer; check the columns of --accels")
    if not some.all():
        log.noted(f"spin: {int((~some).sum())} of {len(some)} rows without a number dropped")
    both = both.where(some)
    lost = int((~np.isfinite(both.values)).any(axis=1).sum())
    if lost:
        log.noted(f"spin: {lost} rows lack some sensors; kept as NaN")
    if options.drop_disordered:
        both = rising(both, "spin", log)
    return Spin(both.t_ns, both.values[:, :k], both.values[:, k:], geometry)


def _encoder(table: Table, t_ns: Times, options: SpinOptions, log: Log) -> Encoder | None:
    """Angle and rate of the shaft; what the log lacks of the two is made from the other, and said."""
    angle = _one(table, t_ns, options, "encoder_angle", ANGLES, ANGLE, log)
    rate = _one(table, t_ns, options, "encoder_rate", RATES, RATE, log)
    if angle is None and rate is None:
        return None
    if angle is not None:
        turned = np.unwrap(angle.values[:, 0])
        if not np.array_equal(turned, angle.values[:, 0]):
            log.converted(f"encoder angle unwrapped over {np.ptp(turned) / (2 * np.pi):.1f} turns")
        angle = Series(angle.t_ns, turned[:, None])
    if angle is not None and rate is not None:
        t_ns, at, by = np.intersect1d(angle.t_ns, rate.t_ns, return_indices=True)
        return Encoder(t_ns, angle.values[at, 0], rate.values[by, 0])
    if angle is not None:
        if len(angle.t_ns) < 2:
            raise BadSource(f"{table.where}: one angle of the encoder gives no rate; check its column")
        log.converted("encoder rate: difference of the angle over the step that ends at the stamp")
        steps = np.diff(angle.values[:, 0]) / (np.diff(angle.t_ns) / 1e9)
        return Encoder(angle.t_ns, angle.values[:, 0], np.concatenate([steps[:1], steps]))
    assert rate is not None
    log.converted("encoder angle: integral of the rate from 0 (trapezoidal rule)")
    speed = rate.values[:, 0]
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(rate.t_ns) / 1e9)])
    return Encoder(rate.t_ns, turned, speed)


def _one(
    table: Table, t_ns: Times, options: SpinOptions, what: str, usual: str, units: dict[str, float], log: Log
) -> Series | None:
    text = getattr(options, what)
    if text is None and usual.partition(":")[0] not in table.columns:
        return None
    flag, target = f"--{what.replace('_', '-')}", "rad" if units is ANGLE else "rad/s"
    series = finite(Series(t_ns, _columns(table, text or usual, flag, units, 1, log, target)), what, log)
    if len(series.t_ns) == 0:
        raise BadSource(f"{table.where}: no row has a number for {flag}; check the column")
    return rising(series, what, log) if options.drop_disordered else series
