"""Detect rest: at rest the gyro reads its bias about all three axes, also about the vertical.

A window of samples is still when gyro and accelerometer hardly vary in it and the rate could be a bias. A slow even
turn passes that test too. So neither up nor the field may have turned in the body since the rest began: a turn of less
than ``_TURN_RAD`` in a rest of t seconds is a rate of less than ``_TURN_RAD`` / t, which :func:`rest_rate_sd` returns.
"""

from math import pi
from typing import NamedTuple

from stillpoint.datasets.compiled import compiled_inside
from stillpoint.filters.rotation import Vector, cross, dot

# Up and field are seen to turn from there on: noise of a mean over a window is far less.
_TURN_RAD = pi / 180
_TURN_RAD2 = _TURN_RAD**2


class Means(NamedTuple):
    """Means over a window of samples in body axes; the field is 0 where there was none."""

    length_s: float
    gyro_b_radps: Vector
    gyro_variance: float  # about its mean, of all three axes together
    accel_b_mps2: Vector
    accel_variance: float
    mag_b_ut: Vector


class Stillness(NamedTuple):
    """The memory of the current rest."""

    accel_b_mps2: Vector  # mean when it began
    mag_b_ut: Vector  # mean when it began, 0 for none
    lasted_s: float  # 0: the body moves


class Limits(NamedTuple):
    """Constants derived once from the parameters."""

    gyro_variance: float  # (rad/s)^2
    accel_variance: float  # (m/s^2)^2
    rate_radps: float  # no bias is larger
    least_s: float  # a rest counts after so long


@compiled_inside
def no_rest(zero: float) -> Stillness:
    """Return the record of a body that moves."""
    return Stillness((zero, zero, zero), (zero, zero, zero), zero)


@compiled_inside
def _has_turned(before: Vector, now: Vector) -> bool:
    """Return whether a direction differs by more than ``_TURN_RAD``; an unknown one does not."""
    across = cross(before, now)
    most = _TURN_RAD2 * dot(before, before) * dot(now, now)
    return dot(across, across) > most


@compiled_inside
def watch_rest(still: Stillness, means: Means, c: Limits) -> Stillness:
    """Update the rest by one more window."""
    quiet = means.gyro_variance < c.gyro_variance and means.accel_variance < c.accel_variance
    if not quiet or dot(means.gyro_b_radps, means.gyro_b_radps) > c.rate_radps * c.rate_radps:
        return no_rest(0.0)
    accel_b, mag_b, lasted_s = still
    turned = _has_turned(accel_b, means.accel_b_mps2) or _has_turned(mag_b, means.mag_b_ut)
    if lasted_s == 0 or turned:
        return Stillness(means.accel_b_mps2, means.mag_b_ut, means.length_s)
    if dot(mag_b, mag_b) == 0:
        mag_b = means.mag_b_ut
    return Stillness(accel_b, mag_b, lasted_s + means.length_s)


@compiled_inside
def is_resting(still: Stillness, c: Limits) -> bool:
    """Return whether the rest has lasted long enough to count."""
    return still.lasted_s > 0 and still.lasted_s >= c.least_s


@compiled_inside
def rest_rate_sd(still: Stillness) -> float:
    """Return the fastest rate, in rad/s, that up and field would not have shown."""
    return _TURN_RAD / still.lasted_s
