"""``stillpoint estimate``: run streaming estimators over recordings."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from stillpoint.datasets import write
from stillpoint.datasets.errors import BadParameter, StillpointError
from stillpoint.datasets.settings import chosen
from stillpoint.datasets.store import read_recording, sha256
from stillpoint.filters import ESTIMATORS
from stillpoint.filters import estimate as run
from stillpoint.filters.precision import Precision
from stillpoint.filters.table import Peer, find
from stillpoint.scripts import inputs
from stillpoint.scripts.jobs import Outcome, run_jobs
from stillpoint.scripts.json_file import STDOUT, JsonFile, write_json
from stillpoint.scripts.tables import print_table

COLUMNS = ("recording", "estimator", "samples", "ns per sample", "counted")


@dataclass(frozen=True)
class _Job:
    source: Path
    target: Path
    estimator: str
    precision: Precision
    settings: dict[str, Any] = field(default_factory=dict)


def estimate(
    paths: Annotated[list[Path], Parameter(negative=())],
    /,
    *,
    estimators: Annotated[str, Parameter(name=["--estimators", "-e"])] = "cf",
    out: Annotated[Path, Parameter(name=["--out", "-o"])] = Path(),
    set_: Annotated[list[str] | None, Parameter(name="--set", negative=())] = None,
    single: Annotated[bool, Parameter(negative=())] = False,
    jobs: int | None = None,
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
        Names with commas between, or all: acc, acc-ma, gyro, cf, and the peers vqf and offline-vqf.
    out
        Folder to write into; made when it is not there.
    set_
        A parameter, ESTIMATOR.NAME=VALUE, for example cf.omega0_radps=0.3; can be given several times.
    single
        Compute in single precision, as on a microcontroller (not for peers).
    jobs
        Processes; by default one per core.
    json
        Also write the table's facts as JSON to this file; - is the standard output.
    """
    names = list(ESTIMATORS) if estimators == "all" else list(dict.fromkeys(n.strip() for n in estimators.split(",")))
    settings = _settings(set_ or [], names)
    sources = inputs.recordings(paths)
    work = _jobs(sources, settings, inputs.output_dir(out), single)
    outcomes = run_jobs(_make, work, jobs, "estimate")
    if len(work) == 1 and outcomes[0].error is not None:
        raise StillpointError(outcomes[0].error)
    rows = [_row(job, outcome) for job, outcome in zip(work, outcomes, strict=True)]
    if json != STDOUT:
        print_table("estimates", COLUMNS, [[_cells(row) for row in rows]])
        for row in rows:
            if row["error"] is not None:
                print(f"not made: {row['recording']}, {row['estimator']}: {row['error']}")
    write_json(json, rows)
    return 2 if any(row["error"] is not None for row in rows) else 0


def _settings(pairs: Sequence[str], names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Parameters by estimator, checked before the first recording is read."""
    settings: dict[str, dict[str, Any]] = {name: {} for name in names}
    for name in names:
        find(name)
    for pair in pairs:
        path, equals, value = pair.partition("=")
        estimator, dot, name = path.strip().partition(".")
        if not (equals and dot):
            raise BadParameter(f"--set {pair}: write ESTIMATOR.NAME=VALUE, for example cf.omega0_radps=0.3")
        if estimator not in settings:
            raise BadParameter(f"--set {pair}: {estimator} is not among the estimators {', '.join(names)}")
        settings[estimator][name] = value.strip()
    for estimator, values in settings.items():
        chosen(find(estimator).params(), values, estimator)
    return settings


def _jobs(sources: Sequence[Path], settings: dict[str, dict[str, Any]], folder: Path, single: bool) -> list[_Job]:
    twice = [name for name, count in Counter(source.name for source in sources).items() if count > 1]
    if twice:
        raise BadParameter(f"{twice[0]}: two recordings have this name; write them to different folders")
    peers = [name for name in settings if isinstance(find(name), Peer)]
    if single and peers:
        raise BadParameter(f"--single: {', '.join(peers)} computes in its package's precision; leave it out")
    return [
        _Job(source, folder / f"{source.stem}.{name}.estimate.mcap", name, "single" if single else "double", values)
        for source in sources
        for name, values in settings.items()
    ]


def _make(job: _Job) -> dict[str, Any]:
    """Read, run, write; the facts of the table."""
    recording = read_recording(job.source)
    made = run(recording, job.estimator, job.settings, job.precision)
    write(job.target, replace(made, made_from={job.source.name: sha256(job.source)}))
    return {
        "samples": len(made.t_ns),
        "ns_per_sample": made.ns_per_sample,
        "params": dict(made.params),
        "diagnostics": dict(made.diagnostics),
    }


def _row(job: _Job, outcome: Outcome[dict[str, Any]]) -> dict[str, Any]:
    named = {"recording": job.source.stem, "estimator": job.estimator}
    if outcome.value is None:
        return {**named, "file": None, "error": outcome.error}
    return {**named, "file": str(job.target), **outcome.value, "error": None}


def _cells(row: dict[str, Any]) -> list[str]:
    if row["error"] is not None:
        return [row["recording"], row["estimator"], "-", "-", "-"]
    counted = {name: count for name, count in row["diagnostics"].items() if name.startswith("n_") and count}
    return [
        row["recording"],
        row["estimator"],
        str(row["samples"]),
        f"{row['ns_per_sample']:.0f}",
        ", ".join(f"{name[2:].replace('_', ' ')} {count}" for name, count in counted.items()) or "-",
    ]
