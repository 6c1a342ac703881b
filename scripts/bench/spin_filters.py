"""Times of the spin estimators over 20 minutes at 250 Hz, 300 000 samples: in batch, in single precision, and streamed.

Batch rows are the time that ``estimate`` reports: the filter's own, without the making of arrays around it.
"""

from collections.abc import Callable

from rich.console import Console
from rich.progress import track

from stillpoint.datasets.recording import Recording
from stillpoint.datasets.simulate import simulate
from stillpoint.filters import estimate
from stillpoint.filters.precision import Precision
from stillpoint.filters.spin.stream import SpinStream
from stillpoint.filters.table import ROLLS
from stillpoint.scripts.bench.timing import Timing, time_call

MINUTES = 20.0
STREAMED = 5_000


def bench_roll_filters(runs: int) -> list[Timing]:
    """Return the rows of every estimator of roll, run by run in turn."""
    recording = simulate("spin-constant", minutes=MINUTES, sensor="glitch")
    assert recording.spin is not None
    n = len(recording.spin.t_ns)
    steps: dict[str, tuple[Callable[[], float], int]] = {}
    for name in ROLLS:
        steps[name] = _time_batch(recording, name, "double", n), n
        steps[f"{name}, single precision"] = _time_batch(recording, name, "single", n), n
        steps[f"{name}, a call of a stream"] = _time_stream(recording, name), STREAMED
    seconds: dict[str, list[float]] = {name: [] for name in steps}
    for step, _ in steps.values():
        step()  # compiles, and fills the caches of the machine
    for _ in track(range(runs), "roll filters", console=Console(stderr=True), transient=True):
        for name, (step, _) in steps.items():
            seconds[name].append(step())
    return [Timing(name, seconds[name], samples) for name, (_, samples) in steps.items()]


def _time_batch(recording: Recording, name: str, precision: Precision, n: int) -> Callable[[], float]:
    return lambda: estimate(recording, name, precision=precision).ns_per_sample * n / 1e9


def _time_stream(recording: Recording, name: str) -> Callable[[], float]:
    """Return the seconds of ``STREAMED`` calls, from lists as a program would have them."""
    spin = recording.spin
    assert spin is not None
    rows = list(zip(spin.t_ns[:STREAMED].tolist(), spin.accel_mps2[:STREAMED].tolist(), strict=True))

    def fed() -> float:
        update = SpinStream(name, spin.geometry).update

        def calls() -> None:
            for t_ns, accel_mps2 in rows:
                update(t_ns, accel_mps2)

        return time_call(calls)

    return fed
