"""From scored runs to a table: typical errors, verdicts on pairs, shared ranks, and the sentence below."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import combinations
from statistics import fmean, median
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.recording import Floats
from stillpoint.filters.table import ESTIMATORS, Peer
from stillpoint.studies.leaderboard.board import Pair, RankedBy, Row, Run, Source, Summary, Table, Verdict
from stillpoint.studies.leaderboard.conclusion import write_conclusion
from stillpoint.studies.leaderboard.sources import number_rows
from stillpoint.studies.leaderboard.verdicts import (
    LEAST_ROWS,
    PairTable,
    compare_pairs,
    compute_judge_sd,
    find_ranks,
    find_typical_rmse,
    merge_rows,
)

_AXES: dict[RankedBy, list[int]] = {"total": [0, 1, 2], "heading": [2], "inclination": [0, 1]}  # of East-North-Up
_TRUTH = "truth"


@dataclass(frozen=True, eq=False)
class ErrorSeries:
    """Mean error vectors of a run per bin of time, in deg about East-North-Up."""

    bins_ns: NDArray[np.int64]  # (n,)
    error_n_deg: Floats  # (n, 3)


@dataclass(frozen=True, eq=False)
class JudgeSeries:
    """Covariance of a reference per bin of time."""

    bins_ns: NDArray[np.int64]  # (n,)
    cov_n_deg2: Floats  # (n, 3, 3)


@dataclass(frozen=True, eq=False)
class ScoredRuns:
    """The runs of a table by (recording, label), with what the effect of the judge's error is computed from."""

    runs: Mapping[tuple[str, str], Run]
    errors: Mapping[tuple[str, str], ErrorSeries]
    judges: Mapping[str, JudgeSeries]  # by recording; those judged by truth are missing

    def rmse_deg(self, recordings: Sequence[str], labels: Sequence[str], figure: RankedBy) -> Floats:
        """Return the RMSE (R, E)."""
        return np.array(
            [[getattr(self.runs[name, label], f"{figure}_rmse_deg") for label in labels] for name in recordings]
        ).reshape(len(recordings), len(labels))

    def judge_sd(self, recordings: Sequence[str], labels: Sequence[str], figure: RankedBy) -> Floats | None:
        """Return the effect (R, E, E) of the judge's error on log ratios; None where truth judged everything."""
        if not any(name in self.judges for name in recordings):
            return None
        rmse = self.rmse_deg(recordings, labels, figure)
        sd = np.zeros((len(recordings), len(labels), len(labels)))
        for k, name in enumerate(recordings):
            if name in self.judges:
                sd[k] = self._compute_judge_sd(name, labels, _AXES[figure], rmse[k])
        return sd

    def _compute_judge_sd(self, name: str, labels: Sequence[str], axes: list[int], rmse_deg: Floats) -> Floats:
        """Return the standard deviation (E, E) of log ratios between estimators that the judge's own errors cause."""
        judge, series = self.judges[name], [self.errors[name, label] for label in labels]
        common = reduce(np.intersect1d, [judge.bins_ns, *(one.bins_ns for one in series)])
        error = np.stack([one.error_n_deg[np.searchsorted(one.bins_ns, common)] for one in series], axis=1)
        cov = judge.cov_n_deg2[np.searchsorted(judge.bins_ns, common)]
        return compute_judge_sd(error[:, :, axes], cov[:, axes][:, :, axes], common / 1e9, np.maximum(rmse_deg, 1e-6))


def build_tables(name: str, runs: ScoredRuns, sources: Sequence[Source], rows: Sequence[Row]) -> list[Table]:
    """Rank the rows. Without a magnetometer heading and total error have no meaning, so such rows are ranked apart.

    Rows with the same input (``calibration``) stay together. Rows that may be ranked by the total error come first.
    """
    names = [source.recording for source in sources]
    lacking = {row.calibration for row in rows if any(runs.runs[n, row.label].magnetometer_left_out for n in names)}
    parts = [[row for row in rows if (row.calibration in lacking) is lacks] for lacks in (False, True)]
    return [_build_table(name, runs, sources, part) for part in parts if part]


def _build_table(name: str, runs: ScoredRuns, sources: Sequence[Source], rows: Sequence[Row]) -> Table:
    """Rank the estimators of ``rows`` (of which only the names are used) over the recordings of ``sources``.

    Recordings on which every estimator failed do not count. An estimator that failed on one of the others, or whose
    heading has no meaning in a ranking of the total error, is listed without a rank, and takes part in no pair.
    """
    labels = [row.label for row in rows]
    counted = [s for s in sources if any(runs.runs[s.recording, label].error is None for label in labels)]
    names = [source.recording for source in counted]
    row_of = number_rows(counted)
    failed = {label: [n for n in names if runs.runs[n, label].error is not None] for label in labels}
    ranked_by, why = _choose_figure(runs, names, labels)
    ranked = [
        row.label
        for row in rows
        if names and not failed[row.label] and (ranked_by == "inclination" or _has_heading(row))
    ]
    pairs, ranks = _compare_ranked(runs, names, row_of, ranked, ranked_by)
    filled = [_fill_row(row, runs, counted, failed[row.label], ranks.get(row.label)) for row in rows]
    against = _name_judges(runs, names, labels)
    table = Table(
        name=name,
        against=against,
        ranked_by=ranked_by,
        why_ranked_by=why,
        rows=tuple(sorted(filled, key=lambda row: _make_sort_key(row, ranked_by))),
        pairs=tuple(_name_pairs(pairs, ranked, against)) if pairs else (),
        general=len(set(row_of)) >= LEAST_ROWS,
        independent_rows=len(set(row_of)),
        recordings=tuple(names),
        conclusion="",
    )
    return write_conclusion(table, counted, [s.recording for s in sources if s.recording not in names])


