"""The loop of an estimator over a recording: its step at every sample, as one compiled function per estimator.

The loop closes over the estimator's module. numba keeps such a function on disk; over the step itself it would compile
anew in every process.
"""

from collections.abc import Callable
from functools import cache
from types import ModuleType
from typing import Any

from stillpoint.datasets.compiled import compiled_entry
from stillpoint.filters.sample import Log, Track, read_sample, write_output
from stillpoint.filters.spin.sample import SpinLog, SpinTrack, read_spin_sample, write_spin_output


@cache
def make_run(estimator: ModuleType) -> Callable[[Log, Any, Any, Track], Any]:
    """Return the function that runs an estimator of attitude over a log, fills the track and returns the last state."""

    def run(log: Log, state: Any, c: Any, track: Track) -> Any:
        for k in range(len(log.dt_s)):
            state, output = estimator.step(state, read_sample(log, k), c)
            write_output(track, k, output)
        return state

    return compiled_entry(_name_after(run, estimator))


@cache
def make_spin_run(estimator: ModuleType) -> Callable[[SpinLog, Any, Any, SpinTrack], Any]:
    """Return the function that runs an estimator of a spin over a log, fills the track and returns the last state."""

    def run(log: SpinLog, state: Any, c: Any, track: SpinTrack) -> Any:
        for k in range(len(log.dt_s)):
            state, output = estimator.step(state, read_spin_sample(log, k), c)
            write_spin_output(track, k, output)
        return state

    return compiled_entry(_name_after(run, estimator))


def _name_after(function: Callable[..., Any], estimator: ModuleType) -> Callable[..., Any]:
    """Name a function after its estimator, so that numba keeps the machine code of each in files of its own."""
    function.__qualname__ = f"{function.__name__}_{estimator.__name__.rpartition('.')[2]}"
    return function
