"""The updates of ``ekf``, ``aekf`` and ``iekf``: velocity, bias at rest, heading; see ``error_model``."""

from math import cos, nan, sin, sqrt

import numpy as np

from stillpoint.datasets.compiled import compiled_apart, compiled_inside
from stillpoint.filters.fields import LONGEST_HOLD_S, north_error
from stillpoint.filters.kalman.covariance import ANY_ANGLE_RAD2, Matrix, forget_state, times_row, update_joseph
from stillpoint.filters.kalman.known_field import KnownField, disturbance_variance_ut2, measure_looks
from stillpoint.filters.kalman.model import (
    BIAS,
    HEADING,
    SIZE,
    VELOCITY,
    Coefficients,
    FilterState,
    Measurement,
    Status,
    WindowEnd,
    predict,
)
from stillpoint.filters.kalman.predict import finish_window
from stillpoint.filters.kalman.stillness import is_resting, no_rest, rest_rate_sd, watch_rest
from stillpoint.filters.kalman.window import Turning, Window, is_measured, window_means
from stillpoint.filters.rotation import Vector, norm, scale

# How far from 0 the velocity of a resting body is.
_REST_MPS = 0.02
_REST_M2PS2 = _REST_MPS**2


@compiled_inside
def _measure_innovation(x: Matrix, p: Matrix, m: Measurement) -> tuple[float, float]:
    """Return what is seen less what is expected, and its variance by the model."""
    ph = times_row(p, m.row)
    residual, variance = m.seen, m.variance
    for i in range(SIZE):
        residual -= m.row[i] * x[i]
        variance += m.row[i] * ph[i]
    return residual, variance


@compiled_apart
def update(x: Matrix, p: Matrix, m: Measurement, moves_tilt: bool, alpha: float, gate: float) -> bool:
    """Update x and P by a measurement, its innovation's variance times alpha; True when it was beyond the gate.

    ``gate`` is the square of ``gate_sd``. Without ``moves_tilt`` the gain of the tilt is 0.
    """
    residual, model = _measure_innovation(x, p, m)
    variance, square = model * alpha, residual * residual
    is_beyond = square > gate * variance
    if is_beyond:
        variance = square / gate
    gain = times_row(p, m.row)
    for i in range(SIZE):
        gain[i] = gain[i] / variance if moves_tilt or i >= HEADING else 0.0
        x[i] += gain[i] * residual
    update_joseph(p, m.row, gain, variance - (model - m.variance))
    return is_beyond


@compiled_inside
def _measure_state(p: Matrix, i: int, seen: float, variance: float) -> Measurement:
    """Return a measurement of x[i] itself."""
    row = np.zeros_like(p[0])
    row[i] = 1.0
    return Measurement(True, row, seen, variance)


@compiled_apart
def predict_window(body: FilterState, c: Coefficients) -> WindowEnd:
    """Predict to the end of the window, and return what there is to update with."""
    turning = body.window.turning
    length_s, still = turning.length_s, no_rest(0.0)
    if is_measured(turning):
        still = watch_rest(body.still, window_means(body.window), c.limits)
    heading = measure_heading(body.x, body.window, body.status.since_field_s, body.field, c)
    predict(body.x, body.p, body.window, body.q_nb, c)
    if not body.status.is_headed:  # nothing measured it: no correlation may let the other sensors move it
        forget_state(body.p, HEADING, ANY_ANGLE_RAD2)
    resting, variance = is_resting(still, c.limits), c.velocity_variance / length_s
    return WindowEnd(still, resting, min(variance, _REST_M2PS2) if resting else variance, heading)


@compiled_inside
def whiten_velocity(x: Matrix, p: Matrix, variance: float) -> tuple[float, float]:
    """Return the innovations east and north, whitened: of variance 1 and independent if the model is right."""
    s_east, s_north = p[VELOCITY, VELOCITY] + variance, p[VELOCITY + 1, VELOCITY + 1] + variance
    shared = p[VELOCITY, VELOCITY + 1] / s_east
    s_left = s_north - shared * shared * s_east
    return -x[VELOCITY] / sqrt(s_east), (shared * x[VELOCITY] - x[VELOCITY + 1]) / sqrt(s_left)


