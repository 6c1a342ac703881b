"""``Stream``: an estimator fed sample by sample, as on the device; the same compiled step as a batch run."""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any, NamedTuple

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.settings import Settings, chosen
from stillpoint.filters.precision import Precision, in_precision
from stillpoint.filters.sample import Output, Sample, counts
from stillpoint.filters.table import Estimator, find

NO_VECTOR = (0.0, 0.0, 0.0)
# No sensor reads as much, in rad/s, m/s^2 or uT: such a number is a broken one.
LARGEST = 1e6


class Saved(NamedTuple):
    """A stream between two samples: plain numbers, tuples and arrays, to be pickled or kept in memory."""

    name: str  # of the estimator
    t_ns: int  # of the last sample
    gyro_b_radps: tuple[float, float, float]  # the last good one
    output: Output
    state: Any
    counts: dict[str, int]


class Stream:
    """One run of an estimator, sample by sample.

    Raises :class:`BadParameter` for an unknown estimator or parameter, and for a peer: these take whole recordings.

    Parameters
    ----------
    name, params
        As in :func:`stillpoint.filters.estimate`.
    declination_rad
        East of true north, at the place and date of the run.
    precision
        ``"single"``: every operation in float32, as on a microcontroller.
    saved
        Go on from :meth:`save` instead of starting; the other arguments are to be the same.
    """

    def __init__(
        self,
        name: str,
        params: Settings | Mapping[str, Any] | None = None,
        declination_rad: float = 0.0,
        precision: Precision = "double",
        saved: Saved | None = None,
    ) -> None:
        entry = find(name)
        if not isinstance(entry, Estimator):
            raise BadParameter(f"{name}: takes whole recordings only; use estimate(recording, {name!r})")
        if saved is not None and saved.name != name:
            raise BadParameter(f"{name}: the saved state is of {saved.name}; go on with that one")
        self._name, self._step, self._precision = name, entry.step, precision
        self._c = in_precision(entry.coefficients(chosen(entry.params(), params, name), declination_rad), precision)
        self._t_ns = -1
        self._gyro = NO_VECTOR
        self._output = Output((1.0, 0.0, 0.0, 0.0), None, None, None, False)
        self._counts = {"n_out_of_order": 0, "n_bad_gyro": 0, "n_bad_accel": 0, "n_bad_mag": 0}
        self._state = entry.start(self._c)
        if saved is not None:
            _, self._t_ns, self._gyro, self._output, state, counts = saved
            self._state, self._counts = deepcopy(state), dict(counts)

    def update(
        self,
        t_ns: int,
        gyro_b_radps: Sequence[float],
        accel_b_mps2: Sequence[float],
        mag_b_ut: Sequence[float] | None = None,
    ) -> Output:
        """The output after one sample; ``mag_b_ut`` is given when there is a field that was not given before.

        A stamp that does not rise is left out, and the output before is returned. A gyro vector that is not
        finite, or absurdly large, is replaced by the last good one; such an accelerometer or field vector is left
        out. All are counted.
        """
        if t_ns <= self._t_ns:
            self._counts["n_out_of_order"] += 1
            return self._output
        dt_s = (t_ns - self._t_ns) / 1e9 if self._t_ns >= 0 else 0.0
        gyro, accel, mag = _vector(gyro_b_radps), _vector(accel_b_mps2), NO_VECTOR
        if not _usable(gyro):
            gyro = self._gyro
            self._counts["n_bad_gyro"] += 1
        has_accel = _usable(accel)
        if not has_accel:
            accel = NO_VECTOR
            self._counts["n_bad_accel"] += 1
        has_mag = mag_b_ut is not None
        if mag_b_ut is not None:
            mag = _vector(mag_b_ut)
            if not _usable(mag):
                mag, has_mag = NO_VECTOR, False
                self._counts["n_bad_mag"] += 1
        sample = Sample(dt_s, gyro, accel, mag, has_accel, has_mag)
        if self._precision == "single":
            state, sample = in_precision(self._state, "single"), in_precision(sample, "single")
            self._state, self._output = self._step(state, sample, self._c)
        else:
            self._state, self._output = self._step(self._state, sample, self._c)
        self._t_ns, self._gyro = t_ns, gyro
        return self._output

    def save(self) -> Saved:
        """All that is needed to go on from here, also in another process."""
        return Saved(self._name, self._t_ns, self._gyro, self._output, deepcopy(self._state), dict(self._counts))

    @property
    def counts(self) -> dict[str, int]:
        """What was left out, and what the estimator itself counted."""
        return self._counts | counts(self._state)


def _vector(values: Sequence[float]) -> tuple[float, float, float]:
    x, y, z = values
    return float(x), float(y), float(z)


def _usable(v: tuple[float, float, float]) -> bool:
    """False for NaN too: it is not less than anything."""
    return abs(v[0]) < LARGEST and abs(v[1]) < LARGEST and abs(v[2]) < LARGEST
