"""Sums over a window of samples, in the axes of n by the current estimate (the error state covers its drift).

Covariances change slowly and cost the most, so they are updated once per window and not once per sample. Little is
lost: the integrals are exact up to products of two small errors. Specific force and field are summed in n, so a body
that turns within a window does not blur them (as in VQF, Laidig and Seel 2023).
"""

from typing import NamedTuple

from stillpoint.datasets.compiled import compiled, compiled_inside
from stillpoint.filters.kalman.covariance import Axes, body_axes_in_n
from stillpoint.filters.kalman.stillness import Means
from stillpoint.filters.rotation import Quaternion, Vector, add, dot, norm, normalise, scale
from stillpoint.filters.sample import Sample


class Turning(NamedTuple):
    """Integrals over the time of a window."""

    length_s: float
    spread_s: Axes  # of the body's axes in n, columns of R: by these a bias of the gyro turns the attitude
    turned_rad: float  # of the size of the rate, less its bias
    measured_b_rad: Vector  # of the measured rate
    measured_square: float  # of its square, rad^2/s
    hidden_b_rad: Vector  # of what the rate may be off, clipped or missing: one error lasts, so its sd adds up


class Forces(NamedTuple):
    """Integrals over the samples with a usable accelerometer."""

    push_n_mps: Vector  # of the specific force
    push_b_mps: Vector
    square: float  # of its square, m^2/s^3
    time_s: float


class FieldSum(NamedTuple):
    """Sums over the samples with a usable field."""

    sum_n_ut: Vector
    sum_b_ut: Vector
    how_many: float  # a whole number, in the precision of the run


class Window(NamedTuple):
    """The three sums of one window."""

    turning: Turning
    forces: Forces
    fields: FieldSum


@compiled
def empty_window(zero: float) -> Window:
    """Return a window without samples."""
    none = (zero, zero, zero)
    turning = Turning(zero, (none, none, none), zero, none, zero, none)
    return Window(turning, Forces(none, none, zero, zero), FieldSum(none, none, zero))


@compiled
def add_turn(sums: Turning, sample: Sample, rate_b: Vector, q_from: Quaternion, q_to: Quaternion) -> Turning:
    """Add one interval with this rate, which is the measured one less its bias.

    The mean of R over the interval is that of its middle but for 1/24 of the square of the turn.
    """
    measured_b, dt_s = sample.gyro_b_radps, sample.dt_s
    middle = (q_from[0] + q_to[0], q_from[1] + q_to[1], q_from[2] + q_to[2], q_from[3] + q_to[3])
    first, second, third = body_axes_in_n(normalise(middle))
    spread = sums.spread_s
    return Turning(
        sums.length_s + dt_s,
        (
            add(spread[0], scale(first, dt_s)),
            add(spread[1], scale(second, dt_s)),
            add(spread[2], scale(third, dt_s)),
        ),
        sums.turned_rad + norm(rate_b) * dt_s,
        add(sums.measured_b_rad, scale(measured_b, dt_s)),
        sums.measured_square + dot(measured_b, measured_b) * dt_s,
        add(sums.hidden_b_rad, scale(sample.hidden_b_radps, dt_s)),
    )


@compiled_inside
def is_measured(turning: Turning) -> bool:
    """Return whether the gyro measured the whole turn of the window."""
    return dot(turning.hidden_b_rad, turning.hidden_b_rad) == 0


@compiled
def add_force(sums: Forces, force_n: Vector, force_b: Vector, dt_s: float) -> Forces:
    """Add one interval with this specific force."""
    return Forces(
        add(sums.push_n_mps, scale(force_n, dt_s)),
        add(sums.push_b_mps, scale(force_b, dt_s)),
        sums.square + dot(force_b, force_b) * dt_s,
        sums.time_s + dt_s,
    )


@compiled
def add_field(sums: FieldSum, field_n: Vector, field_b: Vector) -> FieldSum:
    """Add one field."""
    return FieldSum(add(sums.sum_n_ut, field_n), add(sums.sum_b_ut, field_b), sums.how_many + 1.0)


@compiled_inside
def window_means(window: Window) -> Means:
    """Return the means in body axes of a window that has a length; the accelerometer's are 0 where it gave nothing."""
    turning, forces, fields = window
    per_s = 1.0 / turning.length_s
    gyro = scale(turning.measured_b_rad, per_s)
    accel, variance = (0.0, 0.0, 0.0), 0.0
    if forces.time_s > 0:
        accel = scale(forces.push_b_mps, 1.0 / forces.time_s)
        variance = forces.square / forces.time_s - dot(accel, accel)
    return Means(
        turning.length_s,
        gyro,
        turning.measured_square * per_s - dot(gyro, gyro),
        accel,
        variance,
        scale(fields.sum_b_ut, 1.0 / max(fields.how_many, 1.0)),
    )
