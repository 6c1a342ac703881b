"""``gyro``: the integrated rate, started from the fields and never corrected (paper 002, eq (10); paper 004, eq (13)).

Integrated as a rotation instead of as Euler angles, which is the same without the singular pitch. The first usable
accelerometer sample sets the tilt, the first field the heading; across a gap the rate at its end is held.
"""

from dataclasses import dataclass
from math import atan2
from typing import Literal, NamedTuple

from stillpoint.filters import rotation
from stillpoint.filters.compiled import compiled, like
from stillpoint.filters.fields import Fields, compass, level, low_pass, no_fields
from stillpoint.filters.parameters import Parameters, parameter
from stillpoint.filters.rotation import Quaternion, Vector, about_up, blend, conjugate, multiply, normalise, scale
from stillpoint.filters.sample import GAP_S, Log, Output, Sample, Track, keep, sample_at


@dataclass(frozen=True)
class Params(Parameters):
    """Parameters of ``gyro``."""

    rule: Literal["rectangular", "trapezoidal"] = parameter(
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
    """Before the first sample."""
    one, zero = like(c.newest, 1.0), like(c.newest, 0.0)
    return State(no_fields(zero), (one, zero, zero, zero), (zero, zero, zero), False, False, 0)


@compiled
def set_out(state: State, fields: Fields, q_nb: Quaternion, new_mag: bool, c: Coefficients) -> tuple[Quaternion, bool]:
    """The attitude with the tilt of the fields where there was none, and their heading when it is the first."""
    found = False
    if new_mag and not state.is_headed:
        q_fields, found = compass(fields.accel, fields.mag, c.declination_rad)
        if found and state.is_level:
            error = multiply(q_fields, conjugate(q_nb))
            q_nb = multiply(about_up(like(c.newest, 2.0) * atan2(error[3], error[0])), q_nb)
        elif found:
            q_nb = q_fields
    if not found and not state.is_level:
        q_nb = level(fields.accel)
    return q_nb, found


@compiled
def step(state: State, sample: Sample, c: Coefficients) -> tuple[State, Output]:
    """Turn by rate times interval."""
    q_nb, is_level, is_headed = state.q_nb, state.is_level, state.is_headed
    rate = blend(sample.gyro_b_radps, state.rate_b_radps, c.newest) if sample.dt_s > 0 else sample.gyro_b_radps
    if is_level:
        q_nb = normalise(multiply(q_nb, rotation.exp(scale(rate, sample.dt_s))))
    fields = state.fields
    if not (is_level and is_headed):
        fields, new_accel, new_mag = low_pass(fields, sample, like(c.newest, 1.0))
        if new_accel:
            q_nb, found = set_out(state, fields, q_nb, new_mag, c)
            is_level, is_headed = True, is_headed or found
    n_gaps = state.n_gaps + (1 if sample.dt_s > like(sample.dt_s, GAP_S) else 0)
    return State(fields, q_nb, sample.gyro_b_radps, is_level, is_headed, n_gaps), Output(
        q_nb, None, None, None, is_level
    )


@compiled
def run(log: Log, state: State, c: Coefficients, track: Track) -> State:
    """Every sample of a log."""
    for k in range(len(log.dt_s)):
        state, output = step(state, sample_at(log, k), c)
        keep(track, k, output)
    return state
