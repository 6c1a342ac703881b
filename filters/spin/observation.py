"""``roll-obs``: the rate as the root of the observed square, its integral as the angle.

This is the "observation" of Asghari et al. 2018, the baseline that the filters are compared with. Its noise is white,
sqrt(R) / (2 omega) per sample, so the error of the angle is a random walk.
"""

from dataclasses import dataclass
from math import nan
from typing import NamedTuple

from stillpoint.datasets.compiled import compiled, like
from stillpoint.datasets.recording import SpinGeometry
from stillpoint.filters.spin.noise import Noise, SpinParams, observation_noise
from stillpoint.filters.spin.rate import Counts, count_sample, integrate_rate, start_counts
from stillpoint.filters.spin.sample import (
    SpinMotion,
    SpinOutput,
    SpinSample,
    start_motion,
)
from stillpoint.filters.spin.start import rate_size, rate_variance


@dataclass(frozen=True)
class Params(SpinParams):
    """Parameters of ``roll-obs``."""


class Coefficients(NamedTuple):
    """Constants derived once from the parameters."""

    noise: Noise


class State(NamedTuple):
    """The state of the filter between two samples."""

    motion: SpinMotion
    sense: int  # +1 or -1, the last that was told
    begun: bool
    tally: Counts


def coefficients(params: Params, geometry: SpinGeometry) -> Coefficients:
    """Precompute the filter's constants from its parameters and the sensors' geometry."""
    return Coefficients(observation_noise(params, geometry))


@compiled
def start(c: Coefficients) -> State:
    """Return the state before the first sample."""
    return State(start_motion(0.0), c.noise.sense, False, start_counts())


@compiled
def step(state: State, sample: SpinSample, c: Coefficients) -> tuple[State, SpinOutput]:
    """Return the rate by this sample alone; without an observation, the rate before."""
    before, sense, dt_s = state.motion, state.sense, sample.dt_s
    if sample.direction != 0:
        sense = sample.direction
    rate, left, var = before.rate_radps, 1.0, before.rate_var
    if sample.has_square:
        rate, left = like(dt_s, sense) * rate_size(sample.square_rad2ps2), 0.0
        var = rate_variance(rate, c.noise.square_var * sample.square_widened)
    begun = state.begun or sample.has_square
    motion = SpinMotion(0, 0.0, rate, 0.0, 0.0, var)
    if state.begun:
        motion = integrate_rate(before, rate, left, var, dt_s)
    is_turned_over = state.begun and sense != state.sense
    state = State(motion, sense, begun, count_sample(state.tally, sample, is_turned_over))
    return state, SpinOutput(motion, nan, begun)
