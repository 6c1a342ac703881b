"""``kf-axis``: a Kalman filter of angle and gyro bias on each of three Euler angles (Byambajav et al., eqs (1)-(15)).

Roll, pitch and heading are the z-y-x Euler angles of ``q_nb``. Each has a filter of its own, eqs (8)-(12)::

    (angle, bias)' = A (angle, bias) + (dt rate, 0)    A = [[1, -dt], [0, 1]]    H = [1 0]

The rate is the Euler rate (1). The accelerometer measures roll and pitch, (14) and (15); the field, levelled by the
roll and pitch just found, measures the heading (7). The paper's angles are those of a forward-right-down body in
North-East-Down: pitch has the other sign there, heading counts from north, and the filters are the same.

The angles are kept as the rotation that they make, and the three biases as a vector in body axes, where a gyro's bias
is constant; its component along the axis of an angle is that angle's bias. (1) is integrated over the interval as a
rotation, exactly, and an innovation is one arc tangent of the measured against the predicted angle, so nothing wraps
or is averaged across +-180 deg. Where body x is vertical, roll and heading are one angle: within ``GIMBAL`` of it the
accelerometer is left out and only the gyro turns the estimate (``n_gimbal``).

A rate that was clipped or missing hides a turn: P of the angles grows by it, so that the next measurements correct the
angles and not the biases.
"""

from dataclasses import dataclass
from math import atan2, nan, sqrt
from typing import Literal, NamedTuple

from stillpoint.datasets.compiled import compiled_entry, compiled_inside
from stillpoint.datasets.constants import STANDARD_GRAVITY_MPS2
from stillpoint.datasets.settings import Settings, choice, degrees, number
from stillpoint.filters import rotation
from stillpoint.filters.euler_axes import (
    GIMBAL,
    Frame,
    body_rate,
    bound_hidden_turns,
    covariance,
    euler_frame,
    tilt_rotation,
    turn_about_up,
)
from stillpoint.filters.fields import FREE_FALL_M2PS4, level_rotation, north_error
from stillpoint.filters.kalman.covariance import ANY_ANGLE_RAD2
from stillpoint.filters.rotation import Quaternion, Vector, add, dot, multiply, rotate, scale
from stillpoint.filters.sample import GAP_S, Output, Sample


class Axis(NamedTuple):
    """Covariance of (angle, bias) of one axis."""

    p_angle: float  # rad^2
    p_cross: float  # rad^2/s
    p_bias: float  # (rad/s)^2


@compiled_inside
def _predict_axis(axis: Axis, dt_s: float, angle_rad2ps: float, walk_rad2ps3: float) -> Axis:
    """Return P of (11) after an interval: A P A' + Q dt; Q holds the variances per second of angle and bias."""
    p_angle, p_cross, p_bias = axis
    grown = p_angle + dt_s * (dt_s * p_bias - p_cross - p_cross) + angle_rad2ps * dt_s
    return Axis(grown, p_cross - dt_s * p_bias, p_bias + walk_rad2ps3 * dt_s)


@compiled_inside
def _correct_axis(axis: Axis, innovation: float, r: float) -> tuple[Axis, float, float, float]:
    """Return P after a measurement of variance ``r``, the corrections of angle and bias, the normalised innovation.

    P - K S K' in the form that cannot turn negative by rounding: every term is a product or a sum of positive ones.
    """
    p_angle, p_cross, p_bias = axis
    per_s = 1.0 / (p_angle + r)  # one division: they are slow
    left, to_angle, to_bias = r * per_s, p_angle * per_s, p_cross * per_s
    determinant = max(p_angle * p_bias - p_cross * p_cross, 0.0)
    new = Axis(p_angle * left, p_cross * left, p_bias * left + determinant * per_s)
    return new, to_angle * innovation, to_bias * innovation, innovation * sqrt(per_s)


@compiled_inside
def _widen_axis(axis: Axis, turn: float) -> Axis:
    """Inflate the angle variance after an unmeasured turn (sd); such errors persist, so standard deviations add."""
    root = sqrt(axis.p_angle) + turn
    return Axis(max(axis.p_angle, min(root * root, ANY_ANGLE_RAD2)), axis.p_cross, axis.p_bias)


