"""Times of the reference smoother beside ``offlineVQF``, and how its time and memory grow with the recording."""

import json
import subprocess
import sys

from rich.console import Console
from rich.progress import track

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.recording import Recording
from stillpoint.datasets.simulate import simulate
from stillpoint.scripts.bench.timing import Timing, time_call
from stillpoint.smoother import reference

_SHORT_S, _SHORT_HZ = 200, 286  # the length and rate of BROAD's trials
_HOURS = (1, 4)
_LONG_HZ = 100

# In a process of its own: the peak of this one would hide it. Simulated data are part of the peak.
_MEASURE = """
import json, resource, sys
from stillpoint.datasets.simulate import simulate
from stillpoint.scripts.bench.timing import time_call
from stillpoint.smoother import reference
reference(simulate("phone-3", minutes=2))
recording = simulate("phone-3", minutes=60 * float(sys.argv[1]), rate_hz=float(sys.argv[2]))
seconds = time_call(lambda: reference(recording))
unit = 1 if sys.platform == "darwin" else 1024
print(json.dumps({"seconds": seconds, "bytes": unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss}))
"""


def bench_smoother(runs: int) -> list[Timing]:
    """Return the rows of a short recording beside its peer, and of an hour and four hours."""
    short = simulate("phone-3", minutes=_SHORT_S / 60, rate_hz=_SHORT_HZ)
    peer, ours = _time_side_by_side(short, runs)
    n = len(short.require_imu().t_ns)
    offline = Timing(f"offlineVQF, {_SHORT_S} s at {_SHORT_HZ} Hz", peer, n)
    graph = f"graph, {_SHORT_S} s at {_SHORT_HZ} Hz, with covariances"
    rows = [offline, Timing(graph, ours, n, against=offline, ratio_is="times as long")]
    before: Timing | None = None
    for hours in _HOURS:
        measured = _measure(hours)
        peak = measured["bytes"]
        row = Timing(
            f"graph, {hours} h at {_LONG_HZ} Hz: peak memory {peak / 1e6:.0f} MB",
            [measured["seconds"]],
            int(hours * 3600 * _LONG_HZ),
            against=before,
            ratio_is="times as long",
            extra={"peak_bytes": peak},
        )
        rows.append(row)
        before = before or row
    return rows


def _time_side_by_side(recording: Recording, runs: int) -> tuple[list[float], list[float]]:
    """Return seconds of the peer and of the graph in turn, after one call of each that is not counted."""
    try:
        from vqf import offlineVQF
    except ImportError as error:
        raise BadParameter("bench smoother: vqf is not installed; pip install 'stillpoint[peers]'") from error
    imu, mag = recording.require_imu(), recording.mag
    assert mag is not None
    held = mag.mag_b_ut[(mag.t_ns.searchsorted(imu.t_ns, side="right") - 1).clip(0)]

    def peer() -> object:
        return offlineVQF(imu.gyro_b_radps, imu.accel_b_mps2, held, 1 / _SHORT_HZ, {})

    peer()
    reference(recording)
    seconds: tuple[list[float], list[float]] = ([], [])
    for _ in track(range(runs), "smoother", console=Console(stderr=True), transient=True):
        seconds[0].append(time_call(peer))
        seconds[1].append(time_call(lambda: reference(recording)))
    return seconds


def _measure(hours: float) -> dict[str, float]:
    done = subprocess.run(
        [sys.executable, "-c", _MEASURE, str(hours), str(_LONG_HZ)], capture_output=True, text=True, check=True
    )
    result: dict[str, float] = json.loads(done.stdout)
    return result
