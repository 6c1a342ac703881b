"""``kf-axis``: a Kalman filter of angle and gyro bias on each of three Euler angles (paper 004, eqs (1)-(15)).

Roll, pitch and heading are the z-y-x Euler angles of ``q_nb``, each with a filter of its own, eqs (8)-(12)::

    (angle, bias)' = A (angle, bias) + (dt rate, 0)    A = [[1, -dt], [0, 1]]    H = [1 0]

The rate is the Euler rate (1). Roll and pitch are measured by the accelerometer (14), (15), heading by the field that
is levelled by the roll and pitch just found (7). The paper's angles are those of a forward-right-down body in
North-East-Down: pitch has the other sign there, heading counts from north, and every filter is as it is here.

The angles are kept as the rotation that they make, and the three biases as a vector in body axes, where a gyro's bias
is constant; seen along the axis about which an angle turns it is that angle's. (1) is integrated over the interval as a
rotation, exactly, and an innovation is one arc tangent of the measured against the predicted angle: nothing wraps,
nothing is averaged across +-180 deg. Where body x is vertical, roll and heading are one angle: within ``GIMBAL`` of it
the accelerometer is left out and the gyro alone turns the estimate (``n_gimbal``).

A rate that was clipped or missing hides a turn: P of the angles grows by it, so that the next measurements move the
angles and not the biases.
"""

from dataclasses import dataclass
from math import atan2, cos, nan, pi, sin, sqrt
from typing import Literal, NamedTuple

from stillpoint.datasets.settings import Settings, choice, degrees, number
from stillpoint.filters import rotation
from stillpoint.filters.compiled import compiled, like
from stillpoint.filters.fields import FREE_FALL_MPS2, turn_to_north, uprighting
from stillpoint.filters.rotation import Quaternion, Vector, add, dot, multiply, rotate, scale
from stillpoint.filters.sample import GAP_S, Log, Output, Sample, Track, keep, sample_at

# Cosine of the pitch below which roll and heading are one angle: the body's x axis is within 1.1 deg of the vertical.
GIMBAL = 0.02
# Variance of a heading of which nothing is known: uniform over a turn.
ANY_HEADING_RAD2 = pi * pi / 3
START_S = 2.0
GRAVITY_MPS2 = 9.80665  # unit of the accelerometer in (14), (15) as printed
FORMS = ("euler", "roots", "printed")


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
    reset_s: float = number(0.0, 0.0, 1e6, "P starts anew that often (the paper: from time to time), s; 0 = never")
    tilt: Literal["euler", "roots", "printed"] = choice(
        "euler",
        "(14), (15): exact Euler angles; arctan(f_y/sqrt(f_x²+f_z²)), the elevation of each axis, up to 90 deg; "
        "or as printed, in g and without the roots",
    )
    heading: Literal["filtered", "compass"] = choice(
        "filtered", "third filter on the heading (7), or (7) itself as in the paper's fig 2"
    )
    speed_mps: float = number(0.0, 0.0, 300.0, "steady speed along body x, whose Coriolis term (4) is taken off, m/s")


class Coefficients(NamedTuple):
    """Derived once from the parameters."""

    gyro_rad2ps: float  # variances per second
    walk_rad2ps3: float
    tilt_rad2: float
    heading_rad2: float
    bias_rad2ps2: float
    reset_s: float
    tilt: int
    compass: bool
    speed_mps: float
    declination_rad: float  # east of true north


class Axis(NamedTuple):
    """Covariance P of (angle, bias) of one Euler angle."""

    p_angle: float
    p_cross: float
    p_bias: float


class State(NamedTuple):
    """What is remembered."""

    q_nb: Quaternion
    bias_b_radps: Vector
    roll: Axis
    pitch: Axis
    heading: Axis
    age_s: float  # since the start or the last gap, up to START_S
    since_reset_s: float
    is_level: bool  # False until the first tilt, and after a gap
    is_headed: bool
    n_gaps: int
    n_gimbal: int  # samples with body x along the vertical: the gyro alone
    n_free_fall: int  # accelerometer samples left out: too short to point up
    n_no_field: int  # magnetometer samples left out: zero
    n_no_north: int  # and those without horizontal part


class Moved(NamedTuple):
    """What gyro and accelerometer make of a state."""

    q_nb: Quaternion
    bias_b_radps: Vector
    roll: Axis
    pitch: Axis
    nu_roll: float  # normalised innovations, NaN for none
    nu_pitch: float
    is_gimbal: bool


class Frame(NamedTuple):
    """Where the Euler angles of an attitude turn, in body axes."""

    up_b: Vector  # axis of heading: (-sin pitch, cos pitch sin roll, cos pitch cos roll)
    pitch_b: Vector  # axis of pitch: (0, cos roll, -sin roll)
    cos_pitch: float


