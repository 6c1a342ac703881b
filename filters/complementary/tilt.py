"""``acc``: tilt from the accelerometer, heading from the magnetometer, no gyro.

Elmi Aziz and Mohseni Araste 2021, eqs (4)-(9). Between samples of a slower magnetometer its last field is held in body
axes; without a magnetometer the paper's yaw is 0 (body x points north). It is correct only where the sensor is not
accelerated.
"""

from dataclasses import dataclass
from typing import NamedTuple

from stillpoint.datasets.compiled import compiled_entry, compiled_inside
from stillpoint.datasets.settings import Settings, number
from stillpoint.filters.fields import Fields, level_attitude, north_error, smooth_fields, start_fields
from stillpoint.filters.rotation import Quaternion, multiply, rotate, rotation_about_up
from stillpoint.filters.sample import Output, Sample


@dataclass(frozen=True)
class Params(Settings):
    """Parameters of ``acc``."""

    kappa: float = number(0.7, 0.0, 1.0, "share of the newest raw sample in the low pass (9); 1 = no low pass")


class Coefficients(NamedTuple):
    """Constants derived once from the parameters."""

    kappa: float
    declination_rad: float  # east of true north


class State(NamedTuple):
    """The state of the filter between two samples."""

    fields: Fields
    q_nb: Quaternion
    n_no_north: int  # samples that keep the attitude before: no horizontal field


def coefficients(params: Params, declination_rad: float) -> Coefficients:
    """Precompute the filter's constants from its parameters and the local declination (east of true north)."""
    return Coefficients(params.kappa, declination_rad)


@compiled_entry
def start(c: Coefficients) -> State:
    """Return the state before the first sample: level, with the body's x axis pointing east."""
    return State(start_fields(0.0), (1.0, 0.0, 0.0, 0.0), 0)


@compiled_inside
def step(state: State, sample: Sample, c: Coefficients) -> tuple[State, Output]:
    """Return the attitude by this sample (and the raw one before it, eq (9))."""
    fields, _ = smooth_fields(state.fields, sample, c.kappa)
    q_nb, n_no_north = state.q_nb, state.n_no_north
    if fields.has_accel:
        q_level = level_attitude(fields.accel_b_mps2)
        if fields.has_mag:
            turn, found = north_error(rotate(q_level, fields.mag_b_ut), c.declination_rad)
            if found:
                q_nb = multiply(rotation_about_up(turn), q_level)
            else:
                n_no_north += 1
        else:
            q_nb = q_level
    return State(fields, q_nb, n_no_north), Output(q_nb, None, None, None, fields.has_accel)
