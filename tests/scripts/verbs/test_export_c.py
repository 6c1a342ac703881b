"""``export-c`` on the command line."""

from pathlib import Path

import pytest

from stillpoint.scripts import main as command


def call(*words: str) -> int:
    with pytest.raises(SystemExit) as stop:
        command.main(["export-c", *words])
    return int(stop.value.code or 0)


@pytest.mark.slow
def test_all_six_filters_are_written_with_their_settings(tmp_path: Path) -> None:
    saved = tmp_path / "ekf.toml"
    saved.write_text('estimator = "ekf"\n[params]\nwindow_s = 0.5\n')
    names = f"cf,cf-fixed,kf-axis,ekf@{saved},roll-ekf,roll-aekf"
    assert call("-e", names, "-o", str(tmp_path / "c"), "--set", "cf.zeta=0.5", "--declination", "3") == 0
    stems = ("cf", "cf_fixed", "kf_axis", "ekf", "roll_ekf", "roll_aekf")
    assert sorted(path.name for path in (tmp_path / "c").iterdir()) == sorted(
        f"{stem}.{kind}" for stem in stems for kind in "ch"
    )
    assert "zeta = 0.5" in (tmp_path / "c" / "cf.h").read_text()
    assert "window_s = 0.5" in (tmp_path / "c" / "ekf.h").read_text()
    assert "0.05235987755982" in (tmp_path / "c" / "ekf.c").read_text()  # 3 deg


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("-e", "vqf"), "vqf: cannot be exported to C; choose among cf, "),
        (("-e", "cf", "--set", "ekf.window_s=1"), "--set ekf.window_s=1: write ESTIMATOR.NAME=VALUE of cf"),
        (("-e", "cf", "--set", "cf.zeta=-1"), "zeta"),
    ],
)
def test_a_mistake_gives_one_line_error_and_nothing_is_written(words, says, tmp_path: Path, capsys) -> None:
    assert call(*words, "-o", str(tmp_path / "c")) == 2
    said = capsys.readouterr().err
    assert says in said
    assert said.count("\n") == 1
    assert not (tmp_path / "c").exists()
