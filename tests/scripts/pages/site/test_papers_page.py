"""Our figures on docs/papers.md, computed anew, stay within the band that the page states."""

import re
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from stillpoint.datasets.simulate import simulate
from stillpoint.filters import estimate
from stillpoint.scoring.score import score, score_row
from stillpoint.scoring.spin import compare_spin, score_spin_comparison, spin_score_row
from stillpoint.scripts.pages.site import papers_page
from stillpoint.scripts.pages.site.papers_page import COUNT_BAND, PAGE, SHARE_BAND, TABLES, list_gains, replace_tables
from stillpoint.smoother import attitude_reference
from stillpoint.studies.papers.auv import study as auv
from stillpoint.studies.papers.phone import study as phone
from stillpoint.studies.papers.servo import study as servo
from stillpoint.studies.papers.spin import study as spin

TEXT = PAGE.read_text(encoding="utf-8")
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")


def read_block(table: str) -> list[str]:
    """Return the lines of the page between the marks of a table, without empty ones."""
    block = re.search(rf"<!-- run {table} -->\n(.*?)<!-- end -->", TEXT, re.DOTALL)
    assert block is not None
    return [line for line in block[1].splitlines() if line]


def split(line: str) -> list[str]:
    """Return the cells of a line of a table."""
    return line.strip("| ").split(" | ")


def list_rows(lines: Sequence[str]) -> list[list[str]]:
    """Return the cells of the rows of tables, without heads and what the paper printed."""
    below = [*lines[1:], ""]
    rows = [
        split(line)
        for line, next_line in zip(lines, below, strict=True)
        if line.startswith("| ") and not next_line.startswith("|---")
    ]
    return [row for row in rows if "the paper" not in row[0] and row[1] != "the paper"]


def check_lines(table: str, made: Sequence[str], keys: int = 2, columns: slice = slice(None)) -> None:
    """Compare every number of our rows, of those columns, with the page; ``keys`` is how many cells name a row."""
    of_page = {tuple(row[:keys]): row[keys:] for row in list_rows(read_block(table))}
    ours = list_rows(made)
    assert len(ours) > 1
    for cells in ours:
        stated = of_page[tuple(cells[:keys])]
        for found, said in zip(cells[keys:][columns], stated[columns], strict=True):
            band = {"abs": COUNT_BAND} if " of " in said else {"rel": SHARE_BAND}
            expected = [pytest.approx(float(x), **band) for x in NUMBER.findall(said)]
            assert [float(x) for x in NUMBER.findall(found)] == expected, f"{cells}, on the page {stated}"


def run_offline(scenario: spin.Scenario, noise: spin.NoiseKind, seeds: range) -> list[dict[str, Any]]:
    """Return the rows of the paper's methods only, without the smoother."""
    return [row for seed in seeds for row in _run_offline(scenario.name, noise, seed)]


@cache
def _run_offline(name: str, noise: spin.NoiseKind, seed: int) -> list[dict[str, Any]]:
    scenario = {one.name: one for one in (spin.CONSTANT, spin.VARIABLE)}[name]
    recording, rows = simulate(name, seed=seed, sensor=noise), []
    assert recording.roll_truth is not None
    for method in spin.OF_PAPER:
        settings = spin.make_settings(scenario, method, noise in spin.LITERAL)
        made = compare_spin(estimate(recording, spin.FILTERS[method], settings), recording.roll_truth)
        rows.append({**spin_score_row(score_spin_comparison(made)), "noise": noise, "seed": seed, "method": method})
    return rows


@pytest.mark.parametrize("name", TABLES)
def test_every_table_stands_on_the_page_with_its_command_and_band(name: str) -> None:
    intro, *lines = read_block(name)
    assert all(f"`stillpoint experiment {command}`" in intro for command in TABLES[name].commands)
    assert f"Band: {100 * SHARE_BAND:g} %" in intro
    assert (f"counts of trials by {COUNT_BAND}" in intro) == TABLES[name].counts
    assert len(lines) > 3


def test_tables_stay_as_they_are_without_their_files(tmp_path: Path) -> None:
    """The gains of CF need no file, and come out as they stand on the page."""
    assert replace_tables(TEXT, tmp_path) == TEXT


