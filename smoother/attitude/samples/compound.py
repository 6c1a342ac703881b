"""Sum up the samples of an interval to a few measurements that gtsam preintegrates to the same motion.

gtsam takes one measurement (a, w, T) per call. From the turn r and the velocity v so far, in axes of the interval's
start, it computes (Lupton and Sukkarieh (2012) in the tangent space of Forster et al. (2017))

    r + T J(r)^-1 w,   v + T exp(r) a,   p + T v + T^2/2 exp(r) a.

The samples are integrated here at their full rate, with R_k = R_{k-1} exp(w_k dt_k), and split into PARTS of equal
length. Of each part w = J(r) (r' - r) / T and a = exp(r)^T (v' - v) / T lead gtsam to the same r and v. To end at the
same place p, the first part takes a push and the last one gives it back. What a bias changes is then right up to the
square of the turn within one part.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.compiled import compiled
from stillpoint.datasets.quaternion import Quaternion, Vector, exp, log, multiply
from stillpoint.datasets.recording import Floats
from stillpoint.smoother.attitude.keys import Motion

PARTS = 8  # of an interval, at most: none is shorter than a sample
_SERIES_BELOW = 1e-4  # square of an angle, rad^2, below which two terms of a series are exact to 1e-11


@dataclass(frozen=True, eq=False)
class Measurements:
    """Hold the measurements that replace the samples of m intervals."""

    accel_b_mps2: Floats  # (m, PARTS, 3)
    gyro_b_radps: Floats  # (m, PARTS, 3)
    length_s: Floats  # (m, PARTS) 0 for the parts that an interval of few samples does not have


def compound_samples(
    motion: Motion, rows: NDArray[np.int64], intervals: NDArray[np.int64], bias_b_radps: Floats
) -> Measurements:
    """Return the measurements of m intervals; interval i reaches from the sample ``rows[i]`` to ``rows[i + 1]``.

    ``bias_b_radps`` (3,) is the gyro's bias about which gtsam preintegrates.
    """
    accel, gyro, dt_s = (_forbid_writing(each) for each in (motion.accel_b_mps2, motion.gyro_b_radps, motion.dt_s))
    # A copy: gtsam's arrays are of another kind, for which the code would be compiled once more.
    return Measurements(*_compound(rows, intervals, accel, gyro, dt_s, np.array(bias_b_radps, dtype=np.float64)))


def _forbid_writing(column: Floats) -> Floats:
    """Return a view that cannot be written.

    Columns of a recording are so, and columns that were made from them are not: the code would be compiled for each
    combination of both.
    """
    view = column.view()
    view.flags.writeable = False
    return view


@compiled
def _compound(
    rows: NDArray[np.int64], intervals: NDArray[np.int64], accel: Floats, gyro: Floats, dt_s: Floats, bias: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return the three arrays of :class:`Measurements`."""
    n = len(intervals)
    force, rate, length = np.zeros((n, PARTS, 3)), np.zeros((n, PARTS, 3)), np.zeros((n, PARTS))
    speed, place, way, speed_before = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    push, turns, middle = np.empty((PARTS, 3)), np.empty((PARTS, 3)), np.empty(PARTS)
    for i in range(n):
        first, count = rows[intervals[i]] + 1, rows[intervals[i] + 1] - rows[intervals[i]]
        parts = min(PARTS, count)
        speed[:], place[:], way[:] = 0.0, 0.0, 0.0  # way: the place that gtsam gets to without the push
        q, turn, elapsed_s = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0
        for part in range(parts):
            for axis in range(3):
                speed_before[axis] = speed[axis]
            for k in range(first + part * count // parts, first + (part + 1) * count // parts):
                pushed = _rotate(q, (accel[k, 0], accel[k, 1], accel[k, 2]))
                for axis in range(3):
                    place[axis] += (speed[axis] + 0.5 * pushed[axis] * dt_s[k]) * dt_s[k]
                    speed[axis] += pushed[axis] * dt_s[k]
                x, y, z = gyro[k, 0] - bias[0], gyro[k, 1] - bias[1], gyro[k, 2] - bias[2]
                q = multiply(q, exp((x * dt_s[k], y * dt_s[k], z * dt_s[k])))
                length[i, part] += dt_s[k]
            span_s = length[i, part]
            turn_before, turn = turn, _near(log(q), turn)
            step = (turn[0] - turn_before[0], turn[1] - turn_before[1], turn[2] - turn_before[2])
            turned = _apply_right_jacobian(turn_before, step)
            for axis in range(3):
                rate[i, part, axis] = turned[axis] / span_s + bias[axis]
                push[part, axis] = speed[axis] - speed_before[axis]
                way[axis] += (speed_before[axis] + 0.5 * push[part, axis]) * span_s
                turns[part, axis] = turn_before[axis]
            middle[part] = elapsed_s + 0.5 * span_s
            elapsed_s += span_s
        if parts > 1:
            for axis in range(3):
                shift = (place[axis] - way[axis]) / (middle[parts - 1] - middle[0])
                push[0, axis] += shift
                push[parts - 1, axis] -= shift
        for part in range(parts):
            back = exp((-turns[part, 0], -turns[part, 1], -turns[part, 2]))
            pushed = _rotate(back, (push[part, 0], push[part, 1], push[part, 2]))
            for axis in range(3):
                force[i, part, axis] = pushed[axis] / length[i, part]
    return force, rate, length


@compiled
def _rotate(q: Quaternion, v: Vector) -> Vector:
    """Return the vector ``v`` rotated by ``q``."""
    x, y, z = 2 * (q[2] * v[2] - q[3] * v[1]), 2 * (q[3] * v[0] - q[1] * v[2]), 2 * (q[1] * v[1] - q[2] * v[0])
    return (
        v[0] + q[0] * x + q[2] * z - q[3] * y,
        v[1] + q[0] * y + q[3] * x - q[1] * z,
        v[2] + q[0] * z + q[1] * y - q[2] * x,
    )


@compiled
def _near(turn: Vector, before: Vector) -> Vector:
    """Return the rotation vector ``turn``, or the one of the same rotation that is nearer to ``before``."""
    angle = np.sqrt(turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2)
    if angle < 1.0:
        return turn
    share = (angle - 2 * np.pi) / angle
    other = (share * turn[0], share * turn[1], share * turn[2])
    as_it_is = other_way = 0.0
    for axis in range(3):
        as_it_is += (turn[axis] - before[axis]) ** 2
        other_way += (other[axis] - before[axis]) ** 2
    return turn if as_it_is <= other_way else other


@compiled
def _apply_right_jacobian(turn: Vector, v: Vector) -> Vector:
    """Return J v with J = 1 - (1 - cos a)/a^2 [r]x + (a - sin a)/a^3 [r]x^2 for a rotation vector r of length a."""
    square = turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2
    if square < _SERIES_BELOW:
        once, twice = 0.5 - square / 24, 1 / 6 - square / 120
    else:
        angle = np.sqrt(square)
        once, twice = (1 - np.cos(angle)) / square, (angle - np.sin(angle)) / (square * angle)
    crossed = _cross(turn, v)
    again = _cross(turn, crossed)
    return (
        v[0] - once * crossed[0] + twice * again[0],
        v[1] - once * crossed[1] + twice * again[1],
        v[2] - once * crossed[2] + twice * again[2],
    )


@compiled
def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
