"""Choose the states of the graph, and sum up what the sensors measured between them."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.recording import Floats, Imu, Times
from stillpoint.datasets.times import GAP_STEPS
from stillpoint.smoother.attitude.params import KeyParams
from stillpoint.smoother.attitude.samples.clipping import extend_clipped
from stillpoint.smoother.attitude.samples.slow_log import estimate_sampling_error, integrate_slow_log
from stillpoint.smoother.missing import LONG_GAP_S, bridge_gaps

_SMALLEST_GYRO_RANGE_RADPS = 4.3  # 250 deg/s: below the smallest range there is no clipping
_SMALLEST_ACCEL_RANGE_MPS2 = 19.0  # 2 g
_RATE_RMS_S = 5.0  # with 1 s and 30 s instead, errors on BROAD differ by less than 0.002 deg


@dataclass(frozen=True, eq=False)
class Motion:
    """The IMU stream as the graph uses it: N samples in seconds from its first."""

    t_s: Floats  # (N,)
    dt_s: Floats  # (N,) the interval that ends at the sample
    gyro_b_radps: Floats  # (N, 3) with clipped and missing readings replaced
    accel_b_mps2: Floats  # (N, 3) the same
    at_rest: NDArray[np.bool_]  # (N,)
    gyro_beyond_radps: Floats  # (N, 3) by how much a replaced reading may be wrong, 0 elsewhere
    accel_beyond_mps2: Floats  # (N, 3)
    gyro_sampling_radps: Floats  # (N, 3) by how much a slowly sampled rate may be wrong, 0 where that is not noticed


@dataclass(frozen=True, eq=False)
class Keys:
    """n states, the n - 1 intervals between them, and the part of them that belongs to a window.

    A window has the factors of its states ``first`` to ``end - 1`` and of the intervals that begin there, so that a
    window that ends where another begins shares no factor with it.
    """

    row: NDArray[np.int64]  # (n,) the sample at which the state stands
    t_s: Floats  # (n,)
    at_rest: NDArray[np.bool_]  # (n - 1,) no motion in the interval
    gap: NDArray[np.bool_]  # (n - 1,) samples are missing for more than LONG_GAP_S
    gyro_clipped_rad: (
        Floats  # (n - 1, 3) by how much an axis may be wrong, integrated over clipped and missing readings
    )
    accel_clipped_mps: Floats  # (n - 1, 3)
    gyro_sampling_rad: Floats  # (n - 1, 3) by how much an axis may be wrong because it was sampled slowly
    gyro_b_radps: Floats  # (n - 1, 3) mean over the interval
    accel_b_mps2: Floats  # (n - 1, 3) mean over the interval
    jerk_b_mps3: Floats  # (n - 1, 3) change of the specific force over the interval
    rate_rms_radps: Floats  # (n - 1,) RMS of the rate over 5 s around the interval
    first: int = 0
    end: int | None = None  # None: to the last state

    @property
    def states(self) -> range:
        """Return the states whose factors belong to the window."""
        return range(self.first, len(self.t_s) if self.end is None else self.end)

    @property
    def held(self) -> range:
        """Return the states that occur in the window: its own, and the one at which its last interval ends."""
        return range(self.first, min(self.states.stop + 1, len(self.t_s)))

    def intervals(self, which: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Return the numbers of the window's intervals at which ``which`` (n - 1,) is true."""
        return np.flatnonzero(which[self.first : self.end]) + self.first

    def within(self, first: int, end: int) -> "Keys":
        """Return the window of the states ``first`` to ``end - 1``."""
        return replace(self, first=first, end=end)

    @property
    def clipped(self) -> NDArray[np.bool_]:
        """Return which intervals have a clipped or missing reading, (n - 1,)."""
        return np.asarray((self.gyro_clipped_rad > 0).any(axis=1) | (self.accel_clipped_mps > 0).any(axis=1))

    @property
    def span_s(self) -> Floats:
        """Return the lengths of the intervals, (n - 1,)."""
        return np.diff(self.t_s)


def prepare_motion(imu: Imu, rests_ns: Times) -> Motion:
    """Return the IMU stream in seconds, with rests marked and clipped and missing readings replaced.

    Slowly sampled readings are integrated in between (samples/slow_log.py).
    """
    t_s = (imu.t_ns - imu.t_ns[0]) / 1e9
    at_rest = np.zeros(len(t_s), dtype=np.bool_)
    for start, end in np.searchsorted(imu.t_ns, rests_ns):
        at_rest[start : end + 1] = True
    gyro, gyro_beyond = extend_clipped(t_s, imu.gyro_b_radps, _SMALLEST_GYRO_RANGE_RADPS)
    accel, accel_beyond = extend_clipped(t_s, imu.accel_b_mps2, _SMALLEST_ACCEL_RANGE_MPS2)
    step_s = np.diff(t_s)
    dt_s = np.concatenate([[np.median(step_s) if len(step_s) else 0.0], step_s])
    gyro, gyro_missed = bridge_gaps(dt_s, gyro, ~at_rest)
    accel, accel_missed = bridge_gaps(dt_s, accel, ~at_rest)
    beyond = _take_larger(gyro_beyond, gyro_missed), _take_larger(accel_beyond, accel_missed)
    sampling = estimate_sampling_error(gyro, dt_s, at_rest)
    if sampling.any():
        bias = gyro[at_rest].mean(axis=0) if at_rest.any() else np.zeros(3)
        gyro, accel = integrate_slow_log(t_s, gyro, accel, bias)
    return Motion(t_s, dt_s, gyro, accel, at_rest, *beyond, sampling)


