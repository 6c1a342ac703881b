"""One call per sample: guard, heading source and estimator as one compiled function that holds the state.

Between two calls the state lies in a *cell*, a compiled structure that is passed by reference: converting some fifty
numbers to Python objects and back costs more than a step. (A compiled list with one entry would do too, and take more
than a second longer to compile for each kind of state.) The compiled functions close over the estimator's *module*,
which numba keeps on disk; over the function itself it would compile anew in every process.
"""

from collections.abc import Callable
from functools import cache
from types import ModuleType
from typing import Any, cast

from numba import boolean, float64, int64, typeof, types
from numba.experimental import structref

from stillpoint.datasets.compiled import compiled_entry
from stillpoint.filters.front import front
from stillpoint.filters.front.front import State
from stillpoint.filters.front.guard import Fix, Raw
from stillpoint.filters.sample import Sample

Advance = Callable[..., Any]
# Stamp in ns; rate in rad/s, specific force in m/s^2, field in uT, all in b; is there a field; course in rad and speed
# in m/s; is there a fix.
_ARGUMENTS = (int64, *(float64,) * 9, boolean, float64, float64, boolean)


@structref.register
class _CellType(types.StructRef):
    """numba's type of a :class:`Cell`, which has the types of both fields."""


class Cell(structref.StructRefProxy):
    """Hold the ``constants`` of a stream, and its ``state``, which each sample replaces; both are tuples."""


structref.define_proxy(Cell, _CellType, ["constants", "state"])


@cache
def make_begin(estimator: ModuleType) -> Callable[[Any, Any], Any]:
    """Return the function that makes the cell of a new stream from both sets of constants."""

    @compiled_entry
    def begin(front_c: Any, c: Any) -> Any:
        none = (0.0, 0.0, 0.0)
        # What is said before the first sample is what is said after nothing.
        _, output = estimator.step(estimator.start(c), Sample(0.0, none, none, none, False, False, none), c)
        return Cell((front_c, c), (front.start(front_c), estimator.start(c), output))

    return begin


@cache
def _make_advance(estimator: ModuleType) -> Any:
    """Return the function that takes the cell and one sample, and returns the output."""

    @compiled_entry
    def advance(
        cell: Any,
        t_ns: int,
        gyro_x: float,
        gyro_y: float,
        gyro_z: float,
        accel_x: float,
        accel_y: float,
        accel_z: float,
        mag_x: float,
        mag_y: float,
        mag_z: float,
        has_mag: bool,
        course_rad: float,
        speed_mps: float,
        has_fix: bool,
    ) -> Any:
        front_c, c = cell.constants
        front_state, state, output = cell.state
        rate, force, field = (gyro_x, gyro_y, gyro_z), (accel_x, accel_y, accel_z), (mag_x, mag_y, mag_z)
        raw = Raw(t_ns, rate, force, field, has_mag, Fix(course_rad, speed_mps), has_fix)
        front_state, sample, is_taken = front.step(front_state, raw, front_c)
        if is_taken:
            state, output = estimator.step(state, sample, c)
        cell.state = (front_state, state, output)
        return output

    return advance


def compile_advance(estimator: ModuleType, cell: Any) -> Advance:
    """Compile :func:`_make_advance` for this cell and return the machine code's entry: no type lookup per call."""
    return cast(Advance, _make_advance(estimator).compile((typeof(cell), *_ARGUMENTS)))


@compiled_entry
def read_cell(cell: Any) -> Any:
    """Return both states and the newest output; arrays are those of the stream itself."""
    return cell.state


@compiled_entry
def restore_cell(front_c: Any, c: Any, front_state: State, state: Any, output: Any) -> Any:
    """Return the cell of a stream that continues from saved states."""
    return Cell((front_c, c), (front_state, state, output))
