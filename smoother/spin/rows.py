"""Linearise the measurement equations of a spinning body: one dense whitened Jacobian for each block.

A sample measures, with errors e of the lever arms, biases b, gravity's amplitude g and its parts c and s,

    acceleration:  (1 + e_a) (x_{k+1} - x_k) / h_k + b_a + g (c_a cos angle_k + s_a sin angle_k)
    squared rate:  (1 + e_s) rate_k^2              + b_s + g (c_s cos angle_k + s_s sin angle_k)

and an encoder measures angle(t - latency) + offset. A vibration adds v_c cos + v_s sin, of an angle found beforehand,
to each channel. x, h and rate are those of chain.py; the columns are those of ``Layout``.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from stillpoint.datasets.constants import MEDIAN_DEVIATION_TO_SD
from stillpoint.datasets.recording import Floats
from stillpoint.smoother.spin.chain import Chain, integrate_angles, interpolate_rates
from stillpoint.smoother.spin.encoder import build_encoder_rows, compute_encoder_residuals
from stillpoint.smoother.spin.params import SpinNoise
from stillpoint.smoother.spin.state import (
    AMPLITUDE,
    ARM_A,
    ARM_S,
    BIAS_A,
    BIAS_S,
    COS_A,
    COS_S,
    SIN_A,
    SIN_S,
    SpinState,
    split_blocks,
)

_LINK_SD_RAD = 1e-7  # of an angle that is the sum of the rates: practically exact, but well conditioned


@dataclass(frozen=True, eq=False)
class SpinFit:
    """Predictions of a trajectory for the samples, and residuals (measured minus predicted), (B, m) each."""

    state: SpinState
    rate_radps: Floats
    change_radps2: Floats  # of the mean rates
    gravity_accel: Floats  # 1/m: of amplitude 1
    gravity_squared: Floats
    turned_accel: Floats  # their derivatives by the angle
    turned_squared: Floats
    accel_residual: Floats  # rad/s^2, 0 beyond the last sample
    squared_residual: Floats  # rad^2/s^2, 0 where not valid
    encoder_residual: Floats | None  # (E,) rad


def fit(chain: Chain, state: SpinState) -> SpinFit:
    """Return predictions and residuals of a trajectory."""
    n, m, samples = len(chain.samples), chain.layout.m, chain.samples
    c = state.constants[chain.constants_of][:, :, None]
    angle = integrate_angles(chain, state)
    cos, sin = split_blocks(np.cos(angle), m, 0.0), split_blocks(np.sin(angle), m, 0.0)
    (ca, sa), (cs, ss) = samples.accel_gravity, samples.squared_gravity
    gravity_a, gravity_s = ca * cos + sa * sin, cs * cos + ss * sin
    rate = split_blocks(interpolate_rates(chain, state), m, 0.0)
    change = split_blocks(np.diff(state.mean_rate_radps), m, 0.0) / chain.span_s
    accel = chain.accel_radps2 - ((1 + c[:, ARM_A]) * change + c[:, BIAS_A] + c[:, AMPLITUDE] * gravity_a)
    squared = split_blocks(samples.squared_rad2ps2, m, 0.0)
    squared -= (1 + c[:, ARM_S]) * rate**2 + c[:, BIAS_S] + c[:, AMPLITUDE] * gravity_s
    if chain.shaken is not None:
        accel -= c[:, COS_A] * chain.shaken[0] + c[:, SIN_A] * chain.shaken[1]
        squared -= c[:, COS_S] * chain.shaken[0] + c[:, SIN_S] * chain.shaken[1]
    accel.ravel()[n:] = 0.0
    return SpinFit(
        state=state,
        rate_radps=rate,
        change_radps2=change,
        gravity_accel=gravity_a,
        gravity_squared=gravity_s,
        turned_accel=sa * cos - ca * sin,
        turned_squared=ss * cos - cs * sin,
        accel_residual=accel,
        squared_residual=np.where(chain.squared_valid, squared, 0.0),
        encoder_residual=None
        if chain.readings is None
        else compute_encoder_residuals(chain.readings, angle, state, np.repeat(chain.constants_of, m)[:n]),
    )


@dataclass(frozen=True)
class Sizes:
    """Noise sd of a sample of each kind."""

    accel_radps2: float
    squared_rad2ps2: float
    encoder_rad: float


def estimate_sizes(chain: Chain, at: SpinFit, params: SpinNoise) -> Sizes:
    """Return the noise sizes: the larger of the samples' own noise and the residuals'; the former if noise is given."""
    samples, readings = chain.samples, chain.readings
    accel, squared = samples.accel_sd, samples.squared_sd
    encoder = 1.0 if readings is None else readings.sd_rad
    if params.source == "given":
        return Sizes(accel, squared, encoder)
    if at.encoder_residual is not None:
        encoder = max(encoder, _median_size(at.encoder_residual))
    return Sizes(
        max(accel, _median_size(at.accel_residual[chain.accel_seen])),
        max(squared, _median_size(at.squared_residual[chain.squared_valid])),
        encoder,
    )


def _median_size(residual: Floats) -> float:
    return MEDIAN_DEVIATION_TO_SD * float(np.median(np.abs(residual))) if len(residual) else 0.0


@cache
def mean_weight(robust: float) -> float:
    """Return the mean Geman-McClure weight of a normal residual of sd 1."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(64)
    return float(np.sum(weights / (1 + (nodes / robust) ** 2) ** 2) / np.sum(weights))


