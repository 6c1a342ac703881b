"""The JSON of a leaderboard: the contract's names, nothing that is not JSON, and back without a loss."""

import json
from dataclasses import replace

from stillpoint.studies.leaderboard import Leaderboard, Pair, Row, Run, Source, Summary, Table

SUMMARY = Summary(1.0, (0.8, 1.25), 1.1, 1.0, 2.0)
ROW = Row("ekf", "ekf", "none", "truth", "defaults", (1, 2), 4, 0, SUMMARY, SUMMARY, None, 120.0, None, 0.95)
PAIR = Pair("ekf", "cf", "truth", 0.5, (0.4, 0.6), "a")
TABLE = Table("", "truth", "total", "", (ROW,), (PAIR,), True, 4, ("run1",), "ekf is best.")
BOARD = Leaderboard(
    against="truth",
    align="heading",
    tables=(TABLE,),
    groups=(replace(TABLE, name="slow"),),
    runs=(
        Run("run1", "ekf", "none", "ekf", "truth", 1.0, parameters={"bias": 0.1}),
        Run("run1", "cf", "none", "cf", ""),
    ),
    sources=(Source("run1", "run1.mcap", "00", "", "MIT", "", "phone", "", ("slow",), "calibrated", True),),
    version="1",
)
CONTRACT_ROW = [
    "estimator",
    "calibration",
    "rank",
    "recordings",
    "failed",
    "total_rmse_deg",
    "heading_rmse_deg",
    "inclination_rmse_deg",
    "ns_per_sample",
    "nees_per_dof",
    "coverage95",
]


def test_json_has_the_names_of_the_contract():
    content = BOARD.to_json()
    assert {"against", "align", "rows", "pairs", "general", "conclusion", "recordings"} <= set(content)
    assert set(CONTRACT_ROW) <= set(content["rows"][0])
    assert {"typical", "ci95", "mean", "median", "worst"} == set(content["rows"][0]["total_rmse_deg"])
    assert {"a", "b", "ratio", "ci95", "verdict"} <= set(content["pairs"][0])
    assert {"recording", "estimator", "against", "total_rmse_deg", "error"} <= set(content["recordings"][0])


def test_json_goes_through_text_and_back():
    assert Leaderboard.from_json(json.loads(json.dumps(BOARD.to_json()))) == BOARD


def test_tables_of_two_judges_keep_their_rows():
    other = replace(
        TABLE,
        against="reference",
        rows=(replace(ROW, against="reference"),),
        pairs=(replace(PAIR, against="reference"),),
    )
    both = replace(BOARD, against="both", tables=(TABLE, other))
    assert Leaderboard.from_json(json.loads(json.dumps(both.to_json()))) == both


def test_numbers_that_are_not_finite_become_null():
    row = replace(ROW, ns_per_sample=float("nan"))
    content = replace(BOARD, tables=(replace(TABLE, rows=(row,)),)).to_json()
    json.dumps(content, allow_nan=False)
    assert content["rows"][0]["ns_per_sample"] is None
