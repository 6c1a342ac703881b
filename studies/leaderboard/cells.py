"""The cells of a leaderboard: every estimator with every kind of input on every recording, made and scored."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from stillpoint.datasets.errors import StillpointError
from stillpoint.datasets.files.result_store import ResultStore
from stillpoint.scoring import AlignKind
from stillpoint.studies.job_runner import JobRunner
from stillpoint.studies.leaderboard.board import Row, Run, Source
from stillpoint.studies.leaderboard.entrants import Entrant
from stillpoint.studies.leaderboard.estimates import EstimateJob, make_estimate, plan_estimate
from stillpoint.studies.leaderboard.judges import JudgeSpec
from stillpoint.studies.leaderboard.ranking import ErrorSeries, JudgeSeries, ScoredRuns
from stillpoint.studies.leaderboard.references import References
from stillpoint.studies.leaderboard.scores import Entry, Scored, ScoreJob, judge_key, plan_score, score_recording
from stillpoint.studies.leaderboard.study import NONE, REFERENCE


@dataclass(frozen=True)
class Line:
    """One row of the table: an estimator with one kind of input."""

    entrant: Entrant
    calibration: str
    label: str

    def empty_row(self) -> Row:
        """Return the row without figures."""
        name, origin = self.entrant.name, self.entrant.origin
        return Row(self.label, name, self.calibration, "", origin, None, 0, 0, None, None, None, None, None, None)


@dataclass(frozen=True)
class Cell:
    """One line of the table on one recording."""

    source: Source
    line: Line
    job: EstimateJob | None  # None where there is an error before it
    error: str | None


def list_lines(entrants: Sequence[Entrant], calibrations: Sequence[str]) -> list[Line]:
    """Return the rows of the table; a trajectory from a file has the input that it was made with."""
    lines = []
    for entrant in entrants:
        for calibration in calibrations if entrant.kind != "file" else (NONE,):
            label = entrant.name
            if len(calibrations) > 1 and entrant.kind != "file":
                label += f" ({_name_input(calibration)})"
            lines.append(Line(entrant, calibration, label))
    return lines


def plan_cells(
    sources: Sequence[Source], lines: Sequence[Line], references: References, store: ResultStore
) -> Iterator[Cell]:
    """Plan every line on every recording; what cannot be run keeps the reason."""
    for source in sources:
        for line in lines:
            job, error = None, source.error
            if error is None:
                try:
                    file = find_calibration(source, line.calibration, references)
                    job = plan_estimate(source, line.entrant, file, store)
                except StillpointError as problem:
                    error = str(problem)
            yield Cell(source, line, job, error)


def has_missing(sources: Sequence[Source], lines: Sequence[Line], references: References, store: ResultStore) -> bool:
    """Return whether an estimate of these lines has not been made yet."""
    cells = plan_cells(sources, lines, references, store)
    return any(cell.job is not None and store.facts(cell.job.key) is None for cell in cells)


def make_estimates(cells: Sequence[Cell], store: ResultStore, run_jobs: JobRunner) -> list[Cell]:
    """Make the estimates that are missing, fast estimators first; return the cells with the reasons of failures."""
    missing = {cell.job.key: cell for cell in cells if cell.job is not None and store.facts(cell.job.key) is None}
    ordered = sorted(missing.values(), key=lambda cell: cell.line.entrant.slow)
    outcomes = run_jobs(make_estimate, [cell.job for cell in ordered], "estimates") if ordered else []
    errors = {
        cell.job.key: outcome.error for cell, outcome in zip(ordered, outcomes, strict=True) if cell.job is not None
    }
    return [_add_error(cell, errors, store) for cell in cells]


def _add_error(cell: Cell, errors: dict[str, str | None], store: ResultStore) -> Cell:
    """Return the cell with the error of its estimate, from this run or from the results that are kept."""
    if cell.job is None:
        return cell
    facts = store.facts(cell.job.key)
    kept = "the estimate is missing" if facts is None else facts["error"]
    return replace(cell, error=errors.get(cell.job.key) or kept)


def find_calibration(source: Source, calibration: str, references: References) -> Path | None:
    """Return the file with the calibration of a recording; raises :class:`StillpointError` where there is none."""
    if calibration == NONE:
        return None
    if calibration != REFERENCE:
        return Path(calibration)
    reference = references[source.recording]
    if reference.file is None:
        raise StillpointError(f"no calibration: {reference.error}")
    return reference.file


def _name_input(calibration: str) -> str:
    """Return what a page calls the input with this calibration."""
    return {NONE: "raw", REFERENCE: "calibrated"}.get(calibration, Path(calibration).name.partition(".")[0])


def score_cells(
    cells: Sequence[Cell],
    judges: Mapping[str, JudgeSpec | str],
    align: AlignKind,
    store: ResultStore,
    run_jobs: JobRunner,
) -> ScoredRuns:
    """Score all cells, each recording against its judge, on the samples that its estimates share."""
    jobs = _plan_scores(cells, judges, align, store)
    missing = [job for job in jobs if job.read_outcomes() is None]
    outcomes = run_jobs(score_recording, missing, "scores") if missing else []
    errors = {job.key: outcome.error for job, outcome in zip(missing, outcomes, strict=True)}
    scored: dict[tuple[str, str], Scored] = {}
    for job in jobs:
        error = errors.get(job.key) or "the scores are missing"
        found = job.read_outcomes() or [Scored(entry.label, None, error) for entry in job.entries]
        scored |= {(job.source.recording, one.label): one for one in found}
    return _collect(cells, judges, scored, store)


def _plan_scores(
    cells: Sequence[Cell], judges: Mapping[str, JudgeSpec | str], align: AlignKind, store: ResultStore
) -> list[ScoreJob]:
    """Return one job per recording that has a judge and an estimate."""
    sources = {cell.source.recording: cell.source for cell in cells}
    jobs = []
    for name, judge in judges.items():
        entries = tuple(
            Entry(cell.line.label, cell.line.entrant.name, cell.job.key)
            for cell in cells
            if cell.source.recording == name and cell.job is not None and cell.error is None
        )
        if isinstance(judge, JudgeSpec) and entries:
            jobs.append(plan_score(sources[name], judge, align, entries, store))
    return jobs


def _collect(
    cells: Sequence[Cell],
    judges: Mapping[str, JudgeSpec | str],
    scored: Mapping[tuple[str, str], Scored],
    store: ResultStore,
) -> ScoredRuns:
    """Return every cell as a run, with the series from which the effect of a reference's error is computed."""
    runs, errors, covariances = {}, {}, {}
    for cell in cells:
        place = (cell.source.recording, cell.line.label)
        judge, one = judges[cell.source.recording], scored.get(place)
        run = _start_run(cell, judge, store)
        result = None if one is None or one.key is None else store.get(one.key)
        if run.error is None and result is None:
            reason = "the score is missing" if one is None else one.error
            run = replace(run, error=judge if isinstance(judge, str) else reason)
        if run.error is None and result is not None and isinstance(judge, JudgeSpec):
            figures = {name: value for name, value in result.facts.items() if name != "samples_hash"}
            run = replace(run, **figures, score_key=one.key if one else None)
            errors[place] = ErrorSeries(result.arrays["bins"], result.arrays["error_n_deg"])
            kept = store.get(judge_key(judge, result.facts)) if judge.file is not None else None
            if kept is not None:
                covariances[cell.source.recording] = JudgeSeries(kept.arrays["bins"], kept.arrays["cov_n_deg2"])
        runs[place] = run
    return ScoredRuns(runs, errors, covariances)


def _start_run(cell: Cell, judge: JudgeSpec | str, store: ResultStore) -> Run:
    """Return the run of a cell with what is known before it is scored."""
    facts = None if cell.job is None else store.facts(cell.job.key)
    known = facts if facts is not None and facts["error"] is None else {}
    against, file = ("", None) if isinstance(judge, str) else (judge.name, str(judge.file or cell.source.file))
    return Run(
        recording=cell.source.recording,
        estimator=cell.line.entrant.name,
        calibration=cell.line.calibration,
        label=cell.line.label,
        against=against,
        ns_per_sample=known.get("ns_per_sample"),
        magnetometer_left_out=known.get("magnetometer_left_out"),
        parameters=known.get("params", {}),
        judge_file=file,
        estimate_key=None if cell.job is None or cell.error is not None else cell.job.key,
        error=cell.error,
    )