def coefficients(params: Params, declination_rad: float) -> Coefficients:
    """Of these parameters at a place with this declination (east of true north)."""
    return Coefficients(
        params.gyro_noise_rad_rts**2,
        params.bias_walk_radps_rts**2,
        params.tilt_sd_rad**2,
        params.heading_sd_rad**2,
        params.bias_sd_radps**2,
        params.reset_s,
        FORMS.index(params.tilt),
        params.heading == "compass",
        params.speed_mps,
        declination_rad,
    )


@compiled
def start(c: Coefficients) -> State:
    """Before the first sample: level, x over north."""
    zero, half = like(c.tilt_rad2, 0.0), like(c.tilt_rad2, 0.5**0.5)
    tilt = Axis(c.tilt_rad2, zero, c.bias_rad2ps2)
    heading = Axis(like(zero, ANY_HEADING_RAD2), zero, c.bias_rad2ps2)
    none = (zero, zero, zero)
    return State((half, zero, zero, half), none, tilt, tilt, heading, zero, zero, False, False, 0, 0, 0, 0, 0)


@compiled
def predict(axis: Axis, dt_s: float, c: Coefficients) -> Axis:
    """P of (11) after an interval: A P A' + Q dt."""
    p_angle, p_cross, p_bias = axis
    grown = p_angle + dt_s * (dt_s * p_bias - p_cross - p_cross) + c.gyro_rad2ps * dt_s
    return Axis(grown, p_cross - dt_s * p_bias, p_bias + c.walk_rad2ps3 * dt_s)


@compiled
def correct(axis: Axis, innovation: float, r: float) -> tuple[Axis, float, float, float]:
    """One measurement of variance ``r``: P, by how much to turn and to change the bias, the normalised innovation.

    P - K S K' in the form that cannot turn negative by rounding: every term is a product or a sum of positive ones.
    """
    p_angle, p_cross, p_bias = axis
    per_s = like(r, 1.0) / (p_angle + r)  # one division: they are slow
    left, by = r * per_s, innovation * per_s
    determinant = max(p_angle * p_bias - p_cross * p_cross, like(r, 0.0))
    new = Axis(p_angle * left, p_cross * left, p_bias * left + determinant * per_s)
    return new, p_angle * by, p_cross * by, innovation * sqrt(per_s)


@compiled
def widened(axis: Axis, turn: float) -> Axis:
    """P after a turn that the gyro did not tell (sd), which goes on as it began: standard deviations add."""
    root = sqrt(axis.p_angle) + turn
    return Axis(max(axis.p_angle, min(root * root, like(turn, ANY_HEADING_RAD2))), axis.p_cross, axis.p_bias)


@compiled
def hidden_turns(q_nb: Quaternion, hidden_b_rad: Vector) -> Vector:
    """The most that turns about the body's axes, of either sign, make of roll, pitch and heading: (1)."""
    up, (_, across_y, across_z), cos_pitch = frame_of(q_nb)
    x, y, z = hidden_b_rad
    least = like(x, GIMBAL)
    heading = (abs(up[1]) * y + abs(up[2]) * z) / max(cos_pitch * cos_pitch, least * least)
    return x + abs(up[0]) * heading, abs(across_y) * y + abs(across_z) * z, heading


@compiled
def renewed(p_angle: float, p_bias: float) -> Axis:
    """A P whose angle and bias have nothing to do with each other."""
    return Axis(p_angle, like(p_angle, 0.0), p_bias)


@compiled
def frame_of(q: Quaternion) -> Frame:
    """Where the Euler angles of an attitude turn; the pitch's axis is arbitrary where x is vertical."""
    w, x, y, z = q
    one, two = like(w, 1.0), like(w, 2.0)
    up_x, up_y, up_z = (x * z - w * y) * two, (y * z + w * x) * two, one - (x * x + y * y) * two
    square = up_y * up_y + up_z * up_z
    cos_pitch = sqrt(square)
    if cos_pitch < like(w, GIMBAL):
        return Frame((up_x, up_y, up_z), (one - one, one, one - one), cos_pitch)
    share = cos_pitch * (one / square)  # sooner there than 1 / cos_pitch
    return Frame((up_x, up_y, up_z), (one - one, up_z * share, -up_y * share), cos_pitch)


