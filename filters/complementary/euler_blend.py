"""``cf-literal``: the complementary filter of Elmi Aziz and Mohseni Araste 2021, eq (11), as the paper prints it.

For each of roll, pitch and yaw, estimate = F(s) acc + (1 - F(s)) gyro, where acc is the angle by (4)-(8) and gyro the
angle by the integrated Euler rates (10). The gyro's angles are never corrected (open loop), so their errors of tilt
grow and turn the Euler rates; no filter of single angles takes that off again. ``cf`` blends the same signals on the
rotation and feeds its estimate back.

F(s) is discretised as in ``cf``: with y = F(s) (acc - gyro), e = acc - gyro - y and an integral b,
y' = b + 2 zeta w0 e and b' = w0^2 e, exactly over an interval in which acc - gyro is held. Angles are wrapped in e
only. After a gap the gyro's angles start again from the fields, and b is kept.
"""

from dataclasses import dataclass
from math import atan2, cos, pi, sin, sqrt
from typing import NamedTuple

from stillpoint.datasets.compiled import compiled_entry, compiled_inside
from stillpoint.datasets.settings import Settings, number
from stillpoint.filters.complementary import complementary
from stillpoint.filters.complementary.complementary import correct_component, transition_matrix
from stillpoint.filters.complementary.gyro import turn_by_euler_rates
from stillpoint.filters.fields import (
    LONGEST_HOLD_S,
    Fields,
    Fresh,
    level_attitude,
    level_rotation,
    north_error,
    smooth_fields,
    start_fields,
)
from stillpoint.filters.rotation import Quaternion, Vector, add, multiply, normalise, rotate, rotation_about_up, scale
from stillpoint.filters.sample import GAP_S, Output, Sample

Coefficients = complementary.Coefficients


@dataclass(frozen=True)
class Params(Settings):
    """Parameters of ``cf-literal``."""

    omega0_radps: float = number(0.25, 1e-4, 100.0, "natural frequency w0 of (11), rad/s")
    zeta: float = number(3.0, 0.01, 100.0, "damping ratio of (11)")
    kappa: float = number(0.7, 0.0, 1.0, "share of the newest raw sample in the low pass (9); 1 = no low pass")


class State(NamedTuple):
    """The state of the filter between two samples. Triples of angles are roll, pitch, yaw."""

    fields: Fields
    q_gyro_nb: Quaternion  # by (10), never corrected
    added_rad: Vector  # y: what F(s) adds to the gyro's angles
    b_radps: Vector
    age_s: float  # since the start, up to the settling time
    is_level: bool  # False until the first tilt, and after a gap
    is_headed: bool
    n_gaps: int
    n_gimbal: int  # steps of (10) with x along the vertical, taken as a rotation
    n_no_north: int  # magnetometer samples left out: no horizontal field


def coefficients(params: Params, declination_rad: float) -> Coefficients:
    """Precompute the filter's constants from its parameters and the local declination (east of true north)."""
    same = complementary.Params(params.omega0_radps, params.zeta, params.kappa)
    return complementary.coefficients(same, declination_rad)


@compiled_entry
def start(c: Coefficients) -> State:
    """Return the state before the first sample: level, with the body's x axis pointing north."""
    half, none = 0.5**0.5, (0.0, 0.0, 0.0)
    return State(start_fields(0.0), (half, 0.0, 0.0, half), none, none, 0.0, False, False, 0, 0, 0)


@compiled_inside
def wrap_angle(angle: float) -> float:
    """Return an angle of less than three half turns in (-pi, pi]."""
    whole, half = 2.0 * pi, pi
    if angle > half:
        return angle - whole
    return angle + whole if angle <= -half else angle


@compiled_inside
def _find_angles(q: Quaternion) -> Vector:
    """Return the z-y-x Euler angles of an attitude in rad: roll, pitch, and yaw counter-clockwise from east."""
    w, x, y, z = q
    up_x, up_y, up_z = (x * z - w * y) * 2.0, (y * z + w * x) * 2.0, 1.0 - (x * x + y * y) * 2.0
    roll, pitch = atan2(up_y, up_z), atan2(-up_x, sqrt(up_y * up_y + up_z * up_z))
    return roll, pitch, atan2((x * y + w * z) * 2.0, 1.0 - (y * y + z * z) * 2.0)


@compiled_inside
def _add_angles(q: Quaternion, added_rad: Vector) -> Quaternion:
    """Return the attitude whose Euler angles are those of ``q`` plus the given ones."""
    roll, pitch, yaw = _find_angles(q)
    roll, pitch = (roll + added_rad[0]) * 0.5, (pitch + added_rad[1]) * 0.5
    zero = roll - roll
    q_level = multiply((cos(pitch), zero, sin(pitch), zero), (cos(roll), sin(roll), zero, zero))
    return multiply(rotation_about_up(yaw + added_rad[2]), q_level)


