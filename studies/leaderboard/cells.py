"""The cells of a leaderboard: every estimator with every kind of input on every recording."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from stillpoint.datasets.errors import StillpointError
from stillpoint.studies.leaderboard.board import Row, Source
from stillpoint.studies.leaderboard.entrants import Entrant
from stillpoint.studies.leaderboard.estimates import EstimateJob, make_estimate, plan_estimate
from stillpoint.studies.leaderboard.job_runner import JobRunner
from stillpoint.studies.leaderboard.references import References
from stillpoint.studies.leaderboard.study import NONE, REFERENCE
from stillpoint.studies.result_store import ResultStore


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
    return [_with_error(cell, errors, store) for cell in cells]


def _with_error(cell: Cell, errors: dict[str, str | None], store: ResultStore) -> Cell:
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
    return {NONE: "raw", REFERENCE: "calibrated"}.get(calibration, Path(calibration).name.partition(".")[0])
