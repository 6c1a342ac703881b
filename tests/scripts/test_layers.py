"""The layers of the packages: imports go one way, and the contract that says so notices one that does not."""

import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDERS = ("datasets", "filters", "scoring", "scripts", "smoother", "studies")
LINT = "from importlinter.cli import lint_imports; raise SystemExit(lint_imports('pyproject.toml', no_cache=True))"


@pytest.fixture
def copied_package(tmp_path: Path) -> Path:
    for folder in FOLDERS:
        shutil.copytree(ROOT / folder, tmp_path / "stillpoint" / folder, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


def lint_imports(folder: Path) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": str(folder)}
    return subprocess.run([sys.executable, "-c", LINT], cwd=folder, env=environment, capture_output=True, text=True)


@pytest.mark.slow
def test_imports_go_one_way(copied_package):
    linted = lint_imports(copied_package)
    assert linted.returncode == 0, linted.stdout


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "line", "contract"),
    [
        ("scoring/errors.py", "from stillpoint.filters import estimate", "Dependencies go one way"),
        ("filters/run.py", "from stillpoint.smoother.rest import find_rests", "Dependencies go one way"),
        ("datasets/earth.py", "import stillpoint.scripts.main", "Dependencies go one way"),
        ("smoother/rest.py", "import gtsam", "gtsam is imported"),
    ],
)
def test_planted_import_breaks_the_contract(copied_package, module, line, contract):
    source = copied_package / "stillpoint" / module
    source.write_text(source.read_text() + f"\n{line}\n")
    linted = lint_imports(copied_package)
    assert linted.returncode == 1
    assert any(contract in row and "BROKEN" in row for row in linted.stdout.splitlines())


MODULES_AT_MOST = 18  # of a folder that a reader takes in at once; lists of alike things are found by name instead
LISTS_OF_ALIKE_THINGS = {"datasets/importers", "scripts/verbs"}


def test_no_folder_holds_more_modules_than_a_reader_takes_in():
    counts = {
        folder.relative_to(ROOT).as_posix(): sum(module.name != "__init__.py" for module in folder.glob("*.py"))
        for top in (*FOLDERS, "tests")
        for folder in ((ROOT / top), *(ROOT / top).rglob("*/"))
    }
    assert {folder for folder, count in counts.items() if count > MODULES_AT_MOST} <= LISTS_OF_ALIKE_THINGS


def test_every_folder_of_code_is_in_the_wheel():
    """A folder that pyproject.toml does not list works in a checkout and is missing where users install the wheel."""
    listed = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"])
    modules = [module for folder in FOLDERS for module in (ROOT / folder).rglob("*.py")]
    folders = {".".join(("stillpoint", *module.parent.relative_to(ROOT).parts)) for module in modules}
    # scripts/api is the package stillpoint itself; kernels are data.
    assert folders - {"stillpoint.scripts.api"} == listed - {"stillpoint", "stillpoint.scripts.api"}
    assert all((module.parent / "__init__.py").is_file() for module in modules)
