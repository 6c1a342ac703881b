"""Smartphone trials of the Tyrex team: phones on their own clocks, Qualisys truth at 60 Hz.

T. Michel, P. Geneves, H. Fourati, N. Layaida, "On Attitude Estimation with Smartphones", PerCom 2017. Body: x right,
y to the top, z out of the screen. World: East-North-Up against true north (the authors turn the phones' magnetic
attitudes by the declination to compare them).
"""

import configparser
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from stillpoint.datasets.constants import STANDARD_GRAVITY_MPS2
from stillpoint.datasets.errors import BadSource
from stillpoint.datasets.frames import from_xyzw, quaternion
from stillpoint.datasets.importers.arrays import to_floats
from stillpoint.datasets.importers.files import find_folders, hash_files, read_text, reading
from stillpoint.datasets.importers.imported import Imported, make_device_estimate
from stillpoint.datasets.importers.matlab import load_mat
from stillpoint.datasets.importers.options import TyrexOptions
from stillpoint.datasets.importers.series import (
    Log,
    Series,
    drop_before_zero,
    drop_incomplete_rows,
    merge_imu,
    seconds_to_ns,
    sort_by_time,
)
from stillpoint.datasets.recording import Info, Mag, Recording, Truth
from stillpoint.datasets.trajectory import Estimate

CITATION = (
    "T. Michel, P. Geneves, H. Fourati, N. Layaida: On Attitude Estimation with Smartphones. "
    "IEEE PerCom, 2017. doi:10.1109/PERCOM.2017.7917869"
)
_GRENOBLE = (45.187778, 5.726945, 200.0)  # deg, deg, m: the place in the authors' benchmark code
_NEEDED = ("gyroscope.txt", "accelerometer.txt")
_MAG_FILES = {"raw": "magnetometer.txt", "calibrated": "magnetometer-calibrated.txt"}

# Stretches that the authors of the trials left out of their comparison, marked by hand: seconds of the Qualisys clock,
# from AttitudeBenchmarks.m of their benchmark. In most of them markers were swapped or hidden; in
# Guillaume_Nexus5_NoDist_AR the truth is right and the phone's gyro stopped twice.
_EXCLUDED_S: dict[str, tuple[tuple[float, float], ...]] = {
    "Guillaume_iPhone4S_NoDist_BackPocket": ((21.1, 21.5), (23.6, 24.0)),
    "Guillaume_iPhone5_Dist_FrontPocket": ((65.6, 67.2), (100.4, 102.0)),
    "Guillaume_iPhone5_Dist_Swinging": ((103.5, 104.5),),
    "Guillaume_iPhone5_NoDist_BackPocket": (
        (5.7, 6.1),
        (7.9, 8.5),
        (9.1, 9.6),
        (24.7, 25.3),
        (26.0, 26.5),
        (76.4, 77.3),
    ),
    "Guillaume_Nexus5_Dist_FrontPocket": ((21.2, 21.6),),
    "Guillaume_Nexus5_Dist_Phoning": ((40.5, 40.8),),
    "Guillaume_Nexus5_Dist_Swinging": ((59.7, 60.5), (73.1, 73.5)),
    "Guillaume_Nexus5_NoDist_AR": ((64.0, 120.0),),
    "Jakob_iPhone4S_NoDist_RunningHand": ((34.8, 49.2),),
    "Jakob_iPhone5_NoDist_RunningHand": ((16.0, 17.0), (30.0, 37.5), (39.8, 40.2)),
    "Jakob_Nexus5_Dist_Phoning": ((4.7, 5.6), (91.95, 93.2)),
    "Jakob_Nexus5_Dist_Swinging": ((96.2, 97.5),),
    "Jakob_Nexus5_NoDist_RunningHand": ((36.0, 47.5),),
    "Thibaud_iPhone4S_NoDist_Texting": ((51.4, 51.8),),
    "Thibaud_iPhone5_Dist_AR": ((0.0, 2.5), (65.8, 66.5), (87.1, 87.6)),
    "Thibaud_iPhone5_Dist_FrontPocket": ((52.3, 52.8), (61.2, 61.7)),
    "Thibaud_Nexus5_Dist_FrontPocket": ((40.0, 52.6),),
    "Thibaud_Nexus5_Dist_Phoning": ((10.8, 14.0), (18.0, 19.6), (44.8, 46.4), (87.0, 88.0), (90.4, 91.0)),
    "Thibaud_Nexus5_Dist_Swinging": ((105.45, 105.5),),
    "Thibaud_Nexus5_NoDist_Swinging": ((36.8, 37.2),),
}