@compiled_inside
def predict_state(before: State, fields: Fields, sample: Sample, c: Coefficients) -> State:
    """Turn the gyro's angles by the Euler rates (10) and add b to the others; after a gap the state is not level."""
    _, q_gyro, added, b, age_s, is_level, is_headed, n_gaps, n_gimbal, n_no_north = before
    dt_s = sample.dt_s
    if is_level and dt_s > GAP_S:
        q_gyro, added = normalise(_add_angles(q_gyro, added)), scale(added, dt_s - dt_s)
        is_level, is_headed, n_gaps = False, False, n_gaps + 1
    age_s = min(age_s + dt_s, c.settling_s) if is_level else 0.0
    if is_level:
        q_gyro, is_singular = turn_by_euler_rates(q_gyro, sample.gyro_b_radps, dt_s)
        q_gyro, added, n_gimbal = normalise(q_gyro), add(added, scale(b, dt_s)), n_gimbal + is_singular
    return State(fields, q_gyro, added, b, age_s, is_level, is_headed, n_gaps, n_gimbal, n_no_north)


@compiled_inside
def begin_state(state: State, fresh: Fresh, c: Coefficients) -> State:
    """Set the gyro's angles to those of the fields; keep the heading if there is no new field."""
    fields, q_gyro, added, b, age_s, is_level, is_headed, n_gaps, n_gimbal, n_no_north = state
    if fresh.accel:
        q_gyro, is_level = multiply(level_rotation(q_gyro, fields.accel_b_mps2), q_gyro), True
        if fresh.mag:
            turn_rad, is_headed = north_error(rotate(q_gyro, fields.mag_b_ut), c.declination_rad)
            q_gyro = multiply(rotation_about_up(turn_rad), q_gyro) if is_headed else q_gyro
        q_gyro = normalise(q_gyro)
    return State(fields, q_gyro, added, b, age_s, is_level, is_headed, n_gaps, n_gimbal, n_no_north)


@compiled_inside
def correct_state(state: State, dt_s: float, fresh: Fresh, c: Coefficients) -> State:
    """Let F(s) of (11) act on the fields' angles less the gyro's, each angle by itself."""
    fields, q_gyro, (roll, pitch, yaw), b, age_s, is_level, is_headed, n_gaps, n_gimbal, n_no_north = state
    gyro_angles = _find_angles(q_gyro)
    q_level = level_attitude(fields.accel_b_mps2)
    level_angles = _find_angles(q_level)
    rows = transition_matrix(dt_s, c)
    roll_error = wrap_angle(wrap_angle(level_angles[0] - gyro_angles[0]) - roll)
    pitch_error = wrap_angle(level_angles[1] - gyro_angles[1] - pitch)
    turn, b_roll = correct_component(roll_error, b[0], dt_s, rows)
    roll += turn
    turn, b_pitch = correct_component(pitch_error, b[1], dt_s, rows)
    pitch += turn
    b_yaw = b[2]
    if fresh.mag:
        north_rad, found = north_error(rotate(q_level, fields.mag_b_ut), c.declination_rad)
        error = wrap_angle(wrap_angle(wrap_angle(level_angles[2] + north_rad) - gyro_angles[2]) - yaw)
        if not found:
            n_no_north += 1
        elif is_headed:
            hold_s = min(fresh.mag_hold_s, max(dt_s, LONGEST_HOLD_S))
            turn, b_yaw = correct_component(
                error, b_yaw, hold_s, rows if hold_s == dt_s else transition_matrix(hold_s, c)
            )
            yaw += turn
        else:  # the first heading is taken, not approached
            q_gyro, is_headed = normalise(multiply(rotation_about_up(error), q_gyro)), True
    added, b = (wrap_angle(roll), wrap_angle(pitch), wrap_angle(yaw)), (b_roll, b_pitch, b_yaw)
    return State(fields, q_gyro, added, b, age_s, is_level, is_headed, n_gaps, n_gimbal, n_no_north)


@compiled_inside
def step(state: State, sample: Sample, c: Coefficients) -> tuple[State, Output]:
    """Predict by (10) and b, then let the fields correct what F(s) adds."""
    fields, fresh = smooth_fields(state.fields, sample, c.kappa)
    state = predict_state(state, fields, sample, c)
    if not state.is_level:
        state = begin_state(state, fresh, c)
    elif fresh.accel:
        state = correct_state(state, sample.dt_s, fresh, c)
    ready = state.is_level and state.age_s >= c.settling_s
    return state, Output(normalise(_add_angles(state.q_gyro_nb, state.added_rad)), None, None, None, ready)
