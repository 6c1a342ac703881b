"""``stillpoint validate``: score references against independent truth."""

from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from stillpoint.datasets.errors import BadParameter, StillpointError, require_known
from stillpoint.datasets.trajectory import Estimate, SpinReference
from stillpoint.filters import estimate
from stillpoint.filters.table import SPINS
from stillpoint.scoring.align import AlignKind
from stillpoint.scoring.report.printed import save_figure
from stillpoint.scoring.spin import SpinScore, choose_zero, score_roll, spin_score_row
from stillpoint.scripts.shared import inputs
from stillpoint.scripts.shared.children import Outcome
from stillpoint.scripts.shared.flags import LOCAL, Columns, Inputs, OutDir, Workers, split_names
from stillpoint.scripts.shared.jobs import choose_exit_code, run_jobs
from stillpoint.scripts.shared.kept import REUSE, Deciding, Keeping, Task, run_kept
from stillpoint.scripts.shared.output import STDOUT, JsonFile, print_line, write_document, write_json
from stillpoint.scripts.shared.recordings import open_recording
from stillpoint.scripts.shared.spin_scores import find_spin_judge, find_zero, print_spin_scores
from stillpoint.scripts.shared.tables import print_refusals, print_table
from stillpoint.smoother import METHODS, reference
from stillpoint.smoother.reference import SPIN_METHODS
from stillpoint.studies.fidelity import JudgeFidelity, measure_fidelity
from stillpoint.studies.fidelity_figure import draw_fidelity
from stillpoint.studies.validation import (
    FIGURES,
    WARNINGS,
    SourceSummary,
    ValidationRow,
    check_methods,
    list_default_methods,
    summarise_methods,
    summarise_sources,
)
from stillpoint.studies.validation import validate as validate_recording

_FIDELITY_OUT = Path("fidelity")
_FIDELITY_COLUMNS = ("judge", "n", "tau", "median", "worst", "RMSE off", "95 %", "wrong", "other half")
_COLUMNS = (
    "recording",
    "method",
    "total, deg",
    "heading, deg",
    "inclination, deg",
    "max, deg",
    "in 95 %",
    "NEES/3",
    "s",
    "found: heading, deg",
    "mounting, deg",
    "time, ms",
)
_SOURCE_WIDTH = 20  # characters of a line: names of sources are sentences
_SOURCE_COLUMNS = (
    "source",
    "method",
    "made",
    "total, deg",
    "heading, deg",
    "worst, deg",
    "in 95 %",
    "least",
    "NEES/3",
    *(name.replace("_", " ") for name in WARNINGS),
)


def validate(
    paths: Inputs,
    /,
    *,
    align: AlignKind = "heading",
    methods: Annotated[str | None, Parameter(name=["--method", "--methods"])] = None,
    fidelity: Annotated[bool, Parameter(negative=())] = False,
    estimators: Annotated[str | None, Parameter(name=["--estimators", "-e"])] = None,
    out: OutDir = _FIDELITY_OUT,
    workers: Workers = LOCAL,
    keeping: Keeping = REUSE,
    columns: Columns = None,
    json: JsonFile = None,
) -> int:
    """Score references against independent truth: one row per recording and method, then mean, median and worst.

    Errors are RMSEs over the moving samples of the truth, as in BROAD. "in 95 %" is the share of these whose error lies
    in the 95 % ellipsoid of the stated covariance; NEES/3, the mean square of the error over it, is 1 when it fits.
    A second table has the means of each source, and how many of its references warn: of a disturbed field, a
    magnetometer that is left out, a slow log, stretches that are left out, or contradicting factors.
    Exit code 2 when nothing could be scored. Recordings of nothing but spinning bodies are scored by angle and rate.

    With --fidelity: does a reference rank estimators as truth does? Every estimator is scored by both, on the same
    samples. Writes fidelity.json and fidelity.png to the output folder.

    Parameters
    ----------
    paths
        Recordings with truth: MCAP files, folders or globs.
    align
        What the two may differ in: none, heading, heading+mounting, heading+mounting+time.
    methods
        Names of reference methods and of estimators with commas between; by default every reference method and every
        offline estimator.
    fidelity
        Compare judges of estimators, not accuracies of references.
    estimators
        With --fidelity: names with commas between; by default all of attitude whose packages are installed.
    out
        With --fidelity: folder for results.
    columns
        Columns of the table to show: names with commas between, or all. By default those that fit the terminal.
    json
        Also write the rows as JSON to this file; - is the standard output.
    """
    named = None if methods is None else split_names(methods)
    sources = inputs.find_recordings(paths)
    if fidelity:
        chosen_estimators = [] if estimators is None else split_names(estimators)
        return _validate_fidelity(
            sources, chosen_estimators, named or [], align, inputs.make_output_dir(out), workers, json
        )
    if estimators is not None:
        raise BadParameter("--estimators: belongs to --fidelity; to score estimators of a table here use --method")
    if all(inputs.is_of_spin(source) for source in sources):
        return _validate_spins(sources, named, align, workers, keeping, json)
    chosen = list_default_methods() if named is None else check_methods(named)
    outcomes = run_kept(
        partial(_validate, methods=chosen, align=align),
        sources,
        partial(_decide, methods=chosen, align=align),
        workers,
        keeping,
        "validate",
        list[ValidationRow],
    )
    rows: list[ValidationRow] = []
    for source, outcome in zip(sources, outcomes, strict=True):
        lost = [ValidationRow(source.stem, method, align, error=outcome.error) for method in chosen]
        rows += lost if outcome.value is None else outcome.value
    write_json(json, [asdict(row) for row in rows])
    reasons = {row.error for row in rows}
    if len(reasons) == 1 and None not in reasons:
        raise StillpointError(*reasons)
    if json != STDOUT:
        _print_results(rows, summarise_methods(rows), align, columns)
    if any(outcome.defect for outcome in outcomes):
        return 1
    return 0 if None in reasons else 2


