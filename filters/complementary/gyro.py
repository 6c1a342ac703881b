"""``gyro``: the integrated rate, started from the fields and never corrected (paper 002, eq (10); paper 004, eq (13)).

Integrated as a rotation, which is what the Euler kinematics (1) of the papers come to with short steps, without their
singular pitch; on request by (1) itself, z-y-x angles with the rates at the beginning of the step. The first usable
accelerometer sample sets the tilt, the first field the heading; across a gap the rate at its end is held.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

from stillpoint.datasets.settings import Settings, choice
from stillpoint.filters import rotation
from stillpoint.filters.compiled import compiled_entry, compiled_inside
from stillpoint.filters.euler_axes import GIMBAL, frame_of, tilting, turned_about_up
from stillpoint.filters.fields import Fields, low_pass, no_fields, turn_to_north, uprighting
from stillpoint.filters.rotation import Quaternion, Vector, about_up, blend, multiply, normalise, rotate, scale
from stillpoint.filters.sample import GAP_S, Log, Output, Sample, Track, keep, sample_at


@dataclass(frozen=True)
class Params(Settings):
    """Parameters of ``gyro``."""

    rule: Literal["rectangular", "trapezoidal"] = choice(
        "rectangular", "rate over an interval: of the sample that ends it, or the mean of both ends (paper 004)"
    )
    kinematics: Literal["rotation", "euler"] = choice(
        "rotation", "one rotation per interval, or the papers' Euler rates added up"
    )


class Coefficients(NamedTuple):
    """Derived once from the parameters."""

    newest: float  # share of the sample that ends the interval
    euler: bool
    declination_rad: float  # east of true north


class State(NamedTuple):
    """What is remembered."""

    fields: Fields
    q_nb: Quaternion
    rate_b_radps: Vector  # of the sample before
    is_level: bool
    is_headed: bool
    n_gaps: int
    n_gimbal: int  # steps of Euler angles with x along the vertical, taken as a rotation


def coefficients(params: Params, declination_rad: float) -> Coefficients:
    """Of these parameters at a place with this declination (east of true north)."""
    newest = 0.5 if params.rule == "trapezoidal" else 1.0
    return Coefficients(newest, params.kinematics == "euler", declination_rad)


@compiled_entry
def start(c: Coefficients) -> State:
    """Before the first sample: level, x over north."""
    half = 0.5**0.5
    return State(no_fields(0.0), (half, 0.0, 0.0, half), (0.0, 0.0, 0.0), False, False, 0, 0)


@compiled_inside
def turned(q_nb: Quaternion, rate_b_radps: Vector, dt_s: float) -> Quaternion:
    """By one rotation."""
    return multiply(q_nb, rotation.exp(scale(rate_b_radps, dt_s)))


@compiled_inside
def turned_by_euler(q_nb: Quaternion, rate_b_radps: Vector, dt_s: float) -> tuple[Quaternion, bool]:
    """Eq (1) of paper 004, each angle by its rate at the beginning; one rotation and True where it is singular."""
    up, across, cos_pitch = frame_of(q_nb)
    if cos_pitch < GIMBAL:
        return turned(q_nb, rate_b_radps, dt_s), True
    heading = (up[1] * rate_b_radps[1] + up[2] * rate_b_radps[2]) / (cos_pitch * cos_pitch)
    pitch = across[1] * rate_b_radps[1] + across[2] * rate_b_radps[2]
    roll = rate_b_radps[0] - up[0] * heading
    return turned_about_up(multiply(q_nb, tilting(roll * dt_s, pitch * dt_s, across)), heading * dt_s), False


@compiled_inside
def step(state: State, sample: Sample, c: Coefficients) -> tuple[State, Output]:
    """Turn by rate times interval."""
    fields, q_nb, _, is_level, is_headed, n_gaps, n_gimbal = state
    if is_level:
        rate = blend(sample.gyro_b_radps, state.rate_b_radps, c.newest)
        if c.euler:
            q_nb, is_singular = turned_by_euler(q_nb, rate, sample.dt_s)
            n_gimbal += is_singular
        else:
            q_nb = turned(q_nb, rate, sample.dt_s)
        q_nb = normalise(q_nb)
    if sample.dt_s > GAP_S:
        n_gaps += 1
    if not (is_level and is_headed):
        fields, fresh = low_pass(fields, sample, 1.0)
        if fresh.accel and not is_level:
            q_nb, is_level = multiply(uprighting(q_nb, fields.accel_b_mps2), q_nb), True
        if fresh.mag and is_level:
            turn, is_headed = turn_to_north(rotate(q_nb, fields.mag_b_ut), c.declination_rad)
            q_nb = multiply(about_up(turn), q_nb) if is_headed else q_nb
    state = State(fields, q_nb, sample.gyro_b_radps, is_level, is_headed, n_gaps, n_gimbal)
    return state, Output(q_nb, None, None, None, is_level)


@compiled_entry
def run(log: Log, state: State, c: Coefficients, track: Track) -> State:
    """Every sample of a log."""
    for k in range(len(log.dt_s)):
        state, output = step(state, sample_at(log, k), c)
        keep(track, k, output)
    return state