@compiled_inside
def _reset_axis(p_angle: float, p_bias: float) -> Axis:
    """Return a P whose angle and bias are independent."""
    return Axis(p_angle, 0.0, p_bias)


# Not ready for so long after the first tilt.
_START_S = 2.0
_FORMS = ("euler", "roots", "printed")
_EULER, _ROOTS, _ = range(len(_FORMS))


@dataclass(frozen=True)
class Params(Settings):
    """Parameters of ``kf-axis``."""

    gyro_noise_rad_rts: float = degrees(0.1, 1e-6, 100.0, "Q of an angle: random walk of the integrated gyro")
    bias_walk_radps_rts: float = degrees(0.001, 0.0, 100.0, "Q of a bias: its random walk")
    tilt_sd_rad: float = degrees(
        20.0, 1e-3, 90.0, "R of roll and pitch: one sample, level, with its share of slow linear motion"
    )
    heading_sd_rad: float = degrees(40.0, 1e-3, 180.0, "R of heading: one sample, with its share of slow disturbances")
    bias_sd_radps: float = degrees(1.0, 0.0, 100.0, "P of a bias at the start and after each reset")
    reset_s: float = number(
        0.0, 0.0, 1e6, "interval at which P starts again (the paper: from time to time), s; 0 = never"
    )
    tilt: Literal["euler", "roots", "printed"] = choice(
        "euler",
        "(14), (15): exact Euler angles; arctan(f_y/sqrt(f_x²+f_z²)), the elevation of each axis, up to 90 deg; "
        "or as printed, in g and without the roots",
    )
    heading: Literal["filtered", "compass"] = choice(
        "filtered", "third filter on the heading (7), or (7) itself as in the paper's fig 2"
    )
    speed_mps: float = number(0.0, 0.0, 300.0, "steady speed along body x, to subtract its Coriolis term (4), m/s")


class Coefficients(NamedTuple):
    """Constants derived once from the parameters."""

    gyro_rad2ps: float  # variances per second
    walk_rad2ps3: float
    tilt_rad2: float
    heading_rad2: float
    bias_rad2ps2: float
    reset_s: float
    tilt: int  # which of FORMS
    compass: bool
    speed_mps: float
    declination_rad: float  # east of true north


class State(NamedTuple):
    """The state of the filter between two samples."""

    q_nb: Quaternion
    bias_b_radps: Vector
    roll: Axis
    pitch: Axis
    heading: Axis
    age_s: float  # since the start or the last gap, up to _START_S
    since_reset_s: float
    is_level: bool  # False until the first tilt, and after a gap
    is_headed: bool
    n_gaps: int
    n_gimbal: int  # samples with body x along the vertical: the gyro alone
    n_free_fall: int  # accelerometer samples left out: too short to point up
    n_no_field: int  # magnetometer samples left out: zero
    n_no_north: int  # and those without horizontal part


class Corrected(NamedTuple):
    """A state after gyro and accelerometer."""

    q_nb: Quaternion
    bias_b_radps: Vector
    roll: Axis
    pitch: Axis
    nu_roll: float  # normalised innovations, NaN for none
    nu_pitch: float
    is_gimbal: bool


def coefficients(params: Params, declination_rad: float) -> Coefficients:
    """Precompute the filter's constants from its parameters and the local declination (east of true north)."""
    return Coefficients(
        params.gyro_noise_rad_rts**2,
        params.bias_walk_radps_rts**2,
        params.tilt_sd_rad**2,
        params.heading_sd_rad**2,
        params.bias_sd_radps**2,
        params.reset_s,
        _FORMS.index(params.tilt),
        params.heading == "compass",
        params.speed_mps,
        declination_rad,
    )


