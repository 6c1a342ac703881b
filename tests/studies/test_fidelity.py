"""Fidelity of a judge: hand-worked rankings, and a judge that is truth itself."""

import numpy as np
import pytest

from stillpoint.datasets import BadParameter, write
from stillpoint.datasets.simulate import simulate
from stillpoint.studies.fidelity import count_wrong, find_tau, measure_fidelity
from stillpoint.studies.leaderboard.verdicts import compare_pairs


def test_tau_counts_pairs_in_one_order_and_in_the_other():
    truth = np.array([1.0, 2.0, 3.0, 4.0])
    assert find_tau(truth, truth**2) == (6, 6)
    assert find_tau(truth, np.array([1.0, 3.0, 2.0, 4.0])) == (4, 6)
    assert find_tau(truth, truth[::-1]) == (-6, 6)


def test_verdict_that_truth_turns_round_is_wrong():
    judged = np.tile([1.0, 2.0, 4.0], (6, 1))
    truth = np.tile([1.0, 4.0, 2.0], (6, 1))
    assert count_wrong(compare_pairs(judged), truth) == (3, 1)


@pytest.fixture(scope="module")
def fidelity(tmp_path_factory):
    place = tmp_path_factory.mktemp("fidelity")
    for seed in range(2):
        write(place / f"run{seed}.mcap", simulate("phone-3", seed=seed, minutes=1.5, rate_hz=50))
    files = sorted(place.glob("*.mcap"))
    return measure_fidelity(files, ["gyro", "acc", "acc-ma"], place / "out", judges=["redistribution-earth", "graph"])


@pytest.mark.slow
def test_graph_orders_estimators_of_simulated_phones_as_truth_does(fidelity):
    judge = next(judge for judge in fidelity.judges if judge.judge == "graph")
    assert judge.recordings == 2
    assert judge.tau_worst == 1.0
    assert judge.wrong_verdicts == 0
    assert judge.relative_rmse_median < 0.1, "the estimators are several degrees off, the reference some tenths"


@pytest.mark.slow
def test_every_score_stands_in_the_rows(fidelity):
    assert len(fidelity.rows) == 2 * 3 * 2
    assert all(row.error is None for row in fidelity.rows)
    content = fidelity.to_json()
    names = {"judge", "tau_pooled", "tau_median", "tau_worst", "relative_rmse_median", "wrong_verdicts", "verdicts"}
    assert names <= set(content["judges"][0])
    assert {"judges", "rows"} <= set(content)


@pytest.mark.slow
def test_bias_is_the_ratio_of_both_scores(fidelity):
    judge = fidelity.judges[0]
    rows = [row for row in fidelity.rows if (row.judge, row.estimator) == (judge.judge, "gyro")]
    expected = np.exp(np.mean([np.log(row.judge_rmse_deg / row.truth_rmse_deg) for row in rows]))
    assert judge.bias["gyro"] == pytest.approx(expected)


def test_recordings_without_truth_are_refused(tmp_path):
    from dataclasses import replace

    write(tmp_path / "x.mcap", replace(simulate("phone-3", minutes=1.5, rate_hz=50), truth=None))
    with pytest.raises(BadParameter, match="no recording has independent truth"):
        measure_fidelity([tmp_path / "x.mcap"], ["gyro"], tmp_path / "out")


@pytest.mark.slow
def test_verb_writes_figure_and_json(call, capsys, tmp_path):
    write(tmp_path / "run0.mcap", simulate("phone-3", minutes=1.5, rate_hz=50))
    out = tmp_path / "out"
    words = ["--fidelity", "-e", "gyro,acc", "--methods", "redistribution-earth", "-o", out]
    assert call("validate", tmp_path / "run0.mcap", *words) == 0
    assert "redistribution-earth" in capsys.readouterr().out
    assert (out / "fidelity.png").stat().st_size > 1000
    assert (out / "fidelity.json").is_file()
