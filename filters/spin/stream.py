"""``SpinStream``: an estimator of a spin fed sample by sample, as on the device; the same compiled step as in batch."""

import struct
from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any, NamedTuple

import numpy as np

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.recording import SpinGeometry
from stillpoint.datasets.settings import Settings, choose_settings
from stillpoint.filters.advance import read_cell
from stillpoint.filters.precision import Precision, to_precision
from stillpoint.filters.sample import collect_counts
from stillpoint.filters.spin import front as spin_front
from stillpoint.filters.spin.advance import Row, SpinAnswer, compile_advance, make_begin, restore_cell
from stillpoint.filters.spin.noise import SpinParams, make_channels
from stillpoint.filters.table import SpinEstimator, find_estimator


class SavedSpin(NamedTuple):
    """A stream between two samples: plain numbers, tuples and arrays, to be pickled or kept in memory."""

    name: str  # of the estimator
    precision: str
    front: spin_front.State
    state: Any
    answer: SpinAnswer


class SpinStream:
    """One run of an estimator of a spin, sample by sample.

    Raises :class:`BadParameter` for an unknown estimator or parameter, for an estimator of attitude and for a saved
    state of another kind of run, :class:`Unobservable` for a geometry that does not fix rate and angular acceleration.

    Parameters
    ----------
    name, params
        As in :func:`stillpoint.filters.estimate`.
    geometry
        Where the accelerometers and gyros sit.
    precision
        ``"single"``: every operation of the estimator in float32, as on a microcontroller.
    saved
        Go on from :meth:`save` instead of starting; the other arguments are to be the same.
    """

    def __init__(
        self,
        name: str,
        geometry: SpinGeometry,
        params: Settings | Mapping[str, Any] | None = None,
        precision: Precision = "double",
        saved: SavedSpin | None = None,
    ) -> None:
        entry = find_estimator(name)
        if not isinstance(entry, SpinEstimator):
            raise BadParameter(f"{name}: estimates an attitude; use Stream({name!r})")
        kind = (name, precision)
        if saved is not None and tuple(saved[:2]) != kind:
            raise BadParameter(
                f"the saved state is of {' '.join(saved[:2])}, not of {' '.join(kind)}; continue with the first one"
            )
        settings = choose_settings(entry.params(), params, name)
        assert isinstance(settings, SpinParams)
        front_c = spin_front.coefficients(make_channels(settings, geometry), settings, precision)
        c = to_precision(entry.coefficients(settings, geometry), precision)
        self._k, self._m = len(geometry.accel_r_b_m), len(geometry.gyro_axis_b)
        values = np.zeros(self._k + self._m)
        row = Row(values[None, : self._k], values[None, self._k :])
        for columns in row:
            columns.flags.writeable = False  # as those of a recording are: both use the same machine code
        if saved is None:
            self._cell = make_begin(entry.module)(front_c, c, row)
        else:
            state = to_precision(deepcopy(saved.state), precision)
            self._cell = restore_cell(front_c, c, saved.front, state, saved.answer, row)
        self._kind = kind
        self._buffer = values.data  # the memory of the row in the cell
        self._pack = struct.Struct(f"{self._k + self._m}d").pack_into
        self._advance = compile_advance(entry.module, self._cell)

    def update(self, t_ns: int, accel_mps2: Sequence[float], gyro_radps: Sequence[float] = ()) -> SpinAnswer:
        """Return angle and rate after one sample: a number per accelerometer and gyro, NaN where it is lost.

        A stamp that does not rise is left out and counted, and the answer before is returned. Raises
        :class:`BadParameter` for another number of values.
        """
        if len(accel_mps2) != self._k or len(gyro_radps) != self._m:
            given = f"{len(accel_mps2)} accelerometers and {len(gyro_radps)} gyros"
            raise BadParameter(f"{given}: the geometry has {self._k} and {self._m}; give NaN for a value that is lost")
        self._pack(self._buffer, 0, *accel_mps2, *gyro_radps)
        return self._advance(self._cell, t_ns)

    def save(self) -> SavedSpin:
        """Return all that is needed to go on from here, also in another process."""
        return SavedSpin(*self._kind, *deepcopy(read_cell(self._cell)))

    @property
    def counts(self) -> dict[str, int]:
        """Return the counts of the stage before the estimator, and of the estimator."""
        passed, state, _ = read_cell(self._cell)
        return collect_counts(passed) | collect_counts(state)
