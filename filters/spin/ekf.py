"""``roll-ekf``: extended Kalman filter of the roll rate (paper 000, eqs (8)-(14), (24)-(26)), integrated for the angle.

State x = omega, input u = omega', observation y = omega^2::

    x- = x + T u          P- = P + Q_step                      (12)
    H = 2 x-              K = P- H / (H P- H + R)
    x = x- + K (y - x-^2) P = (1 - K H) P-                     (13), (24)

The input enters as T u, so its noise adds T^2 Q per step; the paper prints Q itself with L = 1, with which the filter
is the raw observation to 0.1 % (``process_noise = literal``). P starts at R / (2 x)^2, which the paper does not give.
"""

from dataclasses import dataclass
from math import nan, sqrt
from typing import Literal, NamedTuple

from stillpoint.datasets.recording import SpinGeometry
from stillpoint.datasets.settings import choice
from stillpoint.filters.compiled import compiled
from stillpoint.filters.spin.noise import RollParams, noise
from stillpoint.filters.spin.rate import (
    MEDIAN_OF,
    Drive,
    Process,
    Tally,
    driven,
    faced,
    integrated,
    lost,
    no_tally,
    predicted,
    tallied,
)
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
from stillpoint.filters.spin.start import Start, anew, gather, is_sound, no_start


@dataclass(frozen=True)
class Params(RollParams):
    """Parameters of ``roll-ekf``."""

    process_noise: Literal["per-step", "literal"] = choice(
        "per-step", "what a step adds to the variance: T^2 Q, or Q itself as (12) is printed"
    )
    first_rate: Literal["median", "first"] = choice(
        "median", "rate to start from: of the first nine samples, or the first one's"
    )


class Coefficients(NamedTuple):
    """Derived once from the parameters."""

    process: Process
    room: int  # samples to start from


class State(NamedTuple):
    """What is remembered."""

    start: Start
    roll: Roll
    drive: Drive  # by the sample before
    tally: Tally


def coefficients(params: Params, geometry: SpinGeometry) -> Coefficients:
    """Of these parameters for a geometry."""
    process = Process(noise(params, geometry), params.process_noise == "per-step")
    return Coefficients(process, MEDIAN_OF if params.first_rate == "median" else 1)


@compiled
def start(c: Coefficients) -> State:
    """Before the first sample."""
    return State(no_start(c.room, 0.0), no_roll(0.0), Drive(0.0, c.process.noise.accel_var), no_tally())


@compiled
def begin(state: State, sample: RollSample, c: Coefficients) -> tuple[State, RollOutput]:
    """One of the first samples."""
    sense = c.process.noise.sense if sample.direction == 0 else sample.direction
    square_var = c.process.noise.square_var * sample.square_widened
    begun, roll = gather(state.start, sample, state.drive.accel_radps2, sense, square_var)
    state = State(begun, roll, driven(sample, c.process.noise.accel_var), tallied(state.tally, sample, False))
    return state, RollOutput(roll, nan, begun.held == c.room)


@compiled
def begin_anew(state: State, sample: RollSample, c: Coefficients) -> tuple[State, RollOutput]:
    """After what no body does: from the angle before, with the sample as the first one."""
    drive = Drive(0.0, c.process.noise.accel_var)
    return begin(State(anew(state.start, state.roll), state.roll, drive, lost(state.tally)), sample, c)


@compiled
def step(state: State, sample: RollSample, c: Coefficients) -> tuple[State, RollOutput]:
    """Predict by the angular acceleration, correct by the square of the rate."""
    if state.start.held < c.room:
        return begin(state, sample, c)
    dt_s, r = sample.dt_s, c.process.noise.square_var * sample.square_widened
    rate, var = predicted(state.roll, state.drive, dt_s, c.process.per_step)
    left, innovation = 1.0, nan
    if sample.has_square:
        h = rate + rate
        total = h * var * h + r
        gain = var * h / total
        residual = sample.square_rad2ps2 - rate * rate
        left = r / total  # 1 - K H, and never below 0 by rounding
        rate, var = rate + gain * residual, var * r / total
        innovation = residual / sqrt(total)
    roll, is_turned_over = faced(integrated(state.roll, rate, left, var, dt_s), sample.direction)
    if not is_sound(roll):
        return begin_anew(state, sample, c)
    tally = tallied(state.tally, sample, is_turned_over)
    state = State(state.start, roll, driven(sample, c.process.noise.accel_var), tally)
    return state, RollOutput(roll, innovation, True)


@compiled
def run(log: RollLog, state: State, c: Coefficients, track: RollTrack) -> State:
    """Every sample of a log."""
    for k in range(len(log.dt_s)):
        state, output = step(state, roll_sample_at(log, k), c)
        keep_roll(track, k, output)
    return state