@compiled_entry
def start(c: Coefficients) -> State:
    """Return the state before the first sample: level, with the body's x axis pointing north."""
    half = 0.5**0.5
    tilt = Axis(c.tilt_rad2, 0.0, c.bias_rad2ps2)
    heading = Axis(ANY_ANGLE_RAD2, 0.0, c.bias_rad2ps2)
    none = (0.0, 0.0, 0.0)
    return State((half, 0.0, 0.0, half), none, tilt, tilt, heading, 0.0, 0.0, False, False, 0, 0, 0, 0, 0)


@compiled_inside
def _renormalise(q: Quaternion) -> Quaternion:
    """Return a quaternion of length 1 if only rounding is off: one Newton step, with neither root nor division."""
    share = 1.5 - 0.5 * (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return q[0] * share, q[1] * share, q[2] * share, q[3] * share


@compiled_inside
def _measure_tilt_errors(force: Vector, frame: Frame, form: int) -> tuple[float, float]:
    """Return (14), (15) less the roll and pitch of the attitude, in (-pi, pi]."""
    fx, fy, fz = force
    up, cos_pitch = frame.up_b, frame.cos_pitch
    g = STANDARD_GRAVITY_MPS2
    if form == _EULER:
        roll, pitch = (fy, fz), (-fx, sqrt(fy * fy + fz * fz))
    elif form == _ROOTS:
        roll, pitch = (fy, sqrt(fx * fx + fz * fz)), (-fx, sqrt(fy * fy + fz * fz))
    else:  # as printed
        roll, pitch = (fy * g, fy * fy + fz * fz), (-fx * g, fx * fx + fz * fz)
    return (
        atan2(roll[0] * up[2] - roll[1] * up[1], roll[1] * up[2] + roll[0] * up[1]),
        atan2(pitch[0] * cos_pitch + pitch[1] * up[0], pitch[1] * cos_pitch - pitch[0] * up[0]),
    )


@compiled_inside
def remove_coriolis(force: Vector, rate: Vector, speed_mps: float) -> Vector:
    """Return the specific force less w x V of (4), for a V along body x."""
    return force[0], force[1] - rate[2] * speed_mps, force[2] + rate[1] * speed_mps


@compiled_inside
def _correct_tilt(state: State, sample: Sample, has_accel: bool, c: Coefficients) -> Corrected:
    """Turn the attitude by the gyro, then correct roll and pitch by the accelerometer."""
    dt_s, none = sample.dt_s, nan
    bias = state.bias_b_radps
    rate = add(sample.gyro_b_radps, scale(bias, -1.0))
    q_nb = multiply(_renormalise(state.q_nb), rotation.exp(scale(rate, dt_s)))
    frame = euler_frame(q_nb)
    if frame.cos_pitch < GIMBAL:
        return Corrected(q_nb, bias, state.roll, state.pitch, none, none, True)
    if not has_accel:
        return Corrected(q_nb, bias, state.roll, state.pitch, none, none, False)
    force = remove_coriolis(sample.accel_b_mps2, rate, c.speed_mps) if c.speed_mps > 0 else sample.accel_b_mps2
    off_roll, off_pitch = _measure_tilt_errors(force, frame, c.tilt)
    # The accelerometer shows roll by its part across x only.
    r_roll = c.tilt_rad2 / (frame.cos_pitch * frame.cos_pitch)
    roll, turn_roll, bias_roll, nu_roll = _correct_axis(state.roll, off_roll, r_roll)
    pitch, turn_pitch, bias_pitch, nu_pitch = _correct_axis(state.pitch, off_pitch, c.tilt_rad2)
    q_nb = multiply(q_nb, tilt_rotation(turn_roll, turn_pitch, frame.pitch_b))
    bias = add(bias, body_rate(bias_roll, bias_pitch, frame))
    return Corrected(q_nb, bias, roll, pitch, nu_roll, nu_pitch, False)


@compiled_inside
def _predict_axes(state: State, sample: Sample, is_headed: bool, c: Coefficients) -> tuple[Axis, Axis, Axis, float]:
    """Return P of roll, pitch and heading after the interval, and the time since P was reset."""
    _, _, roll, pitch, heading, _, since_reset_s, _, _ = state[:9]
    dt_s = sample.dt_s
    roll = _predict_axis(roll, dt_s, c.gyro_rad2ps, c.walk_rad2ps3)
    pitch = _predict_axis(pitch, dt_s, c.gyro_rad2ps, c.walk_rad2ps3)
    heading = _predict_axis(heading, dt_s, c.gyro_rad2ps, c.walk_rad2ps3)
    since_reset_s += dt_s
    if dot(sample.hidden_b_radps, sample.hidden_b_radps) > 0:
        by_roll, by_pitch, by_heading = bound_hidden_turns(state.q_nb, scale(sample.hidden_b_radps, dt_s))
        roll, pitch, heading = (
            _widen_axis(roll, by_roll),
            _widen_axis(pitch, by_pitch),
            _widen_axis(heading, by_heading),
        )
    if c.reset_s > 0 and since_reset_s >= c.reset_s:
        since_reset_s = 0.0
        roll = pitch = _reset_axis(c.tilt_rad2, c.bias_rad2ps2)
        heading = _reset_axis(c.heading_rad2 if is_headed else heading.p_angle, c.bias_rad2ps2)
    return roll, pitch, heading, since_reset_s


@compiled_inside
def step(state: State, sample: Sample, c: Coefficients) -> tuple[State, Output]:
    """Predict all three angles, correct roll and pitch, then the heading."""
    dt_s, nu_heading = sample.dt_s, nan
    q_nb, bias, _, _, _, age_s, _, is_level, is_headed = state[:9]
    n_gaps, n_gimbal, n_free_fall, n_no_field, n_no_north = state[9:]
    least = FREE_FALL_M2PS4
    has_accel = sample.has_accel and dot(sample.accel_b_mps2, sample.accel_b_mps2) >= least
    has_mag = sample.has_mag and dot(sample.mag_b_ut, sample.mag_b_ut) > 0
    n_free_fall += sample.has_accel and not has_accel
    n_no_field += sample.has_mag and not has_mag
    if is_level and dt_s > GAP_S:
        is_level, is_headed, age_s, n_gaps = False, False, 0.0, n_gaps + 1
    age_s = min(age_s + dt_s, _START_S)
    roll, pitch, heading, since_reset_s = _predict_axes(state, sample, is_headed, c)
    nu_roll = nu_pitch = nu_heading
    if is_level:
        before = State(q_nb, bias, roll, pitch, heading, 0.0, 0.0, True, is_headed, 0, 0, 0, 0, 0)
        q_nb, bias, roll, pitch, nu_roll, nu_pitch, is_gimbal = _correct_tilt(before, sample, has_accel, c)
        n_gimbal += is_gimbal
    elif has_accel:
        q_nb, is_level, age_s = multiply(level_rotation(q_nb, sample.accel_b_mps2), q_nb), True, 0.0
        roll, pitch = _reset_axis(c.tilt_rad2, roll.p_bias), _reset_axis(c.tilt_rad2, pitch.p_bias)
    frame = euler_frame(q_nb)  # a turn about up, as that of the heading is, leaves it as it is
    if is_level and has_mag:
        turn, found = north_error(rotate(q_nb, sample.mag_b_ut), c.declination_rad)
        if not found:
            n_no_north += 1
        elif c.compass or not is_headed:  # taken, not approached
            heading, is_headed = _reset_axis(c.heading_rad2, heading.p_bias), True
            q_nb = turn_about_up(q_nb, turn)
        else:
            heading, turn, bias_heading, nu_heading = _correct_axis(heading, turn, c.heading_rad2)
            q_nb, bias = turn_about_up(q_nb, turn), add(bias, scale(frame.up_b, bias_heading))
    counts = (n_gaps, n_gimbal, n_free_fall, n_no_field, n_no_north)
    state = State(q_nb, bias, roll, pitch, heading, age_s, since_reset_s, is_level, is_headed, *counts)
    cov_b = covariance(roll.p_angle, pitch.p_angle, heading.p_angle, frame)
    ready = is_level and age_s >= _START_S
    return state, Output(q_nb, bias, cov_b, (nu_roll, nu_pitch, nu_heading), ready)
