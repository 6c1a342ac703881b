"""Tables of the terminal: what fits is shown in the order of importance, a pipe gets all of it without boxes."""

import io

import pytest
from rich.console import Console

from stillpoint.datasets.errors import BadParameter
from stillpoint.scripts.shared import tables
from stillpoint.scripts.shared.tables import choose_columns, fit_columns, print_table

COLUMNS = ("recording", "estimate", "total, deg", "heading, deg", "longest words of all")
ROWS = [["run", "ekf", "1.00", "2.00", "x" * 40], ["run with\ttab", "vqf", "1.50", "2.50", "y"]]


def test_a_pipe_gets_every_column_between_tabs(capsys) -> None:
    print_table("scores", COLUMNS, [ROWS[:1], ROWS[1:]])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "# scores"
    assert lines[1].split("\t") == list(COLUMNS)
    assert lines[2].split("\t") == ROWS[0]
    assert lines[3].split("\t")[0] == "run with\\ttab"  # escaped, so that it stays one cell
    assert not set("│┃─━") & set("".join(lines))


@pytest.fixture
def window(monkeypatch):
    """A terminal of 80 characters; the text that it shows."""
    shown = io.StringIO()
    console = Console(file=shown, force_terminal=True, width=80, color_system=None)
    monkeypatch.setattr(tables, "Console", lambda: console)
    return shown


def test_a_terminal_gets_what_fits_and_the_names_of_the_rest(window, capsys) -> None:
    print_table("scores", COLUMNS, [ROWS])
    assert max(map(len, window.getvalue().splitlines())) <= 80
    assert "heading" in window.getvalue()
    assert "xxxx" not in window.getvalue()
    assert capsys.readouterr().out == "--columns all shows also: longest words of all\n"


def test_columns_can_be_named_or_all_be_shown(window, capsys) -> None:
    print_table("scores", COLUMNS, [ROWS], wanted="recording,total")
    assert "1.50" in window.getvalue()
    assert "vqf" not in window.getvalue()
    print_table("scores", COLUMNS, [ROWS], wanted="all")
    assert "longest" in window.getvalue()
    assert capsys.readouterr().out == ""


def test_a_name_that_no_column_has_is_refused_with_those_there_are() -> None:
    with pytest.raises(BadParameter, match="--columns totle: there is no such column; there are recording, estimate"):
        choose_columns(COLUMNS, "recording,totle")


def test_the_first_two_columns_are_shown_however_narrow_the_window() -> None:
    assert fit_columns(COLUMNS, [ROWS], width=10) == [0, 1]


def test_a_long_text_of_the_first_column_goes_on_in_the_next_line_and_leaves_room_for_figures():
    rows = [["a benchmark with a name as long as a sentence", "graph", "0.35"]]
    columns = ["source", "method", "total, deg"]
    assert fit_columns(columns, [rows], width=60) == [0, 1]
    assert fit_columns(columns, [rows], width=60, widest_first=20) == [0, 1, 2]
