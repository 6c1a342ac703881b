"""``stillpoint estimate``: run streaming estimators over recordings."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from stillpoint.datasets import BadRecording, Estimate
from stillpoint.datasets.calibration.apply import apply_calibration
from stillpoint.datasets.mcap.pieces import PieceReader, read_ahead
from stillpoint.datasets.mcap.store import open_trajectory
from stillpoint.filters import estimate as run
from stillpoint.filters.front.heading_source import Heading
from stillpoint.filters.precision import Precision
from stillpoint.filters.run import start_run
from stillpoint.filters.table import SPINS, Peer, find_estimator
from stillpoint.scripts.shared import inputs
from stillpoint.scripts.shared.batch import make_row, report_made, require_distinct
from stillpoint.scripts.shared.estimator_choice import Run, choose_runs
from stillpoint.scripts.shared.flags import LOCAL, Columns, Inputs, OutBeside, SetFlag, Workers
from stillpoint.scripts.shared.kept import REUSE, Deciding, Keeping, Task, run_kept
from stillpoint.scripts.shared.output import JsonFile
from stillpoint.scripts.shared.recordings import find_calibration, list_references, open_recording, print_losses

_DEFAULT = "ekf"  # where there is an IMU: the most accurate of ours
_COLUMNS = ("recording", "estimator", "samples", "ns per sample", "counted")


@dataclass(frozen=True)
class _Job:
    """An estimate to make: of which recording, into which file, by which run, with which calibration."""

    source: Path
    target: Path
    run: Run
    calibration: str  # none, reference or a file


def estimate(
    paths: Inputs,
    /,
    *,
    estimators: Annotated[str | None, Parameter(name=["--estimators", "-e"])] = None,
    out: OutBeside = None,
    set_: SetFlag = None,
    precision: Precision = "double",
    heading: Heading = "mag",
    calibration: str = "none",
    workers: Workers = LOCAL,
    keeping: Keeping = REUSE,
    columns: Columns = None,
    json: JsonFile = None,
) -> int:
    """Run streaming estimators over recordings.

    Writes NAME.ESTIMATOR.estimate.mcap for each recording NAME.mcap. docs/estimators.md describes the estimators and
    their parameters.

    Parameters
    ----------
    paths
        Recordings: MCAP files, folders or globs.
    estimators
        Names with commas between. Ours: ekf (the default), iekf, aekf, kf-axis, cf, cf-literal, cf-fixed, cf-lse,
        cf-lse-literal, gyro, acc, acc-ma. Of other packages: vqf, offline-vqf, madgwick, mahony, ahrs-ekf, fusion,
        riann. Of a fast spin about one axis: roll-obs, roll-ekf, roll-aekf, roll-guarded. all: every one of attitude;
        roll: every one of roll, the default for recordings of a spinning body.
    out
        Folder to write into; made when it is not there. By default beside each recording.
    set_
        A parameter, ESTIMATOR.NAME=VALUE, for example cf.omega0_radps=0.3; can be given several times. Those of
        --heading gps-course are heading.NAME, full scales of the sensors range.NAME (docs/streaming.md).
    precision
        single: compute in float32, as on a microcontroller (not for peers), and say how far off double that is.
    heading
        gps-course: from satellite fixes while they are valid, from the magnetometer, calibrated by them, otherwise.
    calibration
        none: samples as recorded. reference: first corrected by what the reference found about the sensor (hard iron,
        matrices, biases); NAME.reference.mcap beside the recording or in the output folder, made where there is none.
        Or a file with a calibration.
    columns
        Columns of the table to show: names with commas between, or all. By default those that fit the terminal.
    json
        Also write the table's facts as JSON to this file; - is the standard output.
    """
    sources = inputs.find_recordings(paths)
    runs = _plan_runs(sources, estimators, partial(choose_runs, set_=set_, precision=precision, heading=heading))
    work = _plan_jobs(runs, None if out is None else inputs.make_output_dir(out), calibration)
    outcomes = run_kept(_make, work, _decide, workers, keeping, "estimate", dict)
    rows = [
        make_row({"recording": job.source.stem, "estimator": job.run.estimator}, job.target, outcome)
        for job, outcome in zip(work, outcomes, strict=True)
    ]
    return report_made("estimates", _COLUMNS, rows, _format_cells, json, columns)


def _plan_runs(
    sources: Sequence[Path], estimators: str | None, runs_of_names: Callable[[str], list[Run]]
) -> Mapping[Path, list[Run]]:
    """Return what to run over each recording: what was named, or by default what its streams are for."""
    if estimators is not None:
        return dict.fromkeys(sources, runs_of_names(estimators))
    spins = {source: inputs.is_of_spin(source) for source in sources}
    wanted = [_DEFAULT] * (not all(spins.values())) + list(SPINS) * any(spins.values())
    runs = runs_of_names(",".join(wanted))
    return {source: [run for run in runs if (run.estimator in SPINS) == spins[source]] for source in sources}


def _plan_jobs(runs: Mapping[Path, Sequence[Run]], out: Path | None, calibration: str) -> list[_Job]:
    """Return one job per recording and estimator; raises :class:`BadParameter` where two would write one file."""
    work = [
        _Job(
            source, inputs.choose_folder(source, out) / f"{source.stem}.{run.estimator}.estimate.mcap", run, calibration
        )
        for source, wanted in runs.items()
        for run in wanted
    ]
    require_distinct(job.target for job in work)
    return work


def _decide(job: _Job) -> Deciding:
    """Return what decides an estimate: recording, calibration, estimator and settings."""
    files = [job.source]
    if job.calibration == "reference":
        files += list_references(job.source, _list_folders(job))
    elif job.calibration != "none":
        files.append(Path(job.calibration))
    return Deciding(tuple(files), {"run": job.run, "calibration": job.calibration}, job.target)


def _make(task: Task[_Job]) -> dict[str, Any]:
    """Read, run, write; the facts of the table."""
    return _run_whole(task) if _needs_whole(task.item) else _run_in_pieces(task)


def _make_row(samples: int, last: Estimate) -> dict[str, Any]:
    """Return the facts of the table; the last piece of an estimate carries those of the whole."""
    return {
        "samples": samples,
        "ns_per_sample": last.ns_per_sample,
        "params": dict(last.params),
        "diagnostics": dict(last.diagnostics),
    }


def _needs_whole(job: _Job) -> bool:
    """Return whether the recording has to be in memory whole: for a package of another project, and to calibrate."""
    return job.calibration != "none" or isinstance(find_estimator(job.run.estimator), Peer)


def _run_in_pieces(task: Task[_Job]) -> dict[str, Any]:
    """Run an estimator over a recording of any length: read, estimated and written piece by piece."""
    job = task.item
    chosen, reader = job.run, PieceReader(job.source)
    run = start_run(
        reader.head,
        chosen.estimator,
        chosen.params,
        chosen.precision,
        chosen.heading,
        heading_params=chosen.heading_params,
        ranges=chosen.ranges,
    )
    samples, last = 0, None
    with open_trajectory(job.target) as out:
        for piece in read_ahead(reader.recording()):
            estimated = run.add(piece)
            if estimated is not None:
                out.add(estimated)
                samples, last = samples + len(estimated.t_ns), estimated
        print_losses(job.source, reader.info)
        if last is None:
            raise BadRecording(f"{job.source}: holds no sample for {chosen.estimator}; restore it from a copy")
        digest = task.hash_input(job.source)
        last = replace(run.close(last), made_from={job.source.name: digest})
        row = _make_row(samples, last)
        out.close(last, task.make_origin(row))
    return row


def _run_whole(task: Task[_Job]) -> dict[str, Any]:
    """Run an estimator over a recording that is read whole, corrected by a calibration where one is asked for."""
    job = task.item
    recording = open_recording(job.source)
    digest = task.hash_input(job.source)
    known = find_calibration(job.calibration, recording, job.source, digest, _list_folders(job))
    if known is not None:
        recording = apply_calibration(recording, known, digest)
    made = run(
        recording,
        job.run.estimator,
        job.run.params,
        job.run.precision,
        job.run.heading,
        heading_params=job.run.heading_params,
        ranges=job.run.ranges,
    )
    made_from = {job.source.name: digest}
    if known is not None:
        made = replace(made, diagnostics={**made.diagnostics, "calibrated_by": known.name})
        made_from |= {known.name: known.sha256} if known.sha256 else {}
    made = replace(made, made_from=made_from)
    row = _make_row(len(made.t_ns), made)
    with open_trajectory(job.target) as out:
        out.add(made)
        out.close(made, task.make_origin(row))
    return row


def _list_folders(job: _Job) -> tuple[Path, Path]:
    """Return where a reference of the recording may be: beside it, and in the output folder."""
    return job.source.parent, job.target.parent


def _format_cells(row: dict[str, Any]) -> list[str]:
    """Return the row of an estimate as text, with the counts of what was unusual."""
    if row["error"] is not None:
        return [row["recording"], row["estimator"], "-", "-", "-"]
    diagnostics = row["diagnostics"]
    counts = [f"{name[2:].replace('_', ' ')} {n}" for name, n in diagnostics.items() if name.startswith("n_") and n]
    if "off_double_max_deg" in diagnostics:
        counts.append(f"at most {diagnostics['off_double_max_deg']:.2g} deg off double")
    return [
        row["recording"],
        row["estimator"],
        str(row["samples"]),
        f"{row['ns_per_sample']:.0f}",
        ", ".join(counts) or "-",
    ]
