"""Does a reference judge estimators as optical truth does?

Every estimator is scored twice on the same samples: against independent truth and against a judge that needs none. The
judges are the reference methods and the offline estimators. Three figures say how well a judge replaces truth: the tau
of Kendall of the two rankings, the relative difference of the RMSE, and how many verdicts by the rule of the
leaderboard are contradicted by truth.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.files.result_store import ResultStore
from stillpoint.datasets.recording import Floats
from stillpoint.filters.table import ESTIMATORS
from stillpoint.scoring import AlignKind
from stillpoint.smoother import METHODS
from stillpoint.studies.job_runner import JobRunner, run_here
from stillpoint.studies.leaderboard.board import Source
from stillpoint.studies.leaderboard.cells import Cell, Line, list_lines, make_estimates, plan_cells, score_cells
from stillpoint.studies.leaderboard.entrants import find_entrants, list_default_estimators
from stillpoint.studies.leaderboard.files import drop_trajectories
from stillpoint.studies.leaderboard.judges import TRUTH, JudgeSpec, judge_by_truth
from stillpoint.studies.leaderboard.ranking import ScoredRuns
from stillpoint.studies.leaderboard.references import KeptReference, find_references
from stillpoint.studies.leaderboard.series import RESULTS
from stillpoint.studies.leaderboard.sources import number_rows, survey_sources
from stillpoint.studies.leaderboard.study import NONE
from stillpoint.studies.leaderboard.verdicts import PairTable, compare_pairs, merge_rows

_SPLITS = 120  # random halves of the rows
_LEAST_ROWS_IN_HALF = 2
_SEED = 0


@dataclass(frozen=True)
class JudgedTwice:
    """One estimator on one recording, against truth and against one judge; None where one of them failed."""

    recording: str
    estimator: str
    judge: str
    truth_rmse_deg: float | None
    judge_rmse_deg: float | None
    error: str | None = None


@dataclass(frozen=True)
class JudgeFidelity:
    """How well one judge replaces truth."""

    judge: str
    recordings: int  # that the judge could judge, with at least two estimators
    failed: int  # recordings without this judge
    tau_pooled: float | None  # over all pairs of estimators within recordings
    tau_median: float | None  # over recordings
    tau_worst: float | None
    relative_rmse_median: float | None  # of |RMSE by the judge / RMSE by truth - 1|
    relative_rmse_p95: float | None
    verdicts: int  # pairs that the leaderboard's rule decides by the judge
    wrong_verdicts: int  # of which truth on the same recordings says the opposite
    verdicts_other_half: int  # decided by the judge on random halves of the rows
    wrong_verdicts_other_half: int  # of which truth on the other half says the opposite
    bias: Mapping[str, float] = field(default_factory=dict)  # geometric mean of judge / truth, by estimator


@dataclass(frozen=True)
class Fidelity:
    """The judges, and the scores behind them."""

    judges: tuple[JudgeFidelity, ...]
    rows: tuple[JudgedTwice, ...]
    align: str
    recordings: int  # with truth

    def to_json(self) -> dict[str, Any]:
        """Return plain values for a JSON file."""
        return {**asdict(self), "judges": list(map(asdict, self.judges)), "rows": list(map(asdict, self.rows))}


def _list_default_judges() -> list[str]:
    """Return every reference method, and every offline estimator whose package is installed."""
    return [*METHODS, *(name for name in list_default_estimators() if ESTIMATORS[name].offline)]


def measure_fidelity(
    recordings: Sequence[Path | str],
    estimators: Sequence[str] = (),
    out: Path | str = "fidelity",
    *,
    judges: Sequence[str] = (),
    align: AlignKind = "heading",
    run_jobs: JobRunner = run_here,
) -> Fidelity:
    """Score estimators against truth and against each judge, and compare.

    Recordings without truth are left out. Results are kept in ``out`` as those of a leaderboard. Raises
    :class:`BadParameter` when no recording has truth.
    """
    folder = Path(out)
    store = ResultStore(folder / RESULTS)
    files = drop_trajectories([Path(file) for file in recordings])
    sources = [source for source in survey_sources(files, store) if source.truth and source.error is None]
    if not sources:
        raise BadParameter("no recording has independent truth; fidelity compares with it")
    names = list(dict.fromkeys(judges or _list_default_judges()))
    entrants = find_entrants(list(dict.fromkeys([*(estimators or list_default_estimators())])), [])
    offline = [name for name in names if name not in METHODS]
    lines = list_lines(find_entrants(list(dict.fromkeys([*(e.spelling for e in entrants), *offline])), []), [NONE])
    cells = make_estimates(list(plan_cells(sources, lines, {}, store)), store, run_jobs)
    scored = {TRUTH: score_cells(cells, {s.recording: judge_by_truth(s) for s in sources}, align, store, run_jobs)}
    for name in names:
        specs = _find_judges(name, sources, cells, folder, store, run_jobs)
        scored[name] = score_cells(cells, specs, align, store, run_jobs)
    wanted = [line for line in lines if line.entrant.target in {entrant.target for entrant in entrants}]
    found = [_measure(name, scored[TRUTH], scored[name], sources, wanted) for name in names]
    return Fidelity(
        judges=tuple(fidelity for fidelity, _ in found),
        rows=tuple(row for _, rows in found for row in rows),
        align=align,
        recordings=len(sources),
    )


def find_tau(truth_deg: Floats, judge_deg: Floats) -> tuple[int, int]:
    """Return concordant minus discordant pairs, and all pairs, of two RMSE (E,) of the same estimators."""
    upper = np.triu_indices(len(truth_deg), 1)
    signs = np.sign(np.subtract.outer(truth_deg, truth_deg)) * np.sign(np.subtract.outer(judge_deg, judge_deg))
    return int(signs[upper].sum()), len(upper[0])


def count_wrong(verdicts: PairTable, truth_deg: Floats) -> tuple[int, int]:
    """Return how many pairs are decided, and in how many truth (R, E) has the other one better on the mean."""
    middle = np.log(truth_deg).mean(0)
    worse = middle[:, None] > middle
    return int(verdicts.better.sum()), int((verdicts.better & worse).sum())


def _find_judges(
    name: str, sources: Sequence[Source], cells: Sequence[Cell], out: Path, store: ResultStore, run_jobs: JobRunner
) -> dict[str, JudgeSpec | str]:
    """Return the judge of each recording, read at the truth's stamps, or the reason why there is none."""
    if name in METHODS:
        references = find_references(sources, out, store, run_jobs, name)
        return {recording: _specify_reference_judge(reference) for recording, reference in references.items()}
    found: dict[str, JudgeSpec | str] = {}
    for cell in cells:
        if cell.line.entrant.target == name:
            key = None if cell.job is None else cell.job.key
            spec = JudgeSpec(name, str(key), estimate_key=key, at_truth=True)
            found[cell.source.recording] = spec if cell.error is None else cell.error
    return found


