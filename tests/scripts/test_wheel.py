"""The wheel is what users get: it must hold the whole package, and nothing outside ``stillpoint/``."""

import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.wheel
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("wheel")
    source = out / "source"  # a copy, so that building leaves nothing in the checkout
    names = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout.split(b"\0")
    for name in filter(None, names):
        (source / name.decode()).parent.mkdir(parents=True, exist_ok=True)
        (source / name.decode()).write_bytes((ROOT / name.decode()).read_bytes())
    command = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", str(out), str(source)]
    subprocess.run(command, check=True)
    return next(out.glob("stillpoint-*.whl"))


@pytest.fixture(scope="module")
def fresh(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A new environment with the wheel; the dependencies are those already installed, reached by a path file.

    A path file is not followed into further path files, so the editable stillpoint stays invisible.
    """
    home = tmp_path_factory.mktemp("fresh")
    subprocess.run([sys.executable, "-m", "venv", str(home)], check=True)
    python = home / "bin" / "python"
    subprocess.run([str(python), "-m", "pip", "install", "-q", "--no-deps", str(wheel)], check=True)
    query = "import sysconfig; print(sysconfig.get_path('purelib'))"
    site = Path(subprocess.run([python, "-c", query], capture_output=True, text=True, check=True).stdout.strip())
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return home


def test_nothing_lands_outside_the_package(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    stray = [n for n in names if not n.startswith(("stillpoint/", "stillpoint-"))]
    assert stray == []
    assert not [n for n in names if n.startswith("stillpoint/tests")]


def test_every_tracked_module_is_in_the_wheel(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    folders = ("datasets", "filters", "scoring", "scripts", "smoother", "studies")
    listed = subprocess.run(["git", "ls-files", *folders], cwd=ROOT, capture_output=True, text=True, check=True)
    missing = [line for line in listed.stdout.split() if f"stillpoint/{line}" not in names]
    assert missing == []
    assert "stillpoint/__init__.py" in names


def test_the_installed_package_runs_from_another_folder(fresh: Path, tmp_path: Path) -> None:
    code = (
        "import stillpoint.datasets, stillpoint.smoother, stillpoint.filters, stillpoint.scoring\n"
        "print(stillpoint.datasets.__file__)"
    )
    where = subprocess.run(
        [fresh / "bin" / "python", "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert where.stdout.startswith(str(fresh.resolve())) or str(fresh) in where.stdout
    command = [fresh / "bin" / "stillpoint", "simulate", "phone-1", "--minutes", "2", "-o", "made"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    assert list((tmp_path / "made").glob("*.mcap"))
