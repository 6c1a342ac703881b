"""Solved windows in a folder: those of the same run come back, those of other runs go."""

from pathlib import Path

import numpy as np

from stillpoint.scripts.shared.window_folder import WindowFolder, remove_windows
from stillpoint.smoother.attitude.long.kept_windows import PackedWindow

WINDOW = PackedWindow({"windows": 3, "window": {"cost": 0.1}}, {"a0": np.arange(3.0), "a1": np.eye(2, order="F")})


def test_a_window_comes_back_as_it_was(tmp_path: Path) -> None:
    WindowFolder(tmp_path / "run.reference.mcap", "key")["first"] = WINDOW
    again = WindowFolder(tmp_path / "run.reference.mcap", "key")
    assert list(again) == ["first"]
    assert again.count_windows() == 3
    found = again["first"]
    assert found.facts == WINDOW.facts
    for name, array in WINDOW.arrays.items():
        np.testing.assert_array_equal(found.arrays[name], array)
        assert found.arrays[name].flags.f_contiguous == array.flags.f_contiguous  # sums go in the same order


def test_nothing_is_made_before_a_window_is_kept(tmp_path: Path) -> None:
    windows = WindowFolder(tmp_path / "run.reference.mcap", "key")
    assert windows.get("first") is None
    assert windows.count_windows() == 0
    remove_windows(tmp_path / "run.reference.mcap")
    assert not list(tmp_path.iterdir())


def test_windows_of_a_run_with_other_inputs_are_removed(tmp_path: Path) -> None:
    WindowFolder(tmp_path / "run.reference.mcap", "one")["first"] = WINDOW
    WindowFolder(tmp_path / "other.reference.mcap", "one")["first"] = WINDOW
    assert len(WindowFolder(tmp_path / "run.reference.mcap", "two")) == 0
    assert len(WindowFolder(tmp_path / "run.reference.mcap", "one")) == 0
    assert len(WindowFolder(tmp_path / "other.reference.mcap", "one")) == 1


def test_a_damaged_window_counts_as_missing(tmp_path: Path) -> None:
    windows = WindowFolder(tmp_path / "run.reference.mcap", "key")
    windows["first"] = WINDOW
    (file,) = tmp_path.rglob("*.npz")
    file.write_bytes(file.read_bytes()[:100])
    assert windows.get("first") is None


def test_removing_leaves_nothing(tmp_path: Path) -> None:
    target = tmp_path / "run.reference.mcap"
    WindowFolder(target, "key")["first"] = WINDOW
    remove_windows(target)
    assert not list(tmp_path.iterdir())
