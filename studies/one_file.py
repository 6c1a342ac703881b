"""A recording, its reference, estimates and their errors as one MCAP file, with a layout for Foxglove.

Any reader of MCAP opens it; :func:`stillpoint.datasets.read` gives the recording in it. Topics of an estimate begin
with ``/estimate/NAME/``; ``/error/NAME`` holds total, heading and inclination error in degrees.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from stillpoint.datasets.errors import StillpointError
from stillpoint.datasets.mcap.file import write_file
from stillpoint.datasets.mcap.store import make_contents
from stillpoint.datasets.mcap.topics import VECTOR
from stillpoint.datasets.mcap.writer import Stream, write_mcap
from stillpoint.datasets.recording import Recording, Truth
from stillpoint.datasets.trajectory import Estimate, Reference, SpinReference
from stillpoint.scoring import compare
from stillpoint.scoring.errors import compute_attitude_error

_LAYOUT_SUFFIX = ".foxglove.json"


def write_one_file(
    path: Path, recording: Recording, reference: Reference | SpinReference | None, estimates: Sequence[Estimate]
) -> dict[str, str]:
    """Write ``path`` and, beside it, ``NAME.foxglove.json``; returns why an estimate has no error, by its name.

    Errors are against the truth of the recording, or else against the reference, with the heading aligned. Raises
    :class:`~stillpoint.datasets.errors.BadFile` when a file cannot be written.
    """
    streams, record = make_contents(recording)
    records = {"stillpoint": record}
    if reference is not None:
        more, record = make_contents(reference)
        streams += [replace(stream, group="reference") for stream in more]
        records["stillpoint reference"] = record
    reasons: dict[str, str] = {}
    for estimate in estimates:
        more, record = make_contents(estimate)
        streams += [_name_by_estimator(stream, estimate.name) for stream in more]
        records[f"stillpoint estimate {estimate.name}"] = record
        judge = recording.truth or (reference if isinstance(reference, Reference) else None)
        if estimate.q_nb is None or judge is None:
            reasons[estimate.name] = "nothing judges it"
            continue
        try:
            streams.append(_make_error_stream(estimate, judge))
        except StillpointError as error:
            reasons[estimate.name] = str(error)
    write_mcap(path, streams, records, {})
    layout = make_layout([stream.topic for stream in streams])
    with write_file(path.with_name(path.name.removesuffix(".mcap") + _LAYOUT_SUFFIX)) as file:
        file.write((json.dumps(layout, indent=1) + "\n").encode())
    return reasons


def _name_by_estimator(stream: Stream, name: str) -> Stream:
    """Return the messages of an estimate on topics with the name of its estimator."""
    return replace(stream, topic=stream.topic.replace("/estimate/", f"/estimate/{name}/", 1), group=f"estimate {name}")


def _make_error_stream(estimate: Estimate, judge: Truth | Reference) -> Stream:
    """Return the errors of an estimate at the stamps of its judge, in degrees."""
    compared = compare(estimate, judge)
    found = compute_attitude_error(compared.q_est, compared.q_true)
    angles = {"vector.x": found.total_rad, "vector.y": found.heading_rad, "vector.z": found.inclination_rad}
    holds = f"x: total, y: heading, z: inclination error in degrees, against the {compared.against}, heading aligned"
    columns = {leaf: np.rad2deg(values) for leaf, values in angles.items()}
    return Stream(f"/error/{estimate.name}", VECTOR, compared.t_ns, columns, {}, {"holds": holds}, "errors")


def make_layout(topics: Sequence[str]) -> dict[str, Any]:
    """Return a layout for Foxglove: the attitudes in 3D, and plots of the errors, the gyro and the field."""
    errors = [topic for topic in topics if topic.startswith("/error/")]
    poses = [topic for topic in topics if topic.endswith("/pose")]
    plots = [
        _make_plot("error, deg", [f"{topic}.vector.x" for topic in errors]),
        _make_plot("heading error, deg", [f"{topic}.vector.y" for topic in errors]),
        _make_plot("inclination error, deg", [f"{topic}.vector.z" for topic in errors]),
        _make_plot("gyro, rad/s", [f"/imu/data_raw.angular_velocity.{axis}" for axis in "xyz"]),
    ]
    if "/imu/mag" in topics:
        plots.append(_make_plot("field, T", [f"/imu/mag.magnetic_field.{axis}" for axis in "xyz"]))
    kept = [plot for plot in plots if plot["paths"]]
    panels: dict[str, Any] = {f"Plot!{k}": plot for k, plot in enumerate(kept)}
    panels["3D!poses"] = {
        "followMode": "follow-none",
        "fixedFrame": "map",
        "topics": {topic: {"visible": True, "type": "axis", "axisScale": 1.0} for topic in poses},
    }
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {"direction": "row", "first": "3D!poses", "second": _stack(list(panels)[:-1]), "splitPercentage": 35},
    }


def _make_plot(title: str, paths: Sequence[str]) -> dict[str, Any]:
    """Return a panel of Foxglove's layout that plots these paths."""
    series = [{"value": path, "enabled": True, "timestampMethod": "receiveTime"} for path in paths]
    return {"title": title, "paths": series, "showLegend": True, "isSynced": True, "xAxisVal": "timestamp"}


def _stack(panels: Sequence[str]) -> str | Mapping[str, Any]:
    """Return panels one below the other, all of one height."""
    if len(panels) == 1:
        return panels[0]
    below = _stack(panels[1:])
    return {"direction": "column", "first": panels[0], "second": below, "splitPercentage": 100 / len(panels)}
