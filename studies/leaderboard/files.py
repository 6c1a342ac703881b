"""Trajectories of other programs beside a recording: ``NAME.LABEL.tum`` beside ``NAME.mcap``.

The suffix may be .tum, .csv, .mcap or .bag; stillpoint's own ``NAME.LABEL.estimate.mcap`` is one of them. Estimates of
estimators in the table are not read: a leaderboard makes those itself. Nor are the tables that ``export`` writes.
"""

from dataclasses import replace
from glob import escape
from pathlib import Path

from stillpoint.datasets.errors import BadRecording
from stillpoint.datasets.importers.trajectories import read_trajectory
from stillpoint.datasets.mcap.store import read_estimate, sha256
from stillpoint.datasets.recording import Recording
from stillpoint.datasets.trajectory import Estimate
from stillpoint.filters.table import ESTIMATORS

_ESTIMATE = ".estimate.mcap"
_EXPORTED = ("imu", "mag", "gps", "spin", "encoder", "truth", "roll_truth", "stream", "reference")  # by the verb export
_SUFFIXES = (_ESTIMATE, ".tum", ".csv", ".mcap", ".bag")  # in the order of preference


def find_files(source: Path) -> dict[str, Path]:
    """Return the trajectory files beside a recording ``NAME.mcap`` by their label."""
    found: dict[str, Path] = {}
    for suffix in _SUFFIXES:
        for file in sorted(source.parent.glob(f"{escape(source.stem)}.*{suffix}")):
            label = file.name.removeprefix(f"{source.stem}.").removesuffix(suffix)
            if label and "." not in label and file.is_file():
                found.setdefault(label, file)
    return {label: file for label, file in found.items() if label not in (*ESTIMATORS, *_EXPORTED)}


def drop_trajectories(sources: list[Path]) -> list[Path]:
    """Drop MCAP files ``NAME.LABEL.mcap`` beside ``NAME.mcap``: these are trajectories, not recordings."""
    taken = {file.resolve() for source in sources for file in find_files(source).values()}
    return [source for source in sources if source.resolve() not in taken]


def find_file(source: Path, label: str) -> Path:
    """Return the trajectory with this label beside a recording; raises :class:`BadRecording` when there is none."""
    file = find_files(source).get(label)
    if file is None:
        raise BadRecording(f"there is no file NAME.{label}.tum, .csv, .mcap or .bag beside NAME.mcap")
    return file


def read_estimate_of(source: Path, label: str, recording: Recording) -> Estimate:
    """Read the trajectory with this label beside a recording.

    Raises :class:`BadRecording` when there is none or it says that it was made from another recording,
    :class:`BadSource` or :class:`BadFile` when it cannot be read.
    """
    file = find_file(source, label)
    made = read_estimate(file) if file.name.endswith(_ESTIMATE) else read_trajectory(file, name=label)
    if made.made_from and sha256(source) not in made.made_from.values():
        raise BadRecording(
            f"{file.name}: was made from another recording than {source.name}; make it again from this one"
        )
    return replace(made, name=label, recording=recording.name)
