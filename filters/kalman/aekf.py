"""``aekf``: ``ekf`` with innovation-based adaptation (Asghari et al. 2018, eqs (15)-(23), for vectors).

The paper compares the last M innovations of one scalar with the variance C that the filter expects of them. Here there
are two sensors, which are disturbed at different times, so each has its own: the accelerometer's m = 2 innovations of
the velocity, and the heading's m = 1. With C = H P H' + R and eta the innovation::

    (16), (17)  alpha = max(1, mean over M of eta' C^-1 eta / m)
    observation-uncertain:  lambda = 1, K = P H' / (alpha C)                    the measurement is trusted less
    system-uncertain:  lambda = tr(alpha H P H' + (alpha - 1) R) / tr(H P H')   (23): the prediction is trusted less

Readings. tr(C_bar C^-1) with each innovation weighed by its own C, which is eta' C^-1 eta. 1/M, not 1/(M - 1): no mean
is taken off. alpha is 1 until M innovations exist. lambda enters P once, not again in the gain (as printed, (19) and
(20) make P negative). It fades the errors that the sensor sees, tilt and velocity or the heading: fading the bias too
would let it wander with every shake (fading per state: D. Zhou, P. M. Frank, Int. J. Control 65(2), 1996).

Guards. Without them a wrong model makes alpha grow, the gain fall, the error grow, and alpha grow again: in the
observation-uncertain mode the paper's filter then leaves for good. Here alpha and lambda end at ``largest_alpha`` and
``largest_lambda``, and an alpha that stays there counts as doubt: after the patience of ``ekf`` tilt or heading begin
again. Innovations are given as the model expects them (alpha = 1), so NIS shows what the adaptation answers to. It
leaves the chi-square band by design: alpha >= 1 never trusts more than the model, and on noise that is as the
parameters say alpha is still above 1 half of the time (mean 1.1 to 1.2 for M = 10), so the covariance is pessimistic
(mode observation) and the estimate noisier than that of ``ekf`` (mode system).
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from stillpoint.datasets.compiled import compiled_apart, compiled_entry, compiled_inside, like
from stillpoint.datasets.settings import choice, number
from stillpoint.filters.kalman import model as error_model
from stillpoint.filters.kalman import predict as error_state
from stillpoint.filters.kalman.covariance import Matrix, scale_variance
from stillpoint.filters.kalman.model import HEADING, VELOCITY, ErrorStateParams, FilterState, Measurement
from stillpoint.filters.kalman.predict import add_sample, finish_window, is_due, make_output, rotate_errors
from stillpoint.filters.kalman.update import (
    measure_innovation,
    no_innovations,
    predict_window,
    update_bias,
    update_heading,
    update_velocity,
    whiten_heading,
    whiten_velocity,
)
from stillpoint.filters.sample import Output, Sample


@dataclass(frozen=True)
class Params(ErrorStateParams):
    """Parameters of ``aekf``."""

    mode: Literal["observation", "system"] = choice(
        "observation", "what is not known exactly: the observation (lambda = 1) or the system (lambda of (23))"
    )
    innovations: float = number(10, 1, 1000, "how many innovations M are averaged; alpha is 1 until there are as many")
    largest_alpha: float = number(10.0, 1.0, 1e6, "alpha ends here")
    largest_lambda: float = number(10.0, 1.0, 1e6, "lambda ends here")


class Coefficients(NamedTuple):
    """Constants derived once from the parameters."""

    ekf: error_model.Coefficients
    innovations: int
    fades: bool  # True: lambda by (23)
    largest_alpha: float
    largest_lambda: float


class Memory(NamedTuple):
    """The last M innovations of a sensor."""

    nis: Matrix  # (M,) eta' C^-1 eta / m, a ring that is written into
    seen: int


class State(NamedTuple):
    """What the filter keeps from one sample to the next."""

    body: FilterState
    velocity: Memory
    heading: Memory


class Trust(NamedTuple):
    """What an update is weighed with."""

    alpha: float  # times the variance of the innovation
    fade: float  # lambda: times the variances of the errors that are seen
    at_limit: bool


def coefficients(params: Params, declination_rad: float) -> Coefficients:
    """Precompute the filter's constants from its parameters and the local declination (east of true north)."""
    return Coefficients(
        error_model.coefficients(params, declination_rad),
        round(params.innovations),
        params.mode == "system",
        params.largest_alpha,
        params.largest_lambda,
    )


