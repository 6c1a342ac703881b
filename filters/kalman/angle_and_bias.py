"""Angle and bias of one gyro: the covariance of the Kalman filter of paper 004, eqs (8)-(12).

::

    (angle, bias)' = A (angle, bias) + (dt rate, 0)    A = [[1, -dt], [0, 1]]    H = [1 0]
"""

from math import sqrt
from typing import NamedTuple

from stillpoint.filters.compiled import compiled_inside
from stillpoint.filters.kalman.covariance import ANY_ANGLE_RAD2


class Axis(NamedTuple):
    """P of (angle, bias)."""

    p_angle: float  # rad^2
    p_cross: float  # rad^2/s
    p_bias: float  # (rad/s)^2


@compiled_inside
def predict(axis: Axis, dt_s: float, angle_rad2ps: float, walk_rad2ps3: float) -> Axis:
    """P of (11) after an interval: A P A' + Q dt, with the variances per second of angle and bias in Q."""
    p_angle, p_cross, p_bias = axis
    grown = p_angle + dt_s * (dt_s * p_bias - p_cross - p_cross) + angle_rad2ps * dt_s
    return Axis(grown, p_cross - dt_s * p_bias, p_bias + walk_rad2ps3 * dt_s)


@compiled_inside
def correct(axis: Axis, innovation: float, r: float) -> tuple[Axis, float, float, float]:
    """One measurement of variance ``r``: P, by how much to turn and to change the bias, the normalised innovation.

    P - K S K' in the form that cannot turn negative by rounding: every term is a product or a sum of positive ones.
    """
    p_angle, p_cross, p_bias = axis
    per_s = 1.0 / (p_angle + r)  # one division: they are slow
    left, to_angle, to_bias = r * per_s, p_angle * per_s, p_cross * per_s
    determinant = max(p_angle * p_bias - p_cross * p_cross, 0.0)
    new = Axis(p_angle * left, p_cross * left, p_bias * left + determinant * per_s)
    return new, to_angle * innovation, to_bias * innovation, innovation * sqrt(per_s)


@compiled_inside
def widened(axis: Axis, turn: float) -> Axis:
    """P after a turn that the gyro did not tell (sd), which goes on as it began: standard deviations add."""
    root = sqrt(axis.p_angle) + turn
    return Axis(max(axis.p_angle, min(root * root, ANY_ANGLE_RAD2)), axis.p_cross, axis.p_bias)


@compiled_inside
def renewed(p_angle: float, p_bias: float) -> Axis:
    """A P whose angle and bias have nothing to do with each other."""
    return Axis(p_angle, 0.0, p_bias)
