"""``stillpoint experiment auv-dolphin``: the figures of a mission, and the page that shows them."""

import json
from dataclasses import asdict

import numpy as np
import pytest

from stillpoint.datasets.frames import euler
from stillpoint.datasets.simulate import simulate
from stillpoint.filters import estimate
from stillpoint.studies.papers.auv.study import (
    ADAPTIVE,
    GYRO,
    METHODS,
    RAW,
    Series,
    compute_figures,
    compute_measured_deg,
    run_trial,
    stream_estimate,
    summarise_trials,
)

PHASES = {"dive_s": 100.0, "cruise_s": 140.0, "ascent_s": 740.0, "surfaced_s": 780.0, "end_s": 880.0}


@pytest.fixture(scope="module")
def calm():
    """One mission in a calm sea."""
    return run_trial("calm", 0)


def series(estimated, true=None, measured=None):
    """A mission of nothing at 10 Hz, with one estimate."""
    t_s = np.arange(0, 880, 0.1)
    true = np.zeros((len(t_s), 3)) if true is None else true
    measured = np.zeros((len(t_s), 2)) if measured is None else measured
    return Series(t_s, true, measured, {"x": estimated(t_s)}, t_s[:1], t_s[:1], {}, PHASES, true)


def test_errors_of_an_angle_are_taken_where_they_count():
    def estimated(t_s):
        surface = (t_s < 100) | (t_s > 780)
        roll = np.where(surface, 3.0, -0.5) * (t_s > 20)  # the start is right, and does not count
        return np.column_stack([roll, np.full(len(t_s), 2.0), np.zeros(len(t_s))])

    found = compute_figures(series(estimated), "x")
    assert found.surface_roll_rmse_deg == pytest.approx(3.0)
    assert found.below_roll_rmse_deg == pytest.approx(0.5)
    assert found.pitch_rmse_deg == pytest.approx(2.0)
    assert found.pitch_off_mean_deg == pytest.approx(2.0)
    assert found.pitch_off_var_deg2 == pytest.approx(0.0)


def test_off_is_less_the_measured_angle_and_error_less_the_true_one():
    t_s = np.arange(0, 880, 0.1)
    wave = np.sin(t_s)
    measured = np.column_stack([wave, wave])
    follows = compute_figures(series(lambda _: np.column_stack([wave, wave, 0 * wave]), measured=measured), "x")
    assert follows.roll_off_var_deg2 == pytest.approx(0.0)
    assert follows.surface_roll_rmse_deg == pytest.approx(np.sqrt(0.5), abs=0.01)


def test_a_heading_that_drifts_through_north_is_not_wrapped():
    def estimated(t_s):
        drifting = (175.0 + 0.02 * t_s + 180) % 360 - 180  # 12 deg in 600 s, through +-180
        return np.column_stack([0 * t_s, 0 * t_s, drifting])

    true = np.column_stack([np.zeros((8800, 2)), np.full(8800, 170.0)])
    found = compute_figures(series(estimated, true), "x")
    assert found.heading_drift_deg == pytest.approx(12.0 * 590 / 600, abs=0.01)
    assert found.heading_after_deg == pytest.approx(5 + 0.02 * 735, abs=0.01)


@pytest.mark.slow
def test_measured_angles_are_the_true_ones_of_a_level_unaccelerated_body():
    recording = simulate("auv-dolphin-calm", seed=0, minutes=6.0, sensor="perfect")
    off = compute_measured_deg(recording) - np.rad2deg(euler(recording.truth.q_nb, "ned"))[:, :2]
    assert np.sqrt((off**2).mean(axis=0)).max() < 0.2  # turning at 1.5-2.5 m/s accelerates a little


@pytest.mark.slow
def test_signs_do_not_cancel_over_trials(calm):
    one = calm.figures[RAW].heading_after_deg
    assert summarise_trials([calm, calm], RAW, "heading_after_deg") == pytest.approx(abs(one))
    assert summarise_trials([calm], RAW, "roll_off_var_deg2") == calm.figures[RAW].roll_off_var_deg2


