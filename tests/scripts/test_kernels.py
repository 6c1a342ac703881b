"""Kernels are compiled again only when their sources, numba or Python have changed."""

from collections.abc import Callable
from concurrent.futures import Future

import pytest

from stillpoint.scripts import kernels


class Processes:
    """Stands in for the pool: notes what it was asked to compile, and compiles nothing."""

    asked: list[str] = []  # noqa: RUF012

    def __init__(self, *_, **__):
        Processes.asked = []

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None

    def submit(self, function: Callable, name: str) -> Future:
        Processes.asked.append(name)
        done: Future = Future()
        done.set_result(None)
        return done


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(kernels, "KERNELS", tmp_path / "datasets" / "kernels")
    monkeypatch.setattr(kernels, "_SOURCES", tmp_path)
    for name in ("datasets", "filters", "scoring", "smoother"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.py").write_text("x = 1\n")
    monkeypatch.setattr(kernels, "ProcessPoolExecutor", Processes)
    for name in ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES", "NUMBA_CACHE_DIR", kernels.TARGET):
        monkeypatch.setenv(name, "")  # main changes the environment of its process
    return tmp_path


def test_kernels_are_compiled_again_when_a_source_changes(folder, capsys):
    assert kernels.main() == 0
    assert {"reference", "ekf", "roll-ekf"} < set(Processes.asked)
    (folder / "datasets" / "kernels" / "old.kernel").touch()

    Processes.asked = []
    assert kernels.main() == 0
    assert Processes.asked == []
    assert "are those of these sources" in capsys.readouterr().out

    (folder / "smoother" / "b.py").write_text("y = 2\n")  # hash_sources keeps what it found for the process
    kernels.hash_sources.cache_clear()
    assert kernels.main() == 0
    assert Processes.asked
    assert not (folder / "datasets" / "kernels" / "old.kernel").exists()


def test_a_folder_that_cannot_be_written_is_one_line(folder, capsys):
    (folder / "datasets" / "kernels").touch()
    assert kernels.main() == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "numba compiles at the first call" in said
