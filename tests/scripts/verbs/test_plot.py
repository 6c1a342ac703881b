"""The verb plot: figures for papers from a recording with its estimates and from a leaderboard."""

import json
import re
from dataclasses import replace

import pytest
from boards import make_board

from stillpoint.datasets import write
from stillpoint.datasets.simulate import simulate
from stillpoint.filters import estimate


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A recording with truth and two estimates beside it, and the result of a leaderboard."""
    place = tmp_path_factory.mktemp("plot")
    recording = simulate("phone-1", minutes=0.6)
    write(place / "run.mcap", recording)
    for name in ("cf", "gyro"):
        write(place / f"run.{name}.estimate.mcap", estimate(recording, name))
    (place / "leaderboard.json").write_text(json.dumps(make_board().to_json()))
    return place


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["angles", "errors"])
def test_a_recording_is_drawn_with_all_its_estimates(call, folder, tmp_path, kind) -> None:
    out = tmp_path / "figure.svg"
    assert call("plot", folder / "run.mcap", "--kind", kind, "-o", out) == 0
    svg = out.read_text()
    assert float(re.search(r'width="([\d.]+)pt"', svg)[1]) == pytest.approx(3.5 * 72, abs=0.1)
    for name in ("cf", "gyro"):
        assert f">{name}</text>" in svg


def test_only_named_estimates_are_drawn(call, folder, tmp_path) -> None:
    out = tmp_path / "figure.svg"
    assert call("plot", folder / "run.gyro.estimate.mcap", "--kind", "errors", "-o", out) == 0
    assert ">gyro</text>" in out.read_text()
    assert ">cf</text>" not in out.read_text()


@pytest.mark.slow
def test_a_stretch_of_time_can_be_chosen(call, folder, tmp_path, capsys) -> None:
    out = tmp_path / "figure.svg"
    assert call("plot", folder / "run.mcap", "--kind", "errors", "--from", "20", "--to", "30", "-o", out) == 0
    labels = [float(label) for label in re.findall(r">(\d+)</text>", out.read_text())]
    assert max(labels) <= 30
    assert call("plot", folder / "run.mcap", "--kind", "errors", "--from", "1000", "-o", out) == 2
    assert "--from, --to: select nothing" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ranking", "map"])
@pytest.mark.parametrize("named", ["", "leaderboard.json"])
def test_a_leaderboard_is_drawn_from_its_folder_or_its_file(call, folder, tmp_path, kind, named) -> None:
    out = tmp_path / "figure.pdf"
    assert call("plot", folder / named, "--kind", kind, "-o", out) == 0
    assert out.read_bytes().startswith(b"%PDF")


@pytest.mark.slow
def test_every_table_of_a_leaderboard_is_drawn_or_the_one_that_is_asked_for(call, tmp_path, capsys) -> None:
    board = make_board()
    second = replace(board.tables[0], ranked_by="inclination", rows=board.tables[0].rows[:2], pairs=())
    (tmp_path / "leaderboard.json").write_text(json.dumps(replace(board, tables=(*board.tables, second)).to_json()))
    out = tmp_path / "figure.svg"
    assert call("plot", tmp_path, "--kind", "ranking", "-o", out) == 0
    assert "inclination RMSE" in (tmp_path / "figure-2.svg").read_text()
    assert "total RMSE" in out.read_text()
    assert call("plot", tmp_path, "--kind", "ranking", "-o", out, "--table", "2") == 0
    assert out.read_text() == (tmp_path / "figure-2.svg").read_text()
    assert call("plot", tmp_path, "--kind", "ranking", "-o", out, "--table", "slow") == 0
    assert "figure.svg: slow, by total" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ([".", "--kind", "ranking", "-o", "x.pdf", "--table", "9"], "--table 9: there is no such table; there are 1 ("),
        ([".", "--kind", "map", "-o", "x.pdf", "--table", "1"], "--table 1: chooses a ranking"),
        (["run.mcap", "--kind", "errors", "-o", "x.jpg"], "-o x.jpg: ends in none of .pdf, .svg, .png"),
        (["run.mcap", "--kind", "ranking", "-o", "x.pdf"], "run.mcap: is not a result of stillpoint leaderboard"),
        (["missing.mcap", "--kind", "angles", "-o", "x.pdf"], "missing.mcap: there is no such file"),
        (["run.mcap", "leaderboard.json", "--kind", "map", "-o", "x.pdf"], "--kind ranking and map take one"),
    ],
)
def test_a_wrong_call_gives_one_line_error(call, folder, monkeypatch, capsys, words, says) -> None:
    monkeypatch.chdir(folder)
    assert call("plot", *words) == 2
    printed = capsys.readouterr().err.strip()
    assert says in printed
    assert len(printed.splitlines()) == 1
