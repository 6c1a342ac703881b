"""The parts that ``ekf``, ``aekf`` and ``iekf`` share: the model, its parameters, and the prediction.

Estimated are the attitude, the gyro's bias b (body axes) and the horizontal velocity v (n); the errors are

    e (3, rad, n): q_true = exp(e) q     d (3): b_true = b + d     u (2, m/s): v_true = v + u

    e' = -R (d + white noise)     d' = white noise     u' = (e x f)_horizontal + white noise

with R and the specific force f in n. In n the attitude's error does not turn with the body, so that over a window, in
which R integrates to S and f to F, the transition is exact up to products of two small terms: e loses S d, u gains the
horizontal part of (e - S d / 2) x F, with the vertical part of F. Errors in body axes are R' e
(:mod:`stillpoint.filters.kalman.covariance`).

**Velocity.** An accelerometer shows gravity plus acceleration, and what moves to and fro has a mean velocity of 0.
So the accelerometer drives v, and the measurement is "v = 0", with ``velocity_mps_rts`` as the density of its error. A
shake of any strength that comes back leaves no trace; taking specific force for gravity within an assumed noise, which
is the special case of ``velocity_mps_rts`` near 0, mistakes it for tilt. v is in the heading of the estimate, so an
error of the heading does not enter it.

**Field.** Its heading alone is used, and moves the heading and the bias, never the tilt. The error of the tilt is in
its row, tan(dip) times the tilt about the field's horizontal direction. Its variance grows with the disturbance
that size and dip of the field show (:mod:`stillpoint.filters.kalman.known_field`).

**Rest.** The mean rate is the bias (:mod:`stillpoint.filters.kalman.stillness`), and v is 0 to ``REST_MPS``.

**Rates that were clipped or missing** hide a turn. P grows by it, about the body's axes concerned and as one error that
lasts, and nothing is a rest meanwhile. So what the fields then show goes to the attitude, not to the bias. An update
that turns the attitude far is linear where the turn is not: P grows by the second order of it, and the next windows
find the rest.

Innovations beyond ``gate_sd`` are taken as if their variance were so much larger that they are at ``gate_sd``. When
they stay there, the estimate is wrong and not they: after ``tilt_patience_s`` the tilt starts again from the mean of
the accelerometer, after ``heading_patience_s`` the heading is taken as unknown. So is it when innovations are small but
on the same side for as long, while the field looks known: their mean over ``heading_patience_s`` is beyond ``_OFF_SD``
of what the mean of independent ones has, and beyond ``_OFF_RAD``. A filter that is too sure of itself would follow them
for an hour. And so is it when the known field, which the Earth has nowhere, gives way to another
(:mod:`stillpoint.filters.kalman.known_field`).
"""

from dataclasses import dataclass
from math import pi
from typing import NamedTuple

import numpy as np

from stillpoint.datasets.compiled import compiled, compiled_apart
from stillpoint.datasets.settings import Settings, degrees, number
from stillpoint.filters.kalman.covariance import (
    ANY_ANGLE_RAD2,
    Matrix,
    add_sd,
    apply_congruence,
    body_axes_in_n,
    identity_like,
    round_up,
    scale_variance,
)
from stillpoint.filters.kalman.known_field import KnownField, Tolerance
from stillpoint.filters.kalman.stillness import Limits, Stillness
from stillpoint.filters.kalman.window import Turning, Window, is_measured
from stillpoint.filters.rotation import Quaternion, Vector

# Where the errors stand in P: attitude 0-2 (2 is the heading), bias 3-5, velocity 6-7.
HEADING, BIAS, VELOCITY, SIZE = 2, 3, 6, 8
# How far the specific force may be from gravity where the accelerometer gave nothing.
_LOST_MPS2 = 5.0
# The mean of the heading's innovations, in its own sd, from which on the heading is wrong and not they.
_OFF_SD = 6.0
OFF_SQUARE = _OFF_SD**2 / 2
# And as an angle: less than that is what iron in a room does, and no reason to begin again.
_OFF_RAD = pi / 18
OFF_RAD2 = _OFF_RAD**2


