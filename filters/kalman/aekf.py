"""``aekf``: ``ekf`` that adapts to what its innovations show (Asghari et al. 2018, eqs (15)-(23), for vectors).

The paper compares the last M innovations of one scalar with the variance C = H P H' + R that the filter expects of
them, and lets the user say whether larger ones are the fault of the observation (R) or of the system (P). Here the
innovations say it themselves, per sensor and per axis.

**The observation.** An accelerated body makes innovations of the velocity that are large and change their sign. With
eta the whitened innovation, east and north each with its own::

    (16), (17)  alpha = mean over M of eta^2, where that is at least ``least_alpha``, else 1
    (19)        K = P H' / (alpha C)                                    the measurement is trusted less

**The system.** A gyro's bias that has stepped makes corrections of one sign. With dx the correction of a state in one
update, and P- and P+ its variance before and after, dx has the variance P- - P+ if the model is right (Mohamed and
Schwarz, J. Geodesy 73, 1999). Over a memory of ``memory_s``::

    S = sum of dx     V = sum of (P- - P+)     lambda = S^2 / (gate^2 V), from 1 to ``largest_lambda``

and the variance of that state, the heading or a component of the bias, grows by lambda (fading per state: D. Zhou,
P. M. Frank, Int. J. Control 65(2), 1996). Tilt and velocity are never faded: a sustained acceleration would then pass
for tilt. The correction by a disturbed field does not count.

**A passing magnet** disturbs the field for some seconds with the same sign, so its windows are one measurement and not
many. For the first ``passing_s`` seconds of a disturbance (seen by size and dip) the variance of the heading's
measurement grows by ``passing_factor``. What lasts longer is fixed to the body or stays in the room; waiting would not
help.

**Vibration** shifts the mean of a MEMS gyro. The second differences of the rate show it, as motion is smooth: white
noise of sd s gives them a mean square of 6 s^2. Beyond the gyro's own noise, P of the attitude grows as by a rate
error of ``vibration`` s that lasts 1 s.

**Guards.** alpha and lambda are limited, and no variance grows beyond that of the start. An alpha at its limit counts
as doubt: after the patience of ``ekf`` tilt or heading start again. Innovations are given as the model expects them
(alpha = 1), so NIS shows what the adaptation answers to.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stillpoint.datasets.compiled import compiled_apart, compiled_entry, compiled_inside
from stillpoint.datasets.settings import number
from stillpoint.filters.kalman import model, predict
from stillpoint.filters.kalman.covariance import Matrix, scale_variance
from stillpoint.filters.kalman.known_field import is_alike, measure_looks
from stillpoint.filters.kalman.model import BIAS, HEADING, ErrorStateParams, FilterState, Measurement
from stillpoint.filters.kalman.predict import add_sample, finish_window, is_due, make_output
from stillpoint.filters.kalman.update import (
    no_innovations,
    predict_window,
    update_bias,
    update_heading,
    update_velocity,
    whiten_heading,
    whiten_velocity,
)
from stillpoint.filters.rotation import Vector, scale
from stillpoint.filters.sample import Output, Sample

# The states that fade: the heading and the three components of the bias.
_FADING = BIAS - HEADING + 3
# A V that is a smaller share of the variance is rounding in single precision: the state was hardly measured.
_LEAST_INFORMATION = 1e-4
# Of the second difference of white noise: 1 + 4 + 1, in each of three axes.
_SECOND_DIFFERENCE = 18.0


@dataclass(frozen=True)
class Params(ErrorStateParams):
    """Parameters of ``aekf``."""

    innovations: float = number(10, 1, 1000, "number M of innovations that are averaged for alpha")
    least_alpha: float = number(2.0, 1.0, 1e6, "below this mean square of innovations alpha is 1 (it may be chance)")
    largest_alpha: float = number(10.0, 1.0, 1e6, "largest factor on the variance of an innovation")
    memory_s: float = number(5.0, 0.1, 1e4, "memory of the sums of corrections, s")
    largest_lambda: float = number(1.5, 1.0, 1e6, "largest factor on a variance at the end of a window")
    passing_s: float = number(10.0, 0.0, 1e4, "time within which a disturbance of the field may pass, s")
    passing_factor: float = number(16.0, 1.0, 1e6, "factor on the variance of the heading's measurement meanwhile")
    vibration: float = number(
        0.15, 0.0, 10.0, "error of the mean rate by vibration (sd), relative to the vibration's sd"
    )


class Coefficients(NamedTuple):
    """Constants derived once from the parameters."""

    ekf: model.Coefficients
    newest: float  # share of the newest innovation in the mean
    least_alpha: float
    largest_alpha: float
    memory_s: float
    largest_lambda: float
    passing_s: float
    passing_factor: float
    vibration: float  # a square


class Vibration(NamedTuple):
    """The last two rates, and the integral over the window of their squared second difference, less that of noise."""

    last_b_radps: Vector
    before_b_radps: Vector
    square: float


class State(NamedTuple):
    """The state of the filter between two samples."""

    body: FilterState
    mean_squares: Vector  # of the whitened innovations: east, north, heading
    corrections: Matrix  # (2, 4) S and V of heading and bias; written in place
    disturbed_s: float  # how long the field has been disturbed, less how long it has not
    vibration: Vibration


def coefficients(params: Params, declination_rad: float) -> Coefficients:
    """Precompute the filter's constants from its parameters and the local declination (east of true north)."""
    return Coefficients(
        ekf=model.coefficients(params, declination_rad),
        newest=1 / params.innovations,
        least_alpha=params.least_alpha,
        largest_alpha=params.largest_alpha,
        memory_s=params.memory_s,
        largest_lambda=params.largest_lambda,
        passing_s=params.passing_s,
        passing_factor=params.passing_factor,
        vibration=params.vibration**2,
    )