def find_tyrex(source: Path) -> list[Path]:
    """Return the trial of a folder ``android/NAME`` or ``ios/NAME``, or all below. Raises :class:`BadSource`."""
    return find_folders(source, _NEEDED[0], "name android/, ios/ or a trial in them")


def read_tyrex(folder: Path, options: TyrexOptions) -> Imported:
    """Return the trial of a folder. Raises :class:`BadSource`."""
    log = Log()
    ios = (folder / "description.txt").is_file()
    boot_s = _read_boot_time(folder / "description.txt") if ios else 0.0
    if boot_s:
        log.add_conversion(f"all phone times minus BootTime {boot_s:.4f} s")
    gyro = _read_series(folder, "gyroscope.txt", boot_s, "gyro", log)
    accel = _read_series(folder, "accelerometer.txt", boot_s, "accelerometer", log)
    if ios:
        accel = Series(accel.t_ns, -STANDARD_GRAVITY_MPS2 * accel.values)
        log.add_conversion(
            "accelerometer g -> m/s^2 (x 9.80665), all signs flipped (iOS: -1 g on the axis that points up)"
        )
    imu = merge_imu(gyro, accel, str(folder), log)
    mag_file = _MAG_FILES[options.mag]
    mag = _read_series(folder, mag_file, boot_s, "mag", log)
    raw = options.mag == "raw"
    log.add_conversion(
        f"mag: {'the raw field with its hard iron' if raw else 'the field calibrated by the phone'} ({mag_file})"
    )
    device = _read_device(folder, ios, boot_s, log)
    truth, truth_file, recorded = _read_truth(folder, log)
    used = [folder / name for name in (*_NEEDED, mag_file)] + ([truth_file] if truth_file else [])
    used += [path for path in (folder / "timeAlignment.txt", folder / "description.txt") if path.is_file()]
    info = Info(
        source="Tyrex benchmark of attitude estimation with smartphones",
        licence="CeCILL 2.1",
        citation=CITATION,
        sensor=folder.name.split("_")[1] if folder.name.count("_") else "",
        date=_read_date(folder) or recorded,
        place_lat_lon_alt=_GRENOBLE,
        mag_uncalibrated=raw,
        units_unchecked=options.units_unchecked,
        sha256=hash_files(used, folder.parent.parent),
        conversions=tuple(log.conversions),
        notes=tuple(log.notes),
        extra={"north": "true", "platform": "iOS" if ios else "Android", **_describe_motion(folder.name)},
    )
    recording = Recording(folder.name, imu=imu, mag=Mag(mag.t_ns, mag.values), truth=truth, info=info)
    return Imported(recording, device)


def _read_device(folder: Path, ios: bool, boot_s: float, log: Log) -> tuple[Estimate, ...]:
    """Return the attitude of the phone's own filter, body to a world with z up; of iOS with x to magnetic north."""
    name = "attitude.txt" if ios else "rotation-vector.txt"
    if not (folder / name).is_file():
        return ()
    series = _read_series(folder, name, boot_s, "attitude of the phone", log, width=5)
    q_nb = series.values if ios else from_xyzw(series.values)
    used = hash_files([folder / name], folder.parent.parent)
    return make_device_estimate(series.t_ns, q_nb, folder.name, name, used, log)


def _describe_motion(name: str) -> dict[str, str]:
    """Return motion and tags of a trial PERSON_DEVICE_Dist_MOTION or PERSON_DEVICE_NoDist_MOTION."""
    words = name.split("_")
    if len(words) != 4 or words[2] not in ("Dist", "NoDist"):
        return {}
    text = f"{'disturbed' if words[2] == 'Dist' else 'undisturbed'} {words[3]}"
    return {"motion": text, "tags": text}


def _read_series(folder: Path, name: str, boot_s: float, what: str, log: Log, width: int = 4) -> Series:
    """Return the first columns of a text file: time and three values, or ``width`` columns in all."""
    path = folder / name
    if not path.is_file():
        raise BadSource(f"{folder}: has no {name}; the trial is not whole: download it again")
    with reading(path, "a text of lines 't x y z'", "download it again"):
        text = read_text(path)
        table = np.loadtxt(text.splitlines(), usecols=range(width), ndmin=2) if text.strip() else np.empty((0, width))
    if len(table) == 0:
        raise BadSource(f"{path}: is empty; download it again")
    series = drop_incomplete_rows(Series(seconds_to_ns(table[:, 0] - boot_s), table[:, 1:]), what, log)
    return drop_before_zero(sort_by_time(series, what, log), what, log)


