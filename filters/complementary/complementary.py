"""``cf``: second-order complementary filter of gyro and accelerometer/magnetometer attitude (paper 002, eq (11)).

Eq (11) says estimate = F(s) acc + (1 - F(s)) gyro with F = (2 zeta w0 s + w0^2) / (s^2 + 2 zeta w0 s + w0^2). With
gyro = integral of the rate that is the gyro's attitude plus F applied to the difference, or, as differential equations
for the error e = acc - estimate and an integral b::

    estimate' = rate + b + 2 zeta w0 e        b' = w0^2 e

so -b is a gyro bias. Here e is a rotation, never a difference of angles: a tilt about a horizontal axis from the
accelerometer (the paper's roll and pitch) and a turn about up from the magnetometer (its yaw), with no wrap and no
singular pitch. b lives in body axes, where a gyro bias is constant (the paper's is constant per Euler angle).

Over one interval the difference acc - gyro is taken as constant, which makes the step exact for any length of it:
(e, b) is multiplied by the matrix exponential of the equations. After a gap the filter starts again and keeps b.
"""

from dataclasses import dataclass
from math import cos, exp, sin, sqrt
from typing import Literal, NamedTuple

from stillpoint.datasets.settings import Settings, choice, number
from stillpoint.filters import rotation
from stillpoint.filters.compiled import compiled, compiled_entry, compiled_inside
from stillpoint.filters.complementary.pi_observer import (
    Observer,
    begun,
    corrected,
    moved_on,
    said,
    uncorrected,
    unlevelled,
)
from stillpoint.filters.fields import LONGEST_HOLD_S, Fresh, levelled, low_pass, tilt_of, turn_to_north
from stillpoint.filters.rotation import conjugate, multiply, norm, rotate, scale
from stillpoint.filters.sample import Log, Output, Sample, Track, keep, sample_at

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
    """Derived once from the parameters."""

    damping_radps: float  # zeta w0
    stiffness: float  # w0^2, 1/s^2
    split: float  # w0^2 (zeta^2 - 1), 1/s^2: the square of half the distance of the two poles
    kappa: float
    level_by_acc: bool
    settling_s: float  # three times the longest time constant of the error, without the slow pole's of the bias
    declination_rad: float  # east of true north


def coefficients(params: Params, declination_rad: float) -> Coefficients:
    """Of these parameters at a place with this declination (east of true north)."""
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
    """Before the first sample: level, x over north."""
    return unlevelled(0.0)


@compiled
def transition(dt_s: float, c: Coefficients) -> tuple[float, float, float, float]:
    """Rows of exp(A dt) with A = [[-2 zeta w0, -1], [w0^2, 0]]: what becomes of (e, b) while the difference stands."""
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
def correct(e: float, b: float, dt_s: float, rows: tuple[float, float, float, float]) -> tuple[float, float]:
    """One component of (11) over ``dt_s``: by how much to turn the estimate, and the new b.

    ``e`` is the error left after the estimate was moved on by rate and b; in (11), b acts within the interval.
    """
    before = e + b * dt_s
    return e - (rows[0] * before + rows[1] * b), rows[2] * before + rows[3] * b


@compiled_inside
def pulled(state: State, dt_s: float, fresh: Fresh, c: Coefficients) -> State:
    """The predicted state turned towards the attitude of the fields."""
    fields, q_nb, is_headed, n_no_north = state.fields, state.q_nb, state.is_headed, 0
    up_n = rotate(q_nb, scale(fields.accel_b_mps2, 1.0 / norm(fields.accel_b_mps2)))
    tilt_x, tilt_y = tilt_of(up_n)
    turn = 0.0
    b_east, b_north, b_up = rotate(q_nb, state.b_radps)
    rows = transition(dt_s, c)
    tilt_x, b_east = correct(tilt_x, b_east, dt_s, rows)
    tilt_y, b_north = correct(tilt_y, b_north, dt_s, rows)
    if fresh.mag:
        field_n = rotate(q_nb, fields.mag_b_ut)
        error, found = turn_to_north(levelled(field_n, up_n) if c.level_by_acc else field_n, c.declination_rad)
        if not found:
            n_no_north = 1
        elif is_headed:
            hold_s = min(fresh.mag_hold_s, max(dt_s, LONGEST_HOLD_S))
            turn, b_up = correct(error, b_up, hold_s, rows if hold_s == dt_s else transition(hold_s, c))
        else:  # the first heading is taken, not approached
            turn, is_headed = error, True
    b_radps = rotate(conjugate(q_nb), (b_east, b_north, b_up))
    return corrected(state, multiply(rotation.exp((tilt_x, tilt_y, turn)), q_nb), b_radps, is_headed, n_no_north)


@compiled_inside
def step(state: State, sample: Sample, c: Coefficients) -> tuple[State, Output]:
    """Move on by rate and b, then turn towards the attitude of the fields."""
    fields, fresh = low_pass(state.fields, sample, c.kappa)
    state = moved_on(state, fields, sample, c.settling_s)
    if not state.is_level:
        state = begun(state, fresh, c.declination_rad)
    elif fresh.accel:
        state = pulled(state, sample.dt_s, fresh, c)
    else:
        state = uncorrected(state)
    return state, said(state, c.settling_s)


@compiled_entry
def run(log: Log, state: State, c: Coefficients, track: Track) -> State:
    """Every sample of a log."""
    for k in range(len(log.dt_s)):
        state, output = step(state, sample_at(log, k), c)
        keep(track, k, output)
    return state