def _specify_reference_judge(reference: KeptReference) -> JudgeSpec | str:
    if reference.file is None:
        return f"no reference: {reference.error}"
    return JudgeSpec(f"reference ({reference.method})", reference.sha256, reference.file, at_truth=True)


def _measure(
    judge: str, by_truth: ScoredRuns, by_judge: ScoredRuns, sources: Sequence[Source], lines: Sequence[Line]
) -> tuple[JudgeFidelity, list[JudgedTwice]]:
    """Compare the scores by one judge with those by truth; an offline estimator does not judge itself."""
    labels = [line.label for line in lines if line.entrant.target != judge]
    rows = [_make_row(judge, source.recording, label, by_truth, by_judge) for source in sources for label in labels]
    judged = [s for s in sources if sum(r.error is None for r in rows if r.recording == s.recording) >= 2]
    complete = [
        label for label in labels if all(r.error is None for r in rows if r.estimator == label and _is_in(r, judged))
    ]
    concordance = [_compute_tau(rows, source.recording) for source in judged]
    taus = [net / pairs for net, pairs in concordance]
    relative = [abs(r.judge_rmse_deg / r.truth_rmse_deg - 1) for r in rows if r.judge_rmse_deg and r.truth_rmse_deg]
    verdicts = _judge_verdicts(by_truth, by_judge, judged, complete) if judged and complete else (0, 0, 0, 0)
    fidelity = JudgeFidelity(
        judge=judge,
        recordings=len(judged),
        failed=len(sources) - len(judged),
        tau_pooled=sum(net for net, _ in concordance) / sum(pairs for _, pairs in concordance) if judged else None,
        tau_median=float(np.median(taus)) if taus else None,
        tau_worst=min(taus) if taus else None,
        relative_rmse_median=float(np.median(relative)) if relative else None,
        relative_rmse_p95=float(np.percentile(relative, 95)) if relative else None,
        verdicts=verdicts[0],
        wrong_verdicts=verdicts[1],
        verdicts_other_half=verdicts[2],
        wrong_verdicts_other_half=verdicts[3],
        bias=_find_bias(rows, labels),
    )
    return fidelity, rows


