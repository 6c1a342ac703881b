"""The measurements of a spinning body, linearised: one dense whitened Jacobian for each block of samples.

x_k is the mean rate over the interval (t_{k-1}, t_k] that ends at sample k, as a gyro would give it. It makes the
angle exact, angle_k = angle_{k-1} + dt_k x_k, and each sample of the acceleration one link of a chain whose noise is
white: x_{k+1} - x_k = h_k (acceleration_k + noise), h_k = (dt_k + dt_{k+1}) / 2. The rate at t_k lies between:
rate_k = p_k x_k + (1 - p_k) x_{k+1}. A sample measures

    acceleration:  (1 + e_a) (x_{k+1} - x_k) / h_k + b_a + g (c_a cos angle_k + s_a sin angle_k)
    squared rate:  (1 + e_s) rate_k^2            + b_s + g (c_s cos angle_k + s_s sin angle_k)

and an encoder angle(t - latency) + offset. The columns of a block are those of ``Layout``.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.recording import Floats
from stillpoint.smoother.roll_encoder import EncoderReadings, encoder_rows
from stillpoint.smoother.roll_params import RollNoise
from stillpoint.smoother.roll_samples import RollSamples
from stillpoint.smoother.roll_state import AMPLITUDE, ARM_A, ARM_S, BIAS_A, BIAS_S, Layout, RollState, in_blocks

LINK_SD_RAD = 1e-7  # of an angle that is the sum of the rates: so small that it is exact, large enough to factorise
LONG_STEP = 1.5  # of the median step: after a longer one the samples say nothing of the acceleration between


@dataclass(frozen=True, eq=False)
class Chain:
    """The samples filled up to whole blocks, (B, m), and which constants hold in each."""

    samples: RollSamples
    params: RollNoise
    layout: Layout
    step_s: Floats  # (N + 1,) with the one after the last sample
    span_s: Floats  # (B, m) h
    before: Floats  # (B, m) share p of x_k in the rate at the sample
    constants_of: NDArray[np.int64]  # (B,) row of RollState.constants
    accel_radps2: Floats  # (B, m) interpolated where not valid
    accel_seen: NDArray[np.bool_]  # (B, m) where a sample shows it
    squared_valid: NDArray[np.bool_]  # (B, m)
    readings: EncoderReadings | None

    @property
    def blocks(self) -> int:
        """How many."""
        return len(self.span_s)


def chain_of(
    samples: RollSamples, readings: EncoderReadings | None, block: int, bias_step_s: float, params: RollNoise
) -> Chain:
    """The samples by blocks."""
    n = len(samples)
    count = -(-n // block)
    median_s = float(np.median(samples.step_s))
    step_s = np.append(samples.step_s, median_s)
    usual = step_s <= LONG_STEP * median_s
    seen = samples.accel_valid & usual[:-1] & usual[1:]
    rows = np.arange(n)
    accel = np.interp(rows, rows[samples.accel_valid], samples.accel_radps2[samples.accel_valid])
    first_s = (samples.t_ns[::block][:count] - samples.t_ns[0]) / 1e9
    return Chain(
        samples=samples,
        params=params,
        layout=Layout(block),
        step_s=step_s,
        span_s=in_blocks((step_s[:-1] + step_s[1:]) / 2, block, median_s),
        before=in_blocks(step_s[1:] / (step_s[:-1] + step_s[1:]), block, 0.5),
        constants_of=(first_s / bias_step_s).astype(np.int64),
        accel_radps2=in_blocks(accel, block, 0.0),
        accel_seen=in_blocks(seen, block, False),
        squared_valid=in_blocks(samples.squared_valid, block, False),
        readings=readings,
    )


def angles_of(chain: Chain, state: RollState) -> Floats:
    """Angle at every sample, (N,)."""
    return np.asarray(state.start_angle_rad + np.cumsum(chain.step_s[:-1] * state.mean_rate_radps[:-1]))


def rates_of(chain: Chain, state: RollState) -> Floats:
    """Rate at every sample, (N,)."""
    n = len(chain.samples)
    p, x = chain.before.ravel()[:n], state.mean_rate_radps
    return np.asarray(p * x[:-1] + (1 - p) * x[1:])


def residuals(chain: Chain, state: RollState) -> tuple[Floats, Floats]:
    """Measured less predicted acceleration and squared rate, (B, m); 0 for squared rates that are not valid."""
    n, m = len(chain.samples), chain.layout.m
    c = state.constants[chain.constants_of][:, :, None]
    gravity_a, gravity_s = _gravity(chain, angles_of(chain, state))
    change = in_blocks(np.diff(state.mean_rate_radps), m, 0.0) / chain.span_s
    rate = in_blocks(rates_of(chain, state), m, 0.0)
    squared = in_blocks(chain.samples.squared_rad2ps2, m, 0.0)
    accel = chain.accel_radps2 - ((1 + c[:, ARM_A]) * change + c[:, BIAS_A] + c[:, AMPLITUDE] * gravity_a)
    squared = squared - ((1 + c[:, ARM_S]) * rate**2 + c[:, BIAS_S] + c[:, AMPLITUDE] * gravity_s)
    accel.ravel()[n:] = 0.0
    return accel, np.where(chain.squared_valid, squared, 0.0)


def _gravity(chain: Chain, angle_rad: Floats) -> tuple[Floats, Floats]:
    """The harmonic of amplitude 1 in both channels, (B, m)."""
    both = np.stack([np.cos(angle_rad), np.sin(angle_rad)])
    m = chain.layout.m
    return (
        in_blocks(chain.samples.accel_gravity @ both, m, 0.0),
        in_blocks(chain.samples.squared_gravity @ both, m, 0.0),
    )


@cache
def mean_weight(robust: float) -> float:
    """The mean Geman-McClure weight of a normal residual of sd 1."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(64)
    return float(np.sum(weights / (1 + (nodes / robust) ** 2) ** 2) / np.sum(weights))


