"""``cf``: second-order complementary filter of the gyro and the accelerometer/magnetometer attitude (paper 002, eq (11)).

Eq (11) says estimate = F(s) acc + (1 - F(s)) gyro with F = (2 zeta w0 s + w0^2) / (s^2 + 2 zeta w0 s + w0^2). With
gyro = integral of the rate that is the gyro's attitude plus F applied to the difference, or, as differential equations
for the error e = acc - estimate and an integral b::

    estimate' = rate + b + 2 zeta w0 e        b' = w0^2 e

so -b is a gyro bias. Here the difference is a rotation vector, never a difference of angles: it has no wrap and no
singular pitch. b lives in body axes, where a gyro bias is constant (the paper's, per Euler angle, is constant in n).
Over one interval the difference is constant, which makes the step exact for any length of it: (e, b) is multiplied by
the matrix exponential of the equations. After a long gap the step therefore lands on the acc/mag attitude by itself.
"""

from dataclasses import dataclass
from math import atan2, cos, exp, sin, sqrt
from typing import NamedTuple

from stillpoint.filters import rotation
from stillpoint.filters.compiled import compiled, like
from stillpoint.filters.fields import Fields, compass, level, low_pass, no_fields
from stillpoint.filters.parameters import Parameters, parameter
from stillpoint.filters.rotation import (
    Quaternion,
    Vector,
    about_up,
    add,
    between,
    conjugate,
    multiply,
    normalise,
    rotate,
    scale,
)
from stillpoint.filters.sample import GAP_S, Log, Output, Sample, Track, keep, sample_at

# One field stands for at most that long: after a pause of the magnetometer, a single sample is not taken at its word.
LONGEST_HOLD_S = 1.0


@dataclass(frozen=True)
class Params(Parameters):
    """Parameters of ``cf``."""

    omega0_radps: float = parameter(0.25, "natural frequency w0 of (11), rad/s", 1e-4, 100.0)
    zeta: float = parameter(3.0, "damping ratio of (11)", 0.01, 100.0)
    kappa: float = parameter(0.7, "share of the newest raw sample in the low pass (9); 1 = no low pass", 0.0, 1.0)


class Coefficients(NamedTuple):
    """Derived once from the parameters."""

    decay_radps: float  # zeta w0
    stiffness: float  # w0^2
    split: float  # w0^2 (zeta^2 - 1): the square of half the distance of the two poles
    kappa: float
    declination_rad: float  # east of true north
    settling_s: float


class State(NamedTuple):
    """What is remembered."""

    fields: Fields
    q_nb: Quaternion
    b_radps: Vector  # of (11), in body axes: minus the gyro bias
    since_mag_s: float  # since the last heading
    age_s: float  # since the start, up to the settling time
    is_started: bool  # has had a tilt
    is_level: bool  # False until the first tilt, and after a gap
    is_headed: bool  # False until the first heading, and after a gap
    n_gaps: int
    n_no_north: int  # magnetometer samples left out: no horizontal field


def coefficients(params: Params, declination_rad: float) -> Coefficients:
    """Of these parameters at a place with this declination (east of true north)."""
    w0, zeta = params.omega0_radps, params.zeta
    settling_s = 3.0 / (2.0 * zeta * w0) if zeta >= 1 else 3.0 / (zeta * w0)
    return Coefficients(zeta * w0, w0 * w0, w0 * w0 * (zeta * zeta - 1.0), params.kappa, declination_rad, settling_s)


@compiled
def start(c: Coefficients) -> State:
    """Before the first sample."""
    one, zero = like(c.kappa, 1.0), like(c.kappa, 0.0)
    return State(no_fields(zero), (one, zero, zero, zero), (zero, zero, zero), zero, zero, False, False, False, 0, 0)


@compiled
def transition(dt_s: float, c: Coefficients) -> tuple[float, float, float, float]:
    """Rows of exp(A dt) with A = [[-2 zeta w0, -1], [w0^2, 0]]: what becomes of (e, b) while the difference stands."""
    square = c.split * dt_s * dt_s
    if abs(square) < like(square, 1e-4):  # also where the two poles meet
        even = exp(-c.decay_radps * dt_s)
        odd = even * dt_s * (like(square, 1.0) + square * (like(square, 1 / 6) + square * like(square, 1 / 120)))
        even *= like(square, 1.0) + square * (like(square, 0.5) + square * like(square, 1 / 24))
    elif square > 0:
        half = sqrt(c.split)
        slow, fast = exp((half - c.decay_radps) * dt_s), exp(-(half + c.decay_radps) * dt_s)
        even, odd = (slow + fast) * like(half, 0.5), (slow - fast) * like(half, 0.5) / half
    else:
        half, decay = sqrt(-c.split), exp(-c.decay_radps * dt_s)
        even, odd = decay * cos(half * dt_s), decay * sin(half * dt_s) / half
    damping = c.decay_radps * odd
    return even - damping, -odd, c.stiffness * odd, even + damping


