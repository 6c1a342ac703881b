"""One call per sample of a spin: both stages as one compiled function, the state inside it.

As :mod:`stillpoint.filters.advance` does for attitude: between two calls the state lies in a cell, a compiled list with
one entry. So does the row of the sensors' values: the stream packs them there, however many there are.
"""

from collections.abc import Callable
from functools import cache
from math import sqrt
from types import ModuleType
from typing import Any, NamedTuple, cast

import numpy as np
from numba import int64, typeof
from numba.typed import List

from stillpoint.datasets.recording import Floats
from stillpoint.filters.compiled import compiled
from stillpoint.filters.spin import front as roll_front
from stillpoint.filters.spin.sample import RollOutput, angle_of

RollAdvance = Callable[[Any, int], "RollAnswer"]


class RollAnswer(NamedTuple):
    """Angle and rate about the spin axis after a sample."""

    angle_rad: float  # unwrapped, 0 at the first sample
    rate_radps: float
    angle_sd_rad: float
    rate_sd_radps: float
    innovation: float  # normalised; NaN where there was no update
    ready: bool


class Row(NamedTuple):
    """Where the values of the next sample are put."""

    accel_mps2: Floats  # (1, k)
    gyro_radps: Floats  # (1, m)


@compiled
def no_answer() -> RollAnswer:
    """Before the first sample."""
    return RollAnswer(0.0, 0.0, 0.0, 0.0, np.nan, False)


@compiled
def answer(output: RollOutput) -> RollAnswer:
    """In double precision, whatever that of the estimator."""
    roll = output.roll
    return RollAnswer(
        angle_of(roll),
        np.float64(roll.rate_radps),
        sqrt(np.float64(roll.angle_var)),
        sqrt(np.float64(roll.rate_var)),
        np.float64(output.innovation),
        output.ready,
    )


@cache
def beginning(estimator: ModuleType) -> Callable[[Any, Any, Row], Any]:
    """The function that makes the cell of a new stream from both coefficients and its row."""

    @compiled
    def begin(front_c: Any, c: Any, row: Row) -> Any:
        cell = List()
        cell.append((front_c, c, roll_front.start(), estimator.start(c), no_answer(), row))
        return cell

    return begin


@cache
def advancing(estimator: ModuleType) -> Any:
    """The function that takes the cell, with a sample in its row, and gives the answer."""

    @compiled
    def advance(cell: Any, t_ns: int) -> RollAnswer:
        front_c, c, passed, state, said, row = cell[0]
        passed, sample, is_taken = roll_front.step(passed, t_ns, row.accel_mps2, row.gyro_radps, 0, front_c)
        if is_taken:
            state, output = estimator.step(state, sample, c)
            said = answer(output)
        cell[0] = (front_c, c, passed, state, said, row)
        return said

    return advance


def entry_point(estimator: ModuleType, cell: Any) -> RollAdvance:
    """:func:`advancing` for this cell, without the search for the right types at every call."""
    return cast(RollAdvance, advancing(estimator).compile((typeof(cell), int64)))


@compiled
def filled(front_c: Any, c: Any, passed: roll_front.State, state: Any, said: RollAnswer, row: Row) -> Any:
    """The cell of a stream that goes on."""
    cell = List()
    cell.append((front_c, c, passed, state, said, row))
    return cell
