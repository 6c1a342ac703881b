"""Find rests: stretches without motion, distinguished from sensor noise and from steady slow turning.

At rest specific force and rate *change* little: averaged over a short time to reduce white noise, they stay within a
small deviation for a whole window. The level of the rate proves nothing, as a phone's gyro reads up to 6 deg/s at rest.
Therefore a candidate is dropped if gravity's direction turns during it, or if its mean rate is not the rest bias of the
recording. An IMU alone cannot distinguish rest from a recording that only turns steadily about the vertical.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.compiled import compiled
from stillpoint.datasets.recording import Floats, Imu, Times, rate_hz
from stillpoint.datasets.settings import Settings, degrees, number

Windows: TypeAlias = tuple[NDArray[np.int64], NDArray[np.int64]]  # first and last + 1 of each window's samples
_DENSE_SHARE = 0.6  # share of the samples of a window that must be present; fewer are beside a long gap


@dataclass(frozen=True)
class RestParams(Settings):
    """Thresholds of :func:`find_rests`: default, lowest, highest, meaning.

    They lie between what was measured: the rate deviates by 0.02-0.07 deg/s at rest (BROAD, an MPU6050 on a bench) and
    by 0.9-6 deg/s in a hand that holds a phone still (Tyrex).
    """

    window_s: float = number(1.0, 0.3, 10.0, "time over which deviations are taken; shorter rests go unseen")
    smooth_s: float = number(0.1, 0.0, 0.5, "mean before that, which takes out white noise and vibration")
    gyro_sd_radps: float = degrees(0.2, 0.005, 5.0, "largest deviation of the smoothed rate, three axes together")
    accel_sd_mps2: float = number(0.08, 0.002, 2.0, "the same of the specific force")
    noise_factor: float = number(3.0, 1.0, 10.0, "both rise to this multiple of the sensor's own white noise")
    noise_limit: float = number(5.0, 1.0, 100.0, "but never above this multiple of themselves")
    tilt_change_rad: float = degrees(1.0, 0.05, 10.0, "gravity may turn by this much between the ends of a rest")
    bias_change_radps: float = degrees(0.4, 0.01, 5.0, "the mean rate may change by this much from rest to rest")
    bias_limit_radps: float = degrees(10.0, 0.1, 100.0, "a mean rate above this is a rotation, not a bias")
    min_rest_s: float = number(1.0, 0.1, 60.0, "shorter rests are not reported")
    edge_s: float = number(0.1, 0.0, 1.0, "cut from both ends, where motion fades in and out")


def find_rests(imu: Imu, params: RestParams = RestParams()) -> Times:
    """Return first and last stamp of each rest, ``(R, 2)`` int64 ns, in the order of time; R may be 0.

    The stamps may be irregular; no rest extends across a gap of half a window.
    """
    finder = RestFinder(params)
    finder.add(imu)
    return finder.rests_ns()


class RestFinder:
    """Finds rests in an IMU that comes piece by piece, in the memory of one piece.

    Limits that follow the sensor's noise are those of each piece; the rest bias is that of all pieces. A rest that the
    end of a piece cuts is joined again; a part of it shorter than ``min_rest_s`` is lost.
    """

    def __init__(self, params: RestParams = RestParams()) -> None:
        self._params = params
        self._found: list[_Span] = []
        self._last_ns = 0  # last stamp so far

    def add(self, imu: Imu) -> None:
        """Take the next samples."""
        params, t_ns = self._params, imu.t_ns
        before_ns, self._last_ns = self._last_ns, int(t_ns[-1])
        if len(t_ns) < 3:
            return
        t_s = (t_ns - t_ns[0]) / 1e9
        narrow, wide = _windows(t_s, params.smooth_s), _windows(t_s, params.window_s)
        gyro_sd, gyro_noise = _deviation(imu.gyro_b_radps, narrow, wide)
        accel_sd, accel_noise = _deviation(imu.accel_b_mps2, narrow, wide)
        calmest = np.argmin(gyro_sd / params.gyro_sd_radps + accel_sd / params.accel_sd_mps2)
        gyro_limit = _limit(params.gyro_sd_radps, gyro_noise[calmest], params)
        accel_limit = _limit(params.accel_sd_mps2, accel_noise[calmest], params)

        still = (gyro_sd < gyro_limit) & (accel_sd < accel_limit) & _dense(t_s, rate_hz(t_ns), wide, params)
        spans = _cut_edges(t_s, _widen(_runs(still), wide), params)
        for span in spans:
            if not _keeps_tilt(imu, t_s, span, params):
                continue
            first, last = int(span[0]), int(span[1])
            rows = slice(first, last + 1)
            mean, calm = imu.gyro_b_radps[rows].mean(axis=0), float(np.median(gyro_sd[rows]))
            one = _Span(int(t_ns[first]), int(t_ns[last]), last + 1 - first, mean, calm)
            is_next = first == 0 and t_ns[0] - before_ns <= params.window_s / 2 * 1e9
            if is_next and self._found and self._found[-1].end_ns == before_ns:
                one = self._found.pop().join(one)
            self._found.append(one)

    def rests_ns(self) -> Times:
        """Return first and last stamp of each rest (R, 2)."""
        spans = np.array([(one.start_ns, one.end_ns) for one in self._found], np.int64).reshape(-1, 2)
        return spans[_find_spans_at_bias(self._found, self._params)]


@dataclass(frozen=True)
class _Span:
    """A stretch that may be a rest."""

    start_ns: int
    end_ns: int
    samples: int
    rate_b_radps: Floats  # (3,) mean
    calm_radps: float  # median deviation of the smoothed rate

    def join(self, after: "_Span") -> "_Span":
        """Return this stretch and the one that continues it as one."""
        total = self.samples + after.samples
        share = after.samples / total
        rate = (1 - share) * self.rate_b_radps + share * after.rate_b_radps
        calm = (1 - share) * self.calm_radps + share * after.calm_radps
        return _Span(self.start_ns, after.end_ns, total, rate, calm)


@compiled
def _windows(t_s: Floats, width_s: float) -> Windows:
    """Return the index range [first, last) of the samples within half a width of each stamp."""
    n = len(t_s)
    first, last = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    start = end = 0
    for k in range(n):
        while t_s[start] < t_s[k] - width_s / 2:
            start += 1
        while end < n and t_s[end] <= t_s[k] + width_s / 2:
            end += 1
        first[k], last[k] = start, end
    return first, last


@compiled
def _mean(values: Floats, windows: Windows) -> Floats:
    """Return the means of values (N,) over windows."""
    n = len(values)
    total, mean = np.zeros(n + 1), np.empty(n)
    for k in range(n):
        total[k + 1] = total[k] + values[k]
    for k in range(n):
        first, last = windows[0][k], windows[1][k]
        mean[k] = (total[last] - total[first]) / (last - first)
    return mean


def _deviation(values: Floats, narrow: Windows, wide: Windows) -> tuple[Floats, Floats]:
    """Return the sd of the smoothed values in each window, and the sd that white noise alone would cause."""
    variance, white = np.zeros(len(values)), np.zeros(len(values))
    for axis, mean in enumerate(values.mean(axis=0)):  # one axis at a time: a third of the memory
        centred = values[:, axis] - mean  # keeps the sums of squares small
        smooth = _mean(centred, narrow)
        variance += _mean(smooth**2, wide) - _mean(smooth, wide) ** 2
        white += _mean(np.diff(centred, prepend=centred[:1]) ** 2, wide)
    return np.sqrt(np.maximum(variance, 0.0)), np.sqrt(white / 2) / np.sqrt(narrow[1] - narrow[0])


def _limit(threshold: float, noise: float, params: RestParams) -> float:
    return float(np.clip(params.noise_factor * noise, threshold, params.noise_limit * threshold))


def _dense(t_s: Floats, rate: float, wide: Windows, params: RestParams) -> NDArray[np.bool_]:
    """Return where a window holds enough of the samples that the recording's rate promises."""
    first, last = wide
    inside_s = np.minimum(t_s + params.window_s / 2, t_s[-1]) - np.maximum(t_s - params.window_s / 2, t_s[0])
    return (last - first >= _DENSE_SHARE * rate * inside_s) & (last - first >= 3)


