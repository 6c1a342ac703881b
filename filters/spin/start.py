"""The rate to start from: the median of the first samples, or the first alone as in Asghari et al. 2018.

A single sample may be a glitch, and an adaptive filter that starts on one does not recover. Each sample gives a rate,
the root of the square; the gain since the first sample, by the angular acceleration, is subtracted, so that the median
also holds while the body spins up. A square of exactly 0 gives no rate: a sensor that is not running yet reads it, and
the sign of the noise would then decide the sense. The angle still counts from the first sample, by the rate that is
found.
"""

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.compiled import compiled, like
from stillpoint.filters.spin.sample import SpinMotion, SpinSample, wrap_angle

_MOST_RADPS, _MOST_VAR = 1e8, 1e15  # rate and its variance: beyond, squares of squares leave single precision
MEDIAN_VAR = 1.5708  # pi / 2: the variance of a median over that of the mean, for normal noise


class Start(NamedTuple):
    """The first samples. The array is passed from step to step and written in place."""

    rates_radps: NDArray[np.float64]  # (room,) size of the rate at the first sample by each sample, ascending
    held: int
    gained_radps: float  # by the angular acceleration, since the first sample
    gained_rad: float
    elapsed_s: float
    turns: int  # where the angle begins
    rest_rad: float
    angle_var: float


@compiled
def empty_start(room: int, zero: float) -> Start:
    """Return the record before the first sample; ``zero`` gives the precision."""
    return Start(np.full(room, zero), 0, zero, zero, zero, 0, zero, zero)


@compiled
def restart(start: Start, motion: SpinMotion) -> Start:
    """Return the record as before the first sample, with the angle as it is."""
    return Start(start.rates_radps, 0, 0.0, 0.0, 0.0, motion.turns, motion.rest_rad, motion.angle_var)


@compiled
def forget_rates(start: Start, also_gained: bool) -> Start:
    """Drop the rates so far, which were false, and the gain if that was false too; the time goes on."""
    rates, _, gained, gained_rad, elapsed_s, turns, rest, angle_var = start
    if also_gained:
        gained, gained_rad = 0.0, 0.0
    return Start(rates, 0, gained, gained_rad, elapsed_s, turns, rest, angle_var)


@compiled
def is_sound(motion: SpinMotion) -> bool:
    """Return whether the motion is possible: finite, positive variances, and no rate beyond any body."""
    rate, var = motion.rate_radps, motion.rate_var
    is_finite = abs(motion.rest_rad) < np.inf and motion.angle_var < np.inf and abs(motion.cross_var) < np.inf
    is_positive = var > 0.0 and motion.angle_var >= 0.0
    return is_finite and is_positive and abs(rate) < _MOST_RADPS and var < _MOST_VAR


@compiled
def rate_size(square_rad2ps2: float) -> float:
    """Return the size of a rate by its square; 0 where noise made the square negative."""
    return sqrt(max(square_rad2ps2, 0.0))


@compiled
def rate_variance(rate_radps: float, square_var: float) -> float:
    """Return the variance of the root of a square with this variance; R / (2 x)^2, bounded where the rate is near 0."""
    return square_var / max(4.0 * rate_radps * rate_radps, sqrt(square_var))


@compiled
def insert_sorted(sorted_values: NDArray[np.float64], held: int, value: float) -> None:
    """Insert a value among the first ``held``, which ascend."""
    place = held
    while place > 0 and sorted_values[place - 1] > value:
        sorted_values[place] = sorted_values[place - 1]
        place -= 1
    sorted_values[place] = value


@compiled
def median_sorted(sorted_values: NDArray[np.float64], held: int) -> float:
    """Return the median of the first ``held`` values, which ascend."""
    middle = held // 2
    if held % 2 == 1:
        return sorted_values[middle]
    return (sorted_values[middle - 1] + sorted_values[middle]) * 0.5


@compiled
def add_first_sample(
    start: Start, sample: SpinSample, accel_radps2: float, sense: int, square_var: float
) -> tuple[Start, SpinMotion]:
    """Add one sample; return angle (from the first sample on) and rate by all so far.

    ``accel_radps2`` is of the sample before; ``sense`` is +1 or -1, the sense of the spin.
    """
    rates, held, gained, gained_rad, elapsed_s, turns, rest, angle_var = start
    dt_s, sign = sample.dt_s, like(sample.dt_s, sense)
    gained_rad += dt_s * (gained + 0.5 * dt_s * accel_radps2)
    gained += dt_s * accel_radps2
    elapsed_s += dt_s
    if sample.has_square and sample.square_rad2ps2 != 0.0:
        insert_sorted(rates, held, rate_size(sample.square_rad2ps2) - sign * gained)
        held += 1
    start = Start(rates, held, gained, gained_rad, elapsed_s, turns, rest, angle_var)
    first = sign * median_sorted(rates, held) if held > 0 else 0.0
    rate = first + gained
    var = rate_variance(rate, square_var)
    if held > 1:
        var *= MEDIAN_VAR / like(var, held)
    turns, rest = wrap_angle(turns, rest + first * elapsed_s + gained_rad)
    return start, SpinMotion(turns, rest, rate, angle_var + var * elapsed_s * elapsed_s, var * elapsed_s, var)
