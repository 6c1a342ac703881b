"""``stillpoint experiment servo-bench``: the figures of Byambajav et al. from the simulator."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from stillpoint.studies.papers.servo.study import GYRO, Trial, find_first_swing_s, restart_at, run_trial, select_swings


@pytest.fixture(scope="module")
def one() -> Trial:
    return run_trial(seed=3, minutes=4.0)


def test_the_drift_is_the_bias_of_the_axis_times_a_minute(one: Trial) -> None:
    rest = one.series.gyro_b_degps[select_swings(one.series, None), 0]
    # Rests lie before and after the swings, and the bias changes by less than 0.1 deg/s while the device warms up.
    assert one.figures.drift_deg == pytest.approx(60 * rest.mean(), abs=6)
    assert abs(one.figures.drift_deg) <= one.figures.worst_drift_deg + 6


def test_the_filter_is_better_than_the_accelerometer_while_it_moves(one: Trial) -> None:
    found = one.figures
    assert found.kf_low_deg < found.acc_low_deg < found.acc_high_deg
    assert found.kf_high_deg < 0.3 * found.acc_high_deg


def test_a_fast_swing_spoils_the_heading_that_the_accelerometer_levels(one: Trial) -> None:
    found = one.figures
    assert found.kf_heading_high_deg < 0.5 * found.acc_heading_high_deg
    assert found.acc_heading_high_deg > 2 * found.acc_heading_low_deg


def test_an_integral_that_begins_at_a_time_has_the_true_angle_there(one: Trial) -> None:
    start, _ = find_first_swing_s(one.series, 0.4)
    roll = restart_at(one.series, GYRO, start)
    k = np.searchsorted(one.series.t_s, start)
    assert roll[k] == pytest.approx(one.series.true_roll_deg[k], abs=1e-9)
    steps = np.diff(roll) - np.diff(one.series.roll_deg[GYRO])
    assert np.abs(steps).max() < 1e-9


@pytest.mark.slow
@pytest.mark.ink
def test_the_page_has_the_papers_number_beside_ours(call: Callable[..., int], tmp_path: Path) -> None:
    words = ("experiment", "servo-bench", "--minutes", 3.5, "--trials", 2)
    assert call(*words, "-o", tmp_path / "a", "--json", tmp_path / "a.json") == 0
    assert call(*words, "-o", tmp_path / "b") == 0
    page = (tmp_path / "a" / "servo-bench.experiment.html").read_text()
    assert page == (tmp_path / "b" / "servo-bench.experiment.html").read_text()
    rows = json.loads((tmp_path / "a.json").read_text())["rows"]
    assert [row["recording"] for row in rows] == ["servo-bench-seed0", "servo-bench-seed1"]
    assert "-50 deg after a minute" in page
    for row in rows:
        assert f"{row['drift_deg']:+.0f}" in page
    assert page.count("<svg") == 8  # four figures, each wide and narrow


@pytest.mark.parametrize(("words", "says"), [(("--minutes", 2), "3.5"), (("--trials", 0), "1 trial or more")])
def test_what_makes_no_bench_is_refused(
    words: tuple[object, ...], says: str, call: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert call("experiment", "servo-bench", *words) == 2
    assert says in capsys.readouterr().err
