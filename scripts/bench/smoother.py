"""Times of the reference smoother beside ``offlineVQF``, and how its time and memory grow with the recording."""

import json
import subprocess
import sys

from rich.console import Console
from rich.progress import track

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.recording import Recording
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.simulate.scenes import let_field_wander
from stillpoint.scripts.bench.timing import Timing, time_call
from stillpoint.smoother import reference

_SHORT_S, _SHORT_HZ = 200, 286  # the length and rate of BROAD's trials
_LONG_HZ = 100
_LONG = ((1.0, False), (4.0, False), (1.0, True))  # hours, and whether the field wanders
_WANDERING_UT, _WANDERING_S = 10.0, 4.0  # sd of the disturbed field, and how long an error of it lasts

# In a process of its own: the peak of this one would hide it. Simulated data are part of the peak.
_MEASURE = """
import json, resource, sys
from stillpoint.datasets.simulate import simulate
from stillpoint.scripts.bench.smoother import make_long
from stillpoint.scripts.bench.timing import time_call
from stillpoint.smoother import reference
reference(simulate("phone-3", minutes=2))
recording = make_long(float(sys.argv[1]), float(sys.argv[2]), sys.argv[3] == "wandering")
seconds = time_call(lambda: reference(recording))
unit = 1 if sys.platform == "darwin" else 1024
print(json.dumps({"seconds": seconds, "bytes": unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss}))
"""


def make_long(hours: float, rate_hz: float, wandering: bool) -> Recording:
    """Return a simulated phone in the hand over some hours, where asked for in a field that wanders."""
    recording = simulate("phone-3", minutes=60 * hours, rate_hz=rate_hz)
    return let_field_wander(recording, _WANDERING_UT, _WANDERING_S, seed=1) if wandering else recording


def bench_smoother(runs: int) -> list[Timing]:
    """Return the rows of a short recording beside its peer, and of long ones, one of them in a disturbed field."""
    short = simulate("phone-3", minutes=_SHORT_S / 60, rate_hz=_SHORT_HZ)
    peer, ours = _time_side_by_side(short, runs)
    n = len(short.require_imu().t_ns)
    offline = Timing(f"offlineVQF, {_SHORT_S} s at {_SHORT_HZ} Hz", peer, n)
    graph = f"graph, {_SHORT_S} s at {_SHORT_HZ} Hz, with covariances"
    rows = [offline, Timing(graph, ours, n, against=offline, ratio_is="times as long")]
    hour: Timing | None = None
    for hours, wandering in track(_LONG, "long recordings", console=Console(stderr=True), transient=True):
        measured = _measure_long(hours, wandering)
        peak = measured["bytes"]
        field = f", field wandering by {_WANDERING_UT:.0f} uT" if wandering else ""
        row = Timing(
            f"graph, {hours:.0f} h at {_LONG_HZ} Hz{field}: peak memory {peak / 1e6:.0f} MB",
            [measured["seconds"]],
            int(hours * 3600 * _LONG_HZ),
            against=hour,
            ratio_is="times as long",
            extra={"peak_bytes": peak},
        )
        rows.append(row)
        hour = hour or row
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


def _measure_long(hours: float, wandering: bool) -> dict[str, float]:
    """Return time and memory of the reference of a long recording, made in a process of its own."""
    field = "wandering" if wandering else "clean"
    command = [sys.executable, "-c", _MEASURE, str(hours), str(_LONG_HZ), field]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    result: dict[str, float] = json.loads(done.stdout)
    return result
