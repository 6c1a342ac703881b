"""Recordings of the phone app Sensor Logger: its zip, or the folder of CSV files inside.

Every file has ``time`` (ns since 1970, UTC), ``seconds_elapsed``, and ``z, y, x``. Body: x right, y to the top, z out
of the screen. On iOS accelerations and gravity have the opposite sign, and the uncalibrated ones are in g, unless the
app's "Standardise Units & Frames" was on (the app's pages UNITS, COORDINATES and CROSSPLATFORM).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillpoint.datasets.errors import BadSource
from stillpoint.datasets.importers.bundle import Bundle, open_bundle
from stillpoint.datasets.importers.clock import Log, Series, finite, merge, rising
from stillpoint.datasets.importers.delimited import parse
from stillpoint.datasets.importers.gps import COLUMNS, fixes
from stillpoint.datasets.importers.options import PhoneOptions
from stillpoint.datasets.importers.provenance import own_info
from stillpoint.datasets.importers.units import STANDARD_GRAVITY_MPS2
from stillpoint.datasets.recording import Gps, Mag, Recording

MAG_FILES = {
    "raw": ("MagnetometerUncalibrated.csv", "Magnetometer.csv"),
    "calibrated": ("Magnetometer.csv", "MagnetometerUncalibrated.csv"),
}


@dataclass(frozen=True)
class Phone:
    """What ``Metadata.csv`` says about the device, or the user where it does not."""

    platform: str  # "ios" or "android"
    standardised: bool
    model: str

    @property
    def inverted(self) -> bool:
        """Accelerations point the other way, and raw ones are in g."""
        return self.platform == "ios" and not self.standardised


def read_sensorlogger(source: Path, options: PhoneOptions) -> Iterator[Recording]:
    """The one recording of a zip or folder. Raises :class:`BadSource`."""
    bundle = open_bundle(source)
    log = Log()
    gyro_file = bundle.find("GyroscopeUncalibrated.csv", "Gyroscope.csv")
    if gyro_file is None:
        raise BadSource(
            f"{source}: has no Gyroscope.csv; log the gyroscope, or name the zip or folder of one recording"
        )
    phone = _phone(bundle, options, log)
    gyro = _series(bundle, gyro_file, log)
    log.converted(f"gyro from {gyro_file}, rad/s")
    imu = merge(gyro, _force(bundle, phone, log), str(source), log)
    mag, raw = _mag(bundle, options, log)
    gps = _gps(bundle, log)
    info = own_info(
        "Sensor Logger",
        options,
        imu.t_ns,
        bundle.sha256,
        log,
        sensor=options.sensor or phone.model,
        mag_uncalibrated=raw or options.mag_uncalibrated,
        extra={"platform": phone.platform, "standardised": str(phone.standardised).lower()},
    )
    yield Recording(bundle.name, imu=imu, mag=mag, gps=gps, info=info)


def _phone(bundle: Bundle, options: PhoneOptions, log: Log) -> Phone:
    name = bundle.find("Metadata.csv")
    said: dict[str, str] = {}
    if name is not None:
        table = parse(bundle.texts[name], bundle.where(name), ",")
        said = {column.strip().lower(): cell for column, cell in zip(table.columns, table.rows[0], strict=False)}
    platform = (options.platform or said.get("platform", "")).strip().lower()
    if platform not in ("ios", "android"):
        raise BadSource(
            f"{bundle.source}: no Metadata.csv says whether this is iOS or Android, whose signs differ; "
            "give --platform ios or --platform android"
        )
    if "standardisation" not in said and platform == "ios":
        log.noted("whether units and frames were standardised is not said; taken as off, the app's default")
    standardised = said.get("standardisation", "").strip().lower() == "true"
    return Phone(platform, standardised, said.get("device name", ""))


def _series(bundle: Bundle, name: str, log: Log) -> Series:
    """The x, y, z of a file on its own stamps."""
    table = parse(bundle.texts[name], bundle.where(name), ",")
    series = Series(table.times("time", -9), table.floats(("x", "y", "z")))
    return rising(finite(series, name, log), name, log)


def _force(bundle: Bundle, phone: Phone, log: Log) -> Series:
    """Specific force: the raw one where it was logged, else the total, else motion plus gravity."""
    raw, total = bundle.find("AccelerometerUncalibrated.csv"), bundle.find("TotalAcceleration.csv")
    sign = -1.0 if phone.inverted else 1.0
    if raw is not None:
        series = _series(bundle, raw, log)
        unit = STANDARD_GRAVITY_MPS2 if phone.inverted else 1.0
        log.converted(f"accelerometer from {raw}, " + ("g -> m/s^2 (x 9.80665)" if phone.inverted else "m/s^2"))
        force = Series(series.t_ns, sign * unit * series.values)
    elif total is not None:
        log.converted(f"accelerometer from {total}, m/s^2")
        series = _series(bundle, total, log)
        force = Series(series.t_ns, sign * series.values)
    else:
        force = _motion_and_gravity(bundle, log)
        force = Series(force.t_ns, sign * force.values)
    if phone.inverted:
        log.converted("accelerometer: all signs flipped (iOS reads -1 g on the axis that points up)")
    return force


def _motion_and_gravity(bundle: Bundle, log: Log) -> Series:
    motion_file, gravity_file = bundle.find("Accelerometer.csv"), bundle.find("Gravity.csv")
    if motion_file is None or gravity_file is None:
        raise BadSource(
            f"{bundle.source}: has neither AccelerometerUncalibrated.csv nor TotalAcceleration.csv, nor both of "
            "Accelerometer.csv (which is without gravity) and Gravity.csv; log one of these"
        )
    motion, gravity = _series(bundle, motion_file, log), _series(bundle, gravity_file, log)
    common, at_motion, at_gravity = np.intersect1d(motion.t_ns, gravity.t_ns, return_indices=True)
    lost = len(motion.t_ns) - len(common)
    if len(common) < 2 or lost > 0.5 * len(motion.t_ns):
        raise BadSource(
            f"{bundle.source}: Accelerometer.csv and Gravity.csv share {len(common)} of {len(motion.t_ns)} stamps, "
            "too few to add them; log the uncalibrated accelerometer"
        )
    if lost:
        log.noted(f"accelerometer: {lost} samples without gravity at the same stamp dropped")
    log.converted(f"accelerometer = {motion_file} (without gravity) + {gravity_file}, m/s^2")
    return Series(common, motion.values[at_motion] + gravity.values[at_gravity])


def _mag(bundle: Bundle, options: PhoneOptions, log: Log) -> tuple[Mag | None, bool]:
    """The field, and whether it is the raw one with its hard iron."""
    name = bundle.find(*MAG_FILES[options.mag])
    if name is None:
        log.noted("no magnetometer was logged")
        return None, False
    series = _series(bundle, name, log)
    raw = "uncalibrated" in name.lower()
    log.converted(f"mag from {name}, uT ({'raw, with its hard iron' if raw else 'calibrated by the phone'})")
    return Mag(series.t_ns, series.values), raw


def _gps(bundle: Bundle, log: Log) -> Gps | None:
    name = bundle.find("Location.csv")
    if name is None:
        return None
    table = parse(bundle.texts[name], bundle.where(name), ",")
    return fixes(Series(table.times("time", -9), table.floats(COLUMNS)), log)