def _take_larger(one: Floats, other: Floats) -> Floats:
    """Return the larger of errors (N, 3) that are not negative; no new array where all of one kind are 0."""
    if not other.any():
        return one
    return np.maximum(one, other) if one.any() else other


def choose_keys(motion: Motion, params: KeyParams) -> Keys:
    """Place states every ``moving_s`` in motion, every ``resting_s`` at rest, and at the ends of rests and gaps."""
    rows = _choose_rows(motion, params)
    first, last = rows[:-1] + 1, rows[1:] + 1
    total_s = np.concatenate([[0.0], np.cumsum(motion.dt_s)])
    span_s = (total_s[last] - total_s[first])[:, None]
    moving = np.concatenate([[0], np.cumsum(~motion.at_rest)])
    longest = np.maximum.reduceat(motion.dt_s, first) if len(first) else np.zeros(0)
    gyro = _integrate(motion.gyro_b_radps, motion.dt_s, first, last) / span_s
    return Keys(
        row=rows,
        t_s=motion.t_s[rows],
        at_rest=(moving[last] - moving[rows[:-1]]) == 0,
        gap=longest > max(LONG_GAP_S, GAP_STEPS * float(np.median(motion.dt_s))),
        gyro_clipped_rad=_sum_intervals(motion.gyro_beyond_radps, motion.dt_s, first),
        accel_clipped_mps=_sum_intervals(motion.accel_beyond_mps2, motion.dt_s, first),
        gyro_sampling_rad=_sum_intervals(motion.gyro_sampling_radps, motion.dt_s, first),
        gyro_b_radps=gyro,
        accel_b_mps2=_integrate(motion.accel_b_mps2, motion.dt_s, first, last) / span_s,
        jerk_b_mps3=(motion.accel_b_mps2[rows[1:]] - motion.accel_b_mps2[rows[:-1]]) / span_s,
        rate_rms_radps=_average_rate(gyro, motion.t_s[rows]),
    )


def _average_rate(gyro_b_radps: Floats, t_s: Floats) -> Floats:
    """Return the RMS of rates (n - 1, 3) over RATE_RMS_S around each interval between times (n,)."""
    total = np.concatenate([[0.0], np.cumsum((gyro_b_radps**2).sum(axis=1) * np.diff(t_s))])
    middle = (t_s[1:] + t_s[:-1]) / 2
    from_s, to_s = np.maximum(middle - _RATE_RMS_S / 2, t_s[0]), np.minimum(middle + _RATE_RMS_S / 2, t_s[-1])
    square = (np.interp(to_s, t_s, total) - np.interp(from_s, t_s, total)) / (to_s - from_s)
    return np.asarray(np.sqrt(np.maximum(square, 0.0)))


def _choose_rows(motion: Motion, params: KeyParams) -> NDArray[np.int64]:
    """Return the samples at which states stand: a regular grid in each stretch of rest or motion between gaps."""
    n = len(motion.t_s)
    broken = np.diff(motion.at_rest) | (np.diff(motion.t_s) > LONG_GAP_S)
    edges = np.unique(np.concatenate([[0], np.flatnonzero(broken), np.flatnonzero(broken) + 1, [n - 1]]))
    rows = [edges]
    for start, end in pairwise(edges):
        step_s = params.resting_s if motion.at_rest[start] and motion.at_rest[end] else params.moving_s
        length_s = motion.t_s[end] - motion.t_s[start]
        count = int(np.ceil(length_s / step_s - 0.01))
        if count > 1 and end - start > 1:
            wanted_s = motion.t_s[start] + length_s * np.arange(1, count) / count
            rows.append(np.searchsorted(motion.t_s, wanted_s))
    merged = np.unique(np.concatenate(rows))
    spaced = np.diff(motion.t_s[merged]) >= 0.3 * params.moving_s
    return _drop_slivers(merged, spaced, motion).astype(np.int64)


def _drop_slivers(rows: NDArray[np.int64], spaced: NDArray[np.bool_], motion: Motion) -> NDArray[np.int64]:
    """Drop states a sample or two after another one, but never one beside a gap or the last."""
    after_gap = np.concatenate([[True], np.diff(motion.t_s) > LONG_GAP_S])
    keep = np.concatenate([[True], spaced]) | after_gap[rows]
    keep[-1] = True
    before_gap = np.isin(rows + 1, np.flatnonzero(after_gap))
    return rows[keep | before_gap]


def _integrate(values: Floats, dt_s: Floats, first: NDArray[np.int64], last: NDArray[np.int64]) -> Floats:
    """Return integrals (n - 1, 3) of values (N, 3) from after the sample ``first - 1`` to the sample ``last - 1``."""
    found = np.empty((len(first), 3))
    for axis in range(3):  # one axis at a time: a third of the memory
        total = np.concatenate([[0.0], np.cumsum(values[:, axis] * dt_s)])
        found[:, axis] = total[last] - total[first]
    return found


def _sum_intervals(values: Floats, dt_s: Floats, first: NDArray[np.int64]) -> Floats:
    """Return integrals (n - 1, 3) over the samples of each interval, exactly 0 where all samples are 0."""
    if not len(first) or not values.any():
        return np.zeros((len(first), 3))
    return np.asarray(np.add.reduceat(values * dt_s[:, None], first, axis=0))
