r"""``cf-fixed``: nonlinear (PI) complementary filter with fixed gains (Zia 2022, eq (10)).

The paper's eq (10), with x_g' the rate by the gyro and x_a the attitude by accelerometer and magnetometer, is ::

    x = (1/s) [x_g' + (kp + kI/s) (x_a - x)]                                                            (10)

As differential equations, with the error e = x_a - x and its integral::

    x' = x_g' + kp e + kI integral(e)

The last term converges to minus the gyro bias, so a constant bias leaves no error behind. It is the filter ``cf`` with
2 zeta w0 = kp and w0^2 = kI: the paper's (11) is that of Elmi Aziz and Mohseni Araste 2021. It differs from ``cf`` by
no low pass before it, the field levelled by the *estimated* roll and pitch (its eq (8)), and a forward difference for
the integrals, which makes the system of eq (21) exact in discrete time (see ``least_squares``)::

    x_k  =  x_(k-1) + T (x_g' + kI I_(k-1)) + T kp e_k          I_k  =  I_(k-1) + T e_k

**Angles.** The paper's x are roll, pitch and heading of a forward-right-down body in North-East-Down, corrected one by
one; ``frames.euler(q_nb, "ned")`` gives them back. Here x is a rotation and e is one, too: the smallest turn about a
horizontal axis that brings the measured up to the true one (roll and pitch, eqs (5), (6)), then a turn about the
vertical to north (heading, eqs (7), (8)). Hence no wrap, no five cases of arc tangents, and no singular pitch, where
(4) divides by cos(pitch). For small errors the two agree, but a pure roll error at a pitch p is a turn about the
vertical by its sine as well: what the paper sees as roll, the tilt and the heading share here. The integral lives in
body axes, where a gyro bias is constant; per Euler angle it is only as long as the body stays level.

**Misprints.** (9) has sine and cosine exchanged against (4) (it is q sin(roll) + r cos(roll)), and (8) lacks the term
m_z cos(roll) sin(pitch). Neither has a place in rotations.

**Irregular time.** T is the time since the last sample of that sensor, at most 1 s. No sample turns the estimate
further than its whole error (kp T <= 1, kI T^2 <= 1), so the filter is stable at any rate with any gains. After a gap
it starts again from the fields and keeps the integral.

**Fails** where the specific force is not gravity for longer than 1/kp: a vehicle in waves is tilted by the waves'
accelerations (0.4 m/s^2 are 2.3 deg), and the larger kp, the more of that is followed. Magnetic disturbances pass into
the heading alike. A small kp in turn is slow to forget a wrong start, and to find a bias. The default is a compromise:
on twelve trials of BROAD the median total error is 3.2 deg with it, 4.4 with kp = 1 and 2.8 with kp = 0.2; on a
simulated sea kp = 0.1-0.3 is best. No gain here adapts to when the sea is rough, nor do those of ``cf-lse``.
"""

from dataclasses import dataclass
from typing import NamedTuple

from stillpoint.datasets.compiled import compiled_entry, compiled_inside
from stillpoint.datasets.settings import Settings, number
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
from stillpoint.filters.fields import LONGEST_HOLD_S, Fields, Fresh, north_error, smooth_fields, tilt_error
from stillpoint.filters.rotation import Quaternion, add, conjugate, multiply, rotate
from stillpoint.filters.sample import Output, Sample

State = Observer


@dataclass(frozen=True)
class Params(Settings):
    """Parameters of ``cf-fixed``."""

    kp_per_s: float = number(0.5, 0.0, 10.0, "proportional gain kp of (10), 1/s: errors are forgotten in 1/kp")
    ki_per_s2: float = number(0.01, 0.0, 25.0, "integral gain kI of (10), 1/s^2; up to kp^2/4 nothing overshoots")


class Coefficients(NamedTuple):
    """Constants derived once from the parameters."""

    kp_per_s: float
    ki_per_s2: float
    settling_s: float  # three times the longest time constant of the error, without the slow pole's of the bias
    declination_rad: float  # east of true north


