"""What ``ekf``, ``aekf`` and ``iekf`` share: the model, the prediction, the three updates, the beginning.

Estimated are the attitude, the gyro's bias b (body axes) and the horizontal velocity v (n); the errors are

    e (3, rad, n): q_true = exp(e) q     d (3): b_true = b + d     u (2, m/s): v_true = v + u

    e' = -R (d + white noise)     d' = white noise     u' = (e x f)_horizontal + white noise

with R and the specific force f in n. In n the attitude's error does not turn with the body, so that over a window, in
which R integrates to S and f to F, the transition is exact up to products of two small terms: e loses S d, u gains
((e - S d / 2) x F)_horizontal. Errors in body axes are R' e: :mod:`stillpoint.filters.covariance` turns them.

**Velocity.** An accelerometer shows gravity plus acceleration, and what moves to and fro has a mean velocity of 0.
So the accelerometer drives v, and the measurement is "v = 0", with ``velocity_mps_rts`` as the density of its error. A
shake of any strength that comes back leaves no trace; taking specific force for gravity within an assumed noise, which
is the special case of ``velocity_mps_rts`` near 0, mistakes it for tilt. v is in the heading of the estimate, so an
error of the heading does not enter it.

**Field.** Its heading alone is used, and moves the heading and the bias, never the tilt. The error of the tilt is in
its row, tan(dip) times the tilt about the field's horizontal direction. Its variance grows with the disturbance
that size and dip of the field show (:mod:`stillpoint.filters.known_field`).

**Rest.** The mean rate is the bias (:mod:`stillpoint.filters.stillness`), and v is 0 to ``REST_MPS``.

Innovations beyond ``gate_sd`` are taken as if their variance were so much larger that they are at ``gate_sd``. When
they stay there, the estimate is wrong and not they: after ``tilt_patience_s`` the tilt starts again from the mean of
the accelerometer, after ``heading_patience_s`` the heading is taken as unknown. So nothing is locked out for ever."""

from dataclasses import dataclass
from math import cos, nan, pi, sin, sqrt
from typing import NamedTuple

import numpy as np

from stillpoint.datasets.settings import Settings, degrees, number
from stillpoint.filters import rotation
from stillpoint.filters.compiled import compiled, compiled_apart, like
from stillpoint.filters.covariance import (
    Matrix,
    axes_in_n,
    congruence,
    forget,
    identity,
    in_body_axes,
    joseph,
    round_up,
    times,
    widen,
)
from stillpoint.filters.fields import FREE_FALL_MPS2, turn_to_north
from stillpoint.filters.known_field import KnownField, Tolerance, disturbance_ut2, learn, looks, no_field
from stillpoint.filters.rotation import (
    Quaternion,
    Vector,
    about_up,
    add,
    between,
    dot,
    multiply,
    norm,
    normalise,
    rotate,
    scale,
)
from stillpoint.filters.sample import GAP_S, Output, Sample
from stillpoint.filters.stillness import Limits, Stillness, is_resting, moving, rate_sd, watch
from stillpoint.filters.window import Forces, Turning, Window, means, no_samples, pushed, turned, with_field

# Where the errors stand in P: attitude 0-2 (2 is the heading), bias 3-5, velocity 6-7.
HEADING, BIAS, VELOCITY, SIZE = 2, 3, 6, 8
# The variance of an angle of which nothing is known: even over a whole turn.
UNKNOWN_RAD2 = pi * pi / 3
# How far from 0 the velocity of a resting body is.
REST_MPS = 0.02
# How far the specific force may be from gravity where the accelerometer gave nothing.
LOST_MPS2 = 5.0
# A body whose mean specific force, of at least that size, points that far down (cosine) is not as the estimate says.
LEAST_FORCE_MPS2 = 5.0
OBLIQUE = 0.5
# One field stands for at most that long: after a pause of the magnetometer a single sample is not taken at its word.
LONGEST_HOLD_S = 1.0
# A tilt known to that (sd per axis, 2 deg) is no longer a beginning.
READY_RAD2 = (pi / 90) ** 2


