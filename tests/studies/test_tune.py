"""Tuning: the choice from a table of trials, resuming, and the file that the leaderboard uses."""

from dataclasses import replace

import numpy as np
import pytest

from stillpoint.datasets import BadParameter, read, write
from stillpoint.datasets.simulate import simulate
from stillpoint.filters import estimate
from stillpoint.studies.leaderboard import leaderboard
from stillpoint.studies.tune import ParamRange, find_left_out, format_tuning, tune

optuna = pytest.importorskip("optuna")
RANGE = ParamRange("omega0_radps", 0.05, 2.0, log=True)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    place = tmp_path_factory.mktemp("recordings")
    for seed in (0, 1):
        made = simulate("phone-3", seed=seed, minutes=1.5, rate_hz=50)
        extra = {**made.info.extra, "motion": f"motion {seed}"}  # two motions: one may be left out
        write(place / f"run{seed}.mcap", replace(made, info=replace(made.info, extra=extra)))
    return sorted(place.glob("*.mcap"))


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    return tmp_path_factory.mktemp("tune")


@pytest.fixture(scope="module")
def tuning(files, out):
    return tune(files, "cf", [RANGE], out, sampler="grid", steps=4)


@pytest.mark.slow
def test_grid_tries_every_point_once(tuning):
    tried = sorted(trial.params["omega0_radps"] for trial in tuning.trials)
    np.testing.assert_allclose(tried, np.geomspace(0.05, 2.0, 4))


def test_common_setting_is_the_least_geometric_mean(tuning):
    typical = [np.exp(np.log(trial.rmse_deg).mean()) for trial in tuning.trials]
    assert tuning.best.typical_deg == pytest.approx(min(typical))
    assert tuning.best.typical_deg <= np.exp(np.mean(np.log(tuning.left_out_deg))) + 1e-12, (
        "the others choose no better"
    )
    own = [trial.rmse_deg[k] for k, trial in enumerate(tuning.best_per_recording)]
    assert all(mine <= common for mine, common in zip(own, tuning.best.rmse_deg, strict=True))


def test_second_call_runs_no_trial(files, out, tuning, monkeypatch):
    monkeypatch.setattr("stillpoint.studies.tune.compare", None)
    monkeypatch.setattr("stillpoint.studies.tune._Bench.evaluate", lambda self, params: list(tuning.defaults.rmse_deg))
    again = tune(files, "cf", [RANGE], out, sampler="grid", steps=4)
    assert again.trials == tuning.trials
    assert (tuning.new_trials, again.new_trials) == (4, 0)


def test_tpe_goes_on_to_the_number_asked_for(files, tmp_path):
    assert len(tune(files[:1], "cf", [RANGE], tmp_path, trials=3).trials) == 3
    more = tune(files[:1], "cf", [RANGE], tmp_path, trials=5)
    assert len(more.trials) == 5


@pytest.mark.slow
def test_seconds_score_no_more_than_that_stretch(files, tuning, tmp_path):
    cut = tune(files, "cf", [RANGE], tmp_path, sampler="grid", steps=4, seconds=20.0)
    assert cut.tuned_on.startswith("tuned on the first 20 s of motion of 2 recordings")
    assert cut.trials != tuning.trials, "another stretch has other errors"
    whole = tune(files, "cf", [RANGE], tmp_path, sampler="grid", steps=4, seconds=3600.0)
    begins_late = [np.argmax(read(file).truth.moving) > 0 for file in files]
    assert begins_late == [True, True], "otherwise the estimator would start at the same sample"
    assert whole.new_trials == 4, "trials of another stretch are not taken for these"


@pytest.mark.parametrize("seconds", [0.0, -1.0, float("nan")])
def test_seconds_must_be_above_0(files, tmp_path, seconds):
    with pytest.raises(BadParameter, match="--seconds"):
        tune(files, "cf", [RANGE], tmp_path, seconds=seconds)


def test_saved_setting_is_what_the_leaderboard_runs(files, tuning, tmp_path):
    saved = tmp_path / "mine.toml"
    saved.write_text(format_tuning(tuning))
    board = leaderboard(files, ["cf", f"cf@{saved}"], tmp_path / "out")
    rows = {row.estimator: row for row in board.tables[0].rows}
    assert rows["cf"].parameters == "defaults"
    assert rows["cf@mine"].parameters == tuning.tuned_on
    used = {run.parameters["omega0_radps"] for run in board.runs if run.estimator == "cf@mine"}
    assert used == {tuning.best.params["omega0_radps"]}


def test_parameters_of_another_estimator_are_refused(files, tuning, tmp_path):
    saved = tmp_path / "mine.toml"
    saved.write_text(format_tuning(tuning))
    with pytest.raises(BadParameter, match="holds parameters of cf"):
        leaderboard(files, [f"ekf@{saved}"], tmp_path / "out")


def test_left_out_uses_the_setting_chosen_on_the_others():
    rmse = np.array([[1.0, 9.0, 9.0], [5.0, 2.0, 3.0], [2.0, 8.0, 1.0]])
    assert find_left_out(rmse, [0, 1, 2]) == [5.0, 8.0, 9.0]
    assert find_left_out(rmse, [0, 1, 1]) == [5.0, 9.0, 9.0], "repetitions of a motion are left out together"


def test_nothing_is_left_of_a_single_row():
    assert np.isnan(find_left_out(np.array([[1.0], [2.0]]), [0])).all()


@pytest.mark.parametrize("text", ["x", "x=1", "x=2:1", "x=0:1:log", "x=1:2:cubic", "=1:2", "x=1:2:log:3"])
def test_wrong_range_says_how_to_write_it(text):
    with pytest.raises(BadParameter, match="--param"):
        ParamRange.parse(text)


def test_range_beyond_what_the_parameter_allows_is_refused(files, tmp_path):
    with pytest.raises(BadParameter, match="omega0_radps"):
        tune(files, "cf", [ParamRange("omega0_radps", 0.1, 1e9)], tmp_path)


def test_estimates_while_starting_count(files, tuning):
    """A setting that starts slowly must not be scored on fewer samples."""
    made = estimate(read(files[0]), "cf", {"omega0_radps": 0.05})
    assert made.ready is not None
    assert not made.ready.all(), "otherwise this test says nothing"
    assert all(np.isfinite(trial.rmse_deg).all() for trial in tuning.trials)