@compiled
def half_turn(angle: float) -> tuple[float, float]:
    """Cosine and sine of half an angle; of small ones by their series, exact to 1e-17."""
    half = angle * like(angle, 0.5)
    if abs(half) < like(angle, 0.05):
        t = half * half
        one = like(angle, 1.0)
        even = t * like(angle, 1 / 24) * (one - t * like(angle, 1 / 30) * (one - t * like(angle, 1 / 56)))
        odd = t * like(angle, 1 / 6) * (one - t * like(angle, 1 / 20) * (one - t * like(angle, 1 / 42)))
        return one - t * (like(angle, 0.5) - even), half - half * odd
    return cos(half), sin(half)


@compiled
def tilting(roll: float, pitch: float, pitch_b: Vector) -> Quaternion:
    """A turn by ``pitch`` about the axis of pitch, then by ``roll`` about body x: on the right of an attitude."""
    (cp, sp), (cr, sr) = half_turn(pitch), half_turn(roll)
    y, z = pitch_b[1] * sp, pitch_b[2] * sp
    return cp * cr, cp * sr, y * cr + z * sr, z * cr - y * sr


@compiled
def turned_about_up(q: Quaternion, angle: float) -> Quaternion:
    """The attitude after a turn about up."""
    c, s = half_turn(angle)
    return c * q[0] - s * q[3], c * q[1] - s * q[2], c * q[2] + s * q[1], c * q[3] + s * q[0]


