"""``stillpoint experiment``: the table, and the experiments of Asghari et al. 2018 with few trials."""

import json
import re
from functools import cache
from importlib import import_module

import pytest

from stillpoint.scripts.verbs.experiment import EXPERIMENTS
from stillpoint.studies.papers.spin.page import make_spin_page
from stillpoint.studies.papers.spin.study import (
    CONSTANT,
    METRICS,
    OF_PAPER,
    VARIABLE,
    Trial,
    count_in_order,
    count_wins,
    find_worst,
    run_trial,
)


@cache
def run_glitch_trial(seed: int, online: bool) -> Trial:
    """A trial of the constant scenario, which several tests look at."""
    return run_trial(CONSTANT, "glitch", seed, online)


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_experiment_is_there_and_explains_itself(name, call, capsys):
    module, function = EXPERIMENTS[name][0].split(":")
    assert getattr(import_module(f"stillpoint.scripts.verbs.experiments.{module}"), function).__doc__
    assert call("experiment", name, "--help") == 0
    assert "--out" in capsys.readouterr().out


def test_an_unknown_experiment_is_answered_with_those_there_are(call, capsys):
    assert call("experiment", "spin-fast") == 2
    assert "spin-constant" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "online"), [pytest.param("spin-constant", False, marks=pytest.mark.ink), ("spin-variable", True)]
)
def test_a_page_has_the_figures_of_the_paper_and_ours(name, online, call, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    flags = ["--online"] if online else []
    assert call("experiment", name, *flags, "--noise", "glitch", "--trials", "2", "-j", "x.json") == 2  # no such flag
    assert list(tmp_path.iterdir()) == []
    assert call("experiment", name, *flags, "--noise", "glitch", "--trials", "2", "--json", "x.json") == 0
    rows = json.loads((tmp_path / "x.json").read_text())["rows"]
    methods = ["observation", "EKF", "AEKF", "guarded", *([] if online else ["smoother"])]
    assert [(row["seed"], row["method"]) for row in rows] == [
        (seed, method) for seed in ((10, 11) if online else (0, 1)) for method in methods
    ]
    assert all(row["error"] is None for row in rows)
    page = (tmp_path / f"{name}{'-online' if online else ''}.experiment.html").read_text()
    scenario = {"spin-constant": CONSTANT, "spin-variable": VARIABLE}[name]
    for value in scenario.printed[online].worst.values():
        assert f"<td>{value:.2f}</td>" in page
    largest = max(row["angle_max_deg"] for row in rows if row["method"] == "guarded")
    assert f"<td>{largest:.2f}</td>" in page
    assert page.count("<svg") == 2 * 5
    assert not re.search(r"""(src|href)=["'](?!data:|#)""", page), "the page needs nothing but itself"
    assert "the worst of 2 trials" in capsys.readouterr().out


def test_a_wrong_number_gives_one_line_error(call, capsys):
    assert call("experiment", "spin-constant", "--trials", "0") == 2
    assert "give 1 trial or more" in capsys.readouterr().err


@pytest.mark.slow
def test_online_is_single_precision_and_nearly_the_same():
    """The paper's microcontroller computes in float32, which is 0.01 deg of 2 after 30 s."""
    offline, online = (run_glitch_trial(0, online) for online in (False, True))
    assert "smoother" in offline.scores
    assert "smoother" not in online.scores
    for method in online.scores:
        for metric in METRICS:
            one, other = (getattr(made.scores[method], metric) for made in (offline, online))
            assert one == pytest.approx(other, rel=0.01, abs=0.01)
            assert one != other


@pytest.mark.slow
def test_the_order_and_the_wins_are_counted():
    trials = [run_glitch_trial(seed, True) for seed in (0, 1)]
    assert count_in_order(trials, "rate_rmse_degps", OF_PAPER) == 2
    assert count_in_order(trials, "rate_rmse_degps", tuple(reversed(OF_PAPER))) == 0
    assert count_wins(trials, "rate_max_degps", OF_PAPER) == {"observation": 0, "EKF": 0, "AEKF": 2}
    assert find_worst(trials, "EKF", "rate_max_degps") == max(one.scores["EKF"].rate_max_degps for one in trials)
    assert find_worst([Trial("glitch", 0, {}, {"smoother": "needs gtsam"})], "smoother", "angle_max_deg") is None


@pytest.mark.slow
def test_as_printed_the_ekf_of_the_variable_scenario_is_the_observation():
    """K H = 0.999: one reading of Q does not fit both scenarios."""
    made = run_trial(VARIABLE, "white", 0, online=True, reading="printed").scores
    assert made["EKF"].rate_rmse_degps == pytest.approx(made["observation"].rate_rmse_degps, rel=0.005)
    ours = run_trial(VARIABLE, "white", 0, online=True).scores
    assert ours["EKF"].rate_rmse_degps < 0.5 * ours["observation"].rate_rmse_degps


@pytest.mark.slow
def test_the_page_says_of_the_vibration_what_its_table_counts():
    trials = [run_trial(CONSTANT, "vibration", seed, online=True) for seed in (0, 1)]
    page = make_spin_page(CONSTANT, {"vibration": trials}, True, "command")
    for metric, name in (("rate_rmse_degps", "RMSE"), ("rate_max_degps", "largest error")):
        counts = ", ".join(f"{method} in {n}" for method, n in count_wins(trials, metric, OF_PAPER).items() if n)
        assert f"the least {name} of the rate has {counts}" in page
