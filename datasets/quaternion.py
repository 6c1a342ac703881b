"""Compiled quaternion products, exponentials and logarithms for hot loops, on plain floats in tuples.

Quaternions are Hamilton, ``(w, x, y, z)``, of length 1; vectors are ``(x, y, z)``. Everything works in the precision of
its arguments. Whole columns belong to scipy's ``Rotation`` (:mod:`stillpoint.datasets.frames`): here one product takes
nanoseconds, there it takes microseconds. Not imported by what only reads and writes files: it needs numba.
"""

from math import atan2, cos, sin, sqrt
from typing import TypeAlias

from stillpoint.datasets.compiled import compiled

Quaternion: TypeAlias = tuple[float, float, float, float]
Vector: TypeAlias = tuple[float, float, float]

# Below this square of an angle (rad^2) two terms of the series of the logarithm are exact to 1e-14,
LOG_SERIES_BELOW = 1e-6
# and below this one (9.9 deg) five terms of cosine and sine to 1e-17: an interval of a gyro seldom has more.
HALF_SERIES_BELOW = 0.03


@compiled
def multiply(p: Quaternion, q: Quaternion) -> Quaternion:
    """Return the rotation ``q`` followed by ``p``."""
    return (
        p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
        p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
        p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
        p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
    )


@compiled
def conjugate(q: Quaternion) -> Quaternion:
    """Return the inverse rotation."""
    return q[0], -q[1], -q[2], -q[3]


@compiled
def half_angle(square: float) -> tuple[float, float]:
    """Return cos(a / 2) and sin(a / 2) / a of the angle a with this square.

    The series of small angles are summed in pairs, which wait for each other less than term after term would.
    """
    if square < HALF_SERIES_BELOW:
        fourth = square * square
        cosine = (1 / 384) - square * (1 / 46080) + fourth * (1 / 10321920)
        share = (1 / 3840) - square * (1 / 645120) + fourth * (1 / 185794560)
        return (
            1.0 - square * (1 / 8) + fourth * cosine,
            0.5 - square * (1 / 48) + fourth * share,
        )
    angle = sqrt(square)
    half = angle * 0.5
    return cos(half), sin(half) / angle


@compiled
def exp(v: Vector) -> Quaternion:
    """Return the rotation by ``|v|`` rad about ``v``."""
    w, share = half_angle(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    return w, v[0] * share, v[1] * share, v[2] * share


@compiled
def log(q: Quaternion) -> Vector:
    """Return the rotation vector of ``q``, at most pi long: the inverse of :func:`exp` up to whole turns."""
    sign = 1.0 if q[0] >= 0 else -1.0
    w = q[0] * sign
    square = q[1] * q[1] + q[2] * q[2] + q[3] * q[3]
    if square < LOG_SERIES_BELOW:
        share = (2.0 - square * (2 / 3) / (w * w)) / w
    else:
        sine = sqrt(square)
        share = 2.0 * atan2(sine, w) / sine
    share *= sign
    return q[1] * share, q[2] * share, q[3] * share