def _decide(source: Path, methods: list[str], align: AlignKind) -> Deciding:
    """Return what the validation of a recording depends on."""
    return Deciding((source,), {"methods": methods, "align": align})


def _validate(task: Task[Path], methods: list[str], align: AlignKind) -> list[ValidationRow]:
    source = task.item
    return validate_recording(source.stem, partial(open_recording, source), methods, align)


def _validate_spins(
    sources: Sequence[Path],
    methods: Sequence[str] | None,
    align: AlignKind,
    workers: Workers,
    keeping: Keeping,
    json: JsonFile,
) -> int:
    """Score angle and rate by each method against the truth, else the encoder, of each recording."""
    find_zero(align, "validate")
    chosen = list(dict.fromkeys(methods or SPIN_METHODS))
    for name in chosen:
        require_known(name, [*SPIN_METHODS, *SPINS], "roll reference method or estimator")
    work = [(source, name) for source in sources for name in chosen]
    decide = partial(_decide_spin, align=align)
    outcomes = run_kept(partial(_score_spin, align=align), work, decide, workers, keeping, "validate", SpinScore)
    refused = [(str(o.error), name) for (_, name), o in zip(work, outcomes, strict=True) if o.value is None]
    rows: list[dict[str, Any]] = [
        {"recording": source.stem, "method": name, "error": outcome.error}
        if outcome.value is None
        else spin_score_row(outcome.value)
        for (source, name), outcome in zip(work, outcomes, strict=True)
    ]
    write_json(json, rows)
    if len(refused) == len(work) == 1:
        raise StillpointError(refused[0][0])
    if json != STDOUT:
        print_spin_scores([outcome.value for outcome in outcomes if outcome.value is not None])
        print_refusals("not scored", refused)
    return choose_exit_code(outcomes)


def _decide_spin(job: tuple[Path, str], align: AlignKind) -> Deciding:
    """Return what the validation of a spin recording depends on."""
    source, name = job
    return Deciding((source,), {"spin": name, "align": align})


def _score_spin(task: Task[tuple[Path, str]], align: AlignKind) -> SpinScore:
    """Score one recording by one method or estimator."""
    source, name = task.item
    judge = find_spin_judge(source)
    recording = open_recording(source)
    made = reference(recording, name) if name in SPIN_METHODS else estimate(recording, name)
    assert isinstance(made, SpinReference | Estimate)
    zero = find_zero(align, source.name) or choose_zero(made, judge.truth, judge.name)
    return score_roll(made, judge.truth, zero, judge.name)