def _judge_verdicts(
    by_truth: ScoredRuns, by_judge: ScoredRuns, sources: Sequence[Source], labels: Sequence[str]
) -> tuple[int, int, int, int]:
    """Return decided and wrong pairs, on the same rows and on the other half of random splits."""
    names, row_of = [source.recording for source in sources], number_rows(sources)
    truth = np.exp(merge_rows(np.log(by_truth.rmse_deg(names, labels, "total")), row_of))
    judge = np.exp(merge_rows(np.log(by_judge.rmse_deg(names, labels, "total")), row_of))
    own = by_judge.judge_sd(names, labels, "total")
    sd = None if own is None else merge_rows(own, row_of)
    verdicts, wrong = count_wrong(compare_pairs(judge, sd), truth)
    others = [
        count_wrong(compare_pairs(judge[half], None if sd is None else sd[half]), truth[rest])
        for half, rest in _split(len(truth))
    ]
    return verdicts, wrong, sum(n for n, _ in others), sum(n for _, n in others)


def _split(rows: int) -> Iterator[tuple[Any, Any]]:
    """Yield random halves of the rows, and the rows of the other half; none where a half would be too small."""
    if rows // 2 < _LEAST_ROWS_IN_HALF:
        return
    rng = np.random.default_rng(_SEED)
    for _ in range(_SPLITS):
        order = rng.permutation(rows)
        yield order[: rows // 2], order[rows // 2 :]


def _make_row(judge: str, recording: str, label: str, by_truth: ScoredRuns, by_judge: ScoredRuns) -> JudgedTwice:
    """Return the RMSE in deg of an estimator on a recording by the truth and by another judge."""
    truth, other = by_truth.runs[recording, label], by_judge.runs[recording, label]
    return JudgedTwice(recording, label, judge, truth.total_rmse_deg, other.total_rmse_deg, truth.error or other.error)


def _compute_tau(rows: Sequence[JudgedTwice], recording: str) -> tuple[int, int]:
    """Return concordant minus discordant pairs of estimators on one recording, and all pairs."""
    mine = [row for row in rows if row.recording == recording and row.error is None]
    truth = np.array([row.truth_rmse_deg for row in mine], dtype=np.float64)
    return find_tau(truth, np.array([row.judge_rmse_deg for row in mine], dtype=np.float64))


def _find_bias(rows: Sequence[JudgedTwice], labels: Sequence[str]) -> dict[str, float]:
    """Return the geometric mean of RMSE by the judge over RMSE by truth, by estimator."""
    bias = {}
    for label in labels:
        ratios = [
            row.judge_rmse_deg / row.truth_rmse_deg
            for row in rows
            if row.estimator == label and row.judge_rmse_deg and row.truth_rmse_deg
        ]
        if ratios:
            bias[label] = float(stats.gmean(ratios))
    return bias


def _is_in(row: JudgedTwice, sources: Sequence[Source]) -> bool:
    return any(row.recording == source.recording for source in sources)
