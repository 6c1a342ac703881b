"""Intervals, pairwise verdicts and shared ranks for a table of RMSE.

Everything is computed on the logarithm of the RMSE, so a difference is a ratio. The unit is the recording, or a group
of recordings of one device and one motion: samples within one recording share its bias, start and field, so resampling
them says nothing about other recordings.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtr, stdtrit

from stillpoint.datasets.recording import Floats

LEAST_ROWS = 4  # with fewer rows a verdict holds for these recordings only
_BORROWED_ROWS = 2  # the table's typical scatter counts as this many rows in the scatter of each pair
_LEAST_ESTIMATORS = 5  # with fewer there is no typical scatter to borrow
_FALSE_DISCOVERIES = 0.10  # Benjamini-Hochberg level; at most half of it points the wrong way
_LEAST_RATIO = 1.05  # a smaller difference is never called: the bias of a reference is of that size
_CORRELATION_S = 20.0  # over this time the error of a reference is correlated
_LEAST_RMSE_DEG = 1e-6  # keeps the logarithm finite
_LEAST_COV_DEG2 = 1e-9  # keeps the Cholesky factor of a covariance defined

Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class PairTable:
    """All pairs of E estimators: matrices (E, E), row over column."""

    ratio: Floats  # geometric mean of RMSE(row) / RMSE(column)
    low: Floats  # 95 % interval of the ratio
    high: Floats
    better: Bools  # True where the row is decidedly better than the column
    general: bool  # True: for recordings like these; False: for these recordings only


def compute_judge_sd(error_deg: Floats, cov_deg2: Floats, time_s: Floats, rmse_deg: Floats) -> Floats:
    """Return how far the reference's own error may move log(RMSE_a / RMSE_b), as standard deviations (E, E).

    The diagonal holds the effect on log(RMSE) of one estimator alone. The part of the error that two estimates have in
    common cancels in their ratio.

    Parameters
    ----------
    error_deg
        (n, E, k) mean error vectors of E estimates in n seconds, in k earth axes (3 for the total error).
    cov_deg2
        (n, k, k) covariance of the reference in these seconds and axes.
    time_s
        (n,) the seconds.
    rmse_deg
        (E,) RMSE of the estimates.
    """
    axes = cov_deg2.shape[-1]
    root = np.linalg.cholesky(cov_deg2 + _LEAST_COV_DEG2 * np.eye(axes))
    pull = np.einsum("nji,nej->nei", root, error_deg) / (len(time_s) * rmse_deg[:, None] ** 2)
    correlation = np.exp(-np.abs(time_s[:, None] - time_s) / _CORRELATION_S)
    common = np.einsum("nei,nfi->ef", pull, np.tensordot(correlation, pull, 1))
    alone = np.diag(common)
    sd = np.sqrt(np.maximum(alone[:, None] + alone - 2 * common, 0))
    mean_square = np.trace(cov_deg2, axis1=1, axis2=2).mean() / (2 * rmse_deg**2)
    np.fill_diagonal(sd, np.sqrt(alone + mean_square**2))
    return np.asarray(sd, dtype=np.float64)


def find_typical_rmse(rmse_deg: Floats, judge: Floats | None = None) -> tuple[Floats, Floats, Floats]:
    """Return the geometric mean RMSE (E,) of each estimator with the ends of its 95 % interval.

    ``rmse_deg`` (R, E); ``judge`` (R, E, E) from :func:`compute_judge_sd`, or None where independent truth judged.
    """
    logs = np.log(np.maximum(rmse_deg, _LEAST_RMSE_DEG))
    n = len(logs)
    sampling = np.zeros(logs.shape[1])
    if n >= LEAST_ROWS:
        sampling = stdtrit(n - 1, 0.975) * logs.std(0, ddof=1) / np.sqrt(n)
    own = np.zeros_like(sampling) if judge is None else np.diagonal(judge, axis1=1, axis2=2).mean(0)
    middle, half = logs.mean(0), np.maximum(sampling, ndtri(0.975) * own)
    return np.exp(middle), np.exp(middle - half), np.exp(middle + half)


def compare_pairs(rmse_deg: Floats, judge: Floats | None = None) -> PairTable:
    """Compare all pairs of a table of RMSE (R rows, E estimators) in which every estimator has every row.

    A row is decidedly better when the 95 % interval of the ratio excludes 1 (Student's t over rows, never narrower
    than the effect of the judge's own error), the ratio is beyond 5 %, and the pair passes Benjamini-Hochberg.
    ``judge`` is as in :func:`find_typical_rmse`.
    """
    logs = np.log(np.maximum(rmse_deg, _LEAST_RMSE_DEG))
    n, estimators = logs.shape
    each = logs[:, :, None] - logs[:, None, :]
    middle = each.mean(0)
    half = np.zeros_like(middle) if judge is None else ndtri(0.975) * judge.mean(0)
    np.fill_diagonal(half, 0)
    general = n >= LEAST_ROWS
    allowed = np.ones_like(half, dtype=np.bool_)
    if general:
        borrowed = _BORROWED_ROWS if estimators >= _LEAST_ESTIMATORS else 0
        error, freedom = _compute_standard_error(each, borrowed), n - 1 + borrowed
        half = np.maximum(stdtrit(freedom, 0.975) * error, half)
        allowed = _allow_discoveries(2 * stdtr(freedom, -np.abs(middle / error)))
    better = allowed & (middle < -np.maximum(half, np.log(_LEAST_RATIO)))
    return PairTable(np.exp(middle), np.exp(middle - half), np.exp(middle + half), better, general)


def find_ranks(better: Bools) -> list[tuple[int, int]]:
    """Return the best and worst rank of each estimator: 1 + those decidedly better, and E - those decidedly worse."""
    return [(1 + int(better[:, k].sum()), len(better) - int(better[k].sum())) for k in range(len(better))]


def merge_rows(values: Floats, row_of: Sequence[int]) -> Floats:
    """Average the entries (R, …) of recordings that share a row; ``row_of`` (R,) numbers the rows from 0."""
    rows = np.asarray(row_of)
    return np.stack([values[rows == k].mean(0) for k in range(rows.max() + 1)])


def _compute_standard_error(each: Floats, borrowed: int) -> Floats:
    """Return the standard error (E, E) of the mean of log ratios (R, E, E), with the table's scatter borrowed."""
    n, estimators, _ = each.shape
    spread = each.var(0, ddof=1)
    typical = np.median(spread[np.triu_indices(estimators, 1)]) if borrowed else 0.0
    spread = (borrowed * typical + (n - 1) * spread) / (borrowed + n - 1)
    return np.asarray(np.sqrt(np.maximum(spread, 1e-24) / n), dtype=np.float64)


def _allow_discoveries(chance: Floats) -> Bools:
    """Return the pairs (E, E) that pass Benjamini-Hochberg, each pair counted once."""
    from scipy.stats import false_discovery_control  # takes half a second to import, in every process of a batch

    upper = np.triu_indices(len(chance), 1)
    p = chance[upper]
    passed = np.zeros_like(chance, dtype=np.bool_)
    if len(p):
        passed[upper] = false_discovery_control(p, method="bh") <= _FALSE_DISCOVERIES
    return passed | passed.T
