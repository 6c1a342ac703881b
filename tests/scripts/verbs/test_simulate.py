"""``stillpoint simulate``: files, lines, refusals."""

import json

import pytest

from stillpoint.datasets import read
from stillpoint.datasets.simulate import SIMULATIONS, simulate


def test_writes_one_file_and_one_line_per_seed(call, tmp_path, capsys):
    assert (
        call(
            "simulate",
            "phone-1",
            "-o",
            str(tmp_path / "new" / "folder"),
            "--seed",
            "7",
            "--seeds",
            "2",
            "--minutes",
            "0.6",
        )
        == 0
    )
    files = sorted((tmp_path / "new" / "folder").iterdir())
    assert [file.name for file in files] == ["phone-1-seed7.mcap", "phone-1-seed8.mcap"]
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in lines] == [str(file) for file in files]
    assert "0.6 min" in lines[0]
    made = simulate("phone-1", seed=8, minutes=0.6)
    kept = read(files[1])
    assert kept.imu.gyro_b_radps.tobytes() == made.imu.gyro_b_radps.tobytes()
    assert kept.truth.q_nb.tobytes() == made.truth.q_nb.tobytes()
    assert kept.base_pose.tobytes() == made.base_pose.tobytes()
    assert kept.info == made.info


def test_a_length_in_seconds_is_one_in_minutes(call, tmp_path):
    for folder, length in (("a", ("--seconds", "3")), ("b", ("--minutes", "0.05"))):
        assert call("simulate", "spin-constant", "-o", tmp_path / folder, *length) == 0
    first, second = (tmp_path / folder / "spin-constant-white-seed0.mcap" for folder in ("a", "b"))
    assert first.read_bytes() == second.read_bytes()
    assert call("simulate", "spin-constant", "-o", tmp_path, "--seconds", "3", "--minutes", "1") == 2


def test_same_options_same_bytes(call, tmp_path):
    for folder in ("a", "b"):
        assert call("simulate", "phone-2", "-o", str(tmp_path / folder), "--minutes", "1.5", "--rate", "50") == 0
    first, second = (tmp_path / folder / "phone-2-seed0.mcap" for folder in ("a", "b"))
    assert first.read_bytes() == second.read_bytes()


@pytest.mark.parametrize("to_stdout", [True, False])
def test_json_says_what_was_made(call, tmp_path, capsys, to_stdout):
    target = "-" if to_stdout else str(tmp_path / "made.json")
    assert (
        call("simulate", "phone-1", "-o", str(tmp_path), "--minutes", "0.6", "--sensor", "perfect", "--json", target)
        == 0
    )
    printed = capsys.readouterr().out
    made = json.loads(printed if to_stdout else (tmp_path / "made.json").read_text())
    assert [row["file"] for row in made["rows"]] == [str(tmp_path / "phone-1-seed0.mcap")]
    assert made["rows"][0]["rates_hz"]["imu"] == pytest.approx(100.0)


def test_the_help_names_every_simulation(call, capsys):
    assert call("simulate", "--help") == 0
    text = capsys.readouterr().out
    assert all(kind in text for kind in SIMULATIONS)


@pytest.mark.parametrize(
    ("tokens", "message"),
    [
        (["walk"], "there are phone-1, phone-2, phone-3"),
        (["phone3"], "did you mean 'phone-3'?"),
        (["phone-1", "--seeds", "0"], "--seeds 0"),
        (["phone-1", "--sensor", "gyroscope"], "phone, perfect"),
        (["phone-3", "--minutes", "1"], "at least 1.38"),
        (["phone-1", "--minutes", "0.6", "--json", "no/such/folder/x.json"], "Its folder does not exist"),
    ],
)
def test_wrong_options_are_one_line_and_exit_code_2(call, tmp_path, capsys, tokens, message):
    assert call("simulate", *tokens, "-o", str(tmp_path)) == 2
    error = capsys.readouterr().err.strip()
    assert message in error
    assert "\n" not in error