class Error(NamedTuple):
    """The error x_a - x of (10) that one sample shows, and the time it stands for; 0 where it shows nothing."""

    tilt_x: float  # about east and north, rad
    tilt_y: float
    tilt_s: float
    turn: float  # about up, rad
    turn_s: float
    is_first: bool  # the heading is the first one: taken, not approached
    n_no_north: int  # 1: a field that has no north


def coefficients(params: Params, declination_rad: float) -> Coefficients:
    """Precompute the filter's constants from its parameters and the local declination (east of true north)."""
    return Coefficients(params.kp_per_s, params.ki_per_s2, settling_time_s(params.kp_per_s), declination_rad)


def settling_time_s(kp_per_s: float) -> float:
    """Return three time constants of the error, at most ten minutes."""
    return min(3.0 / max(kp_per_s, 1e-9), 600.0)


@compiled_entry
def start(c: Coefficients) -> State:
    """Return the state before the first sample: level, with the body's x axis pointing north."""
    return start_observer(0.0)


@compiled_inside
def measure_error(
    q_nb: Quaternion, fields: Fields, fresh: Fresh, accel_s: float, is_headed: bool, declination_rad: float
) -> Error:
    """Return the rotation from an attitude to that of the fields; ``accel_s`` is the age of the last acceleration."""
    longest_s = LONGEST_HOLD_S
    tilt_x = tilt_y = tilt_s = turn = turn_s = 0.0
    is_first, n_no_north = False, 0
    if fresh.accel:
        tilt_x, tilt_y = tilt_error(rotate(q_nb, fields.accel_b_mps2))
        tilt_s = min(accel_s, longest_s)
    if fresh.mag:
        angle, found = north_error(rotate(q_nb, fields.mag_b_ut), declination_rad)
        if found:
            turn, turn_s, is_first = angle, min(fresh.mag_hold_s, longest_s), not is_headed
        else:
            n_no_north = 1
    return Error(tilt_x, tilt_y, tilt_s, turn, turn_s, is_first, n_no_north)


@compiled_inside
def correction_gains(kp_per_s: float, ki_per_s2: float, dt_s: float) -> tuple[float, float]:
    """Return the shares of an error, held over ``dt_s``, to turn the estimate by and to add to the bias (1/s)."""
    return min(kp_per_s * dt_s, 1.0), min(ki_per_s2 * dt_s, 1.0 / max(dt_s, 1e-9))


@compiled_inside
def _correct_state(state: State, error: Error, c: Coefficients) -> State:
    """Correct the predicted state by (10)."""
    q_nb, is_headed = state.q_nb, state.is_headed
    tilted, tilt_bias = correction_gains(c.kp_per_s, c.ki_per_s2, error.tilt_s)
    turned, turn_bias = correction_gains(c.kp_per_s, c.ki_per_s2, error.turn_s)
    if error.is_first:
        turned, turn_bias, is_headed = 1.0, 0.0, True
    gained_n = error.tilt_x * tilt_bias, error.tilt_y * tilt_bias, error.turn * turn_bias
    turn_n = error.tilt_x * tilted, error.tilt_y * tilted, error.turn * turned
    b_radps = add(state.b_radps, rotate(conjugate(q_nb), gained_n))
    return set_attitude(state, multiply(rotation.exp(turn_n), q_nb), b_radps, is_headed, error.n_no_north)


@compiled_inside
def step(state: State, sample: Sample, c: Coefficients) -> tuple[State, Output]:
    """Predict by the rate and the bias, then turn towards the attitude of the fields: one step of (10)."""
    accel_s = state.fields.since_accel_s + sample.dt_s
    fields, fresh = smooth_fields(state.fields, sample, 1.0)
    state = predict_observer(state, fields, sample, c.settling_s)
    if not state.is_level:
        state = begin_observer(state, fresh, c.declination_rad)
    elif fresh.accel or fresh.mag:
        error = measure_error(state.q_nb, fields, fresh, accel_s, state.is_headed, c.declination_rad)
        state = _correct_state(state, error, c)
    else:
        state = keep_prediction(state)
    return state, make_output(state, c.settling_s)