@dataclass(frozen=True)
class ErrorStateParams(Settings):
    """Parameters of ``ekf`` and ``iekf``; ``aekf`` has some more."""

    window_s: float = number(0.25, 0.0, 10.0, "time between two updates, s; 0 = one at every sample")
    gyro_noise_rad_rts: float = degrees(0.03, 1e-6, 100.0, "white noise of the gyro")
    turn_error: float = number(0.01, 0.0, 1.0, "gyro's error by scale and axes: sd after a turn of 1 rad, rad")
    bias_sd_radps: float = degrees(2.0, 1e-6, 100.0, "sd of the gyro's bias at the start; three of it are the limit")
    bias_walk_radps: float = degrees(0.002, 0.0, 10.0, "how much the gyro's bias walks in 1 s (sd)")
    accel_noise_mps_rts: float = number(0.02, 1e-6, 10.0, "white noise of the accelerometer, m/s/sqrt(s)")
    velocity_mps_rts: float = number(
        0.5, 1e-3, 1e3, "mean horizontal velocity over 1 s (sd, m/s; over T s by sqrt(T) less); 0.001 = no acceleration"
    )
    tilt_sd_rad: float = degrees(10.0, 0.01, 60.0, "sd of the first tilt, by one accelerometer sample, per axis")
    heading_sd_rad: float = degrees(30.0, 0.01, 100.0, "sd of the first heading, by one sample of the field")
    field_noise_ut_rts: float = number(10.0, 1e-3, 1e4, "error of the mean field over 1 s, also by iron (sd, uT)")
    field_tolerance: float = number(0.1, 1e-3, 1.0, "a known field keeps its size within this share")
    dip_tolerance_rad: float = degrees(10.0, 0.1, 90.0, "and its dip within")
    field_memory_s: float = number(20.0, 0.1, 1e5, "size and dip are the mean over so long, s")
    field_admission_s: float = number(20.0, 0.1, 1e5, "another field is known after so long in motion, s")
    unseen_disturbance: float = number(
        1.0, 0.0, 10.0, "a disturbance's part that turns the heading, against what its size and dip show; 0 = none"
    )
    rest_gyro_radps: float = degrees(2.0, 1e-3, 100.0, "largest sd of the gyro within a window at rest, all axes")
    rest_accel_mps2: float = number(0.5, 1e-3, 100.0, "largest sd of the accelerometer within a window at rest, m/s^2")
    rest_s: float = number(1.5, 0.0, 600.0, "a rest counts after so long, s")
    rest_bias_radps: float = degrees(0.05, 1e-6, 10.0, "error of the mean rate at rest (sd)")
    gate_sd: float = number(3.0, 1.0, 1e3, "innovations beyond so many sd count less")
    tilt_patience_s: float = number(10.0, 0.1, 1e5, "after so long beyond the gate the tilt starts again, s")
    heading_patience_s: float = number(60.0, 0.1, 1e5, "after so long beyond the gate the heading is unknown, s")


class Coefficients(NamedTuple):
    """Derived once from the parameters; variances per second unless said otherwise."""

    window_s: float
    gyro_noise: float
    turn_error: float  # rad^2 per rad
    bias_variance: float
    bias_walk: float
    accel_noise: float
    velocity_variance: float  # (m/s)^2 s; at first as over 1 s
    tilt_variance: float
    heading_variance: float
    field_variance: float  # uT^2 s
    unseen: float  # a square
    tolerance: Tolerance
    limits: Limits
    rest_variance: float
    gate: float  # a square
    tilt_patience_s: float
    heading_patience_s: float
    declination_rad: float  # east of true north


class Status(NamedTuple):
    """How far it has got, and how long it has been in doubt."""

    is_level: bool  # False until the first tilt, and after a gap
    is_headed: bool  # False until the first heading, and after a gap
    is_ready: bool
    since_field_s: float  # since the last window with a usable field
    tilt_doubt_s: float  # for how long innovations have been beyond the gate
    heading_doubt_s: float