def roots_of_weights(chain: Chain, accel: Floats, squared: Floats, sds: tuple[float, float]) -> tuple[Floats, Floats]:
    """Square roots of the information that each residual has, robust weight and noise together, (B, m).

    ``sds`` are those of a sample's acceleration and squared rate. Weights are 1 on average over normal noise, so that
    the covariance is that of least squares.
    """
    mean = mean_weight(chain.params.robust)
    accel_sd, squared_sd = (sd * np.sqrt(mean) for sd in sds)
    unseen, limit = chain.params.unseen_radps2, chain.params.robust / np.sqrt(mean)
    root_a = chain.accel_seen / (1 + (accel / (limit * accel_sd)) ** 2) / accel_sd
    root_s = chain.squared_valid / (1 + (squared / (limit * squared_sd)) ** 2) / squared_sd
    return np.maximum(root_a, 1 / max(unseen, accel_sd)), root_s


def jacobian(chain: Chain, state: RollState, sds: tuple[float, float]) -> Floats:
    """Whitened rows and their right sides, (B, rows, width + 1), of the changes of the unknowns."""
    m, layout = chain.layout.m, chain.layout
    a = np.zeros((chain.blocks, 1 + 2 * m, layout.inside + layout.shared + 1))
    r_accel, r_squared = residuals(chain, state)
    root_a, root_s = roots_of_weights(chain, r_accel, r_squared, sds)
    rates, constants, j = layout.rates, layout.constants, np.arange(m)
    c = state.constants[chain.constants_of][:, :, None]
    angle = angles_of(chain, state)
    gravity_a, gravity_s = _gravity(chain, angle)
    turned_a, turned_s = _gravity(chain, angle + np.pi / 2)  # d/d angle
    rate = in_blocks(rates_of(chain, state), m, 0.0)
    change = in_blocks(np.diff(state.mean_rate_radps), m, 0.0) / chain.span_s
    steps = in_blocks(chain.step_s[:-1], m, 0.0)

    a[:, 0, rates[:m]], a[:, 0, layout.angle], a[:, 0, layout.angle + 2] = -steps, -1.0, 1.0
    a[:, 0] /= LINK_SD_RAD

    by_accel = root_a * (1 + c[:, ARM_A]) / chain.span_s
    a[:, 1 + j, rates[:-1]], a[:, 1 + j, rates[1:]] = -by_accel, by_accel
    by_rate = root_s * 2 * (1 + c[:, ARM_S]) * rate
    a[:, 1 + m + j, rates[:-1]], a[:, 1 + m + j, rates[1:]] = by_rate * chain.before, by_rate * (1 - chain.before)
    if state.constants[:, AMPLITUDE].any():
        for first, root, turned in ((1, root_a, turned_a), (1 + m, root_s, turned_s)):
            by_angle = root * c[:, AMPLITUDE] * turned
            a[:, first + j, layout.angle] = by_angle
            until = np.tril(np.ones((m, m)))  # the angle at a sample holds the rates before it
            a[:, first : first + m, rates[:m]] += by_angle[:, :, None] * steps[:, None, :] * until
    a[:, 1 + j, constants[BIAS_A]], a[:, 1 + m + j, constants[BIAS_S]] = root_a, root_s
    a[:, 1 + j, constants[ARM_A]], a[:, 1 + m + j, constants[ARM_S]] = root_a * change, root_s * rate**2
    a[:, 1 + j, constants[AMPLITUDE]] = root_a * gravity_a
    a[:, 1 + m + j, constants[AMPLITUDE]] = root_s * gravity_s
    a[:, 1 + j, -1], a[:, 1 + m + j, -1] = root_a * r_accel, root_s * r_squared
    if chain.readings is None:
        return a
    t_s = (chain.samples.t_ns - chain.samples.t_ns[0]) / 1e9
    rows, _ = encoder_rows(chain.readings, layout, t_s, chain.step_s[:-1], angle, state)
    return np.concatenate([a, rows], axis=1)
