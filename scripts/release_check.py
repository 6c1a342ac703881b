"""Check what a release needs: ``python -m stillpoint.scripts.release_check``, which is ``make release-check``.

Each check ends as ok, failed or not checked, with a reason; nothing counts as passed because it could not be tried.
The files for the release are written to ``build/release``: two wheels that must be equal, the bill of materials
(CycloneDX) and the report.
"""

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from stillpoint.scripts.program import run_program

_ROOT = Path.cwd()  # make runs it in the checkout
_OUT = _ROOT / "build" / "release"
_PYTHONS = ("3.11", "3.12", "3.13")
# Licences under which a package may be used and passed on with an MIT package. A package with another one needs a
# look, and its line in _KNOWN_LICENCES.
_FREE = (
    "MIT",
    "BSD",
    "APACHE",
    "ISC",
    "PSF",
    "PYTHON SOFTWARE FOUNDATION",
    "MPL",
    "MOZILLA",
    "ZLIB",
    "UNLICENSE",
    "HPND",
)
_KNOWN_LICENCES: dict[str, str] = {
    "apsw": "any licence that the Open Source Initiative approved, as its licence text says",
    "gtsam": "BSD-3-Clause; its wheel names none, its repository holds the text",
    "mlcroissant": "Apache-2.0; its wheel names none, its repository holds the text",
    "stillpoint": "MIT",
}
# The fast tests of every layer: a wrong bound of a dependency shows in them.
_TESTS = ("tests/datasets/mcap", "tests/datasets/importers", "tests/filters/test_filters.py", "tests/smoother/attitude",
         "tests/scoring", "tests/scripts/test_command.py")  # fmt: skip
# What these tests import beside the package, of the extra dev.
_TEST_TOOLS = ("pytest", "hypothesis", "mcap-ros2-support", "foxglove-sdk", "websockets")


@dataclass(frozen=True)
class Outcome:
    """How one check ended, and why."""

    check: str
    ended: Literal["ok", "failed", "not checked"]
    detail: str


def main() -> int:
    """Run all checks, write ``build/release/report.json`` and return the exit code: 1 when one failed."""
    _OUT.mkdir(parents=True, exist_ok=True)
    outcomes = []
    for check in (check_wheel, check_materials, check_licences, check_vulnerabilities, check_citation, check_versions):
        for outcome in check():
            outcomes.append(outcome)
            print(f"{outcome.ended:11}  {outcome.check}: {outcome.detail}", flush=True)
    (_OUT / "report.json").write_text(json.dumps([vars(outcome) for outcome in outcomes], indent=2) + "\n")
    return int(any(outcome.ended == "failed" for outcome in outcomes))


def check_wheel() -> Iterator[Outcome]:
    """Build the wheel of the last commit twice, in two folders, and compare the bytes."""
    stamp = _run_command(["git", "log", "-1", "--format=%ct"]).stdout.strip()
    hashes = []
    for name in ("first", "second"):
        source, out = _OUT / name / "source", _OUT / name
        shutil.rmtree(out, ignore_errors=True)
        source.mkdir(parents=True)
        archive = subprocess.run(["git", "archive", "HEAD"], capture_output=True, check=True).stdout
        subprocess.run(["tar", "-x", "-C", str(source)], input=archive, check=True)
        command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(out), str(source)]
        built = _run_command(command, SOURCE_DATE_EPOCH=stamp)
        wheels = sorted(out.glob("*.whl"))
        if built.returncode or not wheels:
            yield Outcome("reproducible wheel", "failed", f"the wheel is not built: {_find_last_line(built)}")
            return
        hashes.append(hashlib.sha256(wheels[0].read_bytes()).hexdigest())
    equal = len(set(hashes)) == 1
    says = f"two builds, SOURCE_DATE_EPOCH={stamp}, sha256 {' and '.join(sorted(set(hashes)))}"
    yield Outcome("reproducible wheel", "ok" if equal else "failed", says)


def check_materials() -> Iterator[Outcome]:
    """Write the bill of materials of this environment in CycloneDX."""
    target = _OUT / "sbom.cdx.json"
    made = _run_command([_find_tool("cyclonedx-py"), "environment", sys.executable, "--output-file", str(target)])
    if made.returncode:
        yield Outcome("bill of materials", "failed", _find_last_line(made))
        return
    parts = json.loads(target.read_text()).get("components", [])
    yield Outcome("bill of materials", "ok", f"{len(parts)} packages in {target.relative_to(_ROOT)}")


