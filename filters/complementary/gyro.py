"""``gyro``: the integrated rate, started from the fields and never corrected.

Elmi Aziz and Mohseni Araste 2021, eq (10), and Byambajav et al., eq (13). The rate is integrated as a rotation, which
is the limit of the papers' Euler kinematics (1) for short steps, without their singular pitch. On request the Euler
rates (1) are summed: z-y-x angles, with the rates at the beginning of the step. The first usable accelerometer sample
sets the tilt, the first field the heading. Across a gap the rate at its end is held.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

from stillpoint.datasets.compiled import compiled_entry, compiled_inside
from stillpoint.datasets.settings import Settings, choice
from stillpoint.filters import rotation
from stillpoint.filters.euler_axes import GIMBAL, euler_frame, tilt_rotation, turn_about_up
from stillpoint.filters.fields import Fields, level_rotation, north_error, smooth_fields, start_fields
from stillpoint.filters.rotation import Quaternion, Vector, blend, multiply, normalise, rotate, rotation_about_up, scale
from stillpoint.filters.sample import GAP_S, Output, Sample


@dataclass(frozen=True)
class Params(Settings):
    """Parameters of ``gyro``."""

    rule: Literal["rectangular", "trapezoidal"] = choice(
        "rectangular", "rate over an interval: of the sample that ends it, or the mean of both ends (Byambajav et al.)"
    )
    kinematics: Literal["rotation", "euler"] = choice(
        "rotation", "one rotation per interval, or the papers' Euler rates added up"
    )


class Coefficients(NamedTuple):
    """Constants derived once from the parameters."""

    newest: float  # share of the sample that ends the interval
    euler: bool
    declination_rad: float  # east of true north


class State(NamedTuple):
    """The state of the filter between two samples."""

    fields: Fields
    q_nb: Quaternion
    rate_b_radps: Vector  # of the sample before
    is_level: bool
    is_headed: bool
    n_gaps: int
    n_gimbal: int  # steps of Euler angles with x along the vertical, taken as a rotation


def coefficients(params: Params, declination_rad: float) -> Coefficients:
    """Precompute the filter's constants from its parameters and the local declination (east of true north)."""
    newest = 0.5 if params.rule == "trapezoidal" else 1.0
    return Coefficients(newest, params.kinematics == "euler", declination_rad)


@compiled_entry
def start(c: Coefficients) -> State:
    """Return the state before the first sample: level, with the body's x axis pointing north."""
    half = 0.5**0.5
    return State(start_fields(0.0), (half, 0.0, 0.0, half), (0.0, 0.0, 0.0), False, False, 0, 0)


@compiled_inside
def _turn_by_rate(q_nb: Quaternion, rate_b_radps: Vector, dt_s: float) -> Quaternion:
    """Rotate the attitude by one constant rate over the interval."""
    return multiply(q_nb, rotation.exp(scale(rate_b_radps, dt_s)))


@compiled_inside
def turn_by_euler_rates(q_nb: Quaternion, rate_b_radps: Vector, dt_s: float) -> tuple[Quaternion, bool]:
    """Integrate each Euler angle by its rate at the start of the interval; True where the rates are singular."""
    up, across, cos_pitch = euler_frame(q_nb)
    if cos_pitch < GIMBAL:
        return _turn_by_rate(q_nb, rate_b_radps, dt_s), True
    heading = (up[1] * rate_b_radps[1] + up[2] * rate_b_radps[2]) / (cos_pitch * cos_pitch)
    pitch = across[1] * rate_b_radps[1] + across[2] * rate_b_radps[2]
    roll = rate_b_radps[0] - up[0] * heading
    return turn_about_up(multiply(q_nb, tilt_rotation(roll * dt_s, pitch * dt_s, across)), heading * dt_s), False


@compiled_inside
def step(state: State, sample: Sample, c: Coefficients) -> tuple[State, Output]:
    """Turn by the rate times the interval."""
    fields, q_nb, _, is_level, is_headed, n_gaps, n_gimbal = state
    if is_level:
        rate = blend(sample.gyro_b_radps, state.rate_b_radps, c.newest)
        if c.euler:
            q_nb, is_singular = turn_by_euler_rates(q_nb, rate, sample.dt_s)
            n_gimbal += is_singular
        else:
            q_nb = _turn_by_rate(q_nb, rate, sample.dt_s)
        q_nb = normalise(q_nb)
    if sample.dt_s > GAP_S:
        n_gaps += 1
    if not (is_level and is_headed):
        fields, fresh = smooth_fields(fields, sample, 1.0)
        if fresh.accel and not is_level:
            q_nb, is_level = multiply(level_rotation(q_nb, fields.accel_b_mps2), q_nb), True
        if fresh.mag and is_level:
            turn, is_headed = north_error(rotate(q_nb, fields.mag_b_ut), c.declination_rad)
            q_nb = multiply(rotation_about_up(turn), q_nb) if is_headed else q_nb
    state = State(fields, q_nb, sample.gyro_b_radps, is_level, is_headed, n_gaps, n_gimbal)
    return state, Output(q_nb, None, None, None, is_level)
