"""One call per sample of a spin: both stages as one compiled function that holds the state.

As in :mod:`stillpoint.filters.advance`, the state lies in a cell between two calls. Among its constants is the row of
the sensors' values, whose memory stays the same: the stream writes them there, however many there are.
"""

from collections.abc import Callable
from functools import cache
from math import sqrt
from types import ModuleType
from typing import Any, NamedTuple, cast

import numpy as np
from numba import int64, typeof

from stillpoint.datasets.compiled import compiled
from stillpoint.datasets.recording import Floats
from stillpoint.filters.advance import Cell
from stillpoint.filters.spin import front as spin_front
from stillpoint.filters.spin.sample import SpinOutput, unwrap_angle

SpinAdvance = Callable[[Any, int], "SpinAnswer"]


class SpinAnswer(NamedTuple):
    """Angle and rate about the spin axis after a sample."""

    angle_rad: float  # unwrapped, 0 at the first sample
    rate_radps: float
    angle_sd_rad: float
    rate_sd_radps: float
    innovation: float  # normalised; NaN where there was no update
    ready: bool


class Row(NamedTuple):
    """The memory for the values of the next sample."""

    accel_mps2: Floats  # (1, k)
    gyro_radps: Floats  # (1, m)


@compiled
def _start_answer() -> SpinAnswer:
    """Return the answer before the first sample."""
    return SpinAnswer(0.0, 0.0, 0.0, 0.0, np.nan, False)


@compiled
def _make_answer(output: SpinOutput) -> SpinAnswer:
    """Return the answer in double precision, whatever the estimator's is."""
    motion = output.motion
    return SpinAnswer(
        unwrap_angle(motion),
        np.float64(motion.rate_radps),
        sqrt(np.float64(motion.angle_var)),
        sqrt(np.float64(motion.rate_var)),
        np.float64(output.innovation),
        output.ready,
    )


@cache
def make_begin(estimator: ModuleType) -> Callable[[Any, Any, Row], Any]:
    """Return the function that makes the cell of a new stream from both sets of constants and its row."""

    @compiled
    def begin(front_c: Any, c: Any, row: Row) -> Any:
        return Cell((front_c, c, row), (spin_front.start(), estimator.start(c), _start_answer()))

    return begin


@cache
def _make_advance(estimator: ModuleType) -> Any:
    """Return the function that takes the cell, with a sample in its row, and returns the answer."""

    @compiled
    def advance(cell: Any, t_ns: int) -> SpinAnswer:
        front_c, c, row = cell.constants
        passed, state, answer = cell.state
        # numba would compile the step once more for a zero that it knows.
        first: Any = np.int64(0)
        passed, sample, is_taken = spin_front.step(passed, t_ns, row.accel_mps2, row.gyro_radps, first, front_c)
        if is_taken:
            state, output = estimator.step(state, sample, c)
            answer = _make_answer(output)
        cell.state = (passed, state, answer)
        return answer

    return advance


def compile_advance(estimator: ModuleType, cell: Any) -> SpinAdvance:
    """Compile :func:`_make_advance` for this cell and return the machine code's entry: no type lookup per call."""
    return cast(SpinAdvance, _make_advance(estimator).compile((typeof(cell), int64)))


@compiled
def restore_cell(front_c: Any, c: Any, passed: spin_front.State, state: Any, answer: SpinAnswer, row: Row) -> Any:
    """Return the cell of a stream that continues from saved states."""
    return Cell((front_c, c, row), (passed, state, answer))
