"""Allan deviation of a sensor at rest: noise density, bias instability and random walk of the bias.

The overlapping estimator of IEEE Std 952-1997, annex C: with theta the integral of the rate and m samples per cluster,

    sigma^2(tau) = sum (theta_{k+2m} - 2 theta_{k+m} + theta_k)^2 / (2 tau^2 (N - 2m)).

White noise of density N shows as N / sqrt(tau), a random walk of the bias of size K as K sqrt(tau / 3), bias
instability B as a floor of 0.664 B.
"""

from dataclasses import dataclass

import numpy as np

from stillpoint.datasets.errors import Unobservable
from stillpoint.datasets.recording import Floats, Times

_PER_DECADE = 10  # cluster times
FLOOR = 0.664  # sqrt(2 ln 2 / pi): the floor of the deviation over the bias instability
_FEWEST_CLUSTERS = 9  # from which a deviation is good to about 25 %
_SHORTEST_S = 60.0
_EVEN_SHARE = 0.1  # of the median step, by which nearly all steps may differ from it


@dataclass(frozen=True, eq=False)
class AllanDeviation:
    """Deviations of the three axes of one sensor, in its unit."""

    tau_s: Floats  # (T,)
    deviation: Floats  # (T, 3)
    noise_density: Floats  # (3,) unit per sqrt(Hz)
    bias_instability: Floats  # (3,) the lowest deviation over FLOOR: an upper bound where the curve still falls
    bias_instability_s: Floats  # (3,) the cluster time of that
    bias_walk: Floats  # (3,) unit per sqrt(s): an upper bound, from the longest cluster times
    length_s: float


def find_allan_deviation(t_ns: Times, values: Floats) -> AllanDeviation:
    """Return the Allan deviation of samples (N, 3) at rest, on an even clock.

    Raises :class:`Unobservable` for less than SHORTEST_S, and for stamps that are not even.
    """
    length_s = float(t_ns[-1] - t_ns[0]) / 1e9 if len(t_ns) else 0.0
    if length_s < _SHORTEST_S:
        raise Unobservable(f"a rest of {length_s:.0f} s is too short for an Allan deviation; give {_SHORTEST_S:.0f} s")
    step_s = np.diff(t_ns) / 1e9
    step = float(np.median(step_s))
    if np.mean(np.abs(step_s - step) > _EVEN_SHARE * step) > 0.05 or step_s.max() > 5 * step:
        raise Unobservable("the stamps of the rest are not even; an Allan deviation needs an even clock without gaps")
    tau_s, deviation = compute_overlapping_deviation(values, length_s / (len(t_ns) - 1))
    lowest = deviation.argmin(axis=0)
    return AllanDeviation(
        tau_s=tau_s,
        deviation=deviation,
        noise_density=_fit_line(tau_s, deviation, -0.5, (0.0, 1.0)),
        bias_instability=deviation[lowest, range(3)] / FLOOR,
        bias_instability_s=tau_s[lowest],
        bias_walk=_fit_line(tau_s, deviation, 0.5, (length_s / 30, np.inf)) * np.sqrt(3.0),
        length_s=length_s,
    )


def compute_overlapping_deviation(values: Floats, step_s: float) -> tuple[Floats, Floats]:
    """Return cluster times (T,) in s and overlapping Allan deviations (T, k) of samples (N, k) every ``step_s``."""
    n = len(values)
    most = max(1, n // _FEWEST_CLUSTERS)
    count = max(2, int(_PER_DECADE * np.log10(most)) + 1)
    sizes = np.unique(np.round(np.geomspace(1, most, count)).astype(np.int64))
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values - values.mean(axis=0), axis=0)]) * step_s
    rows = []
    for m in sizes.tolist():
        second = total[2 * m :] - 2 * total[m:-m] + total[: -2 * m]
        rows.append(np.sqrt(np.mean(second**2, axis=0) / 2) / (m * step_s))
    return np.asarray(sizes * step_s, dtype=np.float64), np.array(rows, dtype=np.float64)


def _fit_line(tau_s: Floats, deviation: Floats, slope: float, span_s: tuple[float, float]) -> Floats:
    """Return where lines of this slope meet 1 s (3,), the lowest that the deviations in a span of times allow.

    Each deviation bounds the process from above, as others add to it.
    """
    inside = (tau_s >= span_s[0]) & (tau_s <= span_s[1])
    inside = inside if inside.any() else np.ones(len(tau_s), dtype=np.bool_)
    return np.asarray((deviation[inside] / tau_s[inside, None] ** slope).min(axis=0))
