"""``acc``: tilt from the accelerometer, heading from the magnetometer, no gyro (paper 002, eqs (4)-(9)).

Between samples of a slower magnetometer its last field is held in body axes; without any the paper's yaw is 0 (body x
over north). True only where the sensor is not accelerated.
"""

from dataclasses import dataclass
from typing import NamedTuple

from stillpoint.datasets.settings import Settings, number
from stillpoint.filters.compiled import compiled_entry, compiled_inside
from stillpoint.filters.fields import Fields, level, low_pass, no_fields, turn_to_north
from stillpoint.filters.rotation import Quaternion, about_up, multiply, rotate
from stillpoint.filters.sample import Log, Output, Sample, Track, keep, sample_at


@dataclass(frozen=True)
class Params(Settings):
    """Parameters of ``acc``."""

    kappa: float = number(0.7, 0.0, 1.0, "share of the newest raw sample in the low pass (9); 1 = no low pass")


class Coefficients(NamedTuple):
    """Derived once from the parameters."""

    kappa: float
    declination_rad: float  # east of true north


class State(NamedTuple):
    """What is remembered."""

    fields: Fields
    q_nb: Quaternion
    n_no_north: int  # samples that keep the attitude before: no horizontal field


def coefficients(params: Params, declination_rad: float) -> Coefficients:
    """Of these parameters at a place with this declination (east of true north)."""
    return Coefficients(params.kappa, declination_rad)


@compiled_entry
def start(c: Coefficients) -> State:
    """Before the first sample: level, x over east."""
    return State(no_fields(0.0), (1.0, 0.0, 0.0, 0.0), 0)


@compiled_inside
def step(state: State, sample: Sample, c: Coefficients) -> tuple[State, Output]:
    """The attitude by this sample alone (and the raw one before it, eq (9))."""
    fields, _ = low_pass(state.fields, sample, c.kappa)
    q_nb, n_no_north = state.q_nb, state.n_no_north
    if fields.has_accel:
        q_level = level(fields.accel_b_mps2)
        if fields.has_mag:
            turn, found = turn_to_north(rotate(q_level, fields.mag_b_ut), c.declination_rad)
            if found:
                q_nb = multiply(about_up(turn), q_level)
            else:
                n_no_north += 1
        else:
            q_nb = q_level
    return State(fields, q_nb, n_no_north), Output(q_nb, None, None, None, fields.has_accel)


@compiled_entry
def run(log: Log, state: State, c: Coefficients, track: Track) -> State:
    """Every sample of a log."""
    for k in range(len(log.dt_s)):
        state, output = step(state, sample_at(log, k), c)
        keep(track, k, output)
    return state
