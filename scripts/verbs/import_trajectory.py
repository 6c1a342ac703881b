"""``stillpoint import trajectory``: put the attitude of another program beside its recording, to be scored."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from stillpoint.datasets import Estimate, write
from stillpoint.datasets.errors import BadParameter, BadSource
from stillpoint.datasets.frames import EulerFrame
from stillpoint.datasets.importers.trajectories import Format, read_trajectory
from stillpoint.datasets.mcap.store import read_recording, sha256
from stillpoint.datasets.recording import Recording
from stillpoint.filters.table import ESTIMATORS
from stillpoint.scripts.shared.output import STDOUT, JsonFile, print_line, write_json

_LEAST_OVERLAP = 0.5  # of the trajectory within the recording; less is another clock


def import_trajectory(
    file: Path,
    /,
    *,
    recording: Path,
    name: str,
    format: Format | None = None,
    time: str | None = None,
    quaternion: str | None = None,
    frame: EulerFrame = "enu",
    inverse: Annotated[bool, Parameter(negative="")] = False,
    topic: str | None = None,
    parent: str | None = None,
    child: str | None = None,
    times: Path | None = None,
    json: JsonFile = None,
) -> None:
    """Put the attitude of another program beside its recording, to be scored.

    Writes NAME.LABEL.estimate.mcap beside NAME.mcap, which score, report and leaderboard find. Stamps must be on the
    clock of the recording.

    Parameters
    ----------
    file
        A trajectory: TUM, KITTI, EuRoC, a table with quaternions, or a bag or MCAP file with poses.
    recording
        The recording that it is of, NAME.mcap.
    name
        How tables call it: letters, digits, - and _.
    format
        tum, kitti, euroc, csv or bag, where the file does not show it.
    time
        csv: column and unit of time, stamp:us (s, ms, us, ns or iso).
    quaternion
        csv: columns of the quaternion, qw,qx,qy,qz.
    frame
        The local frame that the poses lead to: enu, nwu or ned.
    inverse
        The file holds the rotation from the local frame to the body.
    topic
        bag: the topic of the pose, where there are several.
    parent
        bag: the fixed frame.
    child
        bag: the moving frame of a TF topic.
    times
        kitti: the file of stamps, where it is not times.txt beside the poses.
    json
        Also write what was imported as JSON to this file; - is the standard output.
    """
    _check_name(name)
    options: dict[str, Any] = {
        "format": format,
        "time": time,
        "quaternion": quaternion,
        "frame": frame,
        "inverse": inverse,
    }
    options |= {"topic": topic, "parent": parent, "child": child, "times": times}
    of = read_recording(recording)
    made = read_trajectory(file, name=name, **{key: value for key, value in options.items() if value is not None})
    share = _find_overlap(made, of)
    if share < _LEAST_OVERLAP:
        raise BadSource(
            f"{file}: {share:.0%} of its stamps lie within {recording.name} "
            f"({_format_span(made.t_ns)} against {_format_span(of.require_imu().t_ns)}); bring both to one clock first"
        )
    target = recording.with_name(f"{recording.name.removesuffix('.mcap')}.{name}.estimate.mcap")
    made_from = {recording.name: sha256(recording), file.name: sha256(file) if file.is_file() else ""}
    write(target, replace(made, recording=of.name, made_from={key: value for key, value in made_from.items() if value}))
    facts: dict[str, Any] = {"file": str(target), "name": name, "samples": len(made.t_ns), "overlap": share}
    if json != STDOUT:
        print_line(f"{target}: {len(made.t_ns)} attitudes, {share:.0%} of them within the recording")
    write_json(json, [facts])


def _check_name(name: str) -> None:
    """Raise :class:`BadParameter` for a name that is unfit for a file, or that an estimator of ours has."""
    if not name or not all(letter.isalnum() or letter in "-_" for letter in name):
        raise BadParameter(f"--name {name}: give letters, digits, - and _ (it becomes part of a file's name)")
    if name in ESTIMATORS:
        raise BadParameter(f"--name {name}: is an estimator of stillpoint; choose another name")


def _find_overlap(made: Estimate, of: Recording) -> float:
    """Return the share of the stamps that lie within the recording."""
    t_ns = of.require_imu().t_ns
    return float(np.mean((made.t_ns >= t_ns[0]) & (made.t_ns <= t_ns[-1])))


def _format_span(t_ns: Any) -> str:
    return f"{t_ns[0] / 1e9:.3f} to {t_ns[-1] / 1e9:.3f} s"
