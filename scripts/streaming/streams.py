"""The streams of ``stillpoint stream``, new or from a file of ``--save``, and the samples of a recording for them."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from math import radians
from pathlib import Path
from typing import Any

from stillpoint.datasets import Recording
from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.recording import Head, SpinGeometry
from stillpoint.filters import Saved, SavedSpin, SpinStream, Stream
from stillpoint.filters.front.front import RawLog
from stillpoint.filters.front.sources import RawLogs, plan_heading
from stillpoint.filters.saved import from_plain, to_plain
from stillpoint.scripts.shared.estimator_choice import Run
from stillpoint.scripts.shared.output import write_text
from stillpoint.scripts.streaming.lines import Arrival

Live = Stream | SpinStream
Make = Callable[..., Any]  # of a stream


def make_attitude_stream(run: Run, declination_deg: float | None) -> Callable[..., Stream]:
    """Return a function that makes a stream of attitude, new or from a saved state."""
    return partial(
        Stream,
        run.estimator,
        run.params,
        declination_rad=None if declination_deg is None else radians(declination_deg),
        precision=run.precision,
        heading=run.heading,
        heading_params=run.heading_params,
        ranges=run.ranges,
    )


def make_spin_stream(run: Run, geometry: SpinGeometry) -> Callable[..., SpinStream]:
    """Return a function that makes a spin stream, new or from a saved state."""
    return partial(SpinStream, run.estimator, geometry, run.params, run.precision)


def describe_run(runs: Sequence[Run], declination_deg: float | None, geometry: SpinGeometry | None) -> dict[str, Any]:
    """Return the options that must be the same to continue from a saved state."""
    kind: dict[str, Any] = {"runs": [vars(run) for run in runs], "declination_deg": declination_deg}
    if geometry is not None:
        kind["geometry"] = {name: to_plain(value) for name, value in vars(geometry).items()}
    return kind


def open_streams(makes: Mapping[str, Make], resume: Path | None, kind: Mapping[str, Any]) -> dict[str, Live]:
    """Make one stream each, new or from a saved state. Raises :class:`BadParameter` for a file of other options."""
    if resume is None:
        return {name: make() for name, make in makes.items()}
    kept = _read_saved(resume, kind)
    missing = [name for name in makes if name not in kept]
    if missing:
        raise BadParameter(f"--resume {resume}: holds no state of {', '.join(missing)}; start without it")
    try:
        return {name: make(saved=from_plain(kept[name], make().save())) for name, make in makes.items()}
    except OverflowError as error:
        raise BadParameter(f"--resume {resume}: holds a number that no state has ({error}); start without it") from None


def save_streams(save: Path, streams: Mapping[str, Live], kind: Mapping[str, Any]) -> None:
    """Write the file from which :func:`open_streams` continues."""
    states: dict[str, Saved | SavedSpin] = {name: one.save() for name, one in streams.items()}
    kept = {name: to_plain(state) for name, state in states.items()}
    write_text(save, json.dumps({"kind": kind, "states": kept}) + "\n")


def _read_saved(resume: Path, kind: Mapping[str, Any]) -> dict[str, Any]:
    """Return the states that an earlier run saved; raises :class:`BadParameter` where the options differ."""
    try:
        kept = json.loads(resume.read_text(encoding="utf-8"))
        states, kept_kind = dict(kept["states"]), kept["kind"]
    except OSError as error:
        raise BadParameter(f"--resume {resume}: cannot be read ({error.strerror}); check the name") from None
    except (ValueError, KeyError, TypeError, RecursionError):
        raise BadParameter(f"--resume {resume}: was not written by stream --save; start without it") from None
    if kept_kind != json.loads(json.dumps(kind)):
        raise BadParameter(f"--resume {resume}: was saved with other options ({json.dumps(kept_kind)}); give these")
    return states


def replay_samples(recording: Recording) -> Iterator[Arrival]:
    """Yield each IMU sample with the newest field and fix since the sample before, as a batch run takes them.

    A magnetometer that is not calibrated is left out, the course of a fix that is not valid is NaN. Raises
    :class:`BadRecording` without an IMU.
    """
    yield from list_arrivals(make_raw_logs(recording.head).add(recording.require_imu(), recording.mag, recording.gps))


def make_raw_logs(head: Head) -> RawLogs:
    """Return what gives each IMU sample its field and its fix, for a recording that comes whole or in pieces."""
    return RawLogs(uses_mag=plan_heading(head)[0], uses_gps="gps" in head.samples)


def list_arrivals(log: RawLog) -> Iterator[Arrival]:
    """Yield the samples of a log."""
    for k, t_ns in enumerate(log.t_ns.tolist()):
        field, fix = log.mag_row[k], log.fix_row[k]
        here = None if field < 0 else tuple(log.mag_b_ut[field].tolist())
        course = None if fix < 0 else (float(log.course_rad[fix]), float(log.speed_mps[fix]))
        yield Arrival(t_ns, tuple(log.gyro_b_radps[k].tolist()), tuple(log.accel_b_mps2[k].tolist()), here, course)
