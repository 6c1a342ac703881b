"""``RollStream``: an estimator of roll fed sample by sample, as on the device; the same compiled step as in batch."""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any, NamedTuple

import numpy as np

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.recording import Spin, SpinGeometry
from stillpoint.datasets.settings import Settings, chosen
from stillpoint.filters.precision import Precision, in_precision
from stillpoint.filters.roll_direction import Evidence, no_evidence
from stillpoint.filters.roll_noise import spin_channels
from stillpoint.filters.roll_run import as_roll_log
from stillpoint.filters.roll_sample import RollOutput, angle_of, no_roll, roll_sample_at
from stillpoint.filters.sample import counts
from stillpoint.filters.table import RollEstimator, find


class RollAnswer(NamedTuple):
    """Angle and rate about the spin axis after a sample."""

    angle_rad: float  # unwrapped, 0 at the first sample
    rate_radps: float
    angle_sd_rad: float
    rate_sd_radps: float
    innovation: float  # normalised; NaN where there was no update
    ready: bool


class SavedRoll(NamedTuple):
    """A stream between two samples, to be pickled or kept in memory."""

    name: str  # of the estimator
    t_ns: int  # of the last sample
    evidence: Evidence
    output: RollOutput
    state: Any
    n_out_of_order: int


class RollStream:
    """One run of an estimator of roll, sample by sample.

    Raises :class:`BadParameter` for an unknown estimator or parameter and for an estimator of attitude,
    :class:`Unobservable` for a geometry that does not fix rate and angular acceleration.

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
        saved: SavedRoll | None = None,
    ) -> None:
        entry = find(name)
        if not isinstance(entry, RollEstimator):
            raise BadParameter(f"{name}: estimates an attitude; use Stream({name!r})")
        if saved is not None and saved.name != name:
            raise BadParameter(f"{name}: the saved state is of {saved.name}; go on with that one")
        settings = chosen(entry.params(), params, name)
        self._name, self._step, self._precision = name, entry.step, precision
        self._by = spin_channels(settings, geometry)
        self._c = in_precision(entry.coefficients(settings, geometry), precision)
        self._t_ns, self._n_out_of_order, self._evidence = -1, 0, no_evidence()
        self._output = RollOutput(no_roll(0.0), float("nan"), False)
        self._state = entry.start(self._c)
        if saved is not None:
            _, self._t_ns, self._evidence, self._output, state, self._n_out_of_order = saved
            self._state = deepcopy(state)

    def update(self, t_ns: int, accel_mps2: Sequence[float], gyro_radps: Sequence[float] = ()) -> RollAnswer:
        """Angle and rate after one sample: a number per accelerometer and gyro of the geometry, NaN where it is lost.

        A stamp that does not rise is left out and counted, and the answer before is returned.
        """
        if t_ns <= self._t_ns:
            self._n_out_of_order += 1
            return self._answer()
        spin = Spin(
            np.array([t_ns]), np.array([accel_mps2]), np.array([gyro_radps], dtype=np.float64), self._by.geometry
        )
        dt_s = np.array([(t_ns - self._t_ns) / 1e9 if self._t_ns >= 0 else 0.0])
        log, self._evidence = as_roll_log(spin, self._by, dt_s, self._evidence)
        sample = roll_sample_at(in_precision(log, self._precision), 0)
        state = self._state
        if self._precision == "single":
            state, sample = in_precision(state, "single"), in_precision(sample, "single")
        self._state, self._output = self._step(state, sample, self._c)
        self._t_ns = t_ns
        return self._answer()

    def save(self) -> SavedRoll:
        """All that is needed to go on from here, also in another process."""
        state = deepcopy(self._state)
        return SavedRoll(self._name, self._t_ns, self._evidence, self._output, state, self._n_out_of_order)

    @property
    def counts(self) -> dict[str, int]:
        """What was left out, and what the estimator itself counted."""
        return {"n_out_of_order": self._n_out_of_order} | counts(self._state)

    def _answer(self) -> RollAnswer:
        roll, innovation, ready = self._output
        sds = float(np.sqrt(np.float64(roll.angle_var))), float(np.sqrt(np.float64(roll.rate_var)))
        return RollAnswer(angle_of(roll), float(roll.rate_radps), *sds, float(innovation), bool(ready))
