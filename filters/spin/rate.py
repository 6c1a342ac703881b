"""Steps that the estimators with the rate as their only state share: prediction, and the angle as its integral.

The angle is never corrected. Its variance still follows from that of the rate: with A the share of the rate's error
that an update leaves, the errors of angle and rate evolve as (e_angle + T/2 (e + e'), e' = A e + noise).
"""

from typing import NamedTuple

from stillpoint.datasets.compiled import compiled, like
from stillpoint.filters.spin.noise import Noise
from stillpoint.filters.spin.sample import SpinMotion, SpinSample, wrap_angle

MEDIAN_OF = 9  # samples


class Counts(NamedTuple):
    """Counts of what was handled specially."""

    n_no_accel: int  # samples whose angular acceleration is missing: counted as none
    n_no_square: int  # samples without an update
    n_turned_over: int  # times that the sense of the spin was found to be the other one
    n_begun_anew: int  # times that rate or variance left what any body or sensor has


class Drive(NamedTuple):
    """The angular acceleration that drives the next interval."""

    accel_radps2: float
    var: float


class Process(NamedTuple):
    """How the rate evolves from sample to sample."""

    noise: Noise
    per_step: bool  # True: T^2 Q is added per step, as x' = x + T u asks for; False: Q as (12) is printed


@compiled
def start_counts() -> Counts:
    """Return counts of 0."""
    return Counts(0, 0, 0, 0)


@compiled
def count_sample(tally: Counts, sample: SpinSample, is_turned_over: bool) -> Counts:
    """Count one sample."""
    return Counts(
        tally.n_no_accel + (0 if sample.has_accel else 1),
        tally.n_no_square + (0 if sample.has_square else 1),
        tally.n_turned_over + (1 if is_turned_over else 0),
        tally.n_begun_anew,
    )


@compiled
def count_restart(tally: Counts) -> Counts:
    """Count one restart."""
    return Counts(tally.n_no_accel, tally.n_no_square, tally.n_turned_over, tally.n_begun_anew + 1)


@compiled
def make_drive(sample: SpinSample, accel_var: float) -> Drive:
    """Return the drive by the angular acceleration at this sample, 0 where it is missing."""
    if not sample.has_accel:
        return Drive(0.0, accel_var)
    return Drive(sample.accel_radps2, accel_var * sample.accel_widened)


@compiled
def predict_rate(motion: SpinMotion, drive: Drive, dt_s: float, per_step: bool) -> tuple[float, float]:
    """Apply (12): return the rate and its variance, by the angular acceleration at the sample before."""
    q = dt_s * dt_s * drive.var if per_step else drive.var
    return motion.rate_radps + dt_s * drive.accel_radps2, motion.rate_var + q


@compiled
def integrate_rate(motion: SpinMotion, rate_radps: float, left: float, rate_var: float, dt_s: float) -> SpinMotion:
    """Integrate the mean of both rates; ``left`` is the share A of the rate's error that remains."""
    half_s = 0.5 * dt_s
    turns, rest = wrap_angle(motion.turns, motion.rest_rad + half_s * (motion.rate_radps + rate_radps))
    kept = left * motion.rate_var
    crossed = left * motion.cross_var
    angle_var = motion.angle_var + dt_s * (motion.cross_var + crossed)
    angle_var += half_s * half_s * (motion.rate_var + kept + kept + rate_var)
    return SpinMotion(turns, rest, rate_radps, angle_var, crossed + half_s * (kept + rate_var), rate_var)


@compiled
def set_sense(motion: SpinMotion, direction: int) -> tuple[SpinMotion, bool]:
    """Give the rate the sense that a sensor shows; return whether it had to be reversed."""
    rate = motion.rate_radps
    if direction == 0 or rate * like(rate, direction) >= 0.0 or rate * rate < motion.rate_var:
        return motion, False
    return SpinMotion(motion.turns, motion.rest_rad, -rate, motion.angle_var, -motion.cross_var, motion.rate_var), True
