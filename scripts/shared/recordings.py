"""A recording as verbs open and describe it: losses of a cut file are printed, rests are those of the reference."""

import sys
from functools import cache
from pathlib import Path

from stillpoint.datasets.doctor.clocks import list_losses
from stillpoint.datasets.mcap.store import read_recording
from stillpoint.datasets.recording import Info, Recording, Times
from stillpoint.scripts.shared.output import print_line


def open_recording(path: Path) -> Recording:
    """Read a recording, and print to stderr what is lost of a file that was cut short."""
    recording = read_recording(path)
    print_losses(path, recording.info)
    return recording


def print_losses(path: Path, info: Info) -> None:
    """Print to stderr, once, what is lost of a recording that was cut short."""
    for loss in list_losses(info):
        _print_once(f"stillpoint: {path}: {loss}")


def find_rests_at_default(recording: Recording) -> Times:
    """Return first and last stamp of each rest (R, 2), as the reference finds them by default.

    Rests while satellites see the body under way are left out: an even course looks like rest to an IMU.
    """
    from stillpoint.smoother import find_rests
    from stillpoint.smoother.attitude.outside.satellite import not_under_way

    return not_under_way(find_rests(recording.require_imu()), recording.gps)


@cache
def _print_once(line: str) -> None:
    print_line(line, file=sys.stderr)
