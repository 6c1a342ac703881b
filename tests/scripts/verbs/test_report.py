"""The verbs report, export and view find what lies beside a recording, and write beside it."""

import pytest

from stillpoint.datasets import write
from stillpoint.datasets.simulate import simulate
from stillpoint.filters import estimate
from stillpoint.scripts.verbs.view import _add_companions


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two recordings with truth, each with an estimate beside it."""
    place = tmp_path_factory.mktemp("report")
    for seed in (0, 1):
        recording = simulate("phone-1", minutes=0.6, seed=seed)
        write(place / f"run{seed}.mcap", recording)
        write(place / f"run{seed}.gyro.estimate.mcap", estimate(recording, "gyro"))
    return place


@pytest.mark.slow
def test_a_report_lands_beside_its_recording(call, folder, monkeypatch, tmp_path, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    assert call("report", folder / "run0.mcap") == 0
    page = folder / "run0.report.html"
    assert capsys.readouterr().out.strip() == str(page)
    assert "gyro" in page.read_text(encoding="utf-8")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_report_can_go_to_another_folder_or_file(call, folder, tmp_path) -> None:
    assert call("report", folder / "run0.mcap", "-o", tmp_path / "pages") == 0
    assert (tmp_path / "pages" / "run0.report.html").is_file()
    assert call("report", folder / "run0.mcap", "-o", tmp_path / "mine.html") == 0
    assert (tmp_path / "mine.html").is_file()


@pytest.mark.slow
def test_one_recording_without_estimates_costs_no_other(call, folder, tmp_path, capsys) -> None:
    write(folder / "alone.mcap", simulate("phone-1", minutes=0.6))
    assert call("report", folder, "-o", tmp_path) == 2
    printed = capsys.readouterr()
    assert {path.name for path in tmp_path.iterdir()} == {"run0.report.html", "run1.report.html"}
    assert "no report: " in printed.err
    assert "make one: stillpoint reference" in printed.err
    (folder / "alone.mcap").unlink()


def test_an_export_lands_beside_its_file(call, folder, monkeypatch, tmp_path) -> None:
    monkeypatch.chdir(tmp_path)
    assert call("export", folder / "run0.mcap", "--format", "tum") == 0
    assert (folder / "run0.truth.tum").is_file()
    assert list(tmp_path.iterdir()) == []


def test_view_shows_the_estimates_beside_a_recording(folder) -> None:
    names = [path.name for path in _add_companions([folder / "run1.mcap"])]
    assert names == ["run1.mcap", "run1.gyro.estimate.mcap"]
