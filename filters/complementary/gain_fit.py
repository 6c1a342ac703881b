"""Gains of a PI filter by least squares over its samples: eq (22) of paper 003, for one angle.

The equations, what is regressed on what and why, are in :mod:`stillpoint.filters.complementary.least_squares`.
Each row of H and S comes times T, as the filter adds it in one step; forgetting is exponential.
"""

from math import exp
from typing import NamedTuple

from stillpoint.filters.compiled import compiled_inside
from stillpoint.filters.complementary.fixed_gain import shares

# 1 - (correlation of error and integral)^2 below which both gains together explain the samples, but neither alone.
LEAST_INDEPENDENT = 1e-5


class Regression(NamedTuple):
    """How the gains are fitted; derived once from the parameters."""

    fixed_samples: int  # before the first fit
    memory_s: float
    kp_low_per_s: float
    kp_high_per_s: float
    ki_low_per_s2: float
    as_printed: bool  # S is what was added, and there are no bounds; else what should have been added


class Fit(NamedTuple):
    """Sums over the samples so far, with forgetting, that make H^T H and H^T S of (22), and its solution."""

    ee: float  # (rad s)^2; e for the error, i for its integral, s for S, each times T
    ei: float  # rad^2 s^3
    ii: float  # rad^2 s^4
    es: float  # rad^2 s
    si: float  # rad^2 s^2
    samples: int
    kp_per_s: float
    ki_per_s2: float
    clipped: int  # fits beyond the bounds
    undetermined: int  # samples that keep the gains: error and integral are proportional


class Part(NamedTuple):
    """One of roll, pitch, heading between two samples of its sensor."""

    fit: Fit
    error_rad_s: float  # e T of the last sample: the first column of H, times T
    integral_rad_s: float  # the second column of H
    turned_rad: float  # by kp, at the last sample
    ki_per_s2: float  # in use


@compiled_inside
def unfitted(kp_per_s: float, ki_per_s2: float) -> Part:
    """Before the first sample, with these gains."""
    return Part(Fit(0.0, 0.0, 0.0, 0.0, 0.0, 0, kp_per_s, ki_per_s2, 0, 0), 0.0, 0.0, 0.0, ki_per_s2)


@compiled_inside
def fitted(fit: Fit, error: float, integral: float, added: float, dt_s: float, c: Regression) -> Fit:
    """Eq (22) with one more row of H and S, given times T."""
    ee, ei, ii, es, si, samples, kp, ki, clipped, undetermined = fit
    fade = exp(-dt_s / c.memory_s)
    ee, ei, ii = ee * fade + error * error, ei * fade + error * integral, ii * fade + integral * integral
    es, si = es * fade + error * added, si * fade + integral * added
    samples += 1
    if samples >= c.fixed_samples:
        determinant = ee * ii - ei * ei
        if determinant > LEAST_INDEPENDENT * ee * ii:
            kp, ki = (ii * es - ei * si) / determinant, (ee * si - ei * es) / determinant
            if not c.as_printed:
                best_kp, best_ki = kp, ki
                kp = min(max(kp, c.kp_low_per_s), c.kp_high_per_s)
                ki = min(max(ki, c.ki_low_per_s2), kp * kp * 0.25)
                clipped += 1 if kp != best_kp or ki != best_ki else 0
        else:
            undetermined += 1
    return Fit(ee, ei, ii, es, si, samples, kp, ki, clipped, undetermined)


@compiled_inside
def after_sample(part: Part, error: float, integral: float, dt_s: float, follows: bool, c: Regression) -> Part:
    """One part after a sample: the gains fitted to what the last correction left over, then the next correction.

    ``integral`` is this part's before this error; ``follows`` is False where the sample before is too old for a row.
    """
    fit = part.fit
    if follows:
        added = part.turned_rad + part.ki_per_s2 * part.integral_rad_s * dt_s
        should = added if c.as_printed else added + error
        fit = fitted(fit, part.error_rad_s, part.integral_rad_s * dt_s, should, dt_s, c)
    turned, biased = shares(fit.kp_per_s, fit.ki_per_s2, dt_s)
    return Part(fit, error * dt_s, integral + error * dt_s, error * turned, biased / dt_s)


@compiled_inside
def interrupted(part: Part) -> Part:
    """After a gap: the fit goes on, but its next row has no correction before it."""
    return Part(part.fit, 0.0, part.integral_rad_s, 0.0, part.ki_per_s2)
