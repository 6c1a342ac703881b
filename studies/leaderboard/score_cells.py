"""Score the cells of a leaderboard against the judges of their recordings, and collect the runs."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from stillpoint.scoring import AlignKind
from stillpoint.studies.leaderboard.board import Run
from stillpoint.studies.leaderboard.cells import Cell
from stillpoint.studies.leaderboard.job_runner import JobRunner
from stillpoint.studies.leaderboard.judges import JudgeSpec
from stillpoint.studies.leaderboard.ranking import ErrorSeries, JudgeSeries, ScoredRuns
from stillpoint.studies.leaderboard.scores import Entry, Scored, ScoreJob, judge_key, plan_score, score_recording
from stillpoint.studies.result_store import ResultStore


def score_cells(
    cells: Sequence[Cell],
    judges: Mapping[str, JudgeSpec | str],
    align: AlignKind,
    store: ResultStore,
    run_jobs: JobRunner,
) -> ScoredRuns:
    """Score all cells, each recording against its judge, on the samples that its estimates share."""
    jobs = _plan_scores(cells, judges, align, store)
    missing = [job for job in jobs if job.scored() is None]
    outcomes = run_jobs(score_recording, missing, "scores") if missing else []
    errors = {job.key: outcome.error for job, outcome in zip(missing, outcomes, strict=True)}
    scored: dict[tuple[str, str], Scored] = {}
    for job in jobs:
        error = errors.get(job.key) or "the scores are missing"
        found = job.scored() or [Scored(entry.label, None, error) for entry in job.entries]
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
        error=cell.error,
    )