@dataclass(frozen=True)
class ErrorStateParams(Settings):
    """Parameters of ``ekf`` and ``iekf``; ``aekf`` has some more."""

    window_s: float = number(0.25, 0.0, 10.0, "time between two updates, s; 0 = one at every sample")
    gyro_noise_rad_rts: float = degrees(0.03, 1e-6, 100.0, "white noise of the gyro")
    turn_error: float = number(0.01, 0.0, 1.0, "error after a turn of 1 rad, by scale and axes of the gyro (sd, rad)")
    bias_sd_radps: float = degrees(
        2.0, 1e-6, 100.0, "sd of the gyro's bias at the start; the bias is limited to three sd"
    )
    bias_walk_radps: float = degrees(0.002, 0.0, 10.0, "change of the gyro's bias in 1 s (sd)")
    accel_noise_mps_rts: float = number(0.02, 1e-6, 10.0, "white noise of the accelerometer, m/s/sqrt(s)")
    velocity_mps_rts: float = number(
        0.5, 1e-3, 1e3, "mean horizontal velocity over 1 s (sd, m/s; over T s by sqrt(T) less); 0.001 = no acceleration"
    )
    tilt_sd_rad: float = degrees(10.0, 0.01, 60.0, "sd of the first tilt, by one accelerometer sample, per axis")
    heading_sd_rad: float = degrees(30.0, 0.01, 100.0, "sd of the first heading, by one sample of the field")
    field_noise_ut_rts: float = number(10.0, 1e-3, 1e4, "error of the field's mean over 1 s, iron included (sd, uT)")
    field_tolerance: float = number(0.1, 1e-3, 1.0, "largest relative difference in size from the known field")
    dip_tolerance_rad: float = degrees(10.0, 0.1, 90.0, "largest difference in dip from the known field")
    field_memory_s: float = number(20.0, 0.1, 1e5, "memory of the known field's size and dip, s")
    field_admission_s: float = number(20.0, 0.1, 1e5, "time in motion after which another field is known, s")
    unseen_disturbance: float = number(
        1.0, 0.0, 10.0, "a disturbance's part that turns the heading, against what its size and dip show; 0 = none"
    )
    rest_gyro_radps: float = degrees(2.0, 1e-3, 100.0, "largest sd of the gyro within a window at rest, all axes")
    rest_accel_mps2: float = number(0.5, 1e-3, 100.0, "largest sd of the accelerometer within a window at rest, m/s^2")
    rest_s: float = number(1.5, 0.0, 600.0, "time after which a rest is used, s")
    rest_bias_radps: float = degrees(0.05, 1e-6, 10.0, "error of the mean rate at rest (sd)")
    gate_sd: float = number(3.0, 1.0, 1e3, "innovations beyond this many sd count less")
    tilt_patience_s: float = number(10.0, 0.1, 1e5, "time beyond the gate after which the tilt starts again, s")
    heading_patience_s: float = number(60.0, 0.1, 1e5, "time beyond the gate after which the heading is unknown, s")


class Coefficients(NamedTuple):
    """Constants derived once from the parameters."""

    window_s: float
    gyro_noise: float  # rad^2/s
    turn_error: float  # rad^2 per rad
    bias_variance: float  # (rad/s)^2
    bias_walk: float  # (rad/s)^2/s
    accel_noise: float  # (m/s)^2/s
    velocity_variance: float  # (m/s)^2 s; at first as over 1 s
    tilt_variance: float  # rad^2
    heading_variance: float  # rad^2
    field_variance: float  # uT^2 s
    unseen: float  # a square
    tolerance: Tolerance
    limits: Limits
    rest_variance: float  # (rad/s)^2
    gate: float  # a square
    tilt_patience_s: float
    heading_patience_s: float
    declination_rad: float  # east of true north


class Status(NamedTuple):
    """How far the filter has got, and how long it has been in doubt."""

    is_level: bool  # False until the first tilt, and after a gap
    is_headed: bool  # False until the first heading, and after a gap
    is_ready: bool
    since_field_s: float  # since the last window with a usable field
    tilt_doubt_s: float  # for how long innovations have been beyond the gate
    heading_doubt_s: float
    heading_off: float  # mean of the heading's innovations while the field looks known, whitened, over the patience


class Counts(NamedTuple):
    """Counts of what was left out or handled specially."""

    n_free_fall: int  # accelerometer samples: too short to point up
    n_no_field: int  # magnetometer samples: zero
    n_no_north: int  # windows whose field has no horizontal part
    n_gaps: int
    n_beyond_gate: int  # innovations of velocity and heading
    n_tilt_restarts: int
    n_heading_restarts: int


class FilterState(NamedTuple):
    """The state of the filter between two samples."""

    q_nb: Quaternion
    x: Matrix  # (8,) the attitude's error (0 between updates), the gyro's bias, the velocity
    p: Matrix  # (8, 8) covariance at the end of the window before
    window: Window
    still: Stillness
    field: KnownField
    status: Status
    counts: Counts


class Measurement(NamedTuple):
    """A scalar measurement: seen = row times x + noise of this variance."""

    is_there: bool
    row: Matrix  # (8,)
    seen: float
    variance: float


class WindowEnd(NamedTuple):
    """The start of the updates at the end of a window; x and P are predicted to there."""

    still: Stillness
    is_resting: bool
    velocity_variance: float  # of the measurement that the velocity is 0
    heading: Measurement


