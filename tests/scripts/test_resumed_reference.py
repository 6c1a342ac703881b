"""``reference`` of a long recording that is killed goes on with the next window."""

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from stillpoint.datasets.mcap.store import write
from stillpoint.datasets.simulate import simulate

SETTINGS = ("--set", "keys.window_s=60", "--set", "keys.overlap_s=10")  # three windows
PATIENCE_S = 300.0
MAIN = "from stillpoint.scripts.main import main; main()"

pytestmark = pytest.mark.slow


def start(recording: Path, out: Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", MAIN, "reference", str(recording), "-o", str(out)]
    return subprocess.Popen([*command, *SETTINGS], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.fixture
def make(call: Callable[..., int], capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Run to the end in this process, and return what is said on stderr."""

    def run(recording: Path, out: Path, *options: str) -> str:
        assert call("reference", recording, "-o", out, *options, *SETTINGS) == 0
        return capsys.readouterr().err

    return run


def kill_after_windows(recording: Path, out: Path, count: int) -> int:
    """Kill a run when so many windows are solved, and return how many are."""
    run = start(recording, out)
    end = time.monotonic() + PATIENCE_S
    while len(list(out.rglob("*.npz"))) < count:
        assert run.poll() is None, "it has ended"
        assert time.monotonic() < end
        time.sleep(0.002)
    run.kill()
    run.communicate()
    return len(list(out.rglob("*.npz")))


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("source") / "walk.mcap"
    write(path, simulate("phone-3", minutes=2))
    return path


@pytest.fixture(scope="module")
def wanted(call: Callable[..., int], recording: Path, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    folder = tmp_path_factory.mktemp("whole")
    assert call("reference", recording, "-o", folder, *SETTINGS) == 0
    (file,) = folder.iterdir()  # and no windows
    return file.read_bytes()


def test_a_killed_run_goes_on_and_ends_in_the_same_bytes(
    recording: Path, wanted: bytes, make: Callable[..., str], tmp_path: Path
) -> None:
    solved = kill_after_windows(recording, tmp_path, 2)
    assert not (tmp_path / "walk.reference.mcap").exists()
    said = make(recording, tmp_path)
    assert f"walk.mcap: {solved} of 3 windows kept from an earlier run" in said
    assert [file.name for file in tmp_path.iterdir()] == ["walk.reference.mcap"]
    assert (tmp_path / "walk.reference.mcap").read_bytes() == wanted


def test_windows_go_when_the_reference_is_there(
    recording: Path, wanted: bytes, make: Callable[..., str], tmp_path: Path
) -> None:
    """A run may be killed between the last byte of its file and the removal of its windows."""
    kill_after_windows(recording, tmp_path, 1)
    (tmp_path / "walk.reference.mcap").write_bytes(wanted)
    assert "nothing to compute" in make(recording, tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == ["walk.reference.mcap"]


def test_force_solves_all_windows_anew(
    recording: Path, wanted: bytes, make: Callable[..., str], tmp_path: Path
) -> None:
    kill_after_windows(recording, tmp_path, 1)
    assert "windows kept" not in make(recording, tmp_path, "--force")
    assert [file.name for file in tmp_path.iterdir()] == ["walk.reference.mcap"]
    assert (tmp_path / "walk.reference.mcap").read_bytes() == wanted
