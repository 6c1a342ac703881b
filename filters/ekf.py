"""``ekf``: error-state (multiplicative) extended Kalman filter of attitude and gyro bias."""

from dataclasses import dataclass
from math import nan, sqrt

from stillpoint.filters import error_state, rotation
from stillpoint.filters.compiled import compiled, like
from stillpoint.filters.error_state import (
    Body,
    Coefficients,
    ErrorStateParams,
    Weight,
    corrected,
    gather,
    heading_measurement,
    innovation,
    is_due,
    output,
    predict,
    turn_errors,
    update_bias,
    update_heading,
    update_velocity,
    velocity_innovations,
    velocity_variance,
)
from stillpoint.filters.sample import Log, Output, Sample, Track, keep, sample_at
from stillpoint.filters.stillness import is_resting, watch
from stillpoint.filters.window import means

State = Body
coefficients = error_state.coefficients
start = error_state.start


@dataclass(frozen=True)
class Params(ErrorStateParams):
    """Parameters of ``ekf``."""


@compiled
def step(state: Body, sample: Sample, c: Coefficients) -> tuple[Body, Output]:
    """Turn by the rate; at the end of a window predict the errors, and update them."""
    body = gather(state, sample, c)
    east = north = heading = like(c.gate, nan)
    if is_due(body.window.turning, c):
        x, p, window, status = body.x, body.p, body.window, body.status
        asis = Weight(like(c.gate, 1.0), like(c.gate, 1.0))
        still = watch(body.still, means(window), c.limits)
        resting = is_resting(still, c.limits)
        m = heading_measurement(x, window, status.since_field_s, body.field, c)
        predict(x, p, window, c)
        variance = velocity_variance(window.turning.length_s, resting, c)
        east, north = velocity_innovations(x, p, variance)
        tilt_beyond, heading_beyond = update_velocity(x, p, variance, asis, c.gate), False
        if resting:
            update_bias(x, p, window.turning, still, c)
        if m.is_there:
            residual, expected = innovation(x, p, m)
            heading = residual / sqrt(expected)
            heading_beyond = update_heading(x, p, m, asis, status, c)
        turn_errors(p, rotation.exp((x[0], x[1], x[2])))
        body = corrected(body, still, (tilt_beyond, heading_beyond), m.is_there, c)
    return body, output(body, (east, north, heading), c)


@compiled
def run(log: Log, state: Body, c: Coefficients, track: Track) -> Body:
    """Every sample of a log."""
    for k in range(len(log.dt_s)):
        state, output = step(state, sample_at(log, k), c)
        keep(track, k, output)
    return state
