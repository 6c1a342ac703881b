"""BROAD, the Berlin benchmark for robust inertial orientation estimation: .mat and .hdf5 trials.

D. Laidig, M. Caruso, A. Cereatti, T. Seel, Data 6(7):72, 2021. The IMU and the optical truth share one clock and one
frame (East-North-Up, magnetic north), so a trial needs no change of unit or frame.
"""

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from stillpoint.datasets.errors import BadSource
from stillpoint.datasets.importers.arrays import read_array, to_floats
from stillpoint.datasets.importers.files import hash_files, reading, require_existing
from stillpoint.datasets.importers.imported import Imported
from stillpoint.datasets.importers.matlab import load_mat
from stillpoint.datasets.importers.options import Options
from stillpoint.datasets.importers.series import Log, find_finite_rows
from stillpoint.datasets.plausible import FIELD_RANGE_UT
from stillpoint.datasets.recording import Floats, Imu, Info, Mag, Recording, Truth

_FIELDS = {"imu_gyr": 3, "imu_acc": 3, "imu_mag": 3, "opt_quat": 4, "opt_pos": 3, "movement": 1, "sampling_rate": 1}
CITATION = (
    "D. Laidig, M. Caruso, A. Cereatti, T. Seel: BROAD - A Benchmark for Robust Inertial Orientation Estimation. "
    "Data 6(7):72, 2021. doi:10.3390/data6070072"
)


def find_broad(source: Path) -> list[Path]:
    """Return a trial, or the trials of a folder in the order of their names. Raises :class:`BadSource`."""
    require_existing(source)
    files = sorted([*source.glob("*.mat"), *source.glob("*.hdf5")]) if source.is_dir() else [source]
    if not files:
        raise BadSource(f"{source}: holds no .mat or .hdf5 trial; name BROAD's folder data_mat or data_hdf5")
    return files


def read_broad(file: Path, options: Options) -> Imported:
    """Return the trial of a file. Raises :class:`BadSource`."""
    fields = _read_fields(file)
    log = Log()
    rate_hz = float(fields["sampling_rate"].squeeze())
    if not 1.0 <= rate_hz <= 1e5:
        raise BadSource(f"{file}: its sampling_rate is {rate_hz:g} Hz; download it again")
    # 285.714 Hz is 3.5 ms; the file's rounded rate would drift by ns, so that the period is what is rounded.
    period_ns = round(1e9 / rate_hz)
    t_ns = np.arange(len(fields["imu_gyr"]), dtype=np.int64) * period_ns
    q_nb = fields["opt_quat"]
    known = find_finite_rows(q_nb) & (np.linalg.norm(q_nb, axis=1) > 0.5)
    if not known.all():
        log.add_note(f"truth: {int((~known).sum())} of {len(known)} samples are NaN in the source (gaps)")
    q_nb = q_nb[known] / np.linalg.norm(q_nb[known], axis=1, keepdims=True)
    moving = fields["movement"].squeeze().astype(bool)[known]
    truth = Truth(t_ns[known], q_nb, moving, fields["opt_pos"][known])
    field_ut = float(np.median(np.linalg.norm(fields["imu_mag"], axis=1)))
    disturbed = not FIELD_RANGE_UT[0] <= field_ut <= FIELD_RANGE_UT[1]
    if disturbed:
        log.add_note(f"mag: median size {field_ut:.0f} uT is not the Earth's; marked as uncalibrated")
    log.add_conversion("stamps from the sampling rate: sample k at k x %.6f ms" % (period_ns / 1e6))
    extra, described = _read_description(file)
    info = Info(
        source="BROAD",
        licence="CC BY 4.0",
        citation=CITATION,
        sensor="myon aktos-t (truth: OptiTrack, eight Flex 13 cameras)",
        mag_uncalibrated=disturbed,
        units_unchecked=options.units_unchecked,
        sha256=hash_files([file, *described], file.parent),
        conversions=tuple(log.conversions),
        notes=tuple(log.notes),
        extra={"north": "magnetic", **extra},
    )
    imu = Imu(t_ns, fields["imu_gyr"], fields["imu_acc"])
    return Imported(Recording(file.stem, imu=imu, mag=Mag(t_ns, fields["imu_mag"]), truth=truth, info=info))


def _read_fields(file: Path) -> dict[str, Floats]:
    """Return the arrays of one trial; a value may stand as a dataset or as an attribute."""
    raw: dict[str, Any]
    with reading(file, "a BROAD trial"):
        if file.suffix == ".hdf5":
            with h5py.File(file) as trial:
                raw = {key: read_array(trial[key], file) for key in _FIELDS if key in trial}
                raw |= {key: trial.attrs[key] for key in _FIELDS if key in trial.attrs}
        else:
            raw = {key: value for key, value in load_mat(file).items() if key in _FIELDS}
    missing = [key for key in _FIELDS if key not in raw]
    if missing:
        raise BadSource(
            f"{file}: has no {', '.join(missing)}; it is not a BROAD trial: name one of data_mat or data_hdf5"
        )
    fields = {key: to_floats(value, f"{file}: {key}") for key, value in raw.items()}
    n = len(fields["imu_gyr"])
    for key, width in _FIELDS.items():
        wanted = 1 if key == "sampling_rate" else n * width
        if fields[key].size != wanted:
            raise BadSource(f"{file}: {key} has {fields[key].size} values, not {wanted}; download it again")
        if width > 1 and fields[key].shape != (n, width):
            raise BadSource(f"{file}: {key} has the shape {fields[key].shape}, not {(n, width)}; download it again")
    return fields


def _read_description(file: Path) -> tuple[dict[str, str], list[Path]]:
    """Return what ``trials.json`` beside the file says about this trial, if it is there."""
    path = file.with_name("trials.json")
    if not path.is_file():
        return {}, []
    with reading(path, "BROAD's list of trials", "remove it or download it again"):
        trial = json.loads(path.read_text(encoding="utf-8"))["trials"].get(file.stem, {})
        extra = {"description": str(trial.get("description", "")), "groups": " ".join(trial.get("groups", []))}
    return {key: value for key, value in extra.items() if value}, [path]
