"""A recording as verbs open and describe it: its losses are printed, its rests and calibration are the reference's."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

from stillpoint.datasets.calibration.apply import SensorCalibration, get_calibration, load_calibration
from stillpoint.datasets.mcap.store import read_recording, read_reference
from stillpoint.datasets.recording import Info, Recording, Times
from stillpoint.scripts.shared.output import print_line


def open_recording(path: Path) -> Recording:
    """Read a recording, and print to stderr what is lost of a file that was cut short."""
    recording = read_recording(path)
    print_losses(path, recording.info)
    return recording


def print_losses(path: Path, info: Info) -> None:
    """Print to stderr, once, what is lost of a recording that was cut short."""
    if not info.notes:
        return
    from stillpoint.datasets.doctor.clocks import list_losses  # only here: the doctor's tests take long to import

    for loss in list_losses(info):
        _print_once(f"stillpoint: {path}: {loss}")


def find_rests_at_default(recording: Recording) -> Times:
    """Return first and last stamp of each rest (R, 2), as the reference finds them by default.

    Rests while satellites see the body under way are left out: an even course looks like rest to an IMU.
    """
    from stillpoint.smoother import find_rests
    from stillpoint.smoother.attitude.outside.satellite import drop_rests_under_way

    return drop_rests_under_way(find_rests(recording.require_imu()), recording.gps)


def list_references(source: Path, folders: Sequence[Path]) -> list[Path]:
    """Return the files of some folders that are references of a recording by their name."""
    files = dict.fromkeys(folder / f"{source.stem}.reference.mcap" for folder in folders)
    return [file for file in files if file.is_file()]


def find_calibration(
    calibration: str, recording: Recording, source: Path, sha256: str, folders: Sequence[Path]
) -> SensorCalibration | None:
    """Return what ``--calibration`` names: nothing for ``"none"``, else what to correct the recording by.

    For ``"reference"`` that is the recording's own reference: one of the folders, if it was made from a recording of
    this sha256, otherwise one that is made here. Anything else is a file with a calibration. Raises
    :class:`BadParameter` where there is no such file, :class:`Unobservable` where there can be no reference.
    """
    if calibration == "none":
        return None
    if calibration != "reference":
        return load_calibration(Path(calibration))
    for file in list_references(source, folders):
        if sha256 in read_reference(file).made_from.values():
            return load_calibration(file)
    from stillpoint.smoother import attitude_reference

    return get_calibration(replace(attitude_reference(recording), made_from={source.name: sha256}))


@cache
def _print_once(line: str) -> None:
    print_line(line, file=sys.stderr)