@compiled
def unit(q: Quaternion) -> Quaternion:
    """Length 1 for a quaternion that is off by rounding only: one Newton step, with neither root nor division."""
    half = like(q[0], 0.5)
    share = like(q[0], 1.5) - half * (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return q[0] * share, q[1] * share, q[2] * share, q[3] * share


@compiled
def in_body(roll: float, pitch: float, frame: Frame) -> Vector:
    """The body rate of these rates of roll and pitch: the inverse of (1)."""
    return roll, frame.pitch_b[1] * pitch, frame.pitch_b[2] * pitch


@compiled
def tilt_errors(force: Vector, frame: Frame, form: int) -> tuple[float, float]:
    """(14), (15) less the roll and pitch of the attitude, in (-pi, pi]."""
    fx, fy, fz = force
    up, cos_pitch = frame.up_b, frame.cos_pitch
    g = like(fx, GRAVITY_MPS2)
    if form == 0:
        roll, pitch = (fy, fz), (-fx, sqrt(fy * fy + fz * fz))
    elif form == 1:
        roll, pitch = (fy, sqrt(fx * fx + fz * fz)), (-fx, sqrt(fy * fy + fz * fz))
    else:
        roll, pitch = (fy * g, fy * fy + fz * fz), (-fx * g, fx * fx + fz * fz)
    return (
        atan2(roll[0] * up[2] - roll[1] * up[1], roll[1] * up[2] + roll[0] * up[1]),
        atan2(pitch[0] * cos_pitch + pitch[1] * up[0], pitch[1] * cos_pitch - pitch[0] * up[0]),
    )


@compiled
def covariance(roll: float, pitch: float, heading: float, frame: Frame) -> tuple[float, ...]:
    """Variances of the Euler angles as the covariance of a small rotation in body axes."""
    up, (_, py, pz) = frame.up_b, frame.pitch_b
    xy, xz, yz = heading * up[0] * up[1], heading * up[0] * up[2], heading * up[1] * up[2] + pitch * py * pz
    xx, yy = roll + heading * up[0] * up[0], pitch * py * py + heading * up[1] * up[1]
    return xx, xy, xz, xy, yy, yz, xz, yz, pitch * pz * pz + heading * up[2] * up[2]


@compiled
def without_coriolis(force: Vector, rate: Vector, speed_mps: float) -> Vector:
    """Specific force less w x V of (4), for a V along body x."""
    return force[0], force[1] - rate[2] * speed_mps, force[2] + rate[1] * speed_mps


@compiled
def moved(state: State, sample: Sample, has_accel: bool, c: Coefficients) -> Moved:
    """The attitude by the gyro, then roll and pitch by the accelerometer."""
    dt_s, none = sample.dt_s, like(sample.dt_s, nan)
    bias = state.bias_b_radps
    rate = add(sample.gyro_b_radps, scale(bias, like(dt_s, -1.0)))
    q_nb = multiply(state.q_nb, rotation.exp(scale(rate, dt_s)))
    frame = frame_of(q_nb)
    if frame.cos_pitch < like(dt_s, GIMBAL):
        return Moved(q_nb, bias, state.roll, state.pitch, none, none, True)
    if not has_accel:
        return Moved(q_nb, bias, state.roll, state.pitch, none, none, False)
    force = without_coriolis(sample.accel_b_mps2, rate, c.speed_mps) if c.speed_mps > 0 else sample.accel_b_mps2
    off_roll, off_pitch = tilt_errors(force, frame, c.tilt)
    # The accelerometer shows roll by its part across x only.
    r_roll = c.tilt_rad2 / (frame.cos_pitch * frame.cos_pitch)
    roll, turn_roll, bias_roll, nu_roll = correct(state.roll, off_roll, r_roll)
    pitch, turn_pitch, bias_pitch, nu_pitch = correct(state.pitch, off_pitch, c.tilt_rad2)
    q_nb = multiply(q_nb, tilting(turn_roll, turn_pitch, frame.pitch_b))
    bias = add(bias, in_body(bias_roll, bias_pitch, frame))
    return Moved(q_nb, bias, roll, pitch, nu_roll, nu_pitch, False)


@compiled
def step(state: State, sample: Sample, c: Coefficients) -> tuple[State, Output]:
    """Predict all three angles, correct roll and pitch, then the heading."""
    dt_s, zero, none = sample.dt_s, like(sample.dt_s, 0.0), like(sample.dt_s, nan)
    q_nb, bias, roll, pitch, heading, age_s, since_reset_s, is_level, is_headed = state[:9]
    n_gaps, n_gimbal, n_free_fall, n_no_field, n_no_north = state[9:]
    least = like(dt_s, FREE_FALL_MPS2 * FREE_FALL_MPS2)
    has_accel = sample.has_accel and dot(sample.accel_b_mps2, sample.accel_b_mps2) >= least
    has_mag = sample.has_mag and dot(sample.mag_b_ut, sample.mag_b_ut) > 0
    n_free_fall += sample.has_accel and not has_accel
    n_no_field += sample.has_mag and not has_mag
    if is_level and dt_s > like(dt_s, GAP_S):
        is_level, is_headed, age_s, n_gaps = False, False, zero, n_gaps + 1
    age_s, since_reset_s = min(age_s + dt_s, like(dt_s, START_S)), since_reset_s + dt_s
    roll, pitch, heading = predict(roll, dt_s, c), predict(pitch, dt_s, c), predict(heading, dt_s, c)
    if dot(sample.hidden_b_radps, sample.hidden_b_radps) > 0:
        by_roll, by_pitch, by_heading = hidden_turns(q_nb, scale(sample.hidden_b_radps, dt_s))
        roll, pitch, heading = widened(roll, by_roll), widened(pitch, by_pitch), widened(heading, by_heading)
    if c.reset_s > 0 and since_reset_s >= c.reset_s:
        since_reset_s = zero
        roll = pitch = renewed(c.tilt_rad2, c.bias_rad2ps2)
        heading = renewed(c.heading_rad2 if is_headed else heading.p_angle, c.bias_rad2ps2)
    nu_roll = nu_pitch = nu_heading = none
    if is_level:
        before = State(q_nb, bias, roll, pitch, heading, zero, zero, True, is_headed, 0, 0, 0, 0, 0)
        q_nb, bias, roll, pitch, nu_roll, nu_pitch, is_gimbal = moved(before, sample, has_accel, c)
        n_gimbal += is_gimbal
    elif has_accel:
        q_nb, is_level, age_s = multiply(uprighting(q_nb, sample.accel_b_mps2), q_nb), True, zero
        roll, pitch = renewed(c.tilt_rad2, roll.p_bias), renewed(c.tilt_rad2, pitch.p_bias)
    if is_level and has_mag:
        turn, found = turn_to_north(rotate(q_nb, sample.mag_b_ut), c.declination_rad)
        if not found:
            n_no_north += 1
        elif c.compass or not is_headed:  # taken, not approached
            heading, is_headed = renewed(c.heading_rad2, heading.p_bias), True
            q_nb = turned_about_up(q_nb, turn)
        else:
            heading, turn, bias_heading, nu_heading = correct(heading, turn, c.heading_rad2)
            q_nb = turned_about_up(q_nb, turn)
            bias = add(bias, scale(frame_of(q_nb).up_b, bias_heading))
    q_nb = unit(q_nb)
    counts = (n_gaps, n_gimbal, n_free_fall, n_no_field, n_no_north)
    state = State(q_nb, bias, roll, pitch, heading, age_s, since_reset_s, is_level, is_headed, *counts)
    cov_b = covariance(roll.p_angle, pitch.p_angle, heading.p_angle, frame_of(q_nb))
    ready = is_level and age_s >= like(dt_s, START_S)
    return state, Output(q_nb, bias, cov_b, (nu_roll, nu_pitch, nu_heading), ready)


@compiled
def run(log: Log, state: State, c: Coefficients, track: Track) -> State:
    """Every sample of a log."""
    for k in range(len(log.dt_s)):
        state, output = step(state, sample_at(log, k), c)
        keep(track, k, output)
    return state
