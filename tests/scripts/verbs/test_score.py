"""The verbs demo, score and report, the way a user calls them."""

import json
import shutil

import pytest

from stillpoint.datasets.mcap.store import read_estimate, write
from stillpoint.scripts.shared.companions import get_recording_name, select_files
from stillpoint.scripts.verbs.demo import SHOWN

NAME = "phone-3-seed0"


@pytest.fixture(scope="module")
def made(call, tmp_path_factory):
    """The folder of a short demo."""
    folder = tmp_path_factory.mktemp("demo")
    assert call("demo", "-o", folder, "--minutes", "1.5") == 0
    return folder


@pytest.fixture
def folder(made, tmp_path):
    """A copy that a test may change."""
    return shutil.copytree(made, tmp_path / "demo")


def rows_of(call, capsys, *arguments):
    capsys.readouterr()
    code = call("score", *arguments, "--json", "-")
    return code, json.loads(capsys.readouterr().out)["rows"]


def test_demo_leaves_the_files_of_every_step(made):
    expected = {f"{NAME}.mcap", f"{NAME}.reference.mcap", f"{NAME}.report.html"}
    expected |= {f"{NAME}.{name}.estimate.mcap" for name in SHOWN} | {f"{NAME}.redistribution.reference.mcap"}
    assert {path.name for path in made.iterdir()} == expected


@pytest.mark.slow
def test_score_takes_the_reference_beside_the_estimates(call, made, capsys):
    code, rows = rows_of(call, capsys, made)
    assert code == 0
    assert sorted(row["method"] for row in rows) == sorted(SHOWN)
    assert {row["against"] for row in rows} == {"reference (graph)"}
    assert all(row["total_rmse_deg"] > 0 and row["reference_sd_deg"] > 0 and row["error"] is None for row in rows)
    assert set(rows[0]["found"]) == {"heading_deg", "mounting_deg", "mounting_rotvec_deg", "time_s"}


@pytest.mark.slow
def test_a_recording_stands_for_the_estimates_beside_it(call, made, capsys):
    code, rows = rows_of(call, capsys, made / f"{NAME}.mcap")
    assert code == 0
    assert sorted(row["method"] for row in rows) == sorted(SHOWN)


def test_a_recording_without_estimates_says_what_to_do(call, folder, capsys):
    for file in folder.glob("*.estimate.mcap"):
        file.unlink()
    assert call("score", folder / f"{NAME}.mcap") == 2
    assert "no estimate lies beside it; make one (stillpoint estimate" in capsys.readouterr().err


def test_score_takes_the_truth_where_there_is_no_reference(call, folder, capsys):
    for file in folder.glob("*.reference.mcap"):
        file.unlink()
    code, rows = rows_of(call, capsys, folder / f"{NAME}.vqf.estimate.mcap")
    assert (code, rows[0]["against"], rows[0]["reference_sd_deg"]) == (0, "truth", None)


@pytest.mark.slow
def test_against_both_scores_by_truth_and_by_the_reference(call, made, capsys):
    _, rows = rows_of(call, capsys, made, "--against", "both")
    judges = {}
    for row in rows:
        judges.setdefault(row["method"], []).append(row["against"])
    assert all(found == ["truth", "reference (graph)"] for found in judges.values())


@pytest.mark.slow
def test_against_truth_leaves_the_reference_aside(call, made, capsys):
    _, rows = rows_of(call, capsys, made, "--against", "truth")
    assert {row["against"] for row in rows} == {"truth"}


def test_score_of_a_reference_is_against_the_truth(call, made, capsys):
    code, rows = rows_of(call, capsys, made / f"{NAME}.reference.mcap")
    assert (code, rows[0]["method"], rows[0]["against"]) == (0, "reference (graph)", "truth")
    assert 0 <= rows[0]["coverage95"] <= 1


def test_table_has_a_row_per_estimate(call, made, capsys):
    capsys.readouterr()
    assert call("score", made, "--align", "heading+mounting", "--frame", "ned") == 0
    out = capsys.readouterr().out
    assert all(f"\n{name}\t" in out for name in SHOWN)
    assert "largest absolute error in NED" in out
    assert "mounting" in out
    assert "the reference's own sd is" in out


