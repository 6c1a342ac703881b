"""Verbs on a long recording take no more memory than on a shorter one, and a reference little more."""

import json
import subprocess
import sys

import pytest

from stillpoint.datasets.simulate import simulate
from stillpoint.filters import estimate
from stillpoint.scripts.bench.long import write_long_recording, write_phone_recording
from stillpoint.smoother import reference

RATE_HZ = 200
# Pieces of 80 s instead of 11 minutes, so that a short recording fills all that are in memory at once.
PIECE_ROWS = 1 << 14
HOURS = 1 / 6, 5 / 6
# The columns of the minutes between them (imu 56 bytes a row, estimate 72) would be 61 MB, each copy as much again.
ALLOWED_MB = 30

MEASURE = """
import json, sys
from stillpoint.datasets.mcap.pieces import PieceReader
from stillpoint.scripts.main import main
rows = int(sys.argv.pop(1))
PieceReader.__init__.__defaults__ = (*PieceReader.__init__.__defaults__[:-1], rows)  # of most
try:
    main(sys.argv[1:])
except SystemExit as end:
    assert not end.code, end.code
with open("/proc/self/status") as status:
    print(json.dumps(next(int(line.split()[1]) / 1e3 for line in status if line.startswith("VmHWM"))), file=sys.stderr)
"""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the peak of a process is read from /proc"),
]


def peak_mb(*words, piece_rows=PIECE_ROWS):
    command = [sys.executable, "-c", MEASURE, str(piece_rows), *words]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    return json.loads(run.stderr.strip().splitlines()[-1])


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    folder = tmp_path_factory.mktemp("long")
    paths = [folder / "short.mcap", folder / "long.mcap"]
    for path, hours in zip(paths, HOURS, strict=True):
        write_long_recording(path, hours, RATE_HZ)
    for name in ("cf", "ekf"):
        estimate(simulate("phone-1", minutes=0.6), name)  # compiles: in a process that is measured it takes memory too
    return paths


@pytest.fixture(scope="module")
def estimates(recordings):
    """The estimates of both recordings, and the peak of memory while each was made."""
    peaks = [peak_mb("estimate", str(path), "-e", "cf", "-o", str(path.parent)) for path in recordings]
    return [path.with_name(f"{path.stem}.cf.estimate.mcap") for path in recordings], peaks


def require_bounded(short, long):
    assert long < short + ALLOWED_MB, f"{short:.0f} MB for {HOURS[0]:.2f} h, {long:.0f} MB for {HOURS[1]:.2f} h"


def test_peak_memory_of_an_estimate_does_not_grow_with_the_recording(estimates):
    require_bounded(*estimates[1])


def test_peak_memory_of_an_estimate_with_covariances_does_not_grow_with_the_recording(recordings, tmp_path):
    require_bounded(*(peak_mb("estimate", str(path), "-e", "ekf", "-o", str(tmp_path)) for path in recordings))


def test_peak_memory_of_an_export_does_not_grow_with_the_estimate(estimates, tmp_path):
    require_bounded(*(peak_mb("export", str(path), "--format", "tum", "-o", str(tmp_path)) for path in estimates[0]))


def test_a_reference_of_a_day_fits_in_memory(tmp_path):
    """24 h at 100 Hz within 3 GB are 125 MB an hour; with three copies of the columns it would be 250.

    A run takes 0.1 GB for each hour, within 2 MB the same at lengths of 0.15 to 0.75 h.
    """
    reference(simulate("phone-1", minutes=0.6))  # compiles
    peaks = []
    for hours in (0.15, 0.4):
        write_phone_recording(tmp_path / f"{hours}.mcap", hours, 100)
        windows = ("--set", "keys.window_s=300", "--set", "keys.overlap_s=30")  # they hide less of the growth
        peaks.append(peak_mb("reference", str(tmp_path / f"{hours}.mcap"), *windows))
    assert peaks[1] < peaks[0] + 40, f"{peaks[0]:.0f} MB for 9 minutes, {peaks[1]:.0f} MB for a quarter of an hour more"