@pytest.mark.slow
def test_the_papers_numbers_come_out_in_a_calm_sea(calm):
    """Roll 5.5e-4 deg and 0.0045 deg^2 off; 2 deg of heading without GPS, 10 by the gyro."""
    adaptive = calm.figures[ADAPTIVE]
    assert abs(adaptive.roll_off_mean_deg) < 1e-3
    assert 0.003 < adaptive.roll_off_var_deg2 < 0.006
    assert abs(calm.figures[RAW].heading_after_deg) == pytest.approx(2.0, abs=0.3)
    assert abs(adaptive.heading_after_deg) < 0.4
    assert 5 < abs(calm.figures[GYRO].heading_drift_deg) < 15


@pytest.mark.slow
@pytest.mark.parametrize("heading", ["mag", "gps-course"])
def test_online_is_fed_sample_by_sample_to_the_bits_of_a_batch_run_in_single_precision(heading):
    recording = simulate("auv-dolphin-calm", seed=10, minutes=6.0)
    streamed = stream_estimate(recording, "cf-lse", {}, heading=heading)
    batch = estimate(recording, "cf-lse", precision="single", heading=heading)
    assert np.array_equal(streamed.q_nb, batch.q_nb)
    assert streamed.diagnostics["fed"] == "sample by sample"


@pytest.mark.slow
def test_online_differs_by_single_precision_only(calm):
    single = run_trial("calm", 0, online=True, methods=METHODS[:1])
    assert METHODS[0].name == ADAPTIVE
    for figure in ("roll_off_var_deg2", "below_roll_rmse_deg", "pitch_rmse_deg"):
        one, other = getattr(single.figures[ADAPTIVE], figure), getattr(calm.figures[ADAPTIVE], figure)
        assert one == pytest.approx(other, rel=0.05)
    assert not np.array_equal(single.series.estimated_deg[ADAPTIVE], calm.series.estimated_deg[ADAPTIVE])


@pytest.mark.slow
def test_missions_online_are_others_than_those_offline(call, tmp_path):
    words = ("experiment", "auv-dolphin", "--online", "--sea", "calm", "--trials", "1")
    assert call(*words, "-o", tmp_path, "--json", tmp_path / "facts.json") == 0
    rows = json.loads((tmp_path / "facts.json").read_text())["rows"]
    assert {row["recording"] for row in rows} == {"auv-dolphin-calm-seed10"}
    page = (tmp_path / "auv-dolphin-online.experiment.html").read_text(encoding="utf-8")
    assert "sample by sample" in page
    assert "--online --sea calm --trials 1 --seed 10" in page


@pytest.mark.slow
@pytest.mark.ink
def test_the_command_writes_a_page_and_the_facts(call, tmp_path, capsys, calm):
    words = ("experiment", "auv-dolphin", "--sea", "calm", "--trials", "1")
    assert call(*words, "-o", tmp_path, "--json", tmp_path / "facts.json") == 0
    page = (tmp_path / "auv-dolphin.experiment.html").read_text(encoding="utf-8")
    out = capsys.readouterr().out
    for method in METHODS:
        assert method.name in out
        assert method.name in page
    for number in ("s 4 and 5", " 6", " 7", " 8", " 9", " 10", " 11"):
        assert f"paper's figure{number}" in page.replace("&#39;", "'")
    assert page.count("<svg") == 2 * 7
    assert "<script" not in page
    assert "http" not in page.replace("http://www.w3.org", "")
    rows = json.loads((tmp_path / "facts.json").read_text())["rows"]
    assert {row["method"] for row in rows} == {method.name for method in METHODS}
    for row in rows:  # of the same mission, computed again
        figures = asdict(calm.figures[row["method"]])
        assert {name: row[name] for name in figures} == figures


def test_wrong_options_are_one_line(call, tmp_path, capsys):
    assert call("experiment", "auv-dolphin", "--trials", "0", "-o", tmp_path) == 2
    assert "--trials 0" in capsys.readouterr().err
