"""``stillpoint stream``: estimate while samples arrive."""

import importlib.util
import sys
from collections.abc import Mapping, Sequence
from math import degrees
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Group, Parameter

from stillpoint.datasets.earth import local_declination
from stillpoint.datasets.errors import BadParameter, StillpointError
from stillpoint.datasets.importers.spin_csv import SpinOptions, find_geometry
from stillpoint.datasets.recording import SpinGeometry
from stillpoint.filters.front.heading_source import Heading
from stillpoint.filters.precision import Precision
from stillpoint.filters.table import SPINS, Peer, find_estimator
from stillpoint.scripts.shared.estimator_choice import Run, choose_runs
from stillpoint.scripts.shared.flags import SetFlag, Whole
from stillpoint.scripts.shared.output import STDOUT, JsonFile, check_writable, print_line, write_json
from stillpoint.scripts.shared.recordings import open_recording
from stillpoint.scripts.streaming.heading_watch import HeadingWatch
from stillpoint.scripts.streaming.lines import ATTITUDE, Arrival, SpinArrival, make_spin_layout
from stillpoint.scripts.streaming.pipe import Counts, run_pipe
from stillpoint.scripts.streaming.streams import (
    Live,
    Make,
    describe_run,
    make_attitude_stream,
    make_spin_stream,
    open_streams,
    save_streams,
)
from stillpoint.scripts.streaming.unit_watch import UnitWatch

_SPIN = Group("Estimators of roll", sort_key=1)
_HOST = "127.0.0.1"
SpinText = Annotated[str, Parameter(group=_SPIN)]
SpinSize = Annotated[float | None, Parameter(group=_SPIN)]


