"""Times of the graph of a spinning body: a minute at 250 Hz, 15 000 samples, with covariances."""

from dataclasses import replace
from functools import partial

from rich.console import Console
from rich.progress import track

from stillpoint.datasets.recording import Recording
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.simulate.spin_sensor import VARIABLE
from stillpoint.scripts.bench.timing import Timing, time_call
from stillpoint.smoother import reference

HORIZONTAL_DEG = 90.0


def bench_roll(runs: int) -> list[Timing]:
    """Return the rows of a vertical axis, the same with the encoder, and a horizontal axis, run by run in turn."""
    vertical = simulate("spin-variable", sensor="white")
    tilted = replace(VARIABLE["white"], name="horizontal", tilt_deg=HORIZONTAL_DEG)
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
