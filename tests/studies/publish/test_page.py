"""The page of a leaderboard: complete, small, offline, and usable in a browser by mouse and by keyboard."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from boards import HOSTILE, make_board, make_entries
from browser import open_page

from stillpoint.studies.publish.page import make_page_html

READY = "window.stillpointPlots"
FIRST_COLUMN = "[...document.querySelectorAll('#ranking-1 tbody tr')].map((row) => row.cells[1].textContent)"


@pytest.fixture(scope="module")
def board():
    return make_board()


@pytest.fixture(scope="module")
def page_file(board, tmp_path_factory) -> Path:
    file = tmp_path_factory.mktemp("page") / "index.html"
    file.write_text(make_page_html(board, make_entries(board)), encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def shown(page_file, tmp_path_factory):
    """The page in a browser, shared by the tests that leave it as they found it."""
    with open_page(page_file, tmp_path_factory.mktemp("profile")) as page:
        page.wait(READY)
        yield page


@pytest.mark.slow
def test_fifty_recordings_and_fifteen_estimators_fit_into_5_mb() -> None:
    large = make_board(recordings=50, estimators=15)
    assert len(make_page_html(large, make_entries(large)).encode()) < 5e6


def test_the_page_names_no_network_address_of_its_own(board) -> None:
    """Bokeh's own text holds addresses of its documentation; outside the scripts there is none."""
    text = re.sub(r"<script>.*?</script>", "", make_page_html(board, make_entries(board)), flags=re.DOTALL)
    assert not re.search(r"""(src|href)\s*=\s*["'](?!#|data:)""", text)
    assert "://" not in text


def test_the_same_board_gives_the_same_bytes(board) -> None:
    assert make_page_html(board, make_entries(board)) == make_page_html(board, make_entries(board))


def test_failures_stand_before_the_ranking_with_their_reason(board) -> None:
    text = make_page_html(board)
    assert "2 of 24 runs failed" in text
    assert text.index("ValueError: no &lt;b&gt;field") < text.index('id="ranking-1"')


def test_the_browser_complains_of_nothing_and_fetches_nothing(shown) -> None:
    assert shown.evaluate(f"{READY}[1].figures[0].drawn[0].source.data.t.length") > 100
    assert shown.complaints == []
    assert shown.requests == []


def test_names_stay_text(shown) -> None:
    assert HOSTILE in shown.evaluate(FIRST_COLUMN)
    assert shown.evaluate("document.title") == "Leaderboard – stillpoint leaderboard"


def test_a_header_sorts_with_the_mouse_and_with_the_keyboard(shown) -> None:
    header = "document.querySelectorAll('#ranking-1 th button.sort')[2]"
    order = shown.evaluate(FIRST_COLUMN)
    shown.evaluate(f"{header}.click()")
    assert shown.evaluate(f"{header}.closest('th').getAttribute('aria-sort')") == "ascending"
    sizes = shown.evaluate(
        "[...document.querySelectorAll('#ranking-1 tbody tr')].map((row) => Number(row.cells[2].dataset.value))"
    )
    assert sizes == sorted(sizes)
    shown.evaluate(f"{header}.focus()")
    shown.press("Enter")
    assert shown.evaluate(FIRST_COLUMN) == order[::-1]
    assert shown.evaluate(f"{header}.closest('th').getAttribute('aria-sort')") == "descending"
    shown.evaluate(f"{header}.click()")
    assert shown.evaluate(FIRST_COLUMN) == order


def test_rows_without_a_rank_stay_last_in_both_orders(shown) -> None:
    for _ in range(2):
        shown.evaluate("document.querySelectorAll('#ranking-1 th button.sort')[0].click()")
        assert shown.evaluate(FIRST_COLUMN)[-1] == HOSTILE
    shown.evaluate("document.querySelectorAll('#ranking-1 th button.sort')[0].click()")


def test_a_filter_hides_rows_and_counts_them(shown) -> None:
    def type_words(words: str) -> list[str]:
        shown.evaluate(
            f"(() => {{ const field = document.querySelector('input[data-table=\"run-table\"]'); field.value = "
            f"{json.dumps(words)}; field.dispatchEvent(new Event('input')); }})()"
        )
        return shown.evaluate(
            "[...document.querySelectorAll('#run-table tbody tr')].filter((row) => row.offsetParent !== null)"
            ".map((row) => row.cells[0].textContent + ' ' + row.cells[1].textContent)"
        )

    assert type_words("03 estimator-1") == ["run & 03 estimator-1"]
    assert shown.evaluate("document.getElementById('run-table-count').textContent") == "1 of 24 rows"
    assert len(type_words("")) == 24


def test_a_cell_of_the_map_opens_its_run(shown) -> None:
    shown.evaluate("[...document.querySelectorAll('table.heat tbody tr')][4].querySelector('td a').click()")
    shown.wait("document.getElementById('recording-choice').value === 'run & 04'")


