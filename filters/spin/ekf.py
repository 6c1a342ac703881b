"""``roll-ekf``: extended Kalman filter of the spin rate, integrated for the angle.

Asghari et al. 2018, eqs (8)-(14), (24)-(26). State x = omega, input u = omega', observation y = omega^2::

    x- = x + T u          P- = P + Q_step                      (12)
    H = 2 x-              K = P- H / (H P- H + R)
    x = x- + K (y - x-^2) P = (1 - K H) P-                     (13), (24)

The input enters as T u, so its noise adds T^2 Q per step. The paper prints Q itself with L = 1, with which the filter
is the raw observation to 0.1 % (``process_noise = literal``). P starts at R / (2 x)^2, which the paper does not give.
"""

from dataclasses import dataclass
from math import nan, sqrt
from typing import Literal, NamedTuple

from stillpoint.datasets.compiled import compiled
from stillpoint.datasets.recording import SpinGeometry
from stillpoint.datasets.settings import choice
from stillpoint.filters.spin.noise import SpinParams, observation_noise
from stillpoint.filters.spin.rate import (
    MEDIAN_OF,
    Counts,
    Drive,
    Process,
    count_restart,
    count_sample,
    integrate_rate,
    make_drive,
    predict_rate,
    set_sense,
    start_counts,
)
from stillpoint.filters.spin.sample import (
    SpinMotion,
    SpinOutput,
    SpinSample,
    start_motion,
)
from stillpoint.filters.spin.start import Start, add_first_sample, empty_start, is_sound, restart


@dataclass(frozen=True)
class Params(SpinParams):
    """Parameters of ``roll-ekf``."""

    process_noise: Literal["per-step", "literal"] = choice(
        "per-step", "what a step adds to the variance: T^2 Q, or Q itself as (12) is printed"
    )
    first_rate: Literal["median", "first"] = choice(
        "median", "rate to start from: of the first nine samples, or the first one's"
    )


class Coefficients(NamedTuple):
    """Constants derived once from the parameters."""

    process: Process
    room: int  # samples to start from


class State(NamedTuple):
    """The state of the filter between two samples."""

    start: Start
    motion: SpinMotion
    drive: Drive  # by the sample before
    tally: Counts


def coefficients(params: Params, geometry: SpinGeometry) -> Coefficients:
    """Precompute the filter's constants from its parameters and the sensors' geometry."""
    process = Process(observation_noise(params, geometry), params.process_noise == "per-step")
    return Coefficients(process, MEDIAN_OF if params.first_rate == "median" else 1)


@compiled
def start(c: Coefficients) -> State:
    """Return the state before the first sample."""
    return State(empty_start(c.room, 0.0), start_motion(0.0), Drive(0.0, c.process.noise.accel_var), start_counts())


@compiled
def begin_state(state: State, sample: SpinSample, c: Coefficients) -> tuple[State, SpinOutput]:
    """Use one of the first samples to find the rate to start from."""
    sense = c.process.noise.sense if sample.direction == 0 else sample.direction
    square_var = c.process.noise.square_var * sample.square_widened
    begun, motion = add_first_sample(state.start, sample, state.drive.accel_radps2, sense, square_var)
    state = State(
        begun, motion, make_drive(sample, c.process.noise.accel_var), count_sample(state.tally, sample, False)
    )
    return state, SpinOutput(motion, nan, begun.held == c.room)


@compiled
def restart_state(state: State, sample: SpinSample, c: Coefficients) -> tuple[State, SpinOutput]:
    """Restart after an impossible state: from the angle before, with the sample as the first one."""
    drive = Drive(0.0, c.process.noise.accel_var)
    return begin_state(
        State(restart(state.start, state.motion), state.motion, drive, count_restart(state.tally)), sample, c
    )


@compiled
def step(state: State, sample: SpinSample, c: Coefficients) -> tuple[State, SpinOutput]:
    """Predict by the angular acceleration, correct by the square of the rate."""
    if state.start.held < c.room:
        return begin_state(state, sample, c)
    dt_s, r = sample.dt_s, c.process.noise.square_var * sample.square_widened
    rate, var = predict_rate(state.motion, state.drive, dt_s, c.process.per_step)
    left, innovation = 1.0, nan
    if sample.has_square:
        h = rate + rate
        total = h * var * h + r
        gain = var * h / total
        residual = sample.square_rad2ps2 - rate * rate
        left = r / total  # 1 - K H, and never below 0 by rounding
        rate, var = rate + gain * residual, var * r / total
        innovation = residual / sqrt(total)
    motion, is_turned_over = set_sense(integrate_rate(state.motion, rate, left, var, dt_s), sample.direction)
    if not is_sound(motion):
        return restart_state(state, sample, c)
    tally = count_sample(state.tally, sample, is_turned_over)
    state = State(state.start, motion, make_drive(sample, c.process.noise.accel_var), tally)
    return state, SpinOutput(motion, innovation, True)