def stream(
    file: Path | None = None,
    /,
    *,
    estimators: Annotated[str, Parameter(name=["--estimators", "-e"])] = "ekf",
    set_: SetFlag = None,
    declination: float | None = None,
    precision: Precision = "double",
    heading: Heading = "mag",
    resume: Annotated[Path | None, Parameter(negative=())] = None,
    save: Annotated[Path | None, Parameter(negative=(), validator=check_writable)] = None,
    foxglove: Annotated[Whole | None, Parameter(negative=())] = None,
    host: Annotated[str | None, Parameter(negative=())] = None,
    speed: Annotated[float | None, Parameter(negative=())] = None,
    geometry: SpinText = "bench",
    d1_m: SpinSize = None,
    d2_m: SpinSize = None,
    range_g: SpinSize = None,
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
        Names with commas between: ekf, iekf, aekf, kf-axis, cf, cf-literal, cf-fixed, cf-lse, cf-lse-literal, gyro,
        acc, acc-ma; or roll-obs, roll-ekf, roll-aekf, roll-guarded.
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
        Address to listen on for Foxglove; by default 127.0.0.1, so that this computer alone can connect.
    speed
        How much faster than it was recorded to replay; 1 unless given.
    geometry
        Where the accelerometers sit, for the estimators of roll: bench, five, or a .toml file as import spin takes it.
    d1_m
        Lever arm of the radial accelerometer in m, 0.10 unless given.
    d2_m
        Lever arm of the tangential one in m, 0.50 unless given.
    range_g
        Range of the accelerometers, 16 unless given.
    json
        Also write the counts and latencies of the end to this file.
    """
    if json == STDOUT:
        raise BadParameter("--json -: the standard output is for the estimates; name a file")
    _require_useful_options(
        foxglove is not None, {"--resume": resume, "--save": save, "--json": json}, {"--host": host, "--speed": speed}
    )
    runs = choose_runs(estimators, set_, precision, heading)
    peers = [run.estimator for run in runs if isinstance(find_estimator(run.estimator), Peer)]
    if peers:
        names, take = ",".join(peers), "takes" if len(peers) == 1 else "take"
        raise BadParameter(f"{names}: {take} whole recordings only; use stillpoint estimate -e {names}")
    spin = _read_geometry(runs, SpinOptions(geometry=geometry, d1_m=d1_m, d2_m=d2_m, range_g=range_g), declination)
    if foxglove is not None:
        if spin is not None:
            raise BadParameter(f"--foxglove: replays attitudes; for {estimators} use stillpoint estimate and view")
        _stream_to_foxglove(
            file, runs, declination, _HOST if host is None else host, foxglove, 1.0 if speed is None else speed
        )
        return
    if file is not None:
        raise BadParameter(f"{file}: a recording is replayed with --foxglove PORT; samples come on the standard input")
    kind = describe_run(runs, declination, spin)
    makes: dict[str, Make]
    if spin is None:
        layout = ATTITUDE
        makes = {run.estimator: make_attitude_stream(run, declination) for run in runs}
    else:
        layout = make_spin_layout(len(spin.accel_axis_b), len(spin.gyro_axis_b))
        makes = {run.estimator: make_spin_stream(run, spin) for run in runs}
    streams = open_streams(makes, resume, kind)
    if sys.stdin is None or sys.stdout is None:
        raise BadParameter("the standard input or output is closed; samples come on the one, estimates on the other")
    watch, units = HeadingWatch(list(streams), heading), UnitWatch()

    def see(sample: Arrival | SpinArrival) -> None:
        watch.see(sample)
        units.see(sample)

    passed = run_pipe(streams, sys.stdin.buffer, sys.stdout, layout, see)
    watch.end()
    if save is not None:
        save_streams(save, streams, kind)
    _print_summary(passed, streams)
    write_json(json, [_list_facts(passed, name, one) for name, one in streams.items()])
    if passed.failure:
        raise StillpointError(passed.failure)


def _require_useful_options(is_replay: bool, of_pipe: Mapping[str, Any], of_replay: Mapping[str, Any]) -> None:
    """Raise :class:`BadParameter` for options that would have no effect."""
    for option, value in (of_pipe if is_replay else of_replay).items():
        if value is not None and is_replay:
            raise BadParameter(f"{option}: is for samples from the standard input; leave it out with --foxglove")
        if value is not None:
            raise BadParameter(f"{option}: is for a replay; give --foxglove PORT with it, or leave it out")


def _stream_to_foxglove(
    file: Path | None, runs: Sequence[Run], declination_deg: float | None, host: str, port: int, speed: float
) -> None:
    """Check the options, start the server, and replay. Raises :class:`BadParameter`."""
    if file is None:
        raise BadParameter("--foxglove: names no recording; give the MCAP file to replay")
    if not 0 <= port <= 65535:
        raise BadParameter(f"--foxglove {port}: give a port from 1 to 65535, or 0 for any that is free")
    if not 0 < speed < float("inf"):
        raise BadParameter(f"--speed {speed:g}: give a number above 0, 1 for as fast as it was recorded")
    if importlib.util.find_spec("foxglove") is None:
        raise BadParameter("--foxglove: foxglove-sdk is not installed; pip install 'stillpoint[view]'")
    from stillpoint.scripts.streaming.foxglove import replay_live

    recording = open_recording(file)
    recording.require_imu()  # before somebody waits for it
    if declination_deg is None:
        declination_deg = degrees(local_declination(recording.info)[0])
    streams = {run.estimator: make_attitude_stream(run, declination_deg)() for run in runs}
    n_samples = replay_live(file, recording, streams, host, port, speed)
    print_line(f"stillpoint: {n_samples} samples replayed", file=sys.stderr)


def _read_geometry(runs: Sequence[Run], options: SpinOptions, declination_deg: float | None) -> SpinGeometry | None:
    """Read the geometry of a spinning body; None for attitudes. Raises :class:`BadParameter` for options that clash."""
    spins, names = [run.estimator for run in runs if run.estimator in SPINS], ", ".join(SPINS)
    if not spins:
        if options != SpinOptions():
            raise BadParameter(f"--geometry, --d1-m, --d2-m, --range-g: are for {names}; leave them out")
        return None
    if len(spins) < len(runs):
        raise BadParameter(f"{', '.join(spins)}: reads other samples than those of attitude; run {names} by themselves")
    if declination_deg is not None or runs[0].ranges:
        raise BadParameter(
            f"--declination, --set range: {spins[0]} follows a spin, which has no heading; leave them out"
        )
    return find_geometry(options)


def _print_summary(passed: Counts, streams: Mapping[str, Live]) -> None:
    """Print the summary to stderr."""
    lines = [f"{passed.n_samples} samples, {passed.n_malformed} malformed lines, {passed.ended_by}"]
    for what, latency in (("estimators", passed.update), ("line to line", passed.whole)):
        if not latency.n:
            continue
        facts = latency.facts()
        lines.append(
            f"{what}: median {facts['median_us']:.1f}, p99 {facts['p99_us']:.1f}, max {facts['max_us']:.1f} us"
        )
    for name, one in streams.items():
        counts = ", ".join(f"{what[2:].replace('_', ' ')} {n}" for what, n in one.counts.items() if n)
        lines.append(f"{name} counted: {counts or 'nothing'}")
    for text in lines:
        print_line(f"stillpoint: {text}", file=sys.stderr)


def _list_facts(passed: Counts, name: str, one: Live) -> dict[str, Any]:
    """Return counts, latencies and the way it ended of one estimator for ``--json``."""
    return {
        "estimator": name,
        "n_samples": passed.n_samples,
        "n_malformed": passed.n_malformed,
        "ended_by": passed.ended_by,
        "counts": one.counts,
        "update": passed.update.facts(),
        "line_to_line": passed.whole.facts(),
    }
