"""The command `stillpoint archive`: exit codes, lines for people and for other commands, JSON."""

import io
import json
import os
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from shelf import write_family, write_recording
from warm_command import warm_command

from stillpoint.datasets import read, write
from stillpoint.datasets.simulate import simulate


@pytest.fixture
def lab(tmp_path, call, monkeypatch, capsys):
    """An archive with one family of files, named by the environment."""
    monkeypatch.setenv("STILLPOINT_ARCHIVE", str(tmp_path / "lab"))
    files = tmp_path / "files"
    files.mkdir()
    write_family(files, "walk", 1, sensor="iPhone 5")
    assert call("archive", "init", tmp_path / "lab") == 0
    assert call("archive", "add", files, "--tag", "fast", "--set", "subject=anna") == 0
    assert "3 added: 1 estimate, 1 recording, 1 reference" in capsys.readouterr().out
    return tmp_path / "lab"


def test_find_gives_lines_paths_and_json(lab, call, capsys):
    assert call("archive", "find", "kind:recording and tag:fast and sensor ~ iphone") == 0
    sha256, kind, name = capsys.readouterr().out.strip().split("\t")
    assert (len(sha256), kind, name) == (64, "recording", "walk.mcap")
    assert call("archive", "find", "has:imu", "--paths") == 0
    assert capsys.readouterr().out.strip() == str(lab / "names" / "walk.mcap")
    assert call("archive", "find", "all", "--json", "-") == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert [row["kind"] for row in rows] == ["estimate", "recording", "reference"]
    assert rows[1]["metadata"] == {"subject": "anna"}
    assert call("archive", "find", "all", "--archive", lab) == 0


def test_the_lines_of_find_are_read_from_the_standard_input(lab, call, capsys, monkeypatch):
    call("archive", "find", "kind:recording")
    monkeypatch.setattr("sys.stdin", io.StringIO(capsys.readouterr().out))
    assert call("archive", "tag", "-", "--tag", "checked", "--without", "fast") == 0
    call("archive", "find", "tag:checked", "--json", "-")
    (row,) = json.loads(capsys.readouterr().out.partition("\n")[2])["rows"]
    assert row["tags"] == ["checked"]


def test_show_draws_what_an_object_was_made_from_and_what_was_made_from_it(lab, call, capsys):
    assert call("archive", "show", "walk.reference.mcap") == 0
    said = capsys.readouterr().out
    assert "made from" in said
    assert "walk.mcap  (recording)" in said
    assert call("archive", "show", "walk") == 0
    said = capsys.readouterr().out
    assert "derived" in said
    assert "walk.ekf.estimate.mcap  (estimate)" in said
    assert call("archive", "show", "walk", "--json", "-") == 0
    (row,) = json.loads(capsys.readouterr().out)["rows"]
    assert {child["kind"] for child in row["derived"]} == {"reference", "estimate"}
    assert row["facts"]["info"]["sensor"] == "iPhone 5"


def test_show_has_the_scores_of_a_recording_and_of_its_estimates(lab, call, capsys, tmp_path):
    assert call("score", lab / "names", "--align", "none", "--json", tmp_path / "scores.json") == 0
    assert call("archive", "add", tmp_path / "scores.json") == 0
    capsys.readouterr()
    for name in ("walk", "walk.ekf.estimate.mcap", "scores.json"):
        assert call("archive", "show", name, "--json", "-") == 0
        (row,) = json.loads(capsys.readouterr().out)["rows"]
        assert [(one["estimator"], one["total_rmse_deg"]) for one in row["scores"]] == [
            ("ekf", pytest.approx(0.0, abs=1e-6))
        ]
    assert call("archive", "find", "total_rmse_deg < 1 and kind:score") == 0
    assert call("archive", "verify") == 0


def test_verify_ends_with_0_when_clean_and_with_1_when_not(lab, call, capsys):
    assert call("archive", "verify") == 0
    assert "3 objects" in capsys.readouterr().out
    (path,) = [path for path in (lab / "objects").rglob("*.mcap") if path.samefile(lab / "names" / "walk.mcap")]
    whole = path.read_bytes()
    path.write_bytes(whole[:-1])
    assert call("archive", "verify", "--json", "-") == 1
    (fault,) = json.loads(capsys.readouterr().out)["rows"]
    assert fault["level"] == "object"
    assert "repair --from OTHER" in fault["repair"]
    assert call("archive", "repair") == 1
    assert call("archive", "repair", "--from", lab.parent / "files") == 0
    assert path.read_bytes() == whole
    assert call("archive", "verify") == 0


def test_a_refused_file_gives_one_line_error_and_exit_code_2(lab, call, capsys, tmp_path):
    broken = write_recording(tmp_path / "broken.mcap", 5)
    broken.write_bytes(broken.read_bytes()[:-9] + b"x" * 9)
    assert call("archive", "add", broken) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_remove_and_gc_say_what_they_do(lab, call, capsys):
    assert call("archive", "remove", "walk", "--reason", "wrong subject") == 2
    assert "were made from it" in capsys.readouterr().err
    assert call("archive", "remove", "walk", "--reason", "wrong subject", "--with-derived") == 0
    assert len(capsys.readouterr().out.splitlines()) == 3
    assert call("archive", "gc", "--older-than", "0s") == 0
    assert "--yes deletes them" in capsys.readouterr().err
    assert len(list((lab / "objects").rglob("*.mcap"))) == 3
    assert call("archive", "gc", "--older-than", "0s", "--yes") == 0
    assert not list((lab / "objects").rglob("*.mcap"))
    assert call("archive", "verify") == 0


