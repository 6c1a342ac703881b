"""The pages of single recordings: made from what the leaderboard kept, linked from its page, made once."""

import json
import re
from dataclasses import replace

import pytest
from browser import open_page

from stillpoint.datasets import write
from stillpoint.datasets.simulate import simulate
from stillpoint.studies import leaderboard
from stillpoint.studies.job_runner import run_here
from stillpoint.studies.leaderboard import Leaderboard
from stillpoint.studies.publish.page import make_page_html
from stillpoint.studies.publish.run_pages import write_run_pages

LEVEL = """
class Level:
    def update(self, t_s, gyro_b_radps, accel_b_mps2, mag_b_ut):
        return [1.0, 0.0, 0.0, 0.0]
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The output folder of a leaderboard of two recordings, one with a name that needs quoting, and its pages."""
    place = tmp_path_factory.mktemp("recordings")
    for seed, name in enumerate(("run 0 & #1", "run1")):
        write(place / f"{name}.mcap", replace(simulate("phone-3", seed=seed, minutes=1.5, rate_hz=50), name=name))
    (place / "own.py").write_text(LEVEL)
    out = tmp_path_factory.mktemp("out")
    board = leaderboard(sorted(place.glob("*.mcap")), ["cf", f"{place}/own.py:Level"], out)
    return out, board, write_run_pages(out, board)


@pytest.mark.slow
def test_every_recording_has_a_page_with_the_figures_of_the_leaderboard(made):
    out, board, pages = made
    assert pages.errors == {}
    assert pages.links == {"run 0 & #1": "runs/run%200%20%26%20%231.html", "run1": "runs/run1.html"}
    text = (out / "runs" / "run1.html").read_text()
    for run in board.runs:
        if run.recording == "run1":
            assert f">{run.total_rmse_deg:.2f}</td><td>{run.heading_rmse_deg:.2f}</td>" in text, run.label


@pytest.mark.slow
def test_a_second_time_nothing_is_made_and_a_changed_run_makes_its_page_anew(made):
    out, board, _ = made
    asked = []

    def counted(function, items, what):
        asked.append((what, len(items)))
        return run_here(function, items, what)

    again = Leaderboard.from_json(json.loads(json.dumps(board.to_json())))
    assert write_run_pages(out, again, counted).links == made[2].links
    assert asked == []
    (out / "runs" / "run1.html").write_text("<head></head>")
    write_run_pages(out, board, counted)
    assert asked == [("pages of runs", 1)]


@pytest.mark.slow
def test_a_page_whose_results_are_gone_is_missing_and_says_why(made):
    out, board, _ = made
    gone = replace(board, runs=tuple(replace(run, estimate_key="0" * 64) for run in board.runs))
    (out / "runs" / "run1.html").unlink()
    pages = write_run_pages(out, gone)
    assert "run again" in pages.errors["run1"]
    assert "run1" not in pages.links
    write_run_pages(out, board)


@pytest.mark.slow
def test_the_map_opens_the_estimator_on_the_page_of_its_recording(made, tmp_path):
    out, board, pages = made
    (out / "index.html").write_text(make_page_html(board, run_pages=pages.links), encoding="utf-8")
    with open_page(out / "index.html", tmp_path / "profile") as page:
        page.evaluate("document.querySelectorAll('table.heat tbody tr')[0].querySelectorAll('td a')[1].click()")
        page.wait("document.readyState === 'complete' && document.title.startsWith('run 0')")
        page.wait("window.stillpointPlots")
        second = board.tables[0].rows[1].label
        drawn = "window.stillpointPlots[0].figures[0].drawn.filter((one) => one.line.visible)"
        assert page.evaluate(f"{drawn}.map((one) => one.line.name)") == [second]
        titles = page.evaluate("window.stillpointPlots[0].figures.map((one) => one.figure.title.text)")
        assert {"Total error (deg)", "Roll (deg)", "Gyro bias x (deg/s)"} <= set(titles)
        assert page.complaints == []
        assert page.requests == []
        page.evaluate("document.querySelector('header a').click()")
        page.wait("document.title.startsWith('Leaderboard')")


@pytest.mark.slow
def test_a_page_carries_its_own_script_and_style(made):
    out, _, _ = made
    text = re.sub(r"<script>.*?</script>", "", (out / "runs" / "run1.html").read_text(), flags=re.DOTALL)
    assert set(re.findall(r'(?:src|href)="([^#"]+)"', text)) == {"data:,", "../index.html"}