@compiled_entry
def start(c: Coefficients) -> State:
    """Return the state before the first sample."""
    velocity, heading = np.full(c.innovations, 0.0), np.full(c.innovations, 0.0)
    return State(error_state.start(c.ekf), Memory(velocity, 0), Memory(heading, 0))


@compiled_apart
def adapted(memory: Memory, nis: float, explained: float, noise: float, c: Coefficients) -> tuple[Memory, Trust]:
    """alpha by (17) and lambda by (23) with this innovation; ``explained`` and ``noise`` are tr(H P H') and tr(R)."""
    memory.nis[memory.seen % c.innovations] = nis
    seen = memory.seen + 1 if memory.seen < 2 * c.innovations - 1 else c.innovations  # stays right modulo M
    total = 0.0
    for each in memory.nis:
        total += each
    full = seen >= c.innovations
    raw = max(1.0, total / like(nis, c.innovations)) if full else 1.0
    alpha = min(raw, c.largest_alpha)
    at_limit = raw >= c.largest_alpha and full
    memory = Memory(memory.nis, seen)
    if not c.fades:
        return memory, Trust(alpha, 1.0, at_limit)
    fade = alpha + (alpha - 1.0) * noise / explained
    return memory, Trust(1.0, min(fade, c.largest_lambda), at_limit)


@compiled_inside
def trust_velocity(
    memory: Memory, p: Matrix, innovations: tuple[float, float], variance: float, c: Coefficients
) -> tuple[Memory, Trust]:
    """By both innovations of the velocity."""
    east, north = innovations
    explained = p[VELOCITY, VELOCITY] + p[VELOCITY + 1, VELOCITY + 1]
    memory, trust = adapted(memory, (east * east + north * north) * 0.5, explained, 2.0 * variance, c)
    if trust.fade > 1:
        for i in range(HEADING):
            scale_variance(p, i, trust.fade)
            scale_variance(p, VELOCITY + i, trust.fade)
    return memory, trust


@compiled_inside
def trust_heading(
    memory: Memory, x: Matrix, p: Matrix, m: Measurement, nu: float, c: Coefficients
) -> tuple[Memory, Trust]:
    """By the innovation of the heading; as it was where there is none."""
    if not m.is_there:
        return memory, Trust(1.0, 1.0, False)
    explained = measure_innovation(x, p, m)[1] - m.variance
    memory, trust = adapted(memory, nu * nu, explained, m.variance, c)
    if trust.fade > 1:
        scale_variance(p, HEADING, trust.fade)
    return memory, trust


@compiled_inside
def step(state: State, sample: Sample, c: Coefficients) -> tuple[State, Output]:
    """As that of ``ekf``, with trust in each sensor as its innovations were."""
    body, velocity, heading = add_sample(state.body, sample, c.ekf), state.velocity, state.heading
    innovations = no_innovations(c.ekf)
    if is_due(body.window.turning, c.ekf):
        x, p = body.x, body.p
        at = predict_window(body, c.ekf)
        east, north = whiten_velocity(x, p, at.velocity_variance)
        velocity, trust = trust_velocity(velocity, p, (east, north), at.velocity_variance, c)
        velocity_beyond = update_velocity(x, p, at.velocity_variance, trust.alpha, c.ekf.gate) or trust.at_limit
        update_bias(x, p, body.window.turning, at, c.ekf)
        nu = whiten_heading(x, p, at.heading)
        innovations = (east, north, nu)
        heading, trust = trust_heading(heading, x, p, at.heading, nu, c)
        heading_beyond = update_heading(x, p, at.heading, trust.alpha, body.status, c.ekf) or trust.at_limit
        rotate_errors(x, p)
        body = finish_window(body, at, nu, (velocity_beyond, heading_beyond), c.ekf)
    return State(body, velocity, heading), make_output(body, innovations, c.ekf)