@compiled_apart
def update_velocity(x: Matrix, p: Matrix, variance: float, alphas: tuple[float, float], gate: float) -> bool:
    """Update tilt, bias and velocity by the measurement that the velocity is 0; True beyond the gate.

    ``alphas`` multiply the innovations' variances east and north.
    """
    east = update(x, p, _measure_state(p, VELOCITY, 0.0, variance), True, alphas[0], gate)
    north = update(x, p, _measure_state(p, VELOCITY + 1, 0.0, variance), True, alphas[1], gate)
    return east or north


@compiled_apart
def update_bias(x: Matrix, p: Matrix, turning: Turning, at: WindowEnd, c: Coefficients) -> None:
    """Update the bias by the mean rate, at rest."""
    if not at.is_resting:
        return
    slow = rest_rate_sd(at.still)
    variance = c.gyro_noise / turning.length_s + c.rest_variance + slow * slow
    for i in range(3):
        mean = turning.measured_b_rad[i] / turning.length_s
        update(x, p, _measure_state(p, BIAS + i, mean, variance), True, 1.0, c.gate)


@compiled_apart
def measure_heading(x: Matrix, window: Window, since_field_s: float, field: KnownField, c: Coefficients) -> Measurement:
    """Return the measurement that the window's mean field points to magnetic north; ``x`` is as during the window.

    It has about half of a turn that the gyro did not tell, which is about up at most.
    """
    turning, fields = window.turning, window.fields
    length_s = turning.length_s
    field_n = scale(fields.sum_n_ut, 1.0 / max(fields.how_many, 1.0))
    turn, found = north_error(field_n, c.declination_rad)
    row = np.zeros_like(x)
    if not found:
        return Measurement(False, row, turn, 1.0)
    square = field_n[0] * field_n[0] + field_n[1] * field_n[1]
    tan_dip = -field_n[2] / sqrt(square)
    row[0], row[1], row[HEADING] = tan_dip * sin(c.declination_rad), tan_dip * cos(c.declination_rad), 1.0
    for j in range(3):  # the window's mean error is that at its end, and half of what the bias has done
        row[BIAS + j] = 0.5 * turning.spread_s[j][2]
        turn += row[BIAS + j] * x[BIAS + j]
    hold_s = min(since_field_s + length_s, max(length_s, LONGEST_HOLD_S))
    disturbed = c.unseen * disturbance_variance_ut2(field, measure_looks(field_n, length_s))
    if field.known.seen_s > 0:  # the part of the Earth's field, not of a disturbance, says how well it points
        flat = field.known.size_ut * cos(field.known.dip_rad)
        square = max(flat * flat, square * 0.01)
    missed = 0.5 * norm(turning.hidden_b_rad)
    return Measurement(True, row, turn, (c.field_variance / hold_s + disturbed) / square + missed * missed)


@compiled_inside
def no_innovations(c: Coefficients) -> Vector:
    """Return the innovations of a sample that ends no window."""
    none = nan
    return none, none, none


@compiled_inside
def whiten_heading(x: Matrix, p: Matrix, m: Measurement) -> float:
    """Return the heading's innovation, whitened given the updates before it; NaN without a field."""
    if not m.is_there:
        return nan
    residual, variance = _measure_innovation(x, p, m)
    return residual / sqrt(variance)


@compiled_apart
def update_heading(x: Matrix, p: Matrix, m: Measurement, alpha: float, status: Status, c: Coefficients) -> bool:
    """Update heading and bias by the field; True beyond the gate."""
    if not m.is_there:
        return False
    if status.heading_doubt_s >= c.heading_patience_s:
        forget_state(p, HEADING, ANY_ANGLE_RAD2)
    return update(x, p, m, False, alpha, c.gate)


@compiled_apart
def update_window(body: FilterState, c: Coefficients) -> tuple[FilterState, Vector]:
    """Update at the end of a window; return the state at the beginning of the next, and the innovations."""
    x, p = body.x, body.p
    at = predict_window(body, c)
    east, north = whiten_velocity(x, p, at.velocity_variance)
    velocity_beyond = update_velocity(x, p, at.velocity_variance, (1.0, 1.0), c.gate)
    update_bias(x, p, body.window.turning, at, c)
    innovations = (east, north, whiten_heading(x, p, at.heading))
    heading_beyond = update_heading(x, p, at.heading, 1.0, body.status, c)
    return finish_window(body, at, innovations[2], (velocity_beyond, heading_beyond), c), innovations
