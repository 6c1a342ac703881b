"""Times of every estimator of attitude over two hours of a phone at 100 Hz, beside ``vqf`` and the package ``ahrs``.

The packages' loops in Python get a hundredth of the samples, and their seconds count a hundred times. All rows are the
time that ``estimate`` reports: the filter's own, without the making of arrays around it, which packages do inside.
"""

from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.recording import Floats, Imu, Mag, Recording
from stillpoint.datasets.simulate import simulate
from stillpoint.filters import ESTIMATORS, Stream, estimate
from stillpoint.filters.table import Estimator
from stillpoint.scripts.bench.timing import Timing, time_call

MINUTES = 120.0  # 720 000 samples
_HUNDREDTH = 100
STREAMED = 20_000
_COMPILED_PEERS = ("vqf", "offline-vqf")
_PEERS_PACKAGES = ("vqf", "ahrs", "imufusion")

# The filters of the package ahrs that are of the same kind as ours: entries of the table, or classes of ahrs. Tilt and
# Complementary work on whole columns, of Euler angles; mahony is a PI observer.
KINDS: dict[str, tuple[str, ...]] = {
    "acc": ("Tilt",),
    "acc-ma": ("Tilt",),
    "gyro": ("AngularRate",),
    "cf": ("mahony", "Complementary"),
    "cf-literal": ("Complementary",),
    "cf-fixed": ("mahony",),
    "cf-lse": ("mahony",),
    "cf-lse-literal": ("mahony",),
    "kf-axis": ("ahrs-ekf",),
    "ekf": ("ahrs-ekf",),
    "aekf": ("ahrs-ekf",),
    "iekf": ("ahrs-ekf",),
}


def bench_filters(runs: int) -> list[Timing]:
    """Return the rows of all estimators in batch, against vqf and against ahrs, then of one call of a stream."""
    _require_packages()
    whole = simulate("phone-3", minutes=MINUTES)
    n = len(whole.require_imu().t_ns)
    part = take_first(whole, n // _HUNDREDTH)
    ours = [name for name, entry in ESTIMATORS.items() if isinstance(entry, Estimator)]
    steps: dict[str, Callable[[], float]] = {name: _time_batch(whole, name, 1) for name in (*ours, *_COMPILED_PEERS)}
    for name, entry in ESTIMATORS.items():
        if entry.is_peer and name not in _COMPILED_PEERS:
            steps[name] = _time_batch(part, name, _HUNDREDTH)
    for kind in sorted({kind for kinds in KINDS.values() for kind in kinds if kind not in ESTIMATORS}):
        steps[kind] = _time_ahrs(part, kind)
    for name in ours:
        steps[f"stream {name}"] = _time_stream(whole, name)
    seconds: dict[str, list[float]] = {name: [] for name in steps}
    for step in steps.values():
        step()  # compiles, and fills the caches of the machine
    for _ in track(range(runs), "filters", console=Console(stderr=True), transient=True):
        for name, step in steps.items():
            seconds[name].append(step())
    return _make_rows(ours, seconds, n)


def take_first(recording: Recording, n: int) -> Recording:
    """Return the first ``n`` samples of the IMU, and the fields until then."""
    imu, mag = recording.require_imu(), recording.mag
    assert mag is not None
    until = mag.t_ns <= imu.t_ns[n - 1]
    cut = Imu(imu.t_ns[:n], imu.gyro_b_radps[:n], imu.accel_b_mps2[:n])
    return Recording("bench", cut, mag=Mag(mag.t_ns[until], mag.mag_b_ut[until]), info=recording.info)


def _make_rows(ours: list[str], seconds: dict[str, list[float]], n: int) -> list[Timing]:
    """Return the rows of the table: the peers, ours, the kinds of each, and single calls of a stream."""
    share = f"(a hundredth, times {_HUNDREDTH})"
    peers: dict[str, Timing] = {}
    for name in (name for name in seconds if name not in ours and not name.startswith("stream ")):
        shown = name if name in ESTIMATORS else f"ahrs {name}"
        peers[name] = Timing(shown if name in _COMPILED_PEERS else f"{shown} {share}", seconds[name], n)
    rows = [*peers.values()]
    rows += [Timing(name, seconds[name], n, against=peers["vqf"]) for name in ours]
    rows += [Timing(name, seconds[name], n, against=peers[kind]) for name in ours for kind in KINDS[name]]
    rows += [Timing(f"{name}, a call of a stream", seconds[f"stream {name}"], STREAMED) for name in ours]
    return rows


def _time_batch(recording: Recording, name: str, times: int) -> Callable[[], float]:
    """Return a function that runs an estimator and returns the seconds for ``times`` recordings."""
    samples = len(recording.require_imu().t_ns) * times
    return lambda: estimate(recording, name).ns_per_sample * samples / 1e9


def _time_stream(recording: Recording, name: str) -> Callable[[], float]:
    """Return the seconds of ``STREAMED`` calls, each with a field, from lists as a program would have them."""
    imu, mag = recording.require_imu(), recording.mag
    assert mag is not None
    columns = (imu.t_ns, imu.gyro_b_radps, imu.accel_b_mps2, mag.mag_b_ut)
    rows = list(zip(*(column[:STREAMED].tolist() for column in columns), strict=True))

    def time_calls() -> float:
        """Return the seconds of all calls of a new stream; the first call is not timed."""
        stream = Stream(name)
        update = stream.update
        update(*rows[0])

        def run_calls() -> None:
            for row in rows[1:]:
                update(*row)

        return time_call(run_calls)

    return time_calls


def _time_ahrs(recording: Recording, kind: str) -> Callable[[], float]:
    """Return the seconds of a filter of ahrs that is not in the table, times a hundred."""
    imu, mag = recording.require_imu(), recording.mag
    assert mag is not None
    field = mag.mag_b_ut[(mag.t_ns.searchsorted(imu.t_ns, side="right") - 1).clip(0)]
    arrays: dict[str, Floats] = {"gyr": imu.gyro_b_radps, "acc": imu.accel_b_mps2, "mag": field}
    if kind == "Tilt":
        del arrays["gyr"]
    if kind == "AngularRate":
        arrays = {"gyr": imu.gyro_b_radps}
    filters: Any = import_module("ahrs").filters
    copies = {name: np.array(values) for name, values in arrays.items()}
    return lambda: time_call(lambda: getattr(filters, kind)(**copies)) * _HUNDREDTH


def _require_packages() -> None:
    """Raise :class:`BadParameter` where a peer is not installed."""
    for name in _PEERS_PACKAGES:
        try:
            import_module(name)
        except ImportError as error:
            raise BadParameter(f"bench filters: {name} is not installed; pip install 'stillpoint[peers]'") from error
