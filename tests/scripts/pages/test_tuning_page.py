"""The tables of tuned parameters and of calibrated input: what is split, compared and printed."""

from dataclasses import replace

import pytest
from boards import make_board

from stillpoint.datasets.errors import BadParameter
from stillpoint.filters import ESTIMATORS
from stillpoint.scripts.pages.calibration_page import make_table as make_calibration_table
from stillpoint.scripts.pages.tuning_page import SEARCHES, make_table, split_halves
from stillpoint.studies.leaderboard.board import Pair, Run
from stillpoint.studies.tune import TunedTrial, Tuning


def test_halves_hold_every_recording_once_and_both_hold_each_source():
    source = make_board().sources[0]
    names = [("BROAD", f"{k:02d}") for k in range(5)] + [("Tyrex", f"phone {k}") for k in range(4)]
    sources = [replace(source, source=kind, recording=name, file=name) for kind, name in names]
    half_a, half_b = split_halves(sources[::-1])
    assert [str(file) for file in half_a] == ["00", "02", "04", "phone 0", "phone 2"]
    assert [str(file) for file in half_b] == ["01", "03", "phone 1", "phone 3"]


def test_every_search_is_of_parameters_within_what_they_may_be():
    for name, search in SEARCHES.items():
        known = ESTIMATORS[name].params()
        for each in search.ranges:
            default = getattr(known, each.name)
            assert each.low <= default <= each.high or name == "ahrs-ekf", "the defaults are among what is searched"


def test_a_row_says_the_gain_on_the_other_half_in_the_direction_of_tuned_over_defaults():
    board = make_board(failures=0)
    (table,) = board.tables
    rows = tuple(replace(row, label=label) for row, label in zip(table.rows, ("cf", "cf@cf-tuned"), strict=False))
    pairs = (Pair("cf", "cf@cf-tuned", "truth", 2.0, (1.6, 2.5), "b"),)
    trial = TunedTrial({"omega0_radps": 0.125}, (3.0,), 3.0)
    tuning = Tuning(
        estimator="cf",
        figure="total",
        recordings=("a",),
        sha256={},
        tuned_on="tuned on 1 recordings (phone)",
        ranges=SEARCHES["cf"].ranges,
        trials=(trial,),
        defaults=replace(trial, typical_deg=6.0),
        best=trial,
        best_per_recording=(trial,),
        left_out_deg=(3.0,),
        settings={"sampler": "tpe", "seconds": 60.0},
    )
    text = make_table({"cf": tuning}, replace(board, tables=(replace(table, rows=rows, pairs=pairs),)))
    row = text.splitlines()[2]
    assert "0.50 (0.40-0.62), better" in row
    assert "`omega0_radps` 0.125" in row
    assert "1, tpe, 60 s" in row


def make_run(recording: str, calibration: str, heading: float) -> Run:
    run = Run(recording, "ekf", calibration, "ekf", "truth", inclination_rmse_deg=1.0)
    return replace(run, total_rmse_deg=heading, heading_rmse_deg=heading)


def test_calibrated_heading_is_compared_phone_by_phone():
    runs = [make_run(*each) for each in (("a", "none", 40.0), ("a", "reference", 4.0), ("b", "none", 10.0))]
    runs += [make_run("b", "reference", 8.0), replace(make_run("c", "none", 1.0), error="failed")]
    row = make_calibration_table(runs).splitlines()[2].split(" | ")
    assert row[1:5] == ["25.0", "6.0", "0.45", "0.80"]
    with pytest.raises(BadParameter, match="none,reference"):
        make_calibration_table(runs[:1])