def _runs(mask: NDArray[np.bool_]) -> Times:
    """Return first and last index of each run of True, (R, 2)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return np.stack([edges[::2], edges[1::2] - 1], axis=1).astype(np.int64)


def _widen(runs: Times, wide: Windows) -> Times:
    """Extend runs of still window centres to what their windows cover; neighbours stay separate, half way apart."""
    first, last = wide
    start, end = first[runs[:, 0]], last[runs[:, 1]] - 1
    middle = (runs[:-1, 1] + runs[1:, 0]) // 2
    start[1:], end[:-1] = np.maximum(start[1:], middle + 1), np.minimum(end[:-1], middle)
    return np.stack([start, end], axis=1).astype(np.int64)


def _cut_edges(t_s: Floats, spans: Times, params: RestParams) -> Times:
    """Shorten each span at ends that are not those of the recording, and drop spans that are too short."""
    long_enough = t_s[spans[:, 1]] - t_s[spans[:, 0]] >= params.min_rest_s
    start, end = spans[long_enough].T
    cut_start = np.where(start > 0, np.searchsorted(t_s, t_s[start] + params.edge_s), 0)
    cut_end = np.searchsorted(t_s, t_s[end] - params.edge_s, side="right") - 1
    cut_end = np.where(end < len(t_s) - 1, cut_end, len(t_s) - 1)
    cut = np.stack([cut_start, cut_end], axis=1)
    return cut[cut_end > cut_start].astype(np.int64)


def _keeps_tilt(imu: Imu, t_s: Floats, span: Times, params: RestParams) -> bool:
    """Return whether gravity has the same direction at both ends of the span."""
    start, end = span
    part_s = min(params.window_s, (t_s[end] - t_s[start]) / 2)
    head = imu.accel_b_mps2[start : np.searchsorted(t_s, t_s[start] + part_s, side="right")].mean(axis=0)
    tail = imu.accel_b_mps2[np.searchsorted(t_s, t_s[end] - part_s) : end + 1].mean(axis=0)
    turned = np.arctan2(np.linalg.norm(np.cross(head, tail)), head @ tail)
    return bool(turned <= params.tilt_change_rad)


def _find_spans_at_bias(spans: Sequence[_Span], params: RestParams) -> NDArray[np.bool_]:
    """Return which spans show the gyro's rest bias, which may drift slowly from rest to rest.

    The rest bias is the mean rate that most spans share, among the spans about as calm as the calmest; in a tie the
    smallest mean rate wins.
    """
    keep = np.zeros(len(spans), dtype=np.bool_)
    rates = np.array([one.rate_b_radps for one in spans]).reshape(-1, 3)
    size = np.linalg.norm(rates, axis=1)
    able = np.flatnonzero(size <= params.bias_limit_radps)
    if len(able) == 0:
        return keep
    calm = np.array([one.calm_radps for one in spans])
    calmest = able[calm[able] <= 2 * calm[able].min()]
    gaps = np.linalg.norm(rates[calmest, None] - rates[None, able], axis=2)
    votes = (gaps <= params.bias_change_radps).sum(axis=1)
    best = calmest[np.lexsort((size[calmest], -votes))[0]]
    for order in (range(best, len(spans)), range(best, -1, -1)):
        bias = rates[best]
        for k in order:
            if np.linalg.norm(rates[k] - bias) <= params.bias_change_radps and size[k] <= params.bias_limit_radps:
                keep[k], bias = True, rates[k]
    return keep