@pytest.mark.slow
def test_turns_are_compared_over_the_times_asked_for(call, made, capsys):
    assert call("score", made, "--over", "1,10", "--json", "-") == 0
    for row in json.loads(capsys.readouterr().out)["rows"]:
        assert [turn["over_s"] for turn in row["turns"]] == [1.0, 10.0]
        assert all(0 < turn["rmse_deg"] <= turn["max_deg"] for turn in row["turns"])
    assert call("score", made, "--over", "10") == 0
    assert "over 10 s" in capsys.readouterr().out


@pytest.mark.parametrize("over", ["0", "1,x", "-1", "inf", ""])
def test_a_time_that_is_none_gives_one_line_error(call, made, capsys, over):
    assert call("score", made, f"--over={over}") == 2
    assert "give seconds above 0 with commas between" in capsys.readouterr().err


def test_unknown_alignment_gives_one_line_error(call, made, capsys):
    assert call("score", made, "--align", "yaw") == 2
    assert "heading+mounting+time" in capsys.readouterr().err


@pytest.mark.slow
def test_estimate_of_another_recording_is_refused(call, folder, capsys):
    """The name fits, the SHA-256 does not: a score would compare two different runs."""
    file = folder / f"{NAME}.vqf.estimate.mcap"
    estimate = read_estimate(file)
    object.__setattr__(estimate, "made_from", {f"{NAME}.mcap": "0" * 64})
    write(file, estimate)
    assert call("score", file) == 2
    assert "was made from another recording" in capsys.readouterr().err
    code, rows = rows_of(call, capsys, folder)
    assert code == 2
    assert [row["file"] for row in rows if row["error"]] == [str(file)]
    assert call("report", folder, "-o", folder) == 2


def test_nothing_to_score_against_says_what_to_do(call, folder, capsys):
    for file in (*folder.glob("*.reference.mcap"), folder / f"{NAME}.mcap"):
        file.unlink()
    assert call("score", folder / f"{NAME}.vqf.estimate.mcap") == 2
    assert "stillpoint reference" in capsys.readouterr().err


def test_several_references_ask_for_one_to_be_named(call, folder, capsys):
    shutil.move(folder / f"{NAME}.reference.mcap", folder / f"{NAME}.graph.reference.mcap")
    file = folder / f"{NAME}.vqf.estimate.mcap"
    assert call("score", file) == 2
    assert "--against" in capsys.readouterr().err
    code, rows = rows_of(call, capsys, file, "--against", folder / f"{NAME}.redistribution.reference.mcap")
    assert (code, rows[0]["against"]) == (0, "reference (redistribution)")


def test_graph_is_nearer_to_the_truth_than_what_it_is_compared_with(call, made, capsys):
    code, rows = rows_of(call, capsys, *made.glob("*.reference.mcap"), "--against", made / f"{NAME}.mcap")
    total_deg = {row["method"]: row["total_rmse_deg"] for row in rows}
    assert code == 0
    assert total_deg["reference (graph)"] < 0.7 * total_deg["reference (redistribution)"]


@pytest.mark.slow
@pytest.mark.ink
def test_report_writes_a_page_per_recording(call, made, tmp_path, capsys):
    assert call("report", made, "-o", tmp_path / "pages") == 0
    page = tmp_path / "pages" / f"{NAME}.report.html"
    assert str(page) in capsys.readouterr().out
    assert page.read_bytes() == (made / page.name).read_bytes()


def test_report_without_reference_or_truth_says_what_to_do(call, tmp_path, capsys):
    assert call("simulate", "phone-1", "-o", tmp_path, "--minutes", "1") == 0
    assert call("report", tmp_path / "phone-1-seed0.mcap", "-o", tmp_path) == 2
    assert "no reference or estimate of it lies beside it" in capsys.readouterr().err


def test_files_of_one_recording_are_told_from_those_of_another(tmp_path):
    names = ("run.reference", "run.graph.reference", "run2.reference", "run.2.graph.reference", "run.vqf.estimate")
    files = [tmp_path / f"{name}.mcap" for name in names]
    assert select_files("run", "reference", files) == files[:2]
    assert select_files("run.2", "reference", files) == [files[3]]
    assert select_files("run", "estimate", files) == [files[4]]
    assert get_recording_name(tmp_path / "a.b.vqf.estimate.mcap") == "a.b"
    assert get_recording_name(tmp_path / "a.b.mcap") == "a.b"
