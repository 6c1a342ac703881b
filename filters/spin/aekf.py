"""``roll-aekf``: the spin rate with adaptive trust in observation and model (Asghari et al. 2018, eqs (15)-(23)).

The last M innovations e are compared with the variance C that the filter expects of them::

    C = H P- H + R                                              (15)
    alpha = max(1, mean(e^2) / C)                               (16), (17)
    lambda = 1, or (alpha H P- H + (alpha - 1) R) / (H P- H)    (23)
    K = (lambda / alpha) P- H / C      P = (1 - K H) lambda P-  (20), (21)

Innovations larger than expected are attributed to the observation (lambda = 1: ``mode = observation``) or to the model
(lambda of (23): ``mode = system``). lambda enters once: with it in (19) and again in (20), as printed, K H exceeds 1
and the variance turns negative (``fading = literal``; then the output is no longer ready, and the event is counted).
"""

from dataclasses import dataclass
from math import nan, sqrt
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.compiled import compiled
from stillpoint.datasets.recording import SpinGeometry
from stillpoint.datasets.settings import choice, number
from stillpoint.filters.spin import ekf as spin_ekf
from stillpoint.filters.spin.rate import count_sample, integrate_rate, make_drive, predict_rate, set_sense
from stillpoint.filters.spin.sample import (
    SpinOutput,
    SpinSample,
)
from stillpoint.filters.spin.start import is_sound, rate_variance


@dataclass(frozen=True)
class Params(spin_ekf.Params):
    """Parameters of ``roll-aekf``."""

    mode: Literal["observation", "system"] = choice(
        "observation", "what is not known exactly: the observation (lambda = 1) or the system (lambda of (23))"
    )
    window: float = number(5, 2, 1000, "number M of innovations that are averaged; alpha is 1 until then")
    mean: Literal["per-m", "literal"] = choice("per-m", "their sum over M, or over M - 1 as (16) is printed")
    fading: Literal["once", "literal"] = choice("once", "lambda in P alone, or in (19) and (20) as printed")
    largest_alpha: float = number(1e4, 1, 1e12, "upper limit of alpha")
    largest_lambda: float = number(1e4, 1, 1e12, "upper limit of lambda")


class Adaptation(NamedTuple):
    """How alpha and lambda are computed."""

    window: int
    over: float  # what the sum of squares is divided by
    fades: bool  # True: lambda by (23)
    twice: bool  # True: lambda also in (20)
    largest_alpha: float
    largest_lambda: float


class Coefficients(NamedTuple):
    """Constants derived once from the parameters."""

    ekf: spin_ekf.Coefficients
    adaptation: Adaptation


class State(NamedTuple):
    """The state of the filter between two samples."""

    ekf: spin_ekf.State
    squares: NDArray[np.float64]  # (M,) of the last innovations, a ring that is handed on and written in place
    seen: int  # innovations
    n_variance_not_positive: int


def coefficients(params: Params, geometry: SpinGeometry) -> Coefficients:
    """Precompute the filter's constants from its parameters and the sensors' geometry."""
    m = round(params.window)
    adaptation = Adaptation(
        window=m,
        over=float(m if params.mean == "per-m" else m - 1),
        fades=params.mode == "system",
        twice=params.fading == "literal",
        largest_alpha=params.largest_alpha,
        largest_lambda=params.largest_lambda,
    )
    return Coefficients(spin_ekf.coefficients(params, geometry), adaptation)


@compiled
def start(c: Coefficients) -> State:
    """Return the state before the first sample."""
    return State(spin_ekf.start(c.ekf), np.full(c.adaptation.window, 0.0), 0, 0)


@compiled
def _adapt(
    squares: NDArray[np.float64], seen: int, expected: float, of_rate: float, a: Adaptation
) -> tuple[float, float]:
    """Return alpha and lambda by (16), (17), (23); ``expected`` is C and ``of_rate`` its part H P- H."""
    if seen < a.window:
        return 1.0, 1.0
    total = 0.0
    for k in range(a.window):
        total += squares[k]
    alpha = min(max(1.0, total / (a.over * expected)), a.largest_alpha)
    if not a.fades or alpha == 1.0:
        return alpha, 1.0
    fade = alpha + (alpha - 1.0) * (expected - of_rate) / of_rate
    return alpha, min(max(1.0, fade), a.largest_lambda)  # infinite where the rate is 0: cut off as well


@compiled
def _correct_rate(
    rate: float, var: float, residual: float, r: float, alpha: float, fade: float, twice: bool
) -> tuple[float, float, float]:
    """Apply (20)-(22): return the rate, its variance, and the share of its error that is left."""
    h = rate + rate
    faded, of_rate = fade * var, h * var * h
    if twice:
        gain = fade / alpha * faded * h / (h * faded * h + r)
        left = 1.0 - gain * h
    else:  # left is 1 - K H, put so that rounding cannot take it below 0: lambda is that of (23) or smaller
        total = alpha * (of_rate + r)
        gain = faded * h / total
        left = (r + max(0.0, (alpha - 1.0) * (of_rate + r) - (fade - 1.0) * of_rate)) / total
    return rate + gain * residual, left * faded, left


@compiled
def step(state: State, sample: SpinSample, c: Coefficients) -> tuple[State, SpinOutput]:
    """Predict, compare the innovations with their expected variance, correct."""
    ekf, squares, seen, n_lost = state
    if ekf.start.held < c.ekf.room:
        ekf, output = spin_ekf.begin_state(ekf, sample, c.ekf)
        return State(ekf, squares, seen, n_lost), output
    dt_s, r = sample.dt_s, c.ekf.process.noise.square_var * sample.square_widened
    rate, var = predict_rate(ekf.motion, ekf.drive, dt_s, c.ekf.process.per_step)
    left, innovation = 1.0, nan
    if sample.has_square:
        h = rate + rate
        of_rate = h * var * h
        residual = sample.square_rad2ps2 - rate * rate
        squares[seen % c.adaptation.window] = residual * residual
        seen += 1
        alpha, fade = _adapt(squares, seen, of_rate + r, of_rate, c.adaptation)
        rate, var, left = _correct_rate(rate, var, residual, r, alpha, fade, c.adaptation.twice)
        innovation = residual / sqrt(of_rate + r)
    if not var > 0.0:
        var, left, n_lost = rate_variance(rate, r), 0.0, n_lost + 1
    motion, is_turned_over = set_sense(integrate_rate(ekf.motion, rate, left, var, dt_s), sample.direction)
    if not is_sound(motion):
        ekf, output = spin_ekf.restart_state(ekf, sample, c.ekf)
        return State(ekf, squares, 0, n_lost), output
    tally = count_sample(ekf.tally, sample, is_turned_over)
    ekf = spin_ekf.State(ekf.start, motion, make_drive(sample, c.ekf.process.noise.accel_var), tally)
    return State(ekf, squares, seen, n_lost), SpinOutput(motion, innovation, n_lost == 0)