def _read_truth(folder: Path, log: Log) -> tuple[Truth | None, Path | None, str]:
    """Return the Qualisys attitude on the phone's clock, its file, and its date.

    The phones hardly rest, so every frame with a body counts as moving, but those that the authors leave out.
    """
    path = folder.parent.parent / "qualisys" / f"{folder.name}.mat"
    if not path.is_file():
        log.add_note(f"no truth: there is no qualisys/{path.name} beside the phone's folder")
        return None, None, ""
    with reading(path, "a Qualisys export"):
        motion = next(iter(load_mat(path).values()))
        body = motion["RigidBodies"]
        columns = to_floats(body["Rotations"], f"{path}: Rotations").squeeze()
        position_n_m = to_floats(body["Positions"], f"{path}: Positions").squeeze().T / 1e3
        residual = np.atleast_1d(to_floats(body["Residual"], f"{path}: Residual").squeeze())
        rate_hz = float(motion["FrameRate"].squeeze())
        recorded = str(motion["Timestamp"])[:10]
    if not 1.0 <= rate_hz <= 1e4:
        raise BadSource(f"{path}: its FrameRate is {rate_hz:g} Hz; download it again")
    late_s = _read_alignment(folder / "timeAlignment.txt")
    if columns.ndim != 2 or len(columns) != 9:
        raise BadSource(
            f"{path}: holds rotations of shape {columns.shape}, not 9 x frames of one body; export one body"
        )
    frame_s = np.arange(columns.shape[1]) / rate_hz
    if len(residual) != len(frame_s) or position_n_m.shape != (len(frame_s), 3):
        raise BadSource(f"{path}: positions or residuals are not one per frame; download it again")
    seen = np.isfinite(columns).all(axis=0) & np.isfinite(residual)
    seen[seen] = np.linalg.det(columns.T[seen].reshape(-1, 3, 3)) > 0.5  # a frame without body may hold zeros
    log.add_note(f"truth: {int((~seen).sum())} of {len(seen)} frames have no body (gaps)")
    scored = np.ones(len(seen), dtype=np.bool_)
    for start, end in _EXCLUDED_S.get(folder.name, ()):
        scored &= (frame_s < start) | (frame_s > end)
    if not scored.all():
        log.add_note(
            f"truth: {int((~scored & seen).sum())} frames are not scored: the dataset's authors leave them out"
        )
    t_ns = seconds_to_ns(frame_s - late_s)
    early = t_ns < 0
    if early.any():
        log.add_note(f"truth: {int(early.sum())} frames before the zero of the phone's clock dropped")
    keep = seen & ~early
    rotations = columns.T.reshape(-1, 3, 3).transpose(0, 2, 1)[keep]  # stored column by column
    log.add_conversion(f"truth time = frame / {rate_hz:g} Hz - timeAlignment ({late_s:g} s); given on a 10 ms grid")
    log.add_conversion("truth rotation matrix (body -> East-North-Up) -> quaternion; positions mm -> m")
    q_nb = quaternion(Rotation.from_matrix(rotations))
    truth = Truth(t_ns[keep], q_nb, scored[keep], position_n_m[keep])
    return truth, path, recorded


def _read_boot_time(path: Path) -> float:
    """Return the Unix time in s at which the phone was started; raises :class:`BadSource`."""
    try:
        return float(_read_properties(path)["Time"]["BootTime"])
    except (KeyError, ValueError):
        raise BadSource(f"{path}: has no number BootTime in [Time]; download it again") from None


def _read_alignment(path: Path) -> float:
    """Return the offset in s between the clocks of truth and phone; raises :class:`BadSource`."""
    if not path.is_file():
        raise BadSource(f"{path}: is missing, and without it the truth cannot be put on the phone's clock; download it")
    try:
        return float(read_text(path))
    except ValueError:
        raise BadSource(f"{path}: holds no number of seconds; download it again") from None


def _read_properties(path: Path) -> configparser.ConfigParser:
    """Return the properties that the app wrote; raises :class:`BadSource`."""
    parser = configparser.ConfigParser()
    try:
        parser.read_string(read_text(path))
    except (configparser.Error, UnicodeDecodeError):
        raise BadSource(f"{path}: is not a file of [Section] and Key = Value; download it again") from None
    return parser


def _read_date(folder: Path) -> str:
    """Return the UTC day of an Android record, "" where none is written."""
    path = folder / "record.properties"
    start = _read_properties(path).get("Time", "StartTime", fallback="") if path.is_file() else ""
    return datetime.fromtimestamp(int(start), UTC).date().isoformat() if start.isdigit() else ""
