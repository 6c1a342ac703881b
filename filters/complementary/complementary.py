"""``cf``: second-order complementary filter of gyro and accelerometer/magnetometer attitude.

Elmi Aziz and Mohseni Araste 2021, eq (11), is estimate = F(s) acc + (1 - F(s)) gyro with
F = (2 zeta w0 s + w0^2) / (s^2 + 2 zeta w0 s + w0^2). Since gyro is the integral of the rate, that is the gyro's
attitude plus F applied to the difference, or, as differential equations with e = acc - estimate and an integral b::

    estimate' = rate + b + 2 zeta w0 e        b' = w0^2 e

so -b is a gyro bias. Here e is a rotation, never a difference of angles: a tilt about a horizontal axis from the
accelerometer (the paper's roll and pitch) and a turn about up from the magnetometer (its yaw). It has no wrap and no
singular pitch. b is kept in body axes, where a gyro bias is constant (the paper's is constant per Euler angle).

Over one interval the difference acc - gyro is held constant, which makes the step exact for any interval: (e, b) is
multiplied by the matrix exponential of the equations. After a gap the filter starts again and keeps b.
"""

from dataclasses import dataclass
from math import cos, exp, sin, sqrt
from typing import Literal, NamedTuple

from stillpoint.datasets.compiled import compiled, compiled_entry, compiled_inside
from stillpoint.datasets.settings import Settings, choice, number
from stillpoint.filters import rotation
from stillpoint.filters.complementary.pi_observer import (
    Observer,
    begin_observer,
    keep_prediction,
    make_output,
    predict_observer,
    set_attitude,
    start_observer,
)
from stillpoint.filters.fields import LONGEST_HOLD_S, Fresh, level_vector, north_error, smooth_fields, tilt_error
from stillpoint.filters.rotation import conjugate, multiply, norm, rotate, scale
from stillpoint.filters.sample import Output, Sample

State = Observer


@dataclass(frozen=True)
class Params(Settings):
    """Parameters of ``cf``."""

    omega0_radps: float = number(0.25, 1e-4, 100.0, "natural frequency w0 of (11), rad/s")
    zeta: float = number(3.0, 0.01, 100.0, "damping ratio of (11)")
    kappa: float = number(0.7, 0.0, 1.0, "share of the newest raw sample in the low pass (9); 1 = no low pass")
    levelled_by: Literal["acc", "estimate"] = choice(
        "acc", "tilt by which (5) levels the field: the accelerometer's, as the paper has it, or the estimate's"
    )


class Coefficients(NamedTuple):
    """Constants derived once from the parameters."""

    damping_radps: float  # zeta w0
    stiffness: float  # w0^2, 1/s^2
    split: float  # w0^2 (zeta^2 - 1), 1/s^2: the square of half the distance of the two poles
    kappa: float
    level_by_acc: bool
    settling_s: float  # three times the longest time constant of the error, without the slow pole's of the bias
    declination_rad: float  # east of true north


def coefficients(params: Params, declination_rad: float) -> Coefficients:
    """Precompute the filter's constants from its parameters and the local declination (east of true north)."""
    w0, zeta = params.omega0_radps, params.zeta
    settling_s = 3.0 / (w0 * zeta) if zeta < 1 else 3.0 / (2.0 * zeta * w0)
    return Coefficients(
        zeta * w0,
        w0 * w0,
        w0 * w0 * (zeta * zeta - 1.0),
        params.kappa,
        params.levelled_by == "acc",
        settling_s,
        declination_rad,
    )


@compiled_entry
def start(c: Coefficients) -> State:
    """Return the state before the first sample: level, with the body's x axis pointing north."""
    return start_observer(0.0)


@compiled
def transition_matrix(dt_s: float, c: Coefficients) -> tuple[float, float, float, float]:
    """Return the rows of exp(A dt), A = [[-2 zeta w0, -1], [w0^2, 0]]: how (e, b) evolves over an interval."""
    square = c.split * dt_s * dt_s
    if abs(square) < 1e-4:  # short intervals, and zeta = 1 where the two poles meet
        even = exp(-c.damping_radps * dt_s)
        odd = even * dt_s * (1.0 + square * ((1 / 6) + square * (1 / 120)))
        even *= 1.0 + square * (0.5 + square * (1 / 24))
    elif square > 0:
        root = sqrt(c.split)
        slow, fast = exp((root - c.damping_radps) * dt_s), exp(-(root + c.damping_radps) * dt_s)
        even, odd = (slow + fast) * 0.5, (slow - fast) * 0.5 / root
    else:
        root, decay = sqrt(-c.split), exp(-c.damping_radps * dt_s)
        even, odd = decay * cos(root * dt_s), decay * sin(root * dt_s) / root
    damped = c.damping_radps * odd
    return even - damped, -odd, c.stiffness * odd, even + damped


@compiled_inside
def correct_component(e: float, b: float, dt_s: float, rows: tuple[float, float, float, float]) -> tuple[float, float]:
    """Return the turn of the estimate about one axis, and the new b, after ``dt_s`` of eq (11).

    ``e`` is the error left after the estimate was moved on by rate and b; in (11), b acts within the interval.
    """
    before = e + b * dt_s
    return e - (rows[0] * before + rows[1] * b), rows[2] * before + rows[3] * b


@compiled_inside
def _correct_state(state: State, dt_s: float, fresh: Fresh, c: Coefficients) -> State:
    """Turn the predicted state towards the attitude of the fields."""
    fields, q_nb, is_headed, n_no_north = state.fields, state.q_nb, state.is_headed, 0
    up_n = rotate(q_nb, scale(fields.accel_b_mps2, 1.0 / norm(fields.accel_b_mps2)))
    tilt_x, tilt_y = tilt_error(up_n)
    turn = 0.0
    b_east, b_north, b_up = rotate(q_nb, state.b_radps)
    rows = transition_matrix(dt_s, c)
    tilt_x, b_east = correct_component(tilt_x, b_east, dt_s, rows)
    tilt_y, b_north = correct_component(tilt_y, b_north, dt_s, rows)
    if fresh.mag:
        field_n = rotate(q_nb, fields.mag_b_ut)
        error, found = north_error(level_vector(field_n, up_n) if c.level_by_acc else field_n, c.declination_rad)
        if not found:
            n_no_north = 1
        elif is_headed:
            hold_s = min(fresh.mag_hold_s, max(dt_s, LONGEST_HOLD_S))
            turn, b_up = correct_component(
                error, b_up, hold_s, rows if hold_s == dt_s else transition_matrix(hold_s, c)
            )
        else:  # the first heading is taken, not approached
            turn, is_headed = error, True
    b_radps = rotate(conjugate(q_nb), (b_east, b_north, b_up))
    return set_attitude(state, multiply(rotation.exp((tilt_x, tilt_y, turn)), q_nb), b_radps, is_headed, n_no_north)


@compiled_inside
def step(state: State, sample: Sample, c: Coefficients) -> tuple[State, Output]:
    """Predict by the rate and b, then turn towards the attitude of the fields."""
    fields, fresh = smooth_fields(state.fields, sample, c.kappa)
    state = predict_observer(state, fields, sample, c.settling_s)
    if not state.is_level:
        state = begin_observer(state, fresh, c.declination_rad)
    elif fresh.accel:
        state = _correct_state(state, sample.dt_s, fresh, c)
    else:
        state = keep_prediction(state)
    return state, make_output(state, c.settling_s)