class Met(NamedTuple):
    """What was left out or met."""

    n_free_fall: int  # accelerometer samples: too short to point up
    n_no_field: int  # magnetometer samples: zero
    n_no_north: int  # windows whose field has no horizontal part
    n_gaps: int
    n_beyond_gate: int  # innovations of velocity and heading
    n_tilt_restarts: int
    n_heading_restarts: int


class Body(NamedTuple):
    """What is remembered."""

    q_nb: Quaternion
    x: Matrix  # (8,) the attitude's error (0 between updates), the gyro's bias, the velocity
    p: Matrix  # (8, 8) covariance at the end of the window before
    window: Window
    still: Stillness
    field: KnownField
    status: Status
    met: Met


class Measurement(NamedTuple):
    """A scalar: seen = row times x + noise of this variance."""

    is_there: bool
    row: Matrix  # (8,)
    seen: float
    variance: float


class Due(NamedTuple):
    """What an update at the end of a window starts from; x and P are predicted to there."""

    still: Stillness
    is_resting: bool
    velocity_variance: float  # of the measurement that the velocity is 0
    heading: Measurement


def coefficients(params: ErrorStateParams, declination_rad: float) -> Coefficients:
    """Of these parameters at a place with this declination (east of true north)."""
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


@compiled
def start(c: Coefficients) -> Body:
    """Before the first sample: level, x over north, and nothing known of it."""
    zero, half = like(c.gate, 0.0), like(c.gate, 0.5**0.5)
    x, p = np.full(SIZE, zero), np.full((SIZE, SIZE), zero)
    for i in range(BIAS):
        p[i, i] = like(zero, UNKNOWN_RAD2)
        p[BIAS + i, BIAS + i] = c.bias_variance
    for i in range(VELOCITY, SIZE):
        p[i, i] = c.velocity_variance
    status = Status(False, False, False, zero, zero, zero)
    met = Met(0, 0, 0, 0, 0, 0, 0)
    return Body((half, zero, zero, half), x, p, no_samples(zero), moving(zero), no_field(zero), status, met)


@compiled
def gather(body: Body, sample: Sample, c: Coefficients) -> Body:
    """Turn by the rate, and add the sample to the window; or, as long as there is no attitude, begin one."""
    q_nb, x, p, window, still, field, status, met = body
    dt_s, gyro, accel, mag, has_accel, has_mag = sample
    use_accel = has_accel and dot(accel, accel) >= like(dt_s, FREE_FALL_MPS2**2)
    use_mag = has_mag and dot(mag, mag) > 0
    n_free_fall = met.n_free_fall + (1 if has_accel and not use_accel else 0)
    n_no_field = met.n_no_field + (1 if has_mag and not use_mag else 0)
    met = Met(n_free_fall, n_no_field, met[2], met[3], met[4], met[5], met[6])
    is_gap = dt_s > like(dt_s, GAP_S)
    if status.is_level and not is_gap:
        (turning, forces, fields), before = window, q_nb
        rate = add(gyro, (-x[BIAS], -x[BIAS + 1], -x[BIAS + 2]))
        q_nb = normalise(multiply(q_nb, rotation.exp(scale(rate, dt_s))))
        turning = turned(turning, gyro, rate, before, q_nb, dt_s)
        if use_accel:
            forces = pushed(forces, rotate(q_nb, accel), accel, dt_s)
        if use_mag:
            fields = with_field(fields, rotate(q_nb, mag), mag)
        window = Window(turning, forces, fields)
    if is_gap or not status.is_level or (use_mag and not status.is_headed):
        zero = like(dt_s, 0.0)
        window = no_samples(zero)
        if is_gap:
            lose(x, p, dt_s, c)
            still = moving(zero)
        q_nb, status, found = begin(q_nb, x, p, sample, (use_accel, use_mag, is_gap), status, c)
        met = Met(met[0], met[1], met[2] + (0 if found else 1), met[3] + (1 if is_gap else 0), met[4], met[5], met[6])
    return Body(q_nb, x, p, window, still, field, status, met)