@pytest.mark.slow
def test_export_and_import_round_trip(lab, call, capsys, tmp_path):
    pytest.importorskip("rocrate")
    pytest.importorskip("mlcroissant")
    assert call("archive", "export", "all", "-o", tmp_path / "walks.zip", "--author", "Anna Example") == 0
    assert "walks.zip: 1 estimate, 1 recording, 1 reference" in capsys.readouterr().out
    assert call("archive", "init", tmp_path / "other") == 0
    assert call("archive", "import", tmp_path / "walks.zip", "--archive", tmp_path / "other") == 0
    assert call("archive", "verify", "--archive", tmp_path / "other") == 0
    capsys.readouterr()
    call("archive", "list")
    here = capsys.readouterr().out
    call("archive", "list", "--archive", tmp_path / "other")
    assert capsys.readouterr().out == here
    assert call("archive", "export", "all", "-o", tmp_path / "walks.zip") == 2


def test_a_recording_and_its_results_are_published_as_one_file_for_viewers(lab, call, tmp_path):
    assert call("archive", "bundle", "walk.ekf.estimate.mcap", "-o", tmp_path / "one.mcap") == 0
    assert call("info", tmp_path / "one.mcap") == 0
    assert (tmp_path / "one.foxglove.json").is_file()
    assert call("archive", "bundle", "walk", "-e", "kef", "-o", tmp_path / "one.mcap") == 2


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["find", "rate >> 3"], "cannot be understood"),
        (["show", "nothing"], "no such object"),
        (["gc", "--older-than", "soon"], "write a number and"),
        (["verify", "--remake", "some"], "give a number, or all"),
        (["add", "absent.mcap"], "no such file"),
        (["tag", "walk"], "nothing to change"),
    ],
)
def test_a_mistake_gives_one_line_error(lab, call, capsys, words, says):
    assert call("archive", *words) == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count("\n") == 1


def test_without_an_archive_the_line_says_how_to_name_one(call, capsys, monkeypatch):
    monkeypatch.delenv("STILLPOINT_ARCHIVE", raising=False)
    assert call("archive", "list") == 2
    assert "STILLPOINT_ARCHIVE" in capsys.readouterr().err


def test_recover_writes_what_is_left_into_another_folder(call, capsys, tmp_path):
    run = write_recording(tmp_path / "run.mcap", 4, n=9000)
    data = bytearray(run.read_bytes())
    data[len(data) // 2] ^= 4
    run.write_bytes(data)
    assert call("info", run) == 2
    assert call("recover", run, "-o", tmp_path / "back") == 0
    assert "lost: the chunk at byte" in capsys.readouterr().out
    assert call("info", tmp_path / "back" / "run.mcap") == 0
    assert call("recover", run, "-o", tmp_path) == 2


@pytest.mark.slow
def test_the_script_of_a_bundle_makes_everything_anew(call, tmp_path, monkeypatch):
    """As a reader of the dataset would: a changed estimate is found, and the leaderboard is made all the same."""
    recordings = tmp_path / "recordings"
    recordings.mkdir()
    write(recordings / "run.mcap", simulate("phone-1", minutes=0.6))
    assert call("estimate", recordings, "-e", "cf,gyro") == 0
    assert call("leaderboard", recordings, "-e", "cf,gyro", "-o", tmp_path / "board") == 0
    kept = read(recordings / "run.gyro.estimate.mcap")
    write(recordings / "run.gyro.estimate.mcap", replace(kept, q_nb=np.roll(kept.q_nb, 1, axis=0)))
    home, bundle = tmp_path / "lab", tmp_path / "bundle"
    assert call("archive", "init", home) == 0
    assert call("archive", "add", "--archive", home, recordings, tmp_path / "board" / "leaderboard.json") == 0
    assert call("archive", "export", "all", "--archive", home, "-o", bundle, "--allow-unlicensed") == 0
    with warm_command(tmp_path / "bin") as command:
        monkeypatch.setenv("PATH", f"{command.parent}{os.pathsep}{os.environ['PATH']}")
        ended = subprocess.run(["sh", "reproduce.sh"], cwd=bundle, capture_output=True, text=True)
    assert ended.returncode == 1
    assert "2 made again, 1 differ" in ended.stdout
    assert "run.gyro.estimate.mcap differs" in ended.stdout
    (remade,) = bundle.glob("remade/*/leaderboard.json")
    boards = [json.loads(file.read_text()) for file in (tmp_path / "board" / "leaderboard.json", remade)]
    figures = [[row["total_rmse_deg"] for row in board["recordings"]] for board in boards]
    assert figures[0] == pytest.approx(figures[1], rel=1e-9)
