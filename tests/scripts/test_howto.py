"""The commands on docs/start.md and docs/how-to/ run as they are printed.

Blocks marked ```bash run, in a folder such as a reader of the page has: recordings in ``recordings/``, one recording
``run7.mcap`` with its reference and estimates, two recordings of one device in ``device/``, a log ``log.csv``, a
trajectory of another program ``theirs.txt``, and ``mine.py`` from the page about own estimators. Blocks marked ```sh
need what no test has: a network, a phone, a bag.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from warm_command import warm_command

from stillpoint.datasets import write
from stillpoint.datasets.cut import cut_recording, find_start_ns
from stillpoint.datasets.simulate import simulate
from stillpoint.filters import estimate
from stillpoint.smoother import attitude_reference

DOCS = Path(__file__).parents[2] / "docs"
PAGES = [DOCS / "start.md", *sorted((DOCS / "how-to").glob("*.md"))]
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
RUNNABLE = [page for page in PAGES if any(kind == "bash" for kind, _ in BLOCK.findall(page.read_text("utf-8")))]
OWN = "score-my-own-estimator.md"


def blocks(page, kind):
    return [text for found, text in BLOCK.findall(page.read_text(encoding="utf-8")) if found == kind]


@pytest.fixture(scope="module")
def readers_folder(tmp_path_factory):
    """The files that the pages speak of; the recordings last 40 s, from the end of the rest into the motion."""
    folder = tmp_path_factory.mktemp("reader")
    (folder / "recordings").mkdir()
    for seed in range(2):
        whole = simulate("phone-3", seed=seed, minutes=3.0)
        first_ns = find_start_ns(whole) + 45_000_000_000  # it rests for the first minute
        short = cut_recording(whole, first_ns, first_ns + 40_000_000_000, f"walk{seed}")
        write(folder / "recordings" / f"{short.name}.mcap", short)
    (folder / "device").mkdir()
    for part in range(2):
        begin_ns = first_ns + part * 60_000_000_000
        write(
            folder / "device" / f"{part}.mcap", cut_recording(whole, begin_ns, begin_ns + 60_000_000_000, f"part{part}")
        )
    run7 = cut_recording(whole, first_ns, first_ns + 40_000_000_000, "run7")
    write(folder / "run7.mcap", run7)
    write(folder / "run7.reference.mcap", attitude_reference(run7))
    found = estimate(run7, "ekf")
    write(folder / "run7.ekf.estimate.mcap", found)
    xyzw = np.roll(found.q_nb, -1, axis=1)
    tum = np.column_stack([found.t_ns / 1e9, np.zeros((len(xyzw), 3)), xyzw])
    np.savetxt(folder / "theirs.txt", tum, fmt="%.9f")
    imu, mag = run7.imu, run7.mag
    field = np.column_stack([np.interp(imu.t_ns, mag.t_ns, axis) for axis in mag.mag_b_ut.T])
    log = np.column_stack([imu.t_ns / 1e6, np.degrees(imu.gyro_b_radps), imu.accel_b_mps2 / 9.80665, field])
    names = "t,gx,gy,gz,ax,ay,az,mx,my,mz"
    np.savetxt(folder / "log.csv", log, fmt="%.6f", delimiter=",", header=names, comments="")
    (folder / "mine.py").write_text(blocks(DOCS / "how-to" / OWN, "python")[0], encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def commands(tmp_path_factory):
    """A folder with the commands that the pages call."""
    folder = tmp_path_factory.mktemp("bin")
    # No link: a Python that is called by another path does not find its environment.
    (folder / "python").write_text(f'#!/bin/sh\nexec "{sys.executable}" "$@"\n', encoding="utf-8")
    (folder / "python").chmod(0o755)
    with warm_command(folder):
        yield folder


@pytest.mark.slow
@pytest.mark.parametrize("page", RUNNABLE, ids=lambda page: page.stem)
def test_the_commands_of_a_page_run(page, readers_folder, commands, tmp_path):
    folder = tmp_path / "reader"
    shutil.copytree(readers_folder, folder, symlinks=True)
    script = "\n".join(["set -e", *blocks(page, "bash")])
    environment = os.environ | {"PATH": f"{commands}:{os.environ['PATH']}"}
    ran = subprocess.run(["bash", "-c", script], cwd=folder, env=environment, capture_output=True, text=True)
    assert ran.returncode == 0, f"{page.name}: {ran.stderr[-2000:]}\n{ran.stdout[-1000:]}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_command_that_is_printed_names_a_verb_and_says_whether_it_runs_here(page):
    from stillpoint.scripts.main import VERBS

    for kind, text in BLOCK.findall(page.read_text(encoding="utf-8")):
        for line in text.splitlines():
            if line.startswith("stillpoint "):
                assert line.split()[1] in VERBS, line
                assert kind in ("bash", "sh"), f"mark the block with ```bash or ```sh: {line}"


def test_the_example_of_an_own_estimator_turns_with_the_gyro():
    """A quarter turn about up, at rest otherwise: what the page tells a reader to start from must be right."""
    space = {}
    exec(compile(blocks(DOCS / "how-to" / OWN, "python")[0], OWN, "exec"), space)
    mine = space["Mine"]()
    for k in range(101):
        q_nb = mine.update(k / 100, (0.0, 0.0, np.pi / 2), (0.0, 0.0, 9.81), None)
    turned = Rotation.from_quat(q_nb, scalar_first=True).as_rotvec()
    assert turned == pytest.approx([0, 0, np.pi / 2], abs=1e-9)
