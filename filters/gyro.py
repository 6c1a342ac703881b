"""``gyro``: the integrated rate, started from the fields and never corrected (paper 002, eq (10); paper 004, eq (13)).

Integrated as a rotation instead of as Euler angles, which is the same without the singular pitch. The first usable
accelerometer sample sets the tilt, the first field the heading; across a gap the rate at its end is held.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

from stillpoint.datasets.settings import Settings, choice
from stillpoint.filters import rotation
from stillpoint.filters.compiled import compiled, like
from stillpoint.filters.fields import Fields, low_pass, no_fields, turn_to_north, uprighting
from stillpoint.filters.rotation import Quaternion, Vector, about_up, blend, multiply, normalise, rotate, scale
from stillpoint.filters.sample import GAP_S, Log, Output, Sample, Track, keep, sample_at


@dataclass(frozen=True)
class Params(Settings):
    """Parameters of ``gyro``."""

    rule: Literal["rectangular", "trapezoidal"] = choice(
        "rectangular", "rate over an interval: of the sample that ends it, or the mean of both ends (paper 004)"
    )


class Coefficients(NamedTuple):
    """Derived once from the parameters."""

    newest: float  # share of the sample that ends the interval
    declination_rad: float  # east of true north


class State(NamedTuple):
    """What is remembered."""

    fields: Fields
    q_nb: Quaternion
    rate_b_radps: Vector  # of the sample before
    is_level: bool
    is_headed: bool
    n_gaps: int


def coefficients(params: Params, declination_rad: float) -> Coefficients:
    """Of these parameters at a place with this declination (east of true north)."""
    return Coefficients(0.5 if params.rule == "trapezoidal" else 1.0, declination_rad)


@compiled
def start(c: Coefficients) -> State:
    """Before the first sample: level, x over north."""
    zero, half = like(c.newest, 0.0), like(c.newest, 0.5**0.5)
    return State(no_fields(zero), (half, zero, zero, half), (zero, zero, zero), False, False, 0)


@compiled
def step(state: State, sample: Sample, c: Coefficients) -> tuple[State, Output]:
    """Turn by rate times interval."""
    fields, q_nb, is_level, is_headed, n_gaps = state.fields, state.q_nb, state.is_level, state.is_headed, state.n_gaps
    if is_level:
        rate = blend(sample.gyro_b_radps, state.rate_b_radps, c.newest)
        q_nb = normalise(multiply(q_nb, rotation.exp(scale(rate, sample.dt_s))))
    if sample.dt_s > like(sample.dt_s, GAP_S):
        n_gaps += 1
    if not (is_level and is_headed):
        fields, fresh = low_pass(fields, sample, like(c.newest, 1.0))
        if fresh.accel and not is_level:
            q_nb, is_level = multiply(uprighting(q_nb, fields.accel), q_nb), True
        if fresh.mag and is_level:
            turn, is_headed = turn_to_north(rotate(q_nb, fields.mag), c.declination_rad)
            q_nb = multiply(about_up(turn), q_nb) if is_headed else q_nb
    state = State(fields, q_nb, sample.gyro_b_radps, is_level, is_headed, n_gaps)
    return state, Output(q_nb, None, None, None, is_level)


@compiled
def run(log: Log, state: State, c: Coefficients, track: Track) -> State:
    """Every sample of a log."""
    for k in range(len(log.dt_s)):
        state, output = step(state, sample_at(log, k), c)
        keep(track, k, output)
    return state
