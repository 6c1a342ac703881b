"""Times of a spinning body at 250 Hz: its graph over a minute, its estimators over 20 minutes.

Estimators run in batch, in single precision, and streamed. Batch rows are the time that ``estimate`` reports: the
filter's own, without the making of arrays around it.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from rich.console import Console
from rich.progress import track

from stillpoint.datasets.recording import Recording
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.simulate.spin_sensor import VARIABLE
from stillpoint.filters import estimate
from stillpoint.filters.precision import Precision
from stillpoint.filters.spin.stream import SpinStream
from stillpoint.filters.table import SPINS
from stillpoint.scripts.bench.timing import Timing, time_call
from stillpoint.smoother import reference

_MINUTES = 20.0
_STREAMED = 5_000
_HORIZONTAL_DEG = 90.0


def bench_spin(runs: int) -> list[Timing]:
    """Return the rows of a vertical axis, the same with the encoder, and a horizontal axis, run by run in turn."""
    vertical = simulate("spin-variable", sensor="white")
    tilted = replace(VARIABLE["white"], name="horizontal", tilt_deg=_HORIZONTAL_DEG)
    cases: dict[str, tuple[Recording, dict[str, bool]]] = {
        "roll-graph, vertical axis": (vertical, {}),
        "roll-graph, vertical axis, with the encoder": (vertical, {"encoder.use": True}),
        "roll-graph, horizontal axis, by gravity": (simulate("spin-variable", sensor=tilted), {}),
    }
    seconds: dict[str, list[float]] = {name: [] for name in cases}
    reference(vertical)
    for _ in track(range(runs), "roll", console=Console(stderr=True), transient=True):
        for name, (recording, params) in cases.items():
            seconds[name].append(time_call(partial(reference, recording, params=params)))
    samples = 0 if vertical.spin is None else len(vertical.spin.t_ns)
    return [Timing(f"{name}, {samples} samples", each, samples) for name, each in seconds.items()]


def bench_spin_filters(runs: int) -> list[Timing]:
    """Return the rows of every estimator of roll, run by run in turn."""
    recording = simulate("spin-constant", minutes=_MINUTES, sensor="glitch")
    assert recording.spin is not None
    n = len(recording.spin.t_ns)
    steps: dict[str, tuple[Callable[[], float], int]] = {}
    for name in SPINS:
        steps[name] = _time_batch(recording, name, "double", n), n
        steps[f"{name}, single precision"] = _time_batch(recording, name, "single", n), n
        steps[f"{name}, a call of a stream"] = _time_stream(recording, name), _STREAMED
    seconds: dict[str, list[float]] = {name: [] for name in steps}
    for step, _ in steps.values():
        step()  # compiles, and fills the caches of the machine
    for _ in track(range(runs), "roll filters", console=Console(stderr=True), transient=True):
        for name, (step, _) in steps.items():
            seconds[name].append(step())
    return [Timing(name, seconds[name], samples) for name, (_, samples) in steps.items()]


def _time_batch(recording: Recording, name: str, precision: Precision, n: int) -> Callable[[], float]:
    """Return a function that runs an estimator and returns the seconds of its steps."""
    return lambda: estimate(recording, name, precision=precision).ns_per_sample * n / 1e9


def _time_stream(recording: Recording, name: str) -> Callable[[], float]:
    """Return the seconds of ``_STREAMED`` calls, from lists as a program would have them."""
    spin = recording.spin
    assert spin is not None
    rows = list(zip(spin.t_ns[:_STREAMED].tolist(), spin.accel_mps2[:_STREAMED].tolist(), strict=True))

    def time_calls() -> float:
        """Return the seconds of all calls of a new stream."""
        update = SpinStream(name, spin.geometry).update

        def run_calls() -> None:
            for t_ns, accel_mps2 in rows:
                update(t_ns, accel_mps2)

        return time_call(run_calls)

    return time_calls