@compiled
def correct(e: float, b: float, dt_s: float, c: Coefficients) -> tuple[float, float]:
    """One component of (11) over ``dt_s``: by how much to turn the estimate, and the new b.

    ``e`` is the error left after the estimate was moved on by rate and b; in (11), b acts within the interval.
    """
    ee, eb, be, bb = transition(dt_s, c)
    before = e + b * dt_s
    return e - (ee * before + eb * b), be * before + bb * b


@compiled
def begin(state: State, fields: Fields, new_mag: bool, c: Coefficients) -> tuple[Quaternion, bool, bool]:
    """The attitude to start from: by the fields, or upright with the heading that there was; is it level, headed?"""
    if new_mag:
        q_nb, found = compass(fields.accel, fields.mag, c.declination_rad)
        if found:
            return q_nb, True, True
    if not state.is_started:
        return level(fields.accel), True, False
    zero = like(c.kappa, 0.0)
    upright = between(rotate(state.q_nb, fields.accel), (zero, zero, like(zero, 1.0)))
    return multiply(upright, state.q_nb), True, False


@compiled
def pull(
    q_nb: Quaternion,
    b: Vector,
    fields: Fields,
    new_mag: bool,
    is_headed: bool,
    dt_s: float,
    since_mag_s: float,
    c: Coefficients,
) -> tuple[Quaternion, Vector, bool, bool]:
    """Attitude and b after the correction by the fields; was there a heading before, and one now?"""
    zero, one = like(dt_s, 0.0), like(dt_s, 1.0)
    found = False
    q_error = (one, zero, zero, zero)
    if new_mag:
        q_fields, found = compass(fields.accel, fields.mag, c.declination_rad)
        q_error = multiply(q_fields, conjugate(q_nb))
        if found and not is_headed:  # the first heading is taken, not approached
            turn = about_up(like(dt_s, 2.0) * atan2(q_error[3], q_error[0]))
            q_nb = multiply(turn, q_nb)
            q_error = multiply(q_fields, conjugate(q_nb))
            is_headed = True
    if not found:
        q_error = between(rotate(q_nb, fields.accel), (zero, zero, one))
    e = rotation.log(q_error)
    bx, by, bz = rotate(q_nb, b)
    turn_x, bx = correct(e[0], bx, dt_s, c)
    turn_y, by = correct(e[1], by, dt_s, c)
    turn_z = zero
    if found:
        turn_z, bz = correct(e[2], bz, min(since_mag_s, max(dt_s, like(dt_s, LONGEST_HOLD_S))), c)
    b = rotate(conjugate(q_nb), (bx, by, bz))
    return normalise(multiply(rotation.exp((turn_x, turn_y, turn_z)), q_nb)), b, is_headed, found


@compiled
def step(state: State, sample: Sample, c: Coefficients) -> tuple[State, Output]:
    """Move on by rate and b, then turn towards the attitude of the fields."""
    fields, new_accel, new_mag = low_pass(state.fields, sample, c.kappa)
    q_nb, b, age_s = state.q_nb, state.b_radps, min(state.age_s + sample.dt_s, c.settling_s)
    is_level, is_headed = state.is_level, state.is_headed
    since_mag_s = state.since_mag_s + sample.dt_s
    n_gaps, n_no_north = state.n_gaps, state.n_no_north
    if sample.dt_s > like(sample.dt_s, GAP_S) and state.is_started:
        is_level, is_headed, n_gaps = False, False, n_gaps + 1
    if not is_level:
        age_s = like(age_s, 0.0)
        if new_accel:
            q_nb, is_level, is_headed = begin(state, fields, new_mag, c)
            since_mag_s = like(age_s, 0.0)
    else:
        turned = scale(add(sample.gyro_b_radps, b), sample.dt_s)
        q_nb = normalise(multiply(q_nb, rotation.exp(turned)))
        if new_accel:
            q_nb, b, is_headed, found = pull(q_nb, b, fields, new_mag, is_headed, sample.dt_s, since_mag_s, c)
            if new_mag and found:
                since_mag_s = like(age_s, 0.0)
            elif new_mag:
                n_no_north += 1
    is_started = state.is_started or is_level
    ready = is_level and age_s >= c.settling_s
    state = State(fields, q_nb, b, since_mag_s, age_s, is_started, is_level, is_headed, n_gaps, n_no_north)
    return state, Output(q_nb, (-b[0], -b[1], -b[2]), None, None, ready)


@compiled
def run(log: Log, state: State, c: Coefficients, track: Track) -> State:
    """Every sample of a log."""
    for k in range(len(log.dt_s)):
        state, output = step(state, sample_at(log, k), c)
        keep(track, k, output)
    return state
