"""``stillpoint estimate``: run streaming estimators over recordings."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from stillpoint.datasets import write
from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.settings import chosen
from stillpoint.datasets.store import read_recording, sha256
from stillpoint.filters import estimate as run
from stillpoint.filters.precision import Precision
from stillpoint.filters.table import ATTITUDES, ROLLS, Peer, find
from stillpoint.scripts import inputs
from stillpoint.scripts.batch import assignments, made_row, report_made, require_distinct
from stillpoint.scripts.flags import Inputs, Jobs, OutDir, SetFlag
from stillpoint.scripts.jobs import run_jobs
from stillpoint.scripts.json_file import JsonFile

EXAMPLE = "cf.omega0_radps=0.3"
COLUMNS = ("recording", "estimator", "samples", "ns per sample", "counted")


@dataclass(frozen=True)
class _Job:
    source: Path
    target: Path
    estimator: str
    precision: Precision
    settings: dict[str, Any] = field(default_factory=dict)


def estimate(
    paths: Inputs,
    /,
    *,
    estimators: Annotated[str, Parameter(name=["--estimators", "-e"])] = "cf",
    out: OutDir = Path(),
    set_: SetFlag = None,
    single: Annotated[bool, Parameter(negative=())] = False,
    jobs: Jobs = None,
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
        Names with commas between; all: every one of attitude; roll: every one of a fast spin about one axis.
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
    names = _names(estimators)
    settings = _settings(assignments(set_, EXAMPLE), names)
    sources = inputs.recordings(paths)
    work = _jobs(sources, settings, inputs.output_dir(out), single)
    outcomes = run_jobs(_make, work, jobs, "estimate")
    rows = [
        made_row({"recording": job.source.stem, "estimator": job.estimator}, job.target, outcome)
        for job, outcome in zip(work, outcomes, strict=True)
    ]
    return report_made("estimates", COLUMNS, rows, _cells, json)


def _names(estimators: str) -> list[str]:
    """The estimators that a word of the command line stands for."""
    if estimators in ("all", "roll"):
        return list(ATTITUDES if estimators == "all" else ROLLS)
    return list(dict.fromkeys(name.strip() for name in estimators.split(",")))


def _settings(changes: Mapping[str, str], names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Settings by estimator, checked before the first recording is read."""
    for name in names:
        find(name)
    settings: dict[str, dict[str, Any]] = {name: {} for name in names}
    for path, value in changes.items():
        estimator, dot, name = path.partition(".")
        if not dot:
            raise BadParameter(f"--set {path}={value}: write ESTIMATOR.NAME=VALUE, for example {EXAMPLE}")
        if estimator not in settings:
            raise BadParameter(f"--set {path}={value}: {estimator} is not among the estimators {', '.join(names)}")
        settings[estimator][name] = value
    for estimator, values in settings.items():
        chosen(find(estimator).params(), values, estimator)
    return settings


def _jobs(sources: Sequence[Path], settings: dict[str, dict[str, Any]], folder: Path, single: bool) -> list[_Job]:
    peers = [name for name in settings if isinstance(find(name), Peer)]
    if single and peers:
        raise BadParameter(f"--single: {', '.join(peers)} computes in its package's precision; leave it out")
    work = [
        _Job(source, folder / f"{source.stem}.{name}.estimate.mcap", name, "single" if single else "double", values)
        for source in sources
        for name, values in settings.items()
    ]
    require_distinct(job.target for job in work)
    return work


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
