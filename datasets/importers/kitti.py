"""KITTI raw data: the OXTS unit of a drive, ``oxts/timestamps.txt`` and ``oxts/data/*.txt`` with 30 numbers each.

The unit (RT3003) has x forward, y left, z up; roll, pitch and yaw (0 = east, counter-clockwise) turn it to
East-North-Up, z-y-x. Its attitude is the unit's own solution from this IMU and satellites: the truth of KITTI, but not
an independent one.
"""

from pathlib import Path

import numpy as np

from stillpoint.datasets.earth import enu_m
from stillpoint.datasets.errors import BadSource
from stillpoint.datasets.frames import from_euler
from stillpoint.datasets.importers.clock import ISO, parse_times
from stillpoint.datasets.importers.files import hash_files, read_text, require_existing
from stillpoint.datasets.importers.imported import Imported
from stillpoint.datasets.importers.options import OwnOptions, make_info
from stillpoint.datasets.importers.series import Log, Series, drop_incomplete_rows, make_gps, sort_by_time
from stillpoint.datasets.recording import Imu, Recording, Truth

_NUMBERS = 30
_PLACE, _ANGLES, _NORTH_EAST, _ACCEL, _RATES = slice(0, 3), slice(3, 6), slice(6, 8), slice(11, 14), slice(17, 20)


def find_kitti(source: Path) -> list[Path]:
    """Return the folders ``oxts`` at or below a source. Raises :class:`BadSource`."""
    require_existing(source)
    files = sorted(source.rglob("timestamps.txt")) if source.is_dir() else []
    folders = [file.parent for file in files if (file.parent / "data").is_dir() and _is_oxts(file.parent)]
    if not folders:
        raise BadSource(f"{source}: holds no oxts/timestamps.txt with oxts/data/; name a drive of KITTI's raw data")
    return folders


def _is_oxts(folder: Path) -> bool:
    """Return whether a folder holds samples of OXTS, not scans of the laser."""
    return any((folder / "data").glob("*.txt")) and "velodyne" not in folder.name


def read_kitti(folder: Path, options: OwnOptions) -> Imported:
    """Return the drive of a folder ``oxts``. Raises :class:`BadSource`."""
    log = Log()
    stamps = folder / "timestamps.txt"
    lines = [line for line in read_text(stamps).splitlines() if line.strip()]
    t_ns = parse_times(lines, ISO, str(stamps), list(range(1, len(lines) + 1))).t_ns
    files = sorted((folder / "data").glob("*.txt"))
    if len(files) != len(t_ns):
        raise BadSource(f"{folder}: has {len(t_ns)} stamps and {len(files)} files in data/; download the drive again")
    rows = np.array([_read_numbers(file) for file in files])
    series = sort_by_time(drop_incomplete_rows(Series(t_ns, rows), "oxts", log), "oxts", log)
    t_ns, rows = series.t_ns, series.values
    log.add_conversion(
        "oxts: roll, pitch, yaw (0 = east) -> quaternion, body (x forward, y left, z up) -> East-North-Up"
    )
    log.add_note("truth: the solution of the OXTS unit from this IMU and satellites; it is not independent of them")
    log.add_note("times of KITTI have no zone; taken as UTC")
    lat_deg, lon_deg, alt_m = rows[:, _PLACE].T
    position_n_m = None
    if (np.abs(lat_deg) <= 90).all() and (np.abs(lon_deg) <= 360).all():
        position_n_m = enu_m(lat_deg, lon_deg, alt_m, (lat_deg[0], lon_deg[0], alt_m[0]))
        log.add_conversion("truth position: latitude, longitude, altitude -> East-North-Up from the first fix")
    truth = Truth(t_ns, from_euler(rows[:, _ANGLES], "enu"), np.ones(len(t_ns), dtype=np.bool_), position_n_m)
    north, east = rows[:, _NORTH_EAST].T
    course_deg = np.rad2deg(np.arctan2(east, north)) % 360
    gps = make_gps(Series(t_ns, np.column_stack([rows[:, _PLACE], course_deg, np.hypot(north, east)])), log)
    drive = folder.parent.name or folder.name
    sha256 = hash_files([stamps, *files], folder)
    known = {"sensor": options.sensor or "OXTS RT3003", "extra": {"truth_type": "oxts"}}
    info = make_info(f"KITTI raw data {drive}", options, t_ns, sha256, log, **known)
    return Imported(Recording(drive, imu=Imu(t_ns, rows[:, _RATES], rows[:, _ACCEL]), gps=gps, truth=truth, info=info))


def _read_numbers(file: Path) -> list[float]:
    """Return the numbers of one sample of OXTS; raises :class:`BadSource`."""
    try:
        numbers = [float(cell) for cell in read_text(file).split()]
    except ValueError:
        raise BadSource(f"{file}: holds text, not numbers; download it again") from None
    if len(numbers) != _NUMBERS:
        raise BadSource(f"{file}: has {len(numbers)} numbers, not {_NUMBERS}; download it again")
    return numbers