@compiled_entry
def start(c: Coefficients) -> State:
    """Return the state before the first sample."""
    none = (0.0, 0.0, 0.0)
    return State(predict.start(c.ekf), (1.0, 1.0, 1.0), np.full((2, _FADING), 0.0), 0.0, Vibration(none, none, 0.0))


@compiled_inside
def _add_vibration(vibration: Vibration, sample: Sample, c: Coefficients) -> Vibration:
    """Add the second difference of the rate that ends with this sample, less what the gyro's noise makes of it."""
    (x1, y1, z1), (x2, y2, z2), square = vibration
    x, y, z = sample.gyro_b_radps
    dx, dy, dz = x - x1 - x1 + x2, y - y1 - y1 + y2, z - z1 - z1 + z2
    square += (dx * dx + dy * dy + dz * dz) * sample.dt_s - _SECOND_DIFFERENCE * c.ekf.gyro_noise
    return Vibration(sample.gyro_b_radps, (x1, y1, z1), square)


@compiled_inside
def _choose_alpha(mean_square: float, c: Coefficients) -> float:
    """Return alpha by (17), limited."""
    return min(mean_square, c.largest_alpha) if mean_square > c.least_alpha else 1.0


@compiled_inside
def _watch_field(state: State, heading: Measurement, c: Coefficients) -> tuple[Measurement, bool, float]:
    """Return the heading's measurement (trusted less while a magnet may pass), if the field is known, disturbed_s."""
    window, disturbed_s = state.body.window, state.disturbed_s
    length_s = window.turning.length_s
    if not heading.is_there:
        return heading, False, disturbed_s
    field_n = scale(window.fields.sum_n_ut, 1.0 / window.fields.how_many)
    if is_alike(state.body.field.known, measure_looks(field_n, length_s), c.ekf.tolerance):
        return heading, True, max(disturbed_s - length_s, 0.0)
    disturbed_s = min(disturbed_s + length_s, c.passing_s + c.passing_s)
    is_passing = state.body.field.known.seen_s > 0 and disturbed_s < c.passing_s
    variance = heading.variance * c.passing_factor if is_passing else heading.variance
    return Measurement(True, heading.row, heading.seen, variance), False, disturbed_s


@compiled_apart
def _add_corrections(sums: Matrix, before: tuple[Matrix, Matrix], x: Matrix, p: Matrix) -> None:
    """Add to S what an update has corrected since ``before`` (x and P's diagonal), and to V its expected variance."""
    for i in range(_FADING):
        sums[0, i] += x[HEADING + i] - before[0][i]
        sums[1, i] += before[1][i] - p[HEADING + i, HEADING + i]