def _validate_fidelity(
    sources: Sequence[Path],
    estimators: Sequence[str],
    judges: Sequence[str],
    align: AlignKind,
    out: Path,
    workers: Workers,
    json: str | None,
) -> int:
    """Measure, print and write how well each judge replaces truth."""

    def run(function: Callable[[Any], Any], items: Sequence[Any], what: str) -> list[Outcome[Any]]:
        return run_jobs(function, items, workers, what)

    check_methods(judges)
    found = measure_fidelity(sources, estimators, out, judges=judges, align=align, run_jobs=run)
    write_document(str(out / "fidelity.json"), found.to_json())
    save_figure(draw_fidelity(found), out / "fidelity.png", dpi=150, metadata={"Software": None})
    write_document(json, found.to_json())
    if json != STDOUT:
        estimated = len({row.estimator for row in found.rows})
        title = f"judges of {estimated} estimators on {found.recordings} recordings, aligned: {align}"
        print_table(title, _FIDELITY_COLUMNS, [[_format_fidelity(judge) for judge in found.judges]], texts=1)
        errors = ((row.error, f"{row.judge} of {row.estimator}") for row in found.rows if row.error is not None)
        print_refusals("not compared", errors)
        print_line(f"written to {out}: fidelity.json, fidelity.png")
    return 0 if any(judge.recordings for judge in found.judges) else 2


def _format_fidelity(judge: JudgeFidelity) -> list[str]:
    """Return the row of a judge as text: Kendall's tau, relative errors and verdicts."""
    figures = (judge.tau_pooled, judge.tau_median, judge.tau_worst)
    shares = (judge.relative_rmse_median, judge.relative_rmse_p95)
    return [
        judge.judge,
        str(judge.recordings),
        *("-" if figure is None else f"{figure:.3f}" for figure in figures),
        *("-" if share is None else f"{share:.1%}" for share in shares),
        f"{judge.wrong_verdicts} of {judge.verdicts}",
        f"{judge.wrong_verdicts_other_half / max(judge.verdicts_other_half, 1):.1%}",
    ]


def _print_results(rows: list[ValidationRow], means: list[dict[str, Any]], align: str, wanted: str | None) -> None:
    """Print the errors by recording and by source, and what was refused."""
    scored = [_format_figures(asdict(row)) + _format_found(row) for row in rows]
    named = [[row.recording, row.method, *cells] for row, cells in zip(rows, scored, strict=True)]
    below = [
        [f"{row['statistic']} of {row['scored']} of {row['of']}", row["method"], *_format_figures(row), "", "", ""]
        for row in means
    ]
    print_table(f"against the truth, aligned: {align}", _COLUMNS, [named, below], wanted=wanted)
    by_source = [_format_source(one) for one in summarise_sources(rows)]
    title = "by source: means, and how many references carry a warning"
    every = wanted if wanted == "all" else None
    print_table(title, _SOURCE_COLUMNS, [by_source], wanted=every, widest_first=_SOURCE_WIDTH)
    left_out = ((row.magnetometer_left_out, row.recording) for row in rows if row.magnetometer_left_out is not None)
    print_refusals("without magnetometer", left_out)
    print_refusals("not scored", ((row.error, row.method) for row in rows if row.error is not None))


def _format_source(one: SourceSummary) -> list[str]:
    """Return the row of a source as text: means, worst, and how many references carry a warning."""
    errors = (one.total_mean_deg, one.heading_mean_deg, one.total_worst_deg)
    figures = (*errors, one.coverage95_mean, one.coverage95_least, one.nees_per_dof_mean)
    warned = map(str, one.warned.values()) if one.method in METHODS else ["-"] * len(WARNINGS)
    cells = ["-" if figure is None else f"{figure:.2f}" for figure in figures]
    return [one.source or "not stated", one.method, f"{one.scored} of {one.of}", *cells, *warned]


def _format_figures(row: dict[str, Any]) -> list[str]:
    return ["-" if row[name] is None else f"{row[name]:.2f}" for name in FIGURES]


def _format_found(row: ValidationRow) -> list[str]:
    """Return the heading in deg, mounting in deg and clock offset in ms that aligned a row, as text."""
    found = row.found
    if found.heading_deg is None or found.mounting_deg is None or found.time_s is None:
        return ["-"] * 3
    return [f"{found.heading_deg:.2f}", f"{found.mounting_deg:.2f}", f"{found.time_s * 1e3:.1f}"]