def peak_at_every_zoom(page, panel: int = 0) -> list[float]:
    """The greatest value that the first plot draws while the time axis closes in on the middle of the run."""
    seen = []
    for _ in range(8):
        seen.append(page.evaluate(f"Math.max(...{READY}[1].figures[{panel}].drawn[0].source.data.greatest)"))
        page.evaluate("document.querySelector('button[data-zoom=\"0.5\"]').click()")
        page.evaluate("new Promise((done) => setTimeout(done, 80))")
    page.evaluate("document.querySelector('button[data-zoom=\"1e9\"]').click()")
    return seen


def test_one_sample_stays_visible_at_every_zoom(shown) -> None:
    """77 deg in one of 6000 samples, kept to the 0.02 % of the encoding."""
    assert peak_at_every_zoom(shown) == pytest.approx([77.0] * 8, rel=2e-4)


def test_zooming_in_shows_finer_columns(shown) -> None:
    """Half the length has half the length of a column, until there is nothing finer in the page."""
    first = f"{READY}[1].figures[0].drawn[0].source.data.t"
    whole = np.diff(shown.evaluate(f"Array.from({first})"))[0]
    shown.resize(420)
    shown.evaluate(f"{READY}[1].refine()")
    narrow = np.diff(shown.evaluate(f"Array.from({first})"))[0]
    assert narrow == pytest.approx(2 * whole)
    shown.evaluate("document.querySelector('button[data-zoom=\"0.5\"]').click()")
    shown.evaluate("new Promise((done) => setTimeout(done, 80))")
    assert np.diff(shown.evaluate(f"Array.from({first})"))[0] == pytest.approx(whole)
    shown.evaluate("document.querySelector('button[data-zoom=\"1e9\"]').click()")
    shown.resize(1280)


def test_dragging_in_a_plot_zooms_the_time_axis(shown) -> None:
    shown.evaluate("document.getElementById('time-plots').scrollIntoView()")
    shown.evaluate("new Promise((done) => setTimeout(done, 300))")
    left, top, width, height = shown.evaluate(
        "(({left, top, width, height}) => [left, top, width, height])("
        "document.getElementById('time-plots').getBoundingClientRect())"
    )
    middle = top + height / 2
    shown.drag((left + 0.4 * width, middle), (left + 0.6 * width, middle))
    shown.wait(f"{READY}[1].range.end - {READY}[1].range.start < 20")
    shown.evaluate("document.querySelector('button[data-zoom=\"1e9\"]').click()")


def test_an_estimator_can_be_taken_out_of_the_plots(shown) -> None:
    visible = f"{READY}[1].figures[0].drawn[1].line.visible"
    box = "document.querySelectorAll('input[data-series]')[1]"
    assert shown.evaluate(visible)
    shown.evaluate(f"{box}.click()")
    assert not shown.evaluate(visible)
    shown.evaluate(f"{box}.click()")


@pytest.mark.slow
def test_many_estimators_begin_with_the_best_six(tmp_path) -> None:
    """All of 9 lines at once would be unreadable; a button shows them."""
    board = make_board(recordings=3, estimators=9)
    file = tmp_path / "index.html"
    file.write_text(make_page_html(board, make_entries(board)), encoding="utf-8")
    visible = f"{READY}[1].figures[0].drawn.filter((one) => one.line.visible).length"
    with open_page(file, tmp_path / "profile") as page:
        page.wait(READY)
        assert page.evaluate(visible) == 6
        page.evaluate("document.querySelector('button[data-show=all]').click()")
        assert page.evaluate(visible) == 9


def test_every_control_has_a_name_and_tables_have_headers(shown) -> None:
    """What a screen reader says of them."""
    nameless = (
        "[...document.querySelectorAll('main > * button, main input, main select, main [role=img]')]"
        ".filter((one) => !one.closest('.bk-Column, .plots > *'))"
        ".filter((one) => !(one.textContent.trim() || one.getAttribute('aria-label') || one.closest('label')))"
        ".map((one) => one.outerHTML)"
    )
    assert shown.evaluate(nameless) == []
    headless = (
        "[...document.querySelectorAll('table')]"
        ".filter((one) => !one.tHead || [...one.tHead.rows[0].cells].some((cell) => cell.scope !== 'col')).length"
    )
    assert shown.evaluate(headless) == 0


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width_px", [390, 1280])
def test_the_page_fits_its_window_and_follows_the_colour_scheme(shown, width_px: int, scheme: str) -> None:
    shown.set_scheme(scheme)
    shown.resize(width_px)
    shown.evaluate("new Promise((done) => setTimeout(done, 200))")
    assert shown.evaluate("document.documentElement.scrollWidth") <= width_px
    ink = shown.evaluate("getComputedStyle(document.body).color")
    assert ink == ("rgb(27, 31, 36)" if scheme == "light" else "rgb(232, 234, 237)")
    title = shown.evaluate(f"{READY}[1].figures[0].figure.title.text_color")
    assert title == ("#1b1f24" if scheme == "light" else "#e8eaed")
    shown.resize(1280)
    shown.set_scheme("light")
    assert shown.complaints == []


@pytest.mark.slow
def test_a_board_without_curves_has_no_plots_over_time(board) -> None:
    text = make_page_html(board)
    assert 'id="time-plots"' not in text
    assert 'id="run-table"' in text
