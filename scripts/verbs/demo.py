"""``stillpoint demo``: simulate a phone in the hand and follow it the whole way to a report."""

import importlib.util
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import numpy as np
from rich.console import Console

from stillpoint.datasets import Recording, write
from stillpoint.datasets.doctor import Diagnosis, diagnose
from stillpoint.datasets.mcap.store import sha256
from stillpoint.datasets.recording import Times, rate_hz
from stillpoint.datasets.simulate import simulate
from stillpoint.filters import estimate
from stillpoint.scoring.report.page import Material, judge, make_report_html
from stillpoint.scripts.shared.flags import OutDir, Whole
from stillpoint.scripts.shared.inputs import make_output_dir
from stillpoint.scripts.shared.output import print_line, write_text
from stillpoint.scripts.shared.recordings import find_rests_at_default
from stillpoint.scripts.verbs.report import PAGE, gather_material
from stillpoint.scripts.verbs.score import print_scores
from stillpoint.smoother import DEFAULT_METHOD, attitude_reference

KIND = "phone-3"
_COMPARED = "redistribution"  # the method of the literature, scored beside the graph
# Few enough to tell their lines apart; with the package that each needs.
SHOWN = {"cf": None, "ekf": None, "vqf": "vqf", "offline-vqf": "vqf", "madgwick": "ahrs"}


def demo(
    *,
    out: OutDir = Path("demo"),
    minutes: float = 4.0,
    seed: Whole = 0,
) -> None:
    """Simulate a phone in the hand and follow it the whole way to a report.

    Simulates the third experiment of Elmi Aziz and Mohseni Araste 2021, so the truth is known. Makes the recording, its
    reference, five estimates, their scores and one HTML page. Every step writes the file that its verb would write.

    Parameters
    ----------
    out
        Folder to write into; made when it is not there.
    minutes
        Length of the simulated recording.
    seed
        Another seed gives another motion and another sensor.
    """
    with _step(f"simulate {KIND}"):
        recording = simulate(KIND, seed=seed, minutes=minutes)
        folder = make_output_dir(out)
        path = folder / f"{recording.name}.mcap"
        write(path, recording)
    with _step("doctor"):
        rests_ns = find_rests_at_default(recording)
        diagnosis = diagnose(recording, rests_ns)
    _print_facts(recording, rests_ns, diagnosis)
    made_from = {path.name: sha256(path)}
    with _step(f"reference by {DEFAULT_METHOD}"):
        made = replace(attitude_reference(recording), made_from=made_from)
        write(folder / f"{recording.name}.reference.mcap", made)
    with _step(f"reference by {_COMPARED}, to compare"):
        compared = replace(attitude_reference(recording, _COMPARED), made_from=made_from)
        write(folder / f"{recording.name}.{_COMPARED}.reference.mcap", compared)
    for name in _list_installed():
        with _step(f"estimate by {name}"):
            found = replace(estimate(recording, name), made_from=made_from)
            write(folder / f"{recording.name}.{name}.estimate.mcap", found)
    with _step("scores and report"):
        material = gather_material(path)
        assert isinstance(material, Material)
        verdicts = judge(material)
        page = folder / f"{recording.name}{PAGE}"
        write_text(page, make_report_html(material, verdicts))
    print_scores([score for verdict in verdicts for score in verdict.scores])
    print_line(f"report: {page}")


def _list_installed() -> list[str]:
    """Return the estimators whose packages are installed; print which are left out."""
    lacking = [name for name, package in SHOWN.items() if package and importlib.util.find_spec(package) is None]
    if lacking:
        print_line(
            f"left out: {', '.join(lacking)}; to have them too: pip install 'stillpoint[peers]'", file=sys.stderr
        )
    return [name for name in SHOWN if name not in lacking]


@contextmanager
def _step(name: str) -> Iterator[None]:
    """Print to stderr what is done and how long it took."""
    console = Console(stderr=True, highlight=False)
    begun = perf_counter()
    with console.status(name):
        yield
    console.print(f"{perf_counter() - begun:6.1f} s  {name}")


def _print_facts(recording: Recording, rests_ns: Times, diagnosis: Diagnosis) -> None:
    """Print what a user asks first: length, rates, rests, and whether anything is wrong."""
    streams = ", ".join(f"{name} {rate_hz(t_ns):.1f} Hz" for name, t_ns in recording.streams())
    rests = ", ".join(f"{rest_s:.0f}" for rest_s in np.diff(rests_ns, axis=1)[:, 0] / 1e9)
    print_line(f"{recording.name}: {recording.duration_s:.0f} s, {streams}; {len(rests_ns)} rests of {rests} s")
    print_line(f"doctor: {len(diagnosis.codes('fact'))} facts, " + ("no fault" if diagnosis.clean else "faults:"))
    for finding in diagnosis.findings:
        if finding.severity != "fact":
            print_line(f"  {finding.severity} {finding.code}: {finding.message}")
