"""The verbs import and info, through the command line."""

import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from stillpoint.datasets import Recording
from stillpoint.datasets.importers.table import IMPORTERS
from stillpoint.datasets.mcap.store import read_recording, write
from stillpoint.scripts.verbs.import_ import Flags


@pytest.fixture
def log(tmp_path: Path) -> Path:
    lines = ["t,gx,gy,gz,ax,ay,az"] + [f"{10 * k},0.5,-1,2,0,0,-1" for k in range(1200)]
    file = tmp_path / "still.csv"
    file.write_text("\n".join(lines))
    return file


FLAGS = ("--time", "t:ms", "--gyro", "-gx,gy,gz:deg/s", "--accel", "ax,ay,-az:g")


def test_import_writes_the_recording_and_says_what_it_converted(call, log, tmp_path, capsys):
    assert call("import", "csv", log, "-o", tmp_path / "out", *FLAGS, "--licence", "CC0", "--json", "-") == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    recording = read_recording(rows[0]["file"])
    assert recording.name == rows[0]["recording"] == "still"
    np.testing.assert_allclose(recording.imu.gyro_b_radps[7], np.deg2rad([-0.5, -1, 2]))
    np.testing.assert_allclose(recording.imu.accel_b_mps2[7], [0, 0, 9.80665])
    assert recording.info.licence == "CC0"
    assert any("sign of x flipped" in line for line in rows[0]["conversions"])
    assert rows[0]["streams"]["imu"] == {"samples": 1200, "rate_hz": 100.0}