@compiled_apart
def lose(x: Matrix, p: Matrix, gap_s: float, c: Coefficients) -> None:
    """After a gap: the bias has walked, all else is unknown."""
    for i in range(BIAS):
        forget(p, i, like(gap_s, UNKNOWN_RAD2))
        p[BIAS + i, BIAS + i] += c.bias_walk * gap_s
    stop(x, p, c)


@compiled
def stop(x: Matrix, p: Matrix, c: Coefficients) -> None:
    """Nothing is known of the velocity but how large it may be."""
    for i in range(VELOCITY, SIZE):
        forget(p, i, c.velocity_variance)
        x[i] = like(c.gate, 0.0)


@compiled_apart
def begin(
    q_nb: Quaternion,
    x: Matrix,
    p: Matrix,
    sample: Sample,
    use: tuple[bool, bool, bool],  # the accelerometer, the magnetometer, as the first after a gap
    status: Status,
    c: Coefficients,
) -> tuple[Quaternion, Status, bool]:
    """Tilt and heading, as far as they are missing and there is a sample to tell them; False: a field without north."""
    use_accel, use_mag, is_gap = use
    is_level, is_headed, is_ready, since_s, _, _ = status
    zero, found = like(c.gate, 0.0), True
    if is_gap:
        is_level, is_headed, is_ready = False, False, False
    if use_accel and not is_level:
        q_nb, is_level = upright(q_nb, rotate(q_nb, sample.accel_b_mps2), x, p, c), True
    if use_mag and is_level and not is_headed:
        turn, found = turn_to_north(rotate(q_nb, sample.mag_b_ut), c.declination_rad)
        if found:
            q_nb, is_headed = to_north(q_nb, turn, x, p, c), True
    return q_nb, Status(is_level, is_headed, is_ready, since_s, zero, zero), found


@compiled_apart
def upright(q_nb: Quaternion, force_n: Vector, x: Matrix, p: Matrix, c: Coefficients) -> Quaternion:
    """The tilt by which this specific force, now in n, points up; the heading stays."""
    for i in range(HEADING):
        forget(p, i, c.tilt_variance)
    stop(x, p, c)
    zero = like(c.gate, 0.0)
    return normalise(multiply(between(force_n, (zero, zero, like(zero, 1.0))), q_nb))


@compiled_apart
def to_north(q_nb: Quaternion, turn_rad: float, x: Matrix, p: Matrix, c: Coefficients) -> Quaternion:
    """n turned about up: what is known in its axes turns with it, all but the heading."""
    cosine, sine, a = cos(turn_rad), sin(turn_rad), identity(p)
    for i in (0, VELOCITY):
        a[i, i], a[i, i + 1], a[i + 1, i], a[i + 1, i + 1] = cosine, -sine, sine, cosine
    congruence(a, p)
    for i in range(HEADING, BIAS):
        forget(p, i, c.heading_variance)
    x[VELOCITY], x[VELOCITY + 1] = (
        x[VELOCITY] * cosine - x[VELOCITY + 1] * sine,
        x[VELOCITY] * sine + x[VELOCITY + 1] * cosine,
    )
    return normalise(multiply(about_up(turn_rad), q_nb))


@compiled
def is_due(turning: Turning, c: Coefficients) -> bool:
    """Whether the window is as long as wanted, but for rounding."""
    return turning.length_s > 0 and turning.length_s >= c.window_s * like(c.window_s, 1 - 1e-5)


