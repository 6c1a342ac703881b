"""CSV files of Movella DOT (Xsens DOT) sensors, and text exports of Xsens MTi and MTw sensors (MT Manager).

DOT: ``SampleTimeFine`` in us, which wraps at 2^32; deg/s, m/s^2; the field in units of about 40 uT; ``Quat_W`` ... .
MT Manager: tabs, comment lines with ``//``, rad/s, ``Quat_q0`` ...; its ``SampleTimeFine`` counts 0.1 ms, and where it
is empty the time is ``PacketCounter`` by the update rate of the header, or ``--rate``. The quaternion takes the sensor
to East-North-Up.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillpoint.datasets.errors import BadParameter, BadSource
from stillpoint.datasets.importers.clock import repair_clock, unwrap_counter
from stillpoint.datasets.importers.columns import RATE
from stillpoint.datasets.importers.delimited import Table, parse
from stillpoint.datasets.importers.device_attitude import read_device_attitude
from stillpoint.datasets.importers.files import hash_files, read_text
from stillpoint.datasets.importers.imported import Imported
from stillpoint.datasets.importers.options import OwnOptions, make_info
from stillpoint.datasets.importers.series import Log, Series, drop_incomplete_rows, sort_by_time
from stillpoint.datasets.importers.xio import scale_arbitrary_field
from stillpoint.datasets.recording import Imu, Recording, Times
from stillpoint.datasets.trajectory import Estimate

_RATE_LINE = re.compile(r"Update Rate:\s*([0-9.]+)\s*Hz", re.IGNORECASE)
_XYZ = "XYZ"
_QUATERNIONS = (tuple(f"Quat_{axis}" for axis in "WXYZ"), tuple(f"Quat_q{k}" for k in range(4)))


@dataclass(frozen=True)
class MovellaOptions(OwnOptions):
    """Options of Movella files."""

    rate: float | None = None  # Hz, where the file has no time


def read_movella(file: Path, options: MovellaOptions) -> Imported:
    """Return the recording of a file. Raises :class:`BadSource`."""
    log, text = Log(), read_text(file)
    table = parse("\n".join(line for line in text.splitlines() if not line.startswith("//")), str(file))
    needed = [f"{what}_{axis}" for what in ("Gyr", "Acc") for axis in _XYZ]
    missing = [name for name in needed if name not in table.columns]
    if missing:
        hint = ""
        if "FreeAcc_X" in table.columns:
            hint = " (FreeAcc is without gravity; log a mode with inertial data)"
        raise BadSource(f"{file}: has no {', '.join(missing)}{hint}; it has {table.listed}")
    manager = "Quat_q0" in table.columns or "//" in text[:2]
    t_ns = _read_time(table, text, manager, options, log)
    unit = "rad/s" if manager else "deg/s"
    log.add_conversion(f"gyro {unit} -> rad/s; accelerometer m/s^2")
    inertial = _read_columns(table, t_ns, tuple(needed), "imu", log)
    imu = Imu(inertial.t_ns, RATE[unit] * inertial.values[:, :3], inertial.values[:, 3:])
    mag, uncalibrated = None, options.mag_uncalibrated
    if all(f"Mag_{axis}" in table.columns for axis in _XYZ):
        series = _read_columns(table, t_ns, tuple(f"Mag_{axis}" for axis in _XYZ), "mag", log)
        mag, uncalibrated = scale_arbitrary_field(series, log)
    sha256 = hash_files([file], file.parent)
    estimates: tuple[Estimate, ...] = ()
    names = next((names for names in _QUATERNIONS if all(name in table.columns for name in names)), None)
    if names is not None:
        attitude = _read_columns(table, t_ns, names, "attitude", log)
        estimates = read_device_attitude(attitude, imu, False, file.stem, names[0].partition("_")[0], sha256, log)
    known = {"sensor": options.sensor or "Movella", "mag_uncalibrated": uncalibrated}
    info = make_info(f"Movella {file.name}", options, imu.t_ns, sha256, log, **known)
    return Imported(Recording(file.stem, imu=imu, mag=mag, info=info), estimates)


def _read_columns(table: Table, t_ns: Times, columns: tuple[str, ...], what: str, log: Log) -> Series:
    """Return columns of the table without incomplete rows, sorted by time; raises :class:`BadSource` for none."""
    series = drop_incomplete_rows(Series(t_ns, table.read_floats(columns)), what, log)
    if len(series.t_ns) == 0:
        raise BadSource(f"{table.where}: no row has numbers in {', '.join(columns)}; log them")
    return sort_by_time(series, what, log)


def _read_time(table: Table, text: str, manager: bool, options: MovellaOptions, log: Log) -> Times:
    """Return the stamps of all rows: SampleTimeFine, or the packet counter by the rate."""
    if options.rate is not None and not options.rate > 0:
        raise BadParameter(f"--rate {options.rate:g}: give a positive number of Hz")
    column = "SampleTimeFine"
    if (
        options.rate is None
        and column in table.columns
        and any(cell.strip() for cell in table.cells(table.place(column)))
    ):
        clock = repair_clock(table.clock(column, "us"), log)
        if not clock.known.all():
            raise BadSource(f"{table.where}: {int((~clock.known).sum())} rows have no {column}; give --rate HZ")
        log.add_conversion(f"time {column} in {'0.1 ms' if manager else 'us'}")
        return np.asarray(clock.t_ns * (100 if manager else 1))
    match = _RATE_LINE.search(text[:4000])
    rate_hz = options.rate or (float(match[1]) if match else None)
    if not rate_hz:
        raise BadParameter(f"{table.where}: has neither {column} nor an update rate; give --rate HZ")
    counter = np.arange(len(table.rows))
    if "PacketCounter" in table.columns:
        packets = table.read_floats(("PacketCounter",))[:, 0]
        if not np.isfinite(packets).all() or (np.abs(packets) > 2**32).any():
            raise BadSource(f"{table.where}: PacketCounter is not a number in every row; remove these rows")
        counter = unwrap_counter(np.asarray(packets, np.int64), "PacketCounter", log)
        counter = counter - counter.min()
    log.add_conversion(f"stamps from the packet counter at {rate_hz:g} Hz")
    return np.asarray(np.round(counter * (1e9 / rate_hz)), dtype=np.int64)
