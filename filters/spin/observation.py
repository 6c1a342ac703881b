"""``roll-obs``: the rate as the root of the observed square, its integral as the angle (paper 000's "observation").

The baseline that the filters are compared with. Its noise is white, sqrt(R) / (2 omega) per sample, so the error of the
angle is a random walk.
"""

from dataclasses import dataclass
from math import nan
from typing import NamedTuple

from stillpoint.datasets.recording import SpinGeometry
from stillpoint.filters.compiled import compiled, like
from stillpoint.filters.spin.noise import Noise, RollParams, noise
from stillpoint.filters.spin.rate import Tally, integrated, no_tally, tallied
from stillpoint.filters.spin.sample import (
    Roll,
    RollLog,
    RollOutput,
    RollSample,
    RollTrack,
    keep_roll,
    no_roll,
    roll_sample_at,
)
from stillpoint.filters.spin.start import rate_variance, root


@dataclass(frozen=True)
class Params(RollParams):
    """Parameters of ``roll-obs``."""


class Coefficients(NamedTuple):
    """Derived once from the parameters."""

    noise: Noise


class State(NamedTuple):
    """What is remembered."""

    roll: Roll
    sense: int  # +1 or -1, the last that was told
    begun: bool
    tally: Tally


def coefficients(params: Params, geometry: SpinGeometry) -> Coefficients:
    """Of these parameters for a geometry."""
    return Coefficients(noise(params, geometry))


@compiled
def start(c: Coefficients) -> State:
    """Before the first sample."""
    return State(no_roll(0.0), c.noise.sense, False, no_tally())


@compiled
def step(state: State, sample: RollSample, c: Coefficients) -> tuple[State, RollOutput]:
    """The rate by this sample alone; without one, the rate before."""
    before, sense, dt_s = state.roll, state.sense, sample.dt_s
    if sample.direction != 0:
        sense = sample.direction
    rate, left, var = before.rate_radps, 1.0, before.rate_var
    if sample.has_square:
        rate, left = like(dt_s, sense) * root(sample.square_rad2ps2), 0.0
        var = rate_variance(rate, c.noise.square_var * sample.square_widened)
    begun = state.begun or sample.has_square
    roll = Roll(0, 0.0, rate, 0.0, 0.0, var)
    if state.begun:
        roll = integrated(before, rate, left, var, dt_s)
    is_turned_over = state.begun and sense != state.sense
    state = State(roll, sense, begun, tallied(state.tally, sample, is_turned_over))
    return state, RollOutput(roll, nan, begun)


@compiled
def run(log: RollLog, state: State, c: Coefficients, track: RollTrack) -> State:
    """Every sample of a log."""
    for k in range(len(log.dt_s)):
        state, output = step(state, roll_sample_at(log, k), c)
        keep_roll(track, k, output)
    return state
