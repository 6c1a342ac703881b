"""The statistics of a leaderboard against hand-worked cases, simulation and textbook values."""

import numpy as np
import pytest
from scipy import stats

from stillpoint.studies.leaderboard.verdicts import (
    compare_pairs,
    compute_judge_sd,
    find_ranks,
    find_typical_rmse,
    merge_rows,
)


def test_typical_rmse_is_the_geometric_mean_with_students_interval():
    rmse = np.array([[1.0], [2.0], [4.0], [8.0]])
    typical, low, high = find_typical_rmse(rmse)
    logs = np.log(rmse[:, 0])
    half = stats.t.ppf(0.975, 3) * logs.std(ddof=1) / 2
    assert typical[0] == pytest.approx(np.sqrt(8))
    assert (low[0], high[0]) == pytest.approx((np.sqrt(8) * np.exp(-half), np.sqrt(8) * np.exp(half)))


def test_clear_difference_is_called_and_a_small_one_never():
    rng = np.random.default_rng(0)
    base = np.exp(rng.normal(0, 0.5, 12))
    rmse = np.stack([base, base * 1.5 * np.exp(rng.normal(0, 0.02, 12)), base * 1.03], axis=1)
    found = compare_pairs(rmse)
    assert found.better[0, 1]
    assert not found.better[1, 0]
    assert not found.better[0, 2], "3 % is below the bias of a reference"
    assert found.ratio[0, 2] == pytest.approx(1 / 1.03)
    assert found.general


def test_fewer_than_four_rows_say_nothing_general():
    assert not compare_pairs(np.array([[1.0, 2.0]] * 3)).general


def test_equal_estimators_are_rarely_called_different():
    rng = np.random.default_rng(1)
    wrong = sum(compare_pairs(np.exp(rng.normal(0, 0.3, (12, 8)))).better.any() for _ in range(300))
    assert wrong / 300 < 0.12, "Benjamini-Hochberg at 10 % bounds tables with any false call"


def test_interval_covers_the_true_ratio():
    rng = np.random.default_rng(2)
    covered = []
    for _ in range(600):
        found = compare_pairs(np.exp(rng.normal([0.0, 0.1], 0.3, (9, 2))))
        covered.append(found.low[0, 1] <= np.exp(-0.1) <= found.high[0, 1])
    assert 0.93 < np.mean(covered) < 0.97, "95 % within the scatter of 600 draws"


def test_interval_is_never_narrower_than_the_judge():
    judge = np.full((6, 2, 2), 0.2)
    found = compare_pairs(np.tile([1.0, 1.2], (6, 1)), judge)
    assert np.log(found.high[0, 1] / found.ratio[0, 1]) == pytest.approx(1.96 * 0.2, rel=1e-3)
    assert not found.better.any()


def test_ranks_are_ranges_over_undecided_pairs():
    better = np.zeros((3, 3), dtype=bool)
    better[0, 2] = True  # the first beats the last, the middle one is undecided
    assert find_ranks(better) == [(1, 2), (1, 3), (2, 3)]


def test_recordings_of_one_device_and_motion_are_one_row():
    logs = np.log([[1.0, 2.0], [4.0, 8.0], [3.0, 3.0]])
    np.testing.assert_allclose(merge_rows(logs, [0, 0, 1]), np.log([[2.0, 4.0], [3.0, 3.0]]))


def test_judge_sd_matches_simulated_errors_of_the_judge():
    """Draw judges with the stated covariance and correlation: log ratios scatter as stated."""
    rng = np.random.default_rng(3)
    n, sd_deg = 300, 0.3
    time_s = np.arange(n, dtype=float)
    errors = np.stack([rng.normal(0, 1.5, (n, 3)), rng.normal(0, 2.5, (n, 3))], axis=1)
    smooth = np.linalg.cholesky(np.exp(-np.abs(time_s[:, None] - time_s) / 20.0) + 1e-9 * np.eye(n))
    ratios = []
    for _ in range(400):
        seen = errors - (smooth @ rng.normal(0, sd_deg, (n, 3)))[:, None]
        rmse = np.sqrt((seen**2).sum(2).mean(0))
        ratios.append(np.log(rmse[0] / rmse[1]))
    true_rmse = np.sqrt((errors**2).sum(2).mean(0))
    stated = compute_judge_sd(errors, np.tile(sd_deg**2 * np.eye(3), (n, 1, 1)), time_s, true_rmse)
    assert stated[0, 1] == pytest.approx(np.std(ratios), rel=0.15)


def test_common_error_cancels_in_a_pair():
    errors = np.tile(np.random.default_rng(4).normal(0, 1, (50, 1, 3)), (1, 2, 1))
    sd = compute_judge_sd(errors, np.tile(np.eye(3), (50, 1, 1)), np.arange(50.0), np.ones(2))
    assert sd[0, 1] == pytest.approx(0, abs=1e-6)
    assert sd[0, 0] > 0