def test_import_prints_each_conversion_once_and_notes_with_their_recording(call, log, tmp_path, capsys):
    other = log.with_name("other.csv")
    other.write_text(log.read_text().replace("\n100,0.5,", "\n100,,"))
    assert call("import", "csv", log, other, "-o", tmp_path / "out", *FLAGS) == 0
    out = capsys.readouterr().out
    assert out.count("sign of x flipped") == 1
    assert out.index("other:") < out.index("gyro: 1 of 1200 rows")
    assert "2 written to" in out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("csvv", "X"), "no kind 'csvv'"),
        (("csv",), "no source"),
        (("broad", "X", "--rate", "100"), "--rate: broad takes no such option; it takes --units-unchecked"),
        (("tyrex", "X", "--mag", "best"), "--mag best: tyrex takes raw or calibrated"),
        (("csv", "X", "--truth-frame", "frd"), "--truth-frame frd: csv takes enu or nwu or ned"),
        (("broad", "X"), "X: there is no such file"),
    ],
)
def test_wrong_words_are_one_line_and_exit_code_2(call, tmp_path, capsys, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    assert call("import", *words, "-o", tmp_path) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_two_recordings_of_one_name_are_not_written_over_each_other(call, log, tmp_path, capsys):
    (tmp_path / "again").mkdir()
    twin = tmp_path / "again" / "still.csv"
    twin.write_text(log.read_text())
    assert call("import", "csv", log, twin, "-o", tmp_path / "out", *FLAGS) == 2
    assert "already imported from" in capsys.readouterr().err


@pytest.mark.slow
def test_processes_write_the_same_bytes_and_refuse_a_name_that_another_has_taken(call, log, tmp_path, capsys):
    other = log.with_name("other.csv")
    other.write_text(log.read_text())
    (tmp_path / "again").mkdir()
    twin = tmp_path / "again" / "other.csv"
    twin.write_text(log.read_text())
    assert call("import", "csv", log, other, "-o", tmp_path / "one", *FLAGS) == 0
    assert call("import", "csv", log, other, twin, "-o", tmp_path / "two", *FLAGS, "--jobs", "2") == 2
    printed = capsys.readouterr()
    assert "other was already imported from" in printed.err
    assert "1 not imported" in printed.out
    assert (tmp_path / "two" / "still.mcap").read_bytes() == (tmp_path / "one" / "still.mcap").read_bytes()
    assert sorted(file.name for file in (tmp_path / "two").iterdir()) == ["other.mcap", "still.mcap"]


def test_info_finds_rates_gaps_and_rests(call, tmp_path, capsys):
    """20 s of rest, a second without samples, 20 s of swinging, 20 s of rest; 100 Hz with 1 mrad/s of noise."""
    t_s = np.concatenate([np.arange(0, 20, 0.01), np.arange(21, 61, 0.01)])
    swinging = (t_s > 21) & (t_s < 41)
    rng = np.random.default_rng(1)
    gyro = rng.normal(0, 1e-3, (len(t_s), 3))
    gyro[swinging] += 2 * np.sin(3 * t_s[swinging, None])
    accel = np.array([0, 0, 9.81]) + rng.normal(0, 0.01, (len(t_s), 3))
    accel[swinging] += 3 * np.cos(4 * t_s[swinging, None])
    write(tmp_path / "swing.mcap", Recording.from_arrays("swing", t_s, gyro, accel, source="a test"))
    assert call("info", tmp_path / "*.mcap", "--json", "-") == 0
    facts = json.loads(capsys.readouterr().out)["rows"][0]
    stream = facts["streams"][0]
    assert (stream["samples"], stream["gaps"]) == (6000, 1)
    assert stream["rate_hz"] == pytest.approx(100)
    assert stream["longest_gap_s"] == pytest.approx(1.01)
    assert len(facts["rests"]) == 2
    assert facts["rests"][1]["start_s"] == pytest.approx(41, abs=1)
    assert call("info", tmp_path) == 0
    out = capsys.readouterr().out
    assert "a test" in out
    assert "6000" in out


def test_info_of_what_is_no_recording(call, tmp_path, capsys):
    (tmp_path / "x.mcap").write_bytes(b"nothing of the kind")
    assert call("info", tmp_path / "x.mcap") == 2
    assert "x.mcap" in capsys.readouterr().err


def test_every_option_of_every_kind_is_a_flag_and_stands_in_the_document():
    page = (Path(__file__).parents[3] / "docs" / "importing.md").read_text()
    flags = {field.name for field in fields(Flags)}
    for kind, importer in IMPORTERS.items():
        assert f"\n## {kind}\n" in page
        for field in fields(importer.options):
            assert field.name in flags, f"{kind}: --{field.name}"
            assert f"--{field.name.replace('_', '-')}" in page, f"{kind}: --{field.name}"


def noisy(tmp_path: Path, size: float) -> Path:
    """20 s of rest with little noise; the accelerometer reads ``size`` upwards."""
    rng = np.random.default_rng(3)
    gyro, accel = rng.normal(0, 0.01, (2000, 3)), rng.normal([0, 0, size], 1e-3 * size, (2000, 3))
    file = tmp_path / "rest.csv"
    rows = np.column_stack([np.arange(2000) * 10, gyro, accel])
    np.savetxt(file, rows, delimiter=",", header="t,gx,gy,gz,ax,ay,az", comments="", fmt="%.9g")
    return file


UNITS_OF_THE_VOCABULARY = ("--time", "t:ms", "--gyro", "gx,gy,gz:rad/s", "--accel", "ax,ay,az:m/s^2")


@pytest.mark.slow
def test_repair_mends_what_would_be_refused_and_records_it(call, tmp_path, capsys):
    file = noisy(tmp_path, 1.0)
    assert call("import", "csv", file, "-o", tmp_path, *UNITS_OF_THE_VOCABULARY) == 2
    assert "looks in g" in capsys.readouterr().err
    assert call("import", "csv", file, "-o", tmp_path, *UNITS_OF_THE_VOCABULARY, "--repair") == 0
    recording = read_recording(tmp_path / "rest.mcap")
    assert recording.imu.accel_b_mps2[:, 2].mean() == pytest.approx(9.80665, rel=1e-3)
    assert any(line.startswith("doctor: accel") for line in recording.info.conversions)
    assert not recording.info.units_unchecked


@pytest.mark.slow
def test_a_remedy_that_is_skipped_is_not_applied(call, tmp_path, capsys):
    file = noisy(tmp_path, 1.0)
    words = ("import", "csv", file, "-o", tmp_path / "out", *UNITS_OF_THE_VOCABULARY)
    assert call(*words, "--repair", "--skip", "accel-units") == 2
    assert "looks in g" in capsys.readouterr().err
    assert call(*words, "--skip", "accel-units") == 2
    assert "--repair" in capsys.readouterr().err


@pytest.mark.slow
def test_what_the_doctor_cannot_mend_is_refused_unless_it_is_asked_for(call, tmp_path, capsys):
    file = noisy(tmp_path, 4.0)
    assert call("import", "csv", file, "-o", tmp_path, *UNITS_OF_THE_VOCABULARY, "--repair") == 2
    assert "at rest" in capsys.readouterr().err
    assert call("import", "csv", file, "-o", tmp_path, *UNITS_OF_THE_VOCABULARY, "--units-unchecked") == 0
    assert call("info", tmp_path / "rest.mcap", "--units-unchecked") == 0
    assert "units_unchecked" in capsys.readouterr().out


def test_a_source_that_cannot_be_read_costs_no_other(call, tmp_path, capsys):
    good = noisy(tmp_path, 9.80665)
    logs = tmp_path / "logs"
    logs.mkdir()
    (logs / "a.csv").write_text(good.read_text())
    (logs / "b.csv").write_text("t,gx\n0,1\n")
    (logs / "c.csv").write_text(good.read_text())
    missing = tmp_path / "nothing"
    assert call("import", "csv", logs, missing, "-o", tmp_path / "out", *UNITS_OF_THE_VOCABULARY) == 2
    printed = capsys.readouterr()
    assert sorted(file.name for file in (tmp_path / "out").glob("*.mcap")) == ["a.mcap", "c.mcap"]
    assert printed.err.count("\n") == 2
    assert "b.csv: no column 'gy'" in printed.err
    assert "nothing: there is no such file" in printed.err
    assert "2 not imported" in printed.out


def test_a_long_log_that_is_read_in_pieces_is_imported_as_any_other(call, tmp_path, capsys, monkeypatch):
    rng, n = np.random.default_rng(2), 800
    rows = [
        ",".join(f"{value:.6f}" for value in (k / 100, *rng.normal(size=3), *rng.normal([0, 0, 9.81], 0.02)))
        for k in range(n)
    ]
    log = tmp_path / "walk.csv"
    log.write_text("t,gx,gy,gz,ax,ay,az\n" + "\n".join(rows) + "\n")
    words = ["--time", "t:s", "--gyro", "gx,gy,gz:deg/s", "--accel", "ax,ay,az:m/s2"]
    said = []
    for name, least_bytes in (("whole", 1 << 30), ("pieces", 0)):
        monkeypatch.setattr("stillpoint.scripts.verbs.import_.LONG_BYTES", least_bytes)
        monkeypatch.setattr("stillpoint.datasets.importers.csv_pieces.PIECE_BYTES", 5000)
        assert call("import", "csv", log, "-o", tmp_path / name, *words, "--json", tmp_path / f"{name}.json") == 0
        said.append(capsys.readouterr().out.replace(str(tmp_path / name), ""))
    assert said[0] == said[1]
    assert (tmp_path / "whole/walk.mcap").read_bytes() == (tmp_path / "pieces/walk.mcap").read_bytes()
    facts = [json.loads((tmp_path / f"{name}.json").read_text())["rows"][0] for name in ("whole", "pieces")]
    assert {**facts[0], "file": ""} == {**facts[1], "file": ""}