@dataclass(frozen=True, eq=False)
class Roots:
    """Square roots of each residual's information: robust weight and noise together."""

    accel: Floats  # (B, m)
    squared: Floats  # (B, m)
    encoder: Floats | None  # (E,)


def compute_roots(chain: Chain, at: SpinFit, sizes: Sizes) -> Roots:
    """Return Geman-McClure weights that are 1 on average over normal noise, as in least squares.

    An acceleration that is missing or a glitch counts as a measurement of 0 with sd ``unseen_radps2``.
    """
    robust, unseen = chain.params.robust, chain.params.unseen_radps2

    def root(residual: Floats, sd: float) -> Floats:
        return np.asarray(1 / (1 + (residual / (robust * sd)) ** 2) / (sd * np.sqrt(mean_weight(robust))))

    accel = chain.accel_seen * root(at.accel_residual, sizes.accel_radps2)
    squared = chain.squared_valid * root(at.squared_residual, sizes.squared_rad2ps2)
    encoder = None if at.encoder_residual is None else root(at.encoder_residual, sizes.encoder_rad)
    return Roots(np.maximum(accel, 1 / max(unseen, sizes.accel_radps2)), squared, encoder)


def cost(at: SpinFit, roots: Roots) -> float:
    """Return the sum of weighted squares; if it falls with fixed weights, the robust cost falls too."""
    total = np.sum((roots.accel * at.accel_residual) ** 2) + np.sum((roots.squared * at.squared_residual) ** 2)
    if at.encoder_residual is not None and roots.encoder is not None:
        total += np.sum((roots.encoder * at.encoder_residual) ** 2)
    return float(total)


def build_jacobian(chain: Chain, at: SpinFit, roots: Roots) -> Floats:
    """Return whitened rows for changes of the unknowns, with their right sides, (B, rows, columns + 1)."""
    m, layout = chain.layout.m, chain.layout
    a = np.zeros((chain.blocks, 1 + 2 * m, layout.inside + layout.shared + 1))
    rates, constants = layout.rates, layout.constants
    accel, squared = 1 + np.arange(m), 1 + m + np.arange(m)
    c = at.state.constants[chain.constants_of][:, :, None]
    steps = split_blocks(chain.step_s[:-1], m, 0.0)

    a[:, 0, rates[:m]], a[:, 0, layout.angle], a[:, 0, layout.angle + 2] = -steps, -1.0, 1.0
    a[:, 0] /= _LINK_SD_RAD

    by_change = roots.accel * (1 + c[:, ARM_A]) / chain.span_s
    a[:, accel, rates[:-1]], a[:, accel, rates[1:]] = -by_change, by_change
    by_rate = roots.squared * 2 * (1 + c[:, ARM_S]) * at.rate_radps
    a[:, squared, rates[:-1]], a[:, squared, rates[1:]] = by_rate * chain.before, by_rate * (1 - chain.before)
    if at.state.constants[:, AMPLITUDE].any():
        until = np.tril(np.ones((m, m)))  # the angle at a sample is the sum of the rates before it
        for row, root, turned in (
            (accel, roots.accel, at.turned_accel),
            (squared, roots.squared, at.turned_squared),
        ):
            by_angle = root * c[:, AMPLITUDE] * turned
            a[:, row, layout.angle] = by_angle
            a[:, row[0] : row[-1] + 1, rates[:m]] += by_angle[:, :, None] * steps[:, None, :] * until
    a[:, accel, constants[BIAS_A]], a[:, squared, constants[BIAS_S]] = roots.accel, roots.squared
    a[:, accel, constants[ARM_A]] = roots.accel * at.change_radps2
    a[:, squared, constants[ARM_S]] = roots.squared * at.rate_radps**2
    a[:, accel, constants[AMPLITUDE]] = roots.accel * at.gravity_accel
    a[:, squared, constants[AMPLITUDE]] = roots.squared * at.gravity_squared
    if chain.shaken is not None:
        for part, of_accel, of_squared in zip(chain.shaken, (COS_A, SIN_A), (COS_S, SIN_S), strict=True):
            a[:, accel, constants[of_accel]] = roots.accel * part
            a[:, squared, constants[of_squared]] = roots.squared * part
    a[:, accel, -1], a[:, squared, -1] = roots.accel * at.accel_residual, roots.squared * at.squared_residual
    if chain.readings is None or at.encoder_residual is None or roots.encoder is None:
        return a
    rows = build_encoder_rows(chain.readings, at.encoder_residual, roots.encoder, layout, steps)
    return np.concatenate([a, rows], axis=1)
