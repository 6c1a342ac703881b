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
    clean = simulate("phone-3", seed=3, minutes=1.6)
    write(folder / "clean.mcap", clean)
    imu = replace(clean.imu, gyro_b_radps=clean.imu.gyro_b_radps * [-1.0, 1.0, 1.0])
    write(folder / "flipped.mcap", replace(clean, name="flipped", imu=imu))
    return folder


def call(*arguments):
    with pytest.raises(SystemExit) as ended:
        main(["doctor", *map(str, arguments)])
    return ended.value.code


def test_the_verb_reports_and_strict_sets_the_exit_code(files, capsys):
    assert call(files / "clean.mcap", "--strict", "--json", "-") == 0
    assert {row["severity"] for row in json.loads(capsys.readouterr().out)["rows"]} == {"fact"}
    assert call(files / "flipped.mcap") == 0
    assert "gyro x -> -x" in capsys.readouterr().out
    assert call(files / "flipped.mcap", "--strict") == 2


def test_the_verb_applies_remedies_and_records_them(files, tmp_path, capsys):
    before = (files / "flipped.mcap").read_bytes()
    assert call(files, "--apply", "-o", tmp_path / "mended") == 0
    mended, clean = (read_recording(tmp_path / "mended" / f"{name}.mcap") for name in ("flipped", "clean"))
    assert np.array_equal(mended.imu.gyro_b_radps, clean.imu.gyro_b_radps)
    assert mended.info.conversions[-1] == "doctor: gyro x -> -x"
    assert (files / "flipped.mcap").read_bytes() == before


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