@compiled_apart
def transition(window: Window, p: Matrix) -> Matrix:
    """Of the errors over a window: see the first lines."""
    a, half = identity(p), like(p[0, 0], 0.5)
    spread_s, up_mps = window.turning.spread_s, window.forces.push_n_mps[2]
    a[VELOCITY, 1], a[VELOCITY + 1, 0] = up_mps, -up_mps
    for j in range(3):
        axis = spread_s[j]
        a[0, BIAS + j], a[1, BIAS + j], a[2, BIAS + j] = -axis[0], -axis[1], -axis[2]
        a[VELOCITY, BIAS + j], a[VELOCITY + 1, BIAS + j] = -half * up_mps * axis[1], half * up_mps * axis[0]
    return a


@compiled
def attitude_noise(turning: Turning, c: Coefficients) -> float:
    """What the attitude's variance has gained since P by noise, per axis."""
    length_s = turning.length_s
    walked = c.bias_walk * length_s * length_s * length_s * like(length_s, 1 / 3)
    return c.gyro_noise * length_s + c.turn_error * turning.turned_rad + walked


@compiled_apart
def add_noise(p: Matrix, window: Window, c: Coefficients) -> None:
    """What the window's noise adds to P: the model's densities integrated with its transition."""
    length_s, spread_s, up_mps = window.turning.length_s, window.turning.spread_s, window.forces.push_n_mps[2]
    half, turn, walk = like(length_s, 0.5), attitude_noise(window.turning, c), c.bias_walk * length_s
    lost_mps = like(length_s, LOST_MPS2) * (length_s - window.forces.time_s)
    push = c.accel_noise * length_s + lost_mps * lost_mps + turn * up_mps * up_mps * like(length_s, 1 / 3)
    tilted = half * turn * up_mps
    for i in range(3):
        p[i, i] += turn
        p[BIAS + i, BIAS + i] += walk
        for j in range(3):
            p[i, BIAS + j] -= half * walk * spread_s[j][i]
            p[BIAS + j, i] = p[i, BIAS + j]
    for i in range(2):
        p[VELOCITY + i, VELOCITY + i] += push
        p[VELOCITY + i, 1 - i] += tilted if i == 0 else -tilted
        p[1 - i, VELOCITY + i] = p[VELOCITY + i, 1 - i]


@compiled_apart
def predict(x: Matrix, p: Matrix, window: Window, c: Coefficients) -> None:
    """Velocity and covariance at the end of the window."""
    push = window.forces.push_n_mps
    x[VELOCITY] += push[0]
    x[VELOCITY + 1] += push[1]
    congruence(transition(window, p), p)
    add_noise(p, window, c)
    round_up(p)
    unknown = like(c.gate, UNKNOWN_RAD2)
    for i in range(BIAS):
        if p[i, i] > unknown:
            widen(p, i, unknown / p[i, i])


@compiled
def innovation(x: Matrix, p: Matrix, m: Measurement) -> tuple[float, float]:
    """What is seen less what is expected, and its variance by the model."""
    ph = times(p, m.row)
    residual, variance = m.seen, m.variance
    for i in range(SIZE):
        residual -= m.row[i] * x[i]
        variance += m.row[i] * ph[i]
    return residual, variance


@compiled_apart
def update(x: Matrix, p: Matrix, m: Measurement, moves_tilt: bool, alpha: float, gate: float) -> bool:
    """x and P after a measurement, its innovation's variance times alpha; True when it was beyond the gate."""
    residual, model = innovation(x, p, m)
    variance, square = model * alpha, residual * residual
    is_beyond = square > gate * variance
    if is_beyond:
        variance = square / gate
    gain = times(p, m.row)
    for i in range(SIZE):
        gain[i] = gain[i] / variance if moves_tilt or i >= HEADING else like(gate, 0.0)
        x[i] += gain[i] * residual
    joseph(p, m.row, gain, variance - (model - m.variance))
    return is_beyond


@compiled
def of_one(p: Matrix, i: int, seen: float, variance: float) -> Measurement:
    """A measurement of x[i] itself."""
    row = np.zeros_like(p[0])
    row[i] = like(variance, 1.0)
    return Measurement(True, row, seen, variance)