@compiled_apart
def _copy_fading(x: Matrix, p: Matrix) -> tuple[Matrix, Matrix]:
    """Return heading and bias, and their variances."""
    values, variances = np.zeros(_FADING, x.dtype), np.zeros(_FADING, x.dtype)
    for i in range(_FADING):
        values[i], variances[i] = x[HEADING + i], p[HEADING + i, HEADING + i]
    return values, variances


@compiled_apart
def _fade(p: Matrix, sums: Matrix, c: Coefficients) -> None:
    """Multiply the variances of heading and bias by lambda, up to those of the start."""
    for i in range(_FADING):
        variance = p[HEADING + i, HEADING + i]
        largest = c.ekf.heading_variance if i == 0 else c.ekf.bias_variance
        if variance < largest and sums[1, i] > _LEAST_INFORMATION * variance:
            raw = sums[0, i] * sums[0, i] / (c.ekf.gate * sums[1, i])
            if raw > 1:
                scale_variance(p, HEADING + i, min(raw, c.largest_lambda))


@compiled_apart
def _add_rate_error(p: Matrix, vibration: Vibration, c: Coefficients) -> None:
    """Add to P of the attitude the error of the rate by the window's vibration."""
    for i in range(HEADING + 1):
        p[i, i] += c.vibration * max(vibration.square, 0.0) / _SECOND_DIFFERENCE


@compiled_apart
def _update_window(state: State, c: Coefficients) -> tuple[State, Vector]:
    """Update at the end of a window; return the state at the beginning of the next, and the innovations."""
    body, sums = state.body, state.corrections
    x, p, turning = body.x, body.p, body.window.turning
    kept = max(1.0 - turning.length_s / c.memory_s, 0.0)
    sums[0] *= kept
    sums[1] *= kept * kept
    at = predict_window(body, c.ekf)
    _add_rate_error(p, state.vibration, c)

    east, north = whiten_velocity(x, p, at.velocity_variance)
    of_east, of_north, of_heading = state.mean_squares
    of_east += (east * east - of_east) * c.newest
    of_north += (north * north - of_north) * c.newest
    before, alphas = _copy_fading(x, p), (_choose_alpha(of_east, c), _choose_alpha(of_north, c))
    beyond = update_velocity(x, p, at.velocity_variance, alphas, c.ekf.gate)
    velocity_beyond = beyond or max(alphas[0], alphas[1]) >= c.largest_alpha
    update_bias(x, p, turning, at, c.ekf)
    _add_corrections(sums, before, x, p)

    heading, is_known, disturbed_s = _watch_field(state, at.heading, c)
    nu = whiten_heading(x, p, heading)
    if heading.is_there:
        of_heading += (nu * nu - of_heading) * c.newest
    before, alpha = _copy_fading(x, p), _choose_alpha(of_heading, c)
    heading_beyond = update_heading(x, p, heading, alpha, body.status, c.ekf) or alpha >= c.largest_alpha
    if is_known:
        _add_corrections(sums, before, x, p)

    _fade(p, sums, c)
    body = finish_window(body, at, nu, (velocity_beyond, heading_beyond), c.ekf)
    vibration = Vibration(state.vibration.last_b_radps, state.vibration.before_b_radps, 0.0)
    return State(body, (of_east, of_north, of_heading), sums, disturbed_s, vibration), (east, north, nu)


@compiled_inside
def step(state: State, sample: Sample, c: Coefficients) -> tuple[State, Output]:
    """Turn by the rate; at the end of a window predict the errors and update them, with trust as the evidence says."""
    body, vibration = add_sample(state.body, sample, c.ekf), _add_vibration(state.vibration, sample, c)
    state = State(body, state.mean_squares, state.corrections, state.disturbed_s, vibration)
    innovations = no_innovations(c.ekf)
    if is_due(body.window.turning, c.ekf):
        state, innovations = _update_window(state, c)
    return state, make_output(state.body, innovations, c.ekf)