def coefficients(params: ErrorStateParams, declination_rad: float) -> Coefficients:
    """Precompute the filter's constants from its parameters and the local declination (east of true north)."""
    p = params
    return Coefficients(
        window_s=p.window_s,
        gyro_noise=p.gyro_noise_rad_rts**2,
        turn_error=p.turn_error**2,
        bias_variance=p.bias_sd_radps**2,
        bias_walk=p.bias_walk_radps**2,
        accel_noise=p.accel_noise_mps_rts**2,
        velocity_variance=p.velocity_mps_rts**2,
        tilt_variance=p.tilt_sd_rad**2,
        heading_variance=p.heading_sd_rad**2,
        field_variance=p.field_noise_ut_rts**2,
        unseen=p.unseen_disturbance**2,
        tolerance=Tolerance(p.field_tolerance, p.dip_tolerance_rad, p.field_memory_s, p.field_admission_s),
        limits=Limits(p.rest_gyro_radps**2, p.rest_accel_mps2**2, 3 * p.bias_sd_radps, p.rest_s),
        rest_variance=p.rest_bias_radps**2,
        gate=p.gate_sd**2,
        tilt_patience_s=p.tilt_patience_s,
        heading_patience_s=p.heading_patience_s,
        declination_rad=declination_rad,
    )


@compiled_apart
def transition_matrix(window: Window, p: Matrix) -> Matrix:
    """Return the transition matrix of the errors over a window; see the module's first lines."""
    a = identity_like(p)
    spread_s, up_mps = window.turning.spread_s, window.forces.push_n_mps[2]
    a[VELOCITY, 1], a[VELOCITY + 1, 0] = up_mps, -up_mps
    for j in range(3):
        axis = spread_s[j]
        a[0, BIAS + j], a[1, BIAS + j], a[2, BIAS + j] = -axis[0], -axis[1], -axis[2]
        a[VELOCITY, BIAS + j], a[VELOCITY + 1, BIAS + j] = -0.5 * up_mps * axis[1], 0.5 * up_mps * axis[0]
    return a


@compiled
def attitude_noise_variance(turning: Turning, c: Coefficients) -> float:
    """Return the variance per axis that noise has added to the attitude since P."""
    length_s = turning.length_s
    walked = c.bias_walk * length_s * length_s * length_s * (1 / 3)
    return c.gyro_noise * length_s + c.turn_error * turning.turned_rad + walked


@compiled_apart
def _add_noise(p: Matrix, window: Window, c: Coefficients) -> None:
    """Add the window's process noise to P: the model's densities integrated with its transition."""
    length_s, spread_s, up_mps = window.turning.length_s, window.turning.spread_s, window.forces.push_n_mps[2]
    turn, walk = attitude_noise_variance(window.turning, c), c.bias_walk * length_s
    lost_mps = _LOST_MPS2 * (length_s - window.forces.time_s)
    push = c.accel_noise * length_s + lost_mps * lost_mps + turn * up_mps * up_mps * (1 / 3)
    tilted = 0.5 * turn * up_mps
    for i in range(3):
        p[i, i] += turn
        p[BIAS + i, BIAS + i] += walk
        for j in range(3):
            p[i, BIAS + j] -= 0.5 * walk * spread_s[j][i]
            p[BIAS + j, i] = p[i, BIAS + j]
    for i in range(2):
        p[VELOCITY + i, VELOCITY + i] += push
        p[VELOCITY + i, 1 - i] += tilted if i == 0 else -tilted
        p[1 - i, VELOCITY + i] = p[VELOCITY + i, 1 - i]


@compiled_apart
def _add_hidden_turn(p: Matrix, axis_n: Vector, hidden_rad: float, up_mps: float) -> None:
    """Add to P a turn about this axis that the gyro did not measure; it enters the velocity half as long."""
    total = 0.0
    for i in range(3):
        total += axis_n[i] * (p[i, 0] * axis_n[0] + p[i, 1] * axis_n[1] + p[i, 2] * axis_n[2])
    added, lever = add_sd(total, hidden_rad) - total, 0.5 * up_mps
    entry = np.zeros_like(p[0])
    entry[0], entry[1], entry[2] = axis_n
    entry[VELOCITY], entry[VELOCITY + 1] = lever * axis_n[1], -lever * axis_n[0]
    for i in range(SIZE):
        for j in range(SIZE):
            p[i, j] += added * (entry[i] * entry[j])


@compiled_apart
def predict(x: Matrix, p: Matrix, window: Window, q_nb: Quaternion, c: Coefficients) -> None:
    """Predict velocity and covariance to the end of the window, where the attitude is ``q_nb``."""
    push = window.forces.push_n_mps
    x[VELOCITY] += push[0]
    x[VELOCITY + 1] += push[1]
    apply_congruence(transition_matrix(window, p), p)
    _add_noise(p, window, c)
    if not is_measured(window.turning):
        (x_n, y_n, z_n), (x_rad, y_rad, z_rad) = body_axes_in_n(q_nb), window.turning.hidden_b_rad
        _add_hidden_turn(p, x_n, x_rad, push[2])
        _add_hidden_turn(p, y_n, y_rad, push[2])
        _add_hidden_turn(p, z_n, z_rad, push[2])
    round_up(p)
    unknown = ANY_ANGLE_RAD2
    for i in range(BIAS):
        if p[i, i] > unknown:
            scale_variance(p, i, unknown / p[i, i])