@compiled_apart
def due(body: Body, c: Coefficients) -> Due:
    """Predict to the end of the window, and say what there is to update with."""
    length_s, still = body.window.turning.length_s, watch(body.still, means(body.window), c.limits)
    heading = heading_measurement(body.x, body.window, body.status.since_field_s, body.field, c)
    predict(body.x, body.p, body.window, c)
    resting, variance = is_resting(still, c.limits), c.velocity_variance / length_s
    return Due(still, resting, min(variance, like(variance, REST_MPS * REST_MPS)) if resting else variance, heading)


@compiled
def velocity_innovations(x: Matrix, p: Matrix, variance: float) -> tuple[float, float]:
    """East and north, whitened: of variance 1 and independent if the model is right."""
    s_east, s_north = p[VELOCITY, VELOCITY] + variance, p[VELOCITY + 1, VELOCITY + 1] + variance
    shared = p[VELOCITY, VELOCITY + 1] / s_east
    return -x[VELOCITY] / sqrt(s_east), (shared * x[VELOCITY] - x[VELOCITY + 1]) / sqrt(
        s_north - shared * shared * s_east
    )


@compiled_apart
def update_velocity(x: Matrix, p: Matrix, variance: float, alpha: float, gate: float) -> bool:
    """Tilt, bias and velocity by the measurement that the velocity is 0; True beyond the gate."""
    beyond = False
    for i in range(VELOCITY, SIZE):
        beyond = update(x, p, of_one(p, i, like(gate, 0.0), variance), True, alpha, gate) or beyond
    return beyond


@compiled_apart
def update_bias(x: Matrix, p: Matrix, turning: Turning, at: Due, c: Coefficients) -> None:
    """At rest the mean rate is the bias."""
    if not at.is_resting:
        return
    slow = rate_sd(at.still)
    variance = c.gyro_noise / turning.length_s + c.rest_variance + slow * slow
    for i in range(3):
        mean = turning.measured_b_rad[i] / turning.length_s
        update(x, p, of_one(p, BIAS + i, mean, variance), True, like(mean, 1.0), c.gate)


@compiled_apart
def heading_measurement(
    x: Matrix, window: Window, since_field_s: float, field: KnownField, c: Coefficients
) -> Measurement:
    """That the mean field of the window points to magnetic north; ``x`` is as it was during the window."""
    turning, fields = window.turning, window.fields
    one, half, length_s = like(c.gate, 1.0), like(c.gate, 0.5), turning.length_s
    field_n = scale(fields.sum_n_ut, one / max(fields.how_many, one))
    turn, found = turn_to_north(field_n, c.declination_rad)
    row = np.zeros_like(x)
    if not found:
        return Measurement(False, row, turn, one)
    square = field_n[0] * field_n[0] + field_n[1] * field_n[1]
    tan_dip = -field_n[2] / sqrt(square)
    row[0], row[1], row[HEADING] = tan_dip * sin(c.declination_rad), tan_dip * cos(c.declination_rad), one
    for j in range(3):  # the window's mean error is that at its end, and half of what the bias has done
        row[BIAS + j] = half * turning.spread_s[j][2]
        turn += row[BIAS + j] * x[BIAS + j]
    hold_s = min(since_field_s + length_s, max(length_s, like(square, LONGEST_HOLD_S)))
    disturbed = c.unseen * disturbance_ut2(field, looks(field_n, length_s))
    if field.known.seen_s > 0:  # the part of the Earth's field, not of a disturbance, says how well it points
        flat = field.known.size_ut * cos(field.known.dip_rad)
        square = max(flat * flat, square * like(square, 0.01))
    return Measurement(True, row, turn, (c.field_variance / hold_s + disturbed) / square)


@compiled
def nothing_new(c: Coefficients) -> Vector:
    """The innovations of a sample that ends no window."""
    none = like(c.gate, nan)
    return none, none, none


@compiled
def heading_innovation(x: Matrix, p: Matrix, m: Measurement) -> float:
    """Whitened, given what the updates before have moved; NaN without a field."""
    if not m.is_there:
        return like(m.seen, nan)
    residual, variance = innovation(x, p, m)
    return residual / sqrt(variance)


