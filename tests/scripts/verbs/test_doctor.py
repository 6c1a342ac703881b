"""``doctor``: what it reports, applies, records, and never overwrites."""

import json
from dataclasses import replace

import numpy as np
import pytest

from stillpoint.datasets.mcap.store import read_recording, write
from stillpoint.datasets.simulate import simulate
from stillpoint.scripts.main import main


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A clean recording and one whose gyro has x flipped."""
    folder = tmp_path_factory.mktemp("doctor")
    clean = simulate("phone-3", seed=3, minutes=1.4, rate_hz=50.0)
    write(folder / "clean.mcap", clean)
    imu = replace(clean.imu, gyro_b_radps=clean.imu.gyro_b_radps * [-1.0, 1.0, 1.0])
    write(folder / "flipped.mcap", replace(clean, name="flipped", imu=imu))
    return folder


def call(*arguments):
    with pytest.raises(SystemExit) as ended:
        main(["doctor", *map(str, arguments)])
    return ended.value.code


@pytest.mark.slow
def test_the_verb_reports_and_strict_sets_the_exit_code(files, capsys):
    assert call(files / "clean.mcap", "--strict", "--json", "-") == 0
    assert {row["severity"] for row in json.loads(capsys.readouterr().out)["rows"]} == {"fact"}
    assert call(files / "flipped.mcap") == 0
    assert "gyro x -> -x" in capsys.readouterr().out
    assert call(files / "flipped.mcap", "--strict") == 2


@pytest.mark.slow
def test_the_verb_applies_remedies_and_records_them(files, tmp_path, capsys):
    before = (files / "flipped.mcap").read_bytes()
    assert call(files, "--apply", "-o", tmp_path / "mended") == 0
    mended, clean = (read_recording(tmp_path / "mended" / f"{name}.mcap") for name in ("flipped", "clean"))
    assert np.array_equal(mended.imu.gyro_b_radps, clean.imu.gyro_b_radps)
    assert mended.info.conversions[-1] == "doctor: gyro x -> -x"
    assert (files / "flipped.mcap").read_bytes() == before


@pytest.mark.slow
def test_a_remedy_can_be_left_out(files, tmp_path, capsys):
    assert call(files / "flipped.mcap", "--apply", "-o", tmp_path, "--skip", "gyro-axes") == 0
    assert "0 of 1 remedies applied" in capsys.readouterr().out
    kept, before = read_recording(tmp_path / "flipped.mcap"), read_recording(files / "flipped.mcap")
    assert np.array_equal(kept.imu.gyro_b_radps, before.imu.gyro_b_radps)


@pytest.mark.parametrize("flags", [["--apply"], ["-o", "x"], ["--apply", "-o", "."]])
def test_the_verb_never_overwrites_and_wants_a_folder(files, flags, capsys, monkeypatch):
    monkeypatch.chdir(files)
    assert call("clean.mcap", *flags) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


@pytest.mark.slow
def test_several_files_end_in_a_summary_by_finding(files, capsys):
    """Facts are left to the JSON; --errors leaves the warnings out too."""
    assert call(files, "--errors") == 0
    out = capsys.readouterr().out
    assert "2 recordings, 1 clean" in out
    assert "error\tgyro-axes\t1\tflipped" in out
    assert not [line for line in out.splitlines() if line.strip().startswith("fact ")]


@pytest.mark.slow
def test_repair_is_another_name_for_apply(files, tmp_path):
    assert call(files / "flipped.mcap", "--repair", "-o", tmp_path / "mended") == 0
    assert read_recording(tmp_path / "mended" / "flipped.mcap").info.conversions[-1] == "doctor: gyro x -> -x"


@pytest.mark.slow
@pytest.mark.parametrize("place", ["52,13", "-35,149,600"])
def test_the_place_decides_whether_a_field_that_points_up_is_wrong(files, tmp_path, capsys, place):
    """An inverted accelerometer makes the field point up: right in the south, wrong in the north."""
    clean = read_recording(files / "clean.mcap")
    imu = replace(clean.imu, accel_b_mps2=-clean.imu.accel_b_mps2)
    info = replace(clean.info, place_lat_lon_alt=None, units_unchecked=True)
    write(tmp_path / "up.mcap", replace(clean, imu=imu, truth=None, base_pose=None, info=info))
    assert call(tmp_path / "up.mcap", "--place", place, "--date", "2033-01-01", "--json", "-") == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    found = [row for row in rows if row["severity"] != "fact"]
    assert [row["code"] for row in found] == ([] if place.startswith("-") else ["gravity-inverted"])
    assert all(row["remedy"] is None for row in found), "gravity or the field: nothing tells which"


@pytest.mark.parametrize("flags", [["--place", "91,0"], ["--place", "here"], ["--date", "yesterday"]])
def test_an_invalid_place_or_date_gives_one_line_error(files, flags, capsys):
    assert call(files / "clean.mcap", *flags) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


@pytest.mark.slow
def test_one_file_that_cannot_be_read_does_not_cost_the_others(files, tmp_path, capsys):
    (tmp_path / "broken.mcap").write_bytes(b"no MCAP")
    assert call(files / "clean.mcap", tmp_path / "broken.mcap", "--json", "-") == 2
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert [row["code"] for row in rows if row["severity"] == "error"] == ["unreadable"]
    assert {row["recording"] for row in rows} == {"phone-3-seed3", "broken"}