def _compare_ranked(
    runs: ScoredRuns, names: Sequence[str], row_of: Sequence[int], ranked: Sequence[str], figure: RankedBy
) -> tuple[PairTable | None, dict[str, tuple[int, int]]]:
    """Return the comparison of all pairs of ranked estimators, and the range of ranks of each."""
    if not ranked:
        return None, {}
    rmse = np.exp(merge_rows(np.log(np.maximum(runs.rmse_deg(names, ranked, figure), 1e-6)), row_of))
    judge = runs.judge_sd(names, ranked, figure)
    found = compare_pairs(rmse, None if judge is None else merge_rows(judge, row_of))
    return found, dict(zip(ranked, find_ranks(found.better), strict=True))


def _fill_row(
    row: Row, runs: ScoredRuns, sources: Sequence[Source], failed: Sequence[str], rank: tuple[int, int] | None
) -> Row:
    """Return a row of the table with rank, counts and figures over its recordings."""
    scored = [source for source in sources if source.recording not in failed]
    mine = [runs.runs[source.recording, row.label] for source in scored]
    figures: dict[str, Any] = {
        "rank": rank,
        "recordings": len(sources),
        "failed": len(failed),
        "against": " and ".join(sorted({_find_kind(run.against) for run in mine}, reverse=True)),
        "ns_per_sample": _apply_to_known(median, [run.ns_per_sample for run in mine]),
        "nees_per_dof": _apply_to_known(fmean, [run.nees_per_dof for run in mine]),
        "coverage95": _apply_to_known(fmean, [run.coverage95 for run in mine]),
    }
    for figure in _AXES:
        figures[f"{figure}_rmse_deg"] = _summarise(runs, scored, row.label, figure) if scored else None
    return replace(row, **figures)


def _summarise(runs: ScoredRuns, sources: Sequence[Source], label: str, figure: RankedBy) -> Summary:
    """Return typical, mean, median and worst RMSE in deg of an estimator over recordings."""
    names, row_of = [source.recording for source in sources], number_rows(sources)
    rmse = runs.rmse_deg(names, [label], figure)
    judge = runs.judge_sd(names, [label], figure)
    merged = np.exp(merge_rows(np.log(np.maximum(rmse, 1e-6)), row_of))
    typical, low, high = find_typical_rmse(merged, None if judge is None else merge_rows(judge, row_of))
    return Summary(
        typical=float(typical[0]),
        ci95=(float(low[0]), float(high[0])),
        mean=float(rmse.mean()),
        median=float(np.median(rmse)),
        worst=float(rmse.max()),
    )


def _name_pairs(found: PairTable, labels: Sequence[str], against: str) -> list[Pair]:
    """Return the comparison of each pair of estimators with its verdict."""
    pairs = []
    for j, k in combinations(range(len(labels)), 2):
        verdict: Verdict = "a" if found.better[j, k] else "b" if found.better[k, j] else "undecided"
        interval = (float(found.low[j, k]), float(found.high[j, k]))
        pairs.append(Pair(labels[j], labels[k], against, float(found.ratio[j, k]), interval, verdict))
    return pairs


def _choose_figure(runs: ScoredRuns, names: Sequence[str], labels: Sequence[str]) -> tuple[RankedBy, str]:
    """Return what to rank by: not the heading of estimators that were not given the magnetometer."""
    left_out = [name for name in names if any(runs.runs[name, label].magnetometer_left_out for label in labels)]
    if not left_out:
        return "total", ""
    concerned = [label for label in labels if any(runs.runs[name, label].magnetometer_left_out for name in left_out)]
    whose = "their" if len(concerned) < len(labels) else "the estimators'"
    return "inclination", (
        f"the magnetometer is not calibrated and was left out for {len(concerned)} of {len(labels)} rows on "
        f"{len(left_out)} of {len(names)} recordings, so {whose} heading and total error say nothing; "
        "--calibration reference corrects it"
    )


def _has_heading(row: Row) -> bool:
    entry = ESTIMATORS.get(row.estimator)
    return not isinstance(entry, Peer) or entry.has_heading


def _name_judges(runs: ScoredRuns, names: Sequence[str], labels: Sequence[str]) -> str:
    """Return the kinds of judge of these runs in words."""
    kinds = {_find_kind(runs.runs[name, label].against) for name in names for label in labels}
    return " and ".join(sorted(kinds, reverse=True)) or _TRUTH


def _find_kind(judge: str) -> str:
    """Return "reference" for "reference (graph)"."""
    return judge.partition(" (")[0]


def _apply_to_known(function: Any, values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(function(known)) if known else None


def _make_sort_key(row: Row, figure: RankedBy) -> tuple[bool, tuple[int, int], float]:
    """Return ranked rows first, by rank, then by the typical error."""
    summary: Summary | None = getattr(row, f"{figure}_rmse_deg")
    return row.rank is None, row.rank or (0, 0), float("inf") if summary is None else summary.typical
