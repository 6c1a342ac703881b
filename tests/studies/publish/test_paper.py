"""Tables and figures of a leaderboard for papers."""

import csv
import io
import re
from dataclasses import replace

import pytest
from boards import HOSTILE, make_board
from hypothesis import given
from hypothesis.strategies import characters, text

from stillpoint.datasets.names import make_printable
from stillpoint.studies.publish.paper import write_paper
from stillpoint.studies.publish.tables import (
    format_csv,
    format_html,
    format_latex,
    format_markdown,
    format_text,
    list_rows,
)

BOARD = make_board()


@pytest.fixture(scope="module")
def board():
    return BOARD


def test_csv_holds_every_figure_in_full(board) -> None:
    rows = list(csv.DictReader(io.StringIO(format_csv(board))))
    first = board.tables[0].rows[0]
    assert [row["label"] for row in rows] == [row.label for row in board.tables[0].rows]
    assert float(rows[0]["total_rmse_typical_deg"]) == first.total_rmse_deg.typical
    assert float(rows[0]["total_rmse_low95_deg"]) == first.total_rmse_deg.ci95[0]
    assert rows[-1]["rank_best"] == ""


def test_every_character_that_latex_reads_is_escaped(board) -> None:
    awkward = r"50% a_b & $x$ #1 {~^\}"
    rows = tuple(replace(row, label=awkward) for row in board.tables[0].rows[:1])
    table = format_latex(replace(board, tables=(replace(board.tables[0], rows=rows),)))
    line = next(line for line in table.splitlines() if "50" in line)
    assert r"50\% a\_b \& \$x\$ \#1 \{\textasciitilde{}\textasciicircum{}\textbackslash{}\}" in line
    assert len(re.findall(r"(?<!\\)&", line)) == 8


def test_latex_has_a_column_per_heading(board) -> None:
    table = format_latex(board)
    columns = re.search(r"tabular\}\{(\w+)\}", table)[1]
    body = table.split(r"\midrule")[1].split(r"\bottomrule")[0].strip().splitlines()
    assert len(body) == len(board.tables[0].rows)
    assert {len(re.findall(r"(?<!\\)&", line)) + 1 for line in body} == {len(columns)}


def test_markdown_keeps_its_columns_when_a_name_has_a_bar(board) -> None:
    rows = tuple(replace(row, label="a|b") for row in board.tables[0].rows)
    text = format_markdown(replace(board, tables=(replace(board.tables[0], rows=rows),)))
    lines = [line for line in text.splitlines() if line.startswith("|")]
    assert {len(re.findall(r"(?<!\\)\|", line)) for line in lines} == {10}


@given(text(characters(exclude_categories=()), min_size=1))
def test_a_name_of_any_characters_stays_in_its_cell(name) -> None:
    """No line break, tab, escape sequence or character of the format's own ends a cell or reaches a terminal."""
    first = BOARD.tables[0]
    rows = tuple(replace(row, label=name, estimator=name, calibration=name) for row in first.rows)
    table = replace(first, rows=rows, conclusion=f"{name} is best.")
    board = replace(BOARD, tables=(table,))
    written = [format_latex(board), format_csv(board), format_markdown(board), format_html(board), format_text(board)]
    for each in written:
        assert all(letter.isprintable() or letter == "\n" for letter in each)
        each.encode()
    latex, _, markdown, html, plain = written
    body = latex.split("\\midrule\n")[1].split("\\bottomrule")[0].splitlines()
    assert {len(re.findall(r"(?<!\\)&", line)) for line in body} == {8}
    assert len(body) == len(rows)
    lines = [line for line in markdown.splitlines() if line.startswith("|")]
    assert {len(re.findall(r"(?<!\\)(?:\\\\)*\|", line)) for line in lines} == {10}
    assert len(lines) == len(rows) + 2
    assert html.count("<td>") == 9 * len(rows)
    assert len(plain.splitlines()) == len(rows) + 3
    read = list(csv.DictReader(io.StringIO(format_csv(board))))
    assert {row["label"] for row in read} == {make_printable(name)}


def test_html_escapes_names_and_text_is_aligned(board) -> None:
    assert HOSTILE not in format_html(board)
    lines = format_text(board).splitlines()[1:-1]
    assert len({line.index("estimator") if "estimator" in line else 6 for line in lines}) == 1


def test_rows_that_failed_keep_their_row(board) -> None:
    rows = list_rows(board)
    assert rows[-1]["failed"] == 2
    assert rows[-1]["rank_best"] is None


@pytest.mark.slow
def test_a_paper_gets_tables_and_figures_at_column_width(board, tmp_path) -> None:
    names = {path.name for path in write_paper(tmp_path, board)}
    assert names == {"table.tex", "table.csv", "table.md", "ranking.pdf", "ranking.svg", "map.pdf", "map.svg"}
    svg = (tmp_path / "ranking.svg").read_text()
    assert float(re.search(r'width="([\d.]+)pt"', svg)[1]) == pytest.approx(3.5 * 72, abs=0.1)
    assert "estimator-0" in svg  # text, not outlines
    for name in ("ranking.svg", "map.svg"):
        sizes = [float(size) for size in re.findall(r"font-size: ([\d.]+)px", (tmp_path / name).read_text())]
        assert min(sizes) >= 6
    assert (tmp_path / "ranking.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.slow
def test_the_same_board_gives_the_same_figures(board, tmp_path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write_paper(tmp_path / name, board)
    for file in (tmp_path / "a").iterdir():
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes(), file.name


def test_a_leaderboard_prints_and_shows_itself(board) -> None:
    assert str(board) == format_text(board)
    assert board._repr_html_() == format_html(board)


def test_a_frame_has_every_row(board) -> None:
    pytest.importorskip("pandas")
    frame = board.to_frame()
    assert list(frame["label"]) == [row.label for row in board.tables[0].rows]
    assert frame["total_rmse_typical_deg"][0] == board.tables[0].rows[0].total_rmse_deg.typical