def check_licences() -> Iterator[Outcome]:
    """Look for packages whose licence is not among those that an MIT package may depend on."""
    made = _run_command([_find_tool("pip-licenses"), "--python", sys.executable, "--from=mixed", "--format=json"])
    if made.returncode:
        yield Outcome("licences", "failed", _find_last_line(made))
        return
    rows = json.loads(made.stdout)
    others = [f"{row['Name']} ({row['License']})" for row in rows if not _is_free(row["Name"], row["License"])]
    (_OUT / "licences.json").write_text(json.dumps(rows, indent=2) + "\n")
    says = f"{len(rows)} packages, all free" if not others else "look at " + ", ".join(others)
    yield Outcome("licences", "failed" if others else "ok", says)


def _is_free(name: str, licence: str) -> bool:
    return name.lower() in _KNOWN_LICENCES or any(word in licence.upper() for word in _FREE)


def check_vulnerabilities() -> Iterator[Outcome]:
    """Ask the public database for known vulnerabilities of the pinned versions."""
    made = _run_command([_find_tool("pip-audit"), "--requirement", "constraints.txt", "--no-deps", "--disable-pip",
                 "--format=json", "--progress-spinner=off"])  # fmt: skip
    try:
        found = [d["name"] for d in json.loads(made.stdout)["dependencies"] if d.get("vulns")]
    except (ValueError, KeyError):
        yield Outcome("vulnerabilities", "not checked", f"the database gave no answer: {_find_last_line(made)}")
        return
    says = f"known ones in {', '.join(found)}" if found else "none known in the pinned versions"
    yield Outcome("vulnerabilities", "failed" if found else "ok", says)


def check_citation() -> Iterator[Outcome]:
    """Compare the version of ``CITATION.cff`` with that of the package."""
    cited = [line.partition(":")[2].strip() for line in Path("CITATION.cff").read_text().splitlines()
             if line.startswith("version:")]  # fmt: skip
    version = tomllib.loads(Path("pyproject.toml").read_text())["project"]["version"]
    says = f"CITATION.cff names {', '.join(cited)}, pyproject.toml {version}"
    yield Outcome("citation", "ok" if cited == [version] else "failed", says)


def check_versions() -> Iterator[Outcome]:
    """Run the fast tests with the lowest and the newest versions of pyproject.toml, on every Python there is."""
    for python in _PYTHONS:
        found = _run_command([_find_tool("uv"), "python", "find", "--no-python-downloads", python])
        for resolution in ("lowest-direct", "highest"):
            name = f"Python {python}, {'lowest' if resolution == 'lowest-direct' else 'newest'} versions"
            if found.returncode:
                yield Outcome(name, "not checked", "this Python is not on the machine")
                continue
            yield _run_tests(name, found.stdout.strip(), resolution)


def _run_tests(name: str, interpreter: str, resolution: str) -> Outcome:
    """Run the fast tests in a new environment with this interpreter and these versions."""
    home = _OUT / "environments" / name.replace(" ", "-").replace(",", "")
    shutil.rmtree(home, ignore_errors=True)
    uv, python = _find_tool("uv"), str(home / "bin" / "python")
    dev = tomllib.loads(Path("pyproject.toml").read_text())["project"]["optional-dependencies"]["dev"]
    tools = [line for line in dev if re.split("[=<>]", line)[0] in _TEST_TOOLS]
    steps: list[Sequence[str]] = [
        [uv, "venv", "--quiet", "--python", interpreter, str(home)],
        [uv, "pip", "install", "--quiet", "--python", python, "--resolution", resolution, "--editable", ".[peers]",
         *tools],
        [python, "-m", "pytest", "-q", "-m", "not slow and not wheel", *_TESTS],
    ]  # fmt: skip
    for step in steps:
        made = _run_command(step)
        if made.returncode:
            reason = " ".join([*re.findall(r"^FAILED (\S+)", made.stdout, re.MULTILINE), _find_last_line(made)])
            could = "failed" if "pytest" in step and step[0] == python else "not checked"
            return Outcome(name, could, f"{' '.join(step[:3])}: {reason}")  # type: ignore[arg-type]
    return Outcome(name, "ok", _find_last_line(made))


def _find_tool(name: str) -> str:
    """Return a program beside this Python, else its name for the search path."""
    beside = Path(sys.executable).with_name(name)
    return str(beside) if beside.exists() else name


def _run_command(command: Sequence[str], **environment: str) -> subprocess.CompletedProcess[str]:
    """Return a command's result; one that is not installed gives exit code 127 and says how to install it."""
    try:
        return subprocess.run(command, capture_output=True, text=True, check=False, env=os.environ | environment)
    except FileNotFoundError:
        return subprocess.CompletedProcess(command, 127, "", f"{command[0]} is not installed; run: make release-check")


def _find_last_line(made: "subprocess.CompletedProcess[str]") -> str:
    """Return the last line that explains how a command ended: of its errors where it failed."""
    lines = [line for text in (made.stdout, made.stderr) for line in text.strip().splitlines()[-1:]]
    return lines[-1] if made.returncode and lines else lines[0] if lines else f"exit code {made.returncode}"


if __name__ == "__main__":
    run_program(main)
