"""Recordings of the phone app Sensor Logger: its zip, or the folder of CSV files inside.

Every file has ``time`` (ns since 1970, UTC), ``seconds_elapsed``, and ``z, y, x``. Body: x right, y to the top, z out
of the screen. On iOS accelerations and gravity have the opposite sign, and the uncalibrated ones are in g, unless the
app's "Standardise Units & Frames" was on (the app's pages UNITS, COORDINATES and CROSSPLATFORM).
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from stillpoint.datasets.constants import STANDARD_GRAVITY_MPS2
from stillpoint.datasets.errors import BadParameter, BadSource
from stillpoint.datasets.importers.delimited import parse
from stillpoint.datasets.importers.device_attitude import read_device_attitude
from stillpoint.datasets.importers.files import Bundle, open_bundle
from stillpoint.datasets.importers.imported import Imported, make_mag
from stillpoint.datasets.importers.options import PhoneOptions, make_info
from stillpoint.datasets.importers.series import Log, Series, drop_incomplete_rows, make_gps, merge_imu, sort_by_time
from stillpoint.datasets.recording import Gps, Mag, Recording
from stillpoint.datasets.trajectory import Estimate

_GYRO_FILES = ("GyroscopeUncalibrated.csv", "Gyroscope.csv")
_ACCEL_FILES = ("AccelerometerUncalibrated.csv", "TotalAcceleration.csv", "Accelerometer.csv", "Gravity.csv")
_GPS_COLUMNS = ("latitude", "longitude", "altitude", "bearing", "speed")
_MAG_FILES = {
    "raw": ("MagnetometerUncalibrated.csv", "Magnetometer.csv"),
    "calibrated": ("Magnetometer.csv", "MagnetometerUncalibrated.csv"),
}


@dataclass(frozen=True)
class _Phone:
    """The device as ``Metadata.csv`` describes it, or the user where it does not."""

    platform: str  # "ios" or "android"
    standardised: bool
    model: str

    @property
    def inverted(self) -> bool:
        """Accelerations point the other way, and raw ones are in g."""
        return self.platform == "ios" and not self.standardised


def read_sensorlogger(source: Path, options: PhoneOptions) -> Imported:
    """Return the one recording of a zip or folder. Raises :class:`BadSource`."""
    bundle = open_bundle(source)
    log = Log()
    empty = bundle.find_empty(*_GYRO_FILES, *_ACCEL_FILES, *_MAG_FILES["raw"])
    if empty:
        log.add_note(f"{', '.join(empty)}: empty in the export; the next file of the same sensor is taken")
    gyro_file = bundle.find(*_GYRO_FILES)
    if gyro_file is None:
        raise BadSource(
            f"{source}: has no Gyroscope.csv; log the gyroscope, or name the zip or folder of one recording"
        )
    phone = _read_phone(bundle, options, log)
    gyro = _read_series(bundle, gyro_file, log)
    log.add_conversion(f"gyro from {gyro_file}, rad/s")
    imu = merge_imu(gyro, _read_force(bundle, phone, log), str(source), log)
    mag, uncalibrated = _read_mag(bundle, options, log)
    gps = _read_gps(bundle, log)
    info = make_info(
        "Sensor Logger",
        options,
        imu.t_ns,
        bundle.sha256,
        log,
        sensor=options.sensor or phone.model,
        mag_uncalibrated=uncalibrated,
        extra={"platform": phone.platform, "standardised": str(phone.standardised).lower()},
    )
    estimates: tuple[Estimate, ...] = ()
    if (attitude := _read_attitude(bundle, log)) is not None:
        estimates = read_device_attitude(attitude, imu, False, bundle.name, "Orientation.csv", bundle.sha256, log)
        info = replace(info, conversions=tuple(log.conversions), notes=tuple(log.notes))
    return Imported(Recording(bundle.name, imu=imu, mag=mag, gps=gps, info=info), estimates)


def _read_phone(bundle: Bundle, options: PhoneOptions, log: Log) -> _Phone:
    """Return platform and settings of the app; raises :class:`BadSource` where nothing states the platform."""
    name = bundle.find("Metadata.csv")
    metadata: dict[str, str] = {}
    if name is not None:
        table = parse(bundle.texts[name], bundle.where(name), ",")
        metadata = {column.strip().lower(): cell for column, cell in zip(table.columns, table.rows[0], strict=False)}
    logged = metadata.get("platform", "").strip().lower()
    platform = options.platform or logged
    if options.platform is not None and logged in ("ios", "android") and logged != options.platform:
        raise BadParameter(
            f"--platform {options.platform}: Metadata.csv of {bundle.source} says {logged}; leave it out"
        )
    if platform not in ("ios", "android"):
        raise BadSource(
            f"{bundle.source}: no Metadata.csv says whether this is iOS or Android, whose signs differ; "
            "give --platform ios or --platform android"
        )
    if "standardisation" not in metadata and platform == "ios":
        log.add_note(
            "Metadata.csv does not state whether units and frames were standardised; taken as off, the app's default"
        )
    standardised = metadata.get("standardisation", "").strip().lower() == "true"
    return _Phone(platform, standardised, metadata.get("device name", ""))


def _read_series(bundle: Bundle, name: str, log: Log) -> Series:
    """Return x, y, z of a file on its own stamps."""
    table = parse(bundle.texts[name], bundle.where(name), ",")
    series = Series(table.times("time", "ns"), table.read_floats(("x", "y", "z")))
    return sort_by_time(drop_incomplete_rows(series, name, log), name, log)


def _read_force(bundle: Bundle, phone: _Phone, log: Log) -> Series:
    """Return the specific force: the raw one where it was logged, else the total, else motion plus gravity."""
    raw, total = bundle.find("AccelerometerUncalibrated.csv"), bundle.find("TotalAcceleration.csv")
    sign = -1.0 if phone.inverted else 1.0
    if raw is not None:
        series = _read_series(bundle, raw, log)
        unit = STANDARD_GRAVITY_MPS2 if phone.inverted else 1.0
        log.add_conversion(f"accelerometer from {raw}, " + ("g -> m/s^2 (x 9.80665)" if phone.inverted else "m/s^2"))
        force = Series(series.t_ns, sign * unit * series.values)
    elif total is not None:
        log.add_conversion(f"accelerometer from {total}, m/s^2")
        series = _read_series(bundle, total, log)
        force = Series(series.t_ns, sign * series.values)
    else:
        force = _add_gravity(bundle, log)
        force = Series(force.t_ns, sign * force.values)
    _check_platform(force, raw is not None, phone, str(bundle.source))
    if phone.inverted:
        log.add_conversion("accelerometer: all signs flipped (iOS reads -1 g on the axis that points up)")
    return force


def _check_platform(force: Series, raw: bool, phone: _Phone, where: str) -> None:
    """Raise :class:`BadSource` where the size of the raw specific force fits the units of the other platform."""
    usual_mps2 = float(np.median(np.linalg.norm(force.values, axis=1))) if len(force.values) else np.nan
    factor = STANDARD_GRAVITY_MPS2 if phone.inverted else 1.0 / STANDARD_GRAVITY_MPS2
    if raw and abs(usual_mps2 / factor - STANDARD_GRAVITY_MPS2) < 1.5 and abs(usual_mps2 - STANDARD_GRAVITY_MPS2) > 1.5:
        other = "android, or an iOS log with standardised units" if phone.inverted else "ios"
        raise BadSource(
            f"{where}: the accelerometer has a median of {usual_mps2:.4g} m/s^2 when read as {phone.platform}; "
            f"this looks like {other}: check --platform"
        )


def _add_gravity(bundle: Bundle, log: Log) -> Series:
    """Return the sum of acceleration without gravity and gravity, where their stamps agree."""
    motion_file, gravity_file = bundle.find("Accelerometer.csv"), bundle.find("Gravity.csv")
    if motion_file is None or gravity_file is None:
        raise BadSource(
            f"{bundle.source}: has neither AccelerometerUncalibrated.csv nor TotalAcceleration.csv, nor both of "
            "Accelerometer.csv (which is without gravity) and Gravity.csv; log one of these"
        )
    motion, gravity = _read_series(bundle, motion_file, log), _read_series(bundle, gravity_file, log)
    common, at_motion, at_gravity = np.intersect1d(motion.t_ns, gravity.t_ns, return_indices=True)
    lost = len(motion.t_ns) - len(common)
    if len(common) < 2 or lost > 0.5 * len(motion.t_ns):
        raise BadSource(
            f"{bundle.source}: Accelerometer.csv and Gravity.csv share {len(common)} of {len(motion.t_ns)} stamps, "
            "too few to add them; log the uncalibrated accelerometer"
        )
    if lost:
        log.add_note(f"accelerometer: {lost} samples without gravity at the same stamp dropped")
    log.add_conversion(f"accelerometer = {motion_file} (without gravity) + {gravity_file}, m/s^2")
    return Series(common, motion.values[at_motion] + gravity.values[at_gravity])


def _read_mag(bundle: Bundle, options: PhoneOptions, log: Log) -> tuple[Mag | None, bool]:
    """Return the field, and whether its size has no meaning, as for a raw field with its hard iron."""
    name = bundle.find(*_MAG_FILES[options.mag])
    if name is None:
        log.add_note("no magnetometer was logged")
        return None, options.mag_uncalibrated
    try:
        series = _read_series(bundle, name, log)
    except BadSource as error:
        log.add_note(f"mag left out: {error}")
        return None, options.mag_uncalibrated
    raw = "uncalibrated" in name.lower()
    log.add_conversion(f"mag from {name}, uT ({'raw, with its hard iron' if raw else 'calibrated by the phone'})")
    return make_mag(series, raw or options.mag_uncalibrated, log)


def _read_attitude(bundle: Bundle, log: Log) -> Series | None:
    """Return the attitude (N, 4) wxyz that the phone computed; None where it was not logged or cannot be read."""
    name = bundle.find("Orientation.csv")
    if name is None:
        return None
    try:
        table = parse(bundle.texts[name], bundle.where(name), ",")
        series = Series(table.times("time", "ns"), table.read_floats(("qw", "qx", "qy", "qz")))
    except BadSource as error:
        log.add_note(f"attitude left out: {error}")
        return None
    return sort_by_time(drop_incomplete_rows(series, name, log), name, log)


def _read_gps(bundle: Bundle, log: Log) -> Gps | None:
    """Return the fixes of ``Location.csv``; None without it."""
    name = bundle.find("Location.csv")
    if name is None:
        return None
    table = parse(bundle.texts[name], bundle.where(name), ",")
    return make_gps(Series(table.times("time", "ns"), table.read_floats(_GPS_COLUMNS)), log)
