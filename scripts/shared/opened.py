"""A recording as verbs open it: what a cut file lacks is said on stderr, and not only noted in the recording."""

import sys
from functools import cache
from pathlib import Path

from stillpoint.datasets.doctor.whole import losses
from stillpoint.datasets.mcap.store import read_recording
from stillpoint.datasets.recording import Recording


def open_recording(path: Path) -> Recording:
    """As :func:`~stillpoint.datasets.mcap.store.read_recording`, and says what is lost of a file that was cut short."""
    recording = read_recording(path)
    for loss in losses(recording):
        _say_once(f"stillpoint: {path}: {loss}")
    return recording


@cache
def _say_once(line: str) -> None:
    print(line, file=sys.stderr)
