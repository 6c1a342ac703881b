"""Verbs on a long recording take no more memory than on one a fifth as long."""

import json
import subprocess
import sys

import pytest

from stillpoint.scripts.bench.long import write_long_recording

RATE_HZ = 200
# The columns of one more hour (imu 56 bytes a row, estimate 72) would be 90 MB, each copy of them as much again.
ALLOWED_MB = 60

MEASURE = """
import json, sys
from stillpoint.scripts.main import main
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


def peak_mb(*words):
    run = subprocess.run([sys.executable, "-c", MEASURE, *words], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    return json.loads(run.stderr.strip().splitlines()[-1])


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    folder = tmp_path_factory.mktemp("long")
    paths = [folder / "short.mcap", folder / "long.mcap"]
    for path, hours in zip(paths, (0.25, 1.25), strict=True):
        write_long_recording(path, hours, RATE_HZ)
    return paths


@pytest.mark.parametrize("words", [("estimate", "-e", "cf"), ("estimate", "-e", "ekf"), ("export", "--format", "tum")])
def test_peak_memory_does_not_grow_with_the_recording(recordings, tmp_path, words):
    if words[0] == "export":
        made = [path.with_name(f"{path.stem}.cf.estimate.mcap") for path in recordings]
        for source in recordings:
            peak_mb("estimate", str(source), "-e", "cf", "-o", str(source.parent))
        recordings = made
    short, long = (peak_mb(words[0], str(path), *words[1:], "-o", str(tmp_path)) for path in recordings)
    assert long < short + ALLOWED_MB, f"{short:.0f} MB for a quarter of an hour, {long:.0f} MB for an hour more"