@compiled_apart
def update_heading(x: Matrix, p: Matrix, m: Measurement, alpha: float, status: Status, c: Coefficients) -> bool:
    """Heading and bias by the field; True beyond the gate."""
    if not m.is_there:
        return False
    if status.heading_doubt_s >= c.heading_patience_s:
        for i in range(HEADING, BIAS):
            forget(p, i, like(c.gate, UNKNOWN_RAD2))
    return update(x, p, m, False, alpha, c.gate)


@compiled
def is_oblique(forces: Forces) -> bool:
    """Whether the mean specific force points where it cannot for long, if the estimate is right."""
    up, size = forces.push_n_mps[2], norm(forces.push_n_mps)
    return up < size * like(size, OBLIQUE) and size > forces.time_s * like(size, LEAST_FORCE_MPS2)


@compiled_apart
def turn_errors(x: Matrix, p: Matrix) -> None:
    """P when the attitude's error stays as it is in body axes, which x is about to move in n."""
    a, axes = identity(p), axes_in_n(rotation.exp((x[0], x[1], x[2])))
    for j in range(3):
        axis = axes[j]
        a[0, j], a[1, j], a[2, j] = axis[0], axis[1], axis[2]
    congruence(a, p)


@compiled_apart
def corrected(body: Body, at: Due, beyond: tuple[bool, bool], c: Coefficients) -> Body:
    """The next window's beginning: the attitude moved by its error, and what the updates met."""
    q_nb, x, p, window, _, field, status, met = body
    is_level, is_headed, is_ready, since_s, tilt_doubt_s, heading_doubt_s = status
    n_free_fall, n_no_field, n_no_north, n_gaps, n_beyond, n_tilt, n_heading = met
    length_s, zero = window.turning.length_s, like(c.gate, 0.0)
    q_nb = normalise(multiply(rotation.exp((x[0], x[1], x[2])), q_nb))
    x[0], x[1], x[2] = zero, zero, zero
    is_ready = is_ready or p[0, 0] + p[1, 1] < like(zero, 2 * READY_RAD2)
    n_beyond += (1 if beyond[0] else 0) + (1 if beyond[1] else 0)
    tilt_doubt_s = tilt_doubt_s + length_s if beyond[0] or is_oblique(window.forces) else zero
    if tilt_doubt_s >= c.tilt_patience_s:
        q_nb = upright(q_nb, window.forces.push_n_mps, x, p, c)
        tilt_doubt_s, n_tilt = zero, n_tilt + 1
    since_s += length_s
    if at.heading.is_there:
        n_heading += 1 if heading_doubt_s >= c.heading_patience_s else 0
        heading_doubt_s = min(heading_doubt_s, c.heading_patience_s) + length_s if beyond[1] else zero
        seen = looks(scale(window.fields.sum_n_ut, like(zero, 1.0) / window.fields.how_many), length_s)
        field = learn(field, seen, window.turning.turned_rad / length_s, c.tolerance)
        since_s = zero
    elif window.fields.how_many > 0:
        n_no_north += 1
    status = Status(is_level, is_headed, is_ready, since_s, tilt_doubt_s, heading_doubt_s)
    met = Met(n_free_fall, n_no_field, n_no_north, n_gaps, n_beyond, n_tilt, n_heading)
    return Body(q_nb, x, p, no_samples(zero), at.still, field, status, met)


@compiled
def output(body: Body, innovations: Vector, c: Coefficients) -> Output:
    """The estimate after a sample, with the attitude's covariance there."""
    q_nb, x, p, window, _, _, status, _ = body
    cov_b = in_body_axes(p, window.turning.spread_s, attitude_noise(window.turning, c), q_nb)
    return Output(q_nb, (x[BIAS], x[BIAS + 1], x[BIAS + 2]), cov_b, innovations, status.is_ready)