def test_a_figure_outside_its_band_is_found() -> None:
    first, *figures = split(next(line for line in read_block("servo") if line.startswith("| roll by the acc")))
    moved = [f"{1.2 * float(figure):.3g}" for figure in figures]
    check_lines("servo", [f"| {' | '.join([first, *figures])} |"] * 2, keys=1)
    with pytest.raises(AssertionError, match="on the page"):
        check_lines("servo", [f"| {' | '.join([first, *moved])} |"] * 2, keys=1)


def test_no_frequency_leaves_the_printed_filter_below_the_mean() -> None:
    check_lines("gains", list_gains()[2:], keys=3)
    assert split(read_block("gains")[3])[3] == "0 of 2000"


@pytest.mark.slow
@pytest.mark.parametrize("name", phone.EXPERIMENTS)
def test_tables_2_to_4_of_elmi_aziz_and_mohseni_araste(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = phone.EXPERIMENTS[name]
    rows = []
    hand, kind = next(iter(scenario.hands.items()))
    for seed in range(5):
        blind = replace(simulate(kind, seed=seed), base_pose=None, truth=None)
        benchmark = attitude_reference(blind, "redistribution")
        for method in papers_page.PHONE_METHODS[scenario.number]:
            estimator, params = phone.ESTIMATORS[phone.ACC_MA if method == phone.ACC_MA_CENTRED else method]
            made = estimate(blind, estimator, params)
            made = phone.centre_mean(made) if method == phone.ACC_MA_CENTRED else made
            place = {"hand": hand, "method": method, "against": "benchmark"}
            rows.append({**score_row(score(made, benchmark, "none")), **place})
    monkeypatch.setattr(papers_page, "EXPERIMENTS", {name: scenario})
    check_lines("phone", papers_page.list_phone(rows))


@pytest.mark.slow
def test_two_hours_of_cf_against_kalman_filters(monkeypatch: pytest.MonkeyPatch) -> None:
    """The accuracy only; the time depends on the machine."""
    monkeypatch.setattr(phone, "RUNS", 1)
    runs = phone.time_long_run(120, "carried", (phone.CF, phone.KALMAN))
    lines = papers_page.list_long_run([{"minutes": 120.0, **asdict(run)} for run in runs])
    check_lines("long", lines, columns=slice(0, 2))


@pytest.mark.slow
@pytest.mark.parametrize("scenario", [spin.CONSTANT, spin.VARIABLE], ids=lambda one: one.name)
def test_the_experiments_of_asghari_et_al(scenario: spin.Scenario) -> None:
    offline = [row for noise in spin.NOISES for row in run_offline(scenario, noise, range(10))]
    check_lines(scenario.name, papers_page.list_spin(scenario, offline, []))
    made = [spin.run_trial(scenario, "vibration-f4", seed, online=True) for seed in range(10, 15)]
    online = [
        {**spin_score_row(one.scores[method]), "noise": one.noise, "seed": one.seed, "method": method}
        for one in made
        for method in spin.OF_PAPER
    ]
    check_lines(scenario.name, papers_page.list_spin(scenario, [], online))


@pytest.mark.slow
def test_two_of_six_tens_of_seeds() -> None:
    runs = [run_offline(scenario, "vibration-f4", range(20)) for scenario in (spin.CONSTANT, spin.VARIABLE)]
    check_lines("tens", papers_page.list_tens(*runs), columns=slice(0, 5))  # with Q as printed the last one is rounding
    assert max(float(split(line)[-1]) for line in papers_page.list_tens(*runs) if "-9 " in line) < 1e-6


@pytest.mark.slow
def test_tables_1_and_2_of_zia() -> None:
    """Compute the rows of three methods again; the others take longer."""
    methods = [one for one in auv.METHODS if one.name in (auv.ADAPTIVE, auv.KALMAN, auv.SURE)]
    trials = [auv.run_trial("calm", seed, methods=methods) for seed in range(5)]
    rows = [
        {"sea": one.sea, "method": method, **asdict(figures)}
        for one in trials
        for method, figures in one.figures.items()
    ]
    check_lines("auv", papers_page.list_auv(rows))


@pytest.mark.slow
def test_the_bench_of_byambajav_et_al() -> None:
    rows = [asdict(servo.run_trial(seed, 30.0).figures) for seed in range(5)]
    check_lines("servo", papers_page.list_servo(rows), keys=1)
