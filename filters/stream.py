"""``Stream``: an estimator fed sample by sample, as on the device; the same compiled step as a batch run."""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any, NamedTuple

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.settings import Settings, choose_settings
from stillpoint.filters.advance import compile_advance, make_begin, read_cell, restore_cell
from stillpoint.filters.front.front import State as FrontState
from stillpoint.filters.front.heading_source import Heading
from stillpoint.filters.front.sources import make_front
from stillpoint.filters.precision import Precision, to_precision
from stillpoint.filters.sample import Output, collect_counts
from stillpoint.filters.table import Estimator, find_estimator

_NO_VECTOR = (0.0, 0.0, 0.0)
_NO_FIX = (0.0, 0.0)


class Saved(NamedTuple):
    """A stream between two samples: plain numbers, tuples and arrays, to be pickled or kept in memory."""

    name: str  # of the estimator
    heading: str
    precision: str
    front: FrontState
    state: Any
    output: Output


class Stream:
    """One run of an estimator, sample by sample.

    Raises :class:`BadParameter` for an unknown estimator or parameter, for a peer, which takes whole recordings, and
    for a saved state of another kind of run.

    Parameters
    ----------
    name, params, heading, heading_params, ranges
        As in :func:`stillpoint.filters.estimate`.
    declination_rad
        East of true north, at the place and date of the run; None: not known, north is magnetic (with the heading by
        ``"gps-course"``, true as soon as there are courses).
    precision
        ``"single"``: every operation in float32, as on a microcontroller.
    saved
        Go on from :meth:`save` instead of starting; the other arguments are to be the same.
    """

    def __init__(
        self,
        name: str,
        params: Settings | Mapping[str, Any] | None = None,
        declination_rad: float | None = None,
        precision: Precision = "double",
        heading: Heading = "mag",
        *,
        heading_params: Settings | Mapping[str, Any] | None = None,
        ranges: Settings | Mapping[str, Any] | None = None,
        saved: Saved | None = None,
    ) -> None:
        entry = find_estimator(name)
        if not isinstance(entry, Estimator):
            raise BadParameter(f"{name}: takes whole recordings only; use estimate(recording, {name!r})")
        kind = (name, heading, precision)
        if saved is not None and tuple(saved[:3]) != kind:
            raise BadParameter(
                f"the saved state is of {' '.join(saved[:3])}, not of {' '.join(kind)}; continue with the first one"
            )
        front_c = make_front(heading, heading_params, ranges, declination_rad)
        c = entry.coefficients(choose_settings(entry.params(), params, name), declination_rad or 0.0)
        both = to_precision(front_c, precision), to_precision(c, precision)
        if saved is None:
            self._cell = make_begin(entry.module)(*both)
        else:
            self._cell = restore_cell(*both, *to_precision(deepcopy(saved[3:]), precision))
        self._kind = kind
        self._advance = compile_advance(entry.module, self._cell)

    def update(
        self,
        t_ns: int,
        gyro_b_radps: Sequence[float],
        accel_b_mps2: Sequence[float],
        mag_b_ut: Sequence[float] | None = None,
        course: tuple[float, float] | None = None,
    ) -> Output:
        """Return the output after one sample.

        ``mag_b_ut`` is given when there is a field that was not given before, and ``course`` likewise: course over
        ground (rad, clockwise from true north) and speed (m/s) of a new satellite fix, NaN where it is not valid.

        What is no measurement is left out or replaced, and counted: :mod:`stillpoint.filters.front.guard`.
        """
        gx, gy, gz = gyro_b_radps
        ax, ay, az = accel_b_mps2
        mx, my, mz = _NO_VECTOR if mag_b_ut is None else mag_b_ut
        course_rad, speed_mps = _NO_FIX if course is None else course
        output: Output = self._advance(
            self._cell,
            t_ns,
            gx,
            gy,
            gz,
            ax,
            ay,
            az,
            mx,
            my,
            mz,
            mag_b_ut is not None,
            course_rad,
            speed_mps,
            course is not None,
        )
        return output

    def save(self) -> Saved:
        """Return all that is needed to go on from here, also in another process."""
        return Saved(*self._kind, *deepcopy(read_cell(self._cell)))

    @property
    def counts(self) -> dict[str, int]:
        """Return the counts of the guard, of the heading source, and of the estimator itself."""
        passed, state, _ = read_cell(self._cell)
        return collect_counts(passed) | collect_counts(state)
