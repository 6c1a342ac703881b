"""``stillpoint stream``: estimates while the samples come."""

import importlib.util
import json as json_text
import sys
from collections.abc import Sequence
from math import degrees, radians
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from stillpoint.datasets.earth import local_declination
from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.store import read_recording
from stillpoint.filters import Stream
from stillpoint.filters.heading_source import Heading
from stillpoint.filters.precision import Precision
from stillpoint.filters.saved import plain, rebuilt
from stillpoint.scripts.flags import SetFlag, Whole
from stillpoint.scripts.json_file import STDOUT, JsonFile, write_json
from stillpoint.scripts.pipe import Passed, pipe
from stillpoint.scripts.runs import Run, runs_of
from stillpoint.scripts.text_file import write_text


def stream(
    file: Path | None = None,
    /,
    *,
    estimators: Annotated[str, Parameter(name=["--estimators", "-e"])] = "cf",
    set_: SetFlag = None,
    declination: float | None = None,
    precision: Precision = "double",
    heading: Heading = "mag",
    resume: Annotated[Path | None, Parameter(negative=())] = None,
    save: Annotated[Path | None, Parameter(negative=())] = None,
    foxglove: Annotated[Whole | None, Parameter(negative=())] = None,
    host: str = "127.0.0.1",
    speed: float = 1.0,
    json: JsonFile = None,
) -> None:
    """Estimates while the samples come: NDJSON or CSV on the standard input, NDJSON on the standard output.

    One line out per sample and estimator, flushed at once. Ends with the input, by Ctrl-C, or when the output is
    closed, and says on stderr how long the samples took. Or, with --foxglove, replay a recording to Foxglove.
    docs/streaming.md describes the fields and what becomes of bad samples.

    Parameters
    ----------
    file
        A recording to replay with --foxglove.
    estimators
        Names with commas between: those of attitude that are stillpoint's own.
    set_
        A parameter, ESTIMATOR.NAME=VALUE, heading.NAME=VALUE or range.NAME=VALUE; can be given several times.
    declination
        From true to magnetic north at the place of the run, degrees, east positive; without it, north is magnetic.
    precision
        single: compute in float32, as on a microcontroller.
    heading
        gps-course: from the course in the samples while it is valid, from the magnetometer, calibrated, otherwise.
    resume
        Go on from this file instead of starting; the other options are to be the same.
    save
        Write the state to this file at the end.
    foxglove
        Replay the recording live on this port (0: any that is free) for Foxglove to connect to; needs the extra
        "view".
    host
        Address to listen on for Foxglove; by default this computer alone can connect.
    speed
        How much faster than it was recorded to replay.
    json
        Also write the counts and latencies of the end to this file.
    """
    if json == STDOUT:
        raise BadParameter("--json -: the standard output is for the estimates; name a file")
    runs = runs_of(estimators, set_, precision, heading)
    if foxglove is not None:
        _to_foxglove(file, runs, declination, host, foxglove, speed)
        return
    if file is not None:
        raise BadParameter(f"{file}: a recording is replayed with --foxglove PORT; samples come on the standard input")
    kind = {"runs": [vars(run) for run in runs], "declination_deg": declination}
    streams = _streams(runs, declination, resume, kind)
    passed = pipe(streams, sys.stdin.buffer, sys.stdout)
    if save is not None:
        kept = {name: plain(one.save()) for name, one in streams.items()}
        write_text(save, json_text.dumps({"kind": kind, "states": kept}) + "\n")
    _say(passed, streams)
    write_json(json, [_facts(passed, name, one) for name, one in streams.items()])


def _to_foxglove(
    file: Path | None, runs: Sequence[Run], declination_deg: float | None, host: str, port: int, speed: float
) -> None:
    """Check before the server starts, then replay. Raises :class:`BadParameter`."""
    if file is None:
        raise BadParameter("--foxglove: names no recording; give the MCAP file to replay")
    if not 0 <= port <= 65535:
        raise BadParameter(f"--foxglove {port}: give a port from 1 to 65535, or 0 for any that is free")
    if not 0 < speed < float("inf"):
        raise BadParameter(f"--speed {speed:g}: give a number above 0, 1 for as fast as it was recorded")
    if importlib.util.find_spec("foxglove") is None:
        raise BadParameter("--foxglove: foxglove-sdk is not installed; pip install 'stillpoint[view]'")
    from stillpoint.scripts.foxglove_live import replay

    recording = read_recording(file)
    recording.require_imu()  # before somebody waits for it
    if declination_deg is None:
        declination_deg = degrees(local_declination(recording.info)[0])
    streams = _streams(runs, declination_deg, None, {})
    n_samples = replay(file, recording, streams, host, port, speed)
    print(f"stillpoint: {n_samples} samples replayed", file=sys.stderr)


def _streams(
    runs: Sequence[Run], declination_deg: float | None, resume: Path | None, kind: dict[str, Any]
) -> dict[str, Stream]:
    """One per run, new or gone on with. Raises :class:`BadParameter` for a file of another kind of run."""
    kept = None if resume is None else _kept(resume, kind)
    streams = {}
    for run in runs:
        options: dict[str, Any] = {
            "declination_rad": None if declination_deg is None else radians(declination_deg),
            "precision": run.precision,
            "heading": run.heading,
            "heading_params": run.heading_params,
            "ranges": run.ranges,
        }
        new = Stream(run.estimator, run.params, **options)
        if kept is not None:
            new = Stream(run.estimator, run.params, **options, saved=rebuilt(kept[run.estimator], new.save()))
        streams[run.estimator] = new
    return streams


def _kept(resume: Path, kind: dict[str, Any]) -> dict[str, Any]:
    try:
        kept = json_text.loads(resume.read_text(encoding="utf-8"))
        states, kept_kind = kept["states"], kept["kind"]
    except OSError as error:
        raise BadParameter(f"--resume {resume}: cannot be read ({error.strerror})") from None
    except (ValueError, KeyError, TypeError):
        raise BadParameter(f"--resume {resume}: is no file of stream --save; start without it") from None
    if kept_kind != json_text.loads(json_text.dumps(kind)):
        raise BadParameter(
            f"--resume {resume}: was saved with other options ({json_text.dumps(kept_kind)}); give these"
        )
    return dict(states)


def _say(passed: Passed, streams: dict[str, Stream]) -> None:
    """The summary, on stderr."""
    said = [f"{passed.n_samples} samples, {passed.n_malformed} malformed lines, {passed.ended_by}"]
    for what, latency in (("estimators", passed.update), ("line to line", passed.whole)):
        facts = latency.facts()
        said.append(f"{what}: median {facts['median_us']:.1f}, p99 {facts['p99_us']:.1f}, max {facts['max_us']:.1f} us")
    for name, one in streams.items():
        met = ", ".join(f"{what[2:].replace('_', ' ')} {n}" for what, n in one.counts.items() if n)
        said.append(f"{name} counted: {met or 'nothing'}")
    for text in said:
        print(f"stillpoint: {text}", file=sys.stderr)


def _facts(passed: Passed, name: str, one: Stream) -> dict[str, Any]:
    return {
        "estimator": name,
        "n_samples": passed.n_samples,
        "n_malformed": passed.n_malformed,
        "ended_by": passed.ended_by,
        "counts": one.counts,
        "update": passed.update.facts(),
        "line_to_line": passed.whole.facts(),
    }
