"""Scores of an angle and a rate about a spin axis: the four figures of Asghari et al. 2018, and consistency.

An estimate's angle counts from its own first sample, an encoder's from its index mark: ``zero`` says what is taken
off. The *truth* is read at the estimate's stamps, its angle by the cubic through angles and rates, its rate along a
line; the estimate is not interpolated, as that would average its noise. Nothing is read across a gap of the truth.
"""

from dataclasses import dataclass, fields
from typing import Any, Literal, get_args

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.special import ndtri

from stillpoint.datasets.errors import BadParameter, BadRecording, Unobservable
from stillpoint.datasets.recording import Encoder, Floats, Times
from stillpoint.datasets.times import find_longest_step_ns
from stillpoint.datasets.trajectory import Estimate, SpinReference

AngleZero = Literal["start", "mean", "turns", "none"]
_ANGLE_ZEROS: tuple[AngleZero, ...] = get_args(AngleZero)
ZERO_WORDS: dict[AngleZero, str] = {
    "start": "the angle counts from the first sample",
    "mean": "the angle is free of its mean error",
    "turns": "absolute angles, whole turns aside",
    "none": "absolute angles",
}
_SD_95 = float(ndtri(0.975))


@dataclass(frozen=True, eq=False)
class SpinComparison:
    """N samples of an estimate at which there is a truth; errors are estimate minus truth."""

    estimated: str  # name of the estimator, or "reference (method)"
    against: str  # "truth", "encoder" or "reference (method)"
    recording: str
    zero: AngleZero
    angle_offset_rad: float  # subtracted from the angle
    t_ns: Times
    angle_error_rad: Floats
    rate_error_radps: Floats
    angle_sd_rad: Floats | None  # of the estimate
    rate_sd_radps: Floats | None
    true_angle_sd_rad: Floats | None  # of the reference; None against a truth or an encoder
    true_rate_sd_radps: Floats | None
    samples_outside: int  # left out: before the truth's first or after its last sample
    samples_in_gap: int  # ... in a gap of the truth
    samples_unready: int  # ... while the estimator was starting
    samples_interpolated: int  # scored between two stamps of the truth


@dataclass(frozen=True)
class SpinScore:
    """Errors of angle and rate about the spin axis: RMSE and largest size, as in Asghari et al. 2018."""

    estimated: str
    against: str
    recording: str
    zero: (
        AngleZero  # what was subtracted from the angle: the error at the start, the mean error, whole turns, or nothing
    )
    angle_offset_deg: float

    samples: int
    samples_outside: int
    samples_in_gap: int
    samples_unready: int
    samples_interpolated: int

    angle_max_deg: float
    angle_rmse_deg: float
    angle_end_deg: float  # error at the last sample, with its sign
    rate_max_degps: float
    rate_rmse_degps: float
    rate_mean_degps: float

    angle_nees: float | None  # mean (error / sd)^2: 1 when the stated sd is right; None without one
    angle_coverage95: float | None  # share of errors within 1.96 sd
    rate_nees: float | None
    rate_coverage95: float | None
    reference_angle_sd_deg: float | None  # median; None against a truth or an encoder
    reference_rate_sd_degps: float | None


def score_roll(
    estimated: Estimate | SpinReference, truth: Encoder | SpinReference, zero: AngleZero = "start", against: str = ""
) -> SpinScore:
    """Score angle and rate of an estimate or a roll reference against a truth, an encoder or a roll reference.

    ``zero``: the angle counts from the first common sample ("start", as in Asghari et al. 2018), is free of a
    mean error ("mean"), or is absolute, but for whole turns ("turns") or altogether ("none"); :func:`choose_zero` says
    which is usual. ``against`` names the truth; "" takes a reference's method, else "truth".
    Raises :class:`BadParameter`, :class:`BadRecording` for an estimate without angle and rate, and
    :class:`Unobservable` when no sample can be scored.
    """
    return score_spin_comparison(compare_spin(estimated, truth, zero, against))


def compare_spin(
    estimated: Estimate | SpinReference, truth: Encoder | SpinReference, zero: AngleZero = "start", against: str = ""
) -> SpinComparison:
    """Return the errors at every sample of the estimate that is ready and within the truth; see :func:`score_roll`."""
    if zero not in _ANGLE_ZEROS:
        raise BadParameter(f"zero: {zero!r} is not one of {', '.join(_ANGLE_ZEROS)}")
    name = f"reference ({estimated.method})" if isinstance(estimated, SpinReference) else estimated.name
    if estimated.angle_rad is None or estimated.rate_radps is None:
        raise BadRecording(f"{name}: has no angle and rate about an axis; score its attitude instead")
    t = estimated.t_ns
    outside = (t < truth.t_ns[0]) | (t > truth.t_ns[-1])
    left = np.clip(np.searchsorted(truth.t_ns, t, side="right") - 1, 0, len(truth.t_ns) - 1)
    right = np.clip(np.searchsorted(truth.t_ns, t, side="left"), 0, len(truth.t_ns) - 1)
    in_gap = ~outside & (truth.t_ns[right] - truth.t_ns[left] > find_longest_step_ns(truth.t_ns))
    known = ~(outside | in_gap)
    ready = estimated.ready if isinstance(estimated, Estimate) and estimated.ready is not None else known | True
    kept = known & ready
    if not kept.any():
        counts = f"{outside.sum()} outside its span, {in_gap.sum()} in its gaps, {(known & ~ready).sum()} not ready"
        raise Unobservable(f"{name}: none of {len(t)} samples can be scored ({counts}); are both on one clock?")
    angle, rate = _read(truth, t[known])
    angle_error = estimated.angle_rad[known] - angle
    mean = angle_error[ready[known]].mean()
    turns = 2 * np.pi * np.round(mean / (2 * np.pi))
    offset = {"start": angle_error[0], "mean": mean, "turns": turns, "none": 0.0}[zero]
    reference = truth if isinstance(truth, SpinReference) else None
    return SpinComparison(
        estimated=name,
        against=against or (f"reference ({reference.method})" if reference else "truth"),
        recording=estimated.recording if isinstance(estimated, Estimate) else estimated.name,
        zero=zero,
        angle_offset_rad=float(offset),
        t_ns=t[kept],
        angle_error_rad=(angle_error - offset)[ready[known]],
        rate_error_radps=(estimated.rate_radps[known] - rate)[ready[known]],
        angle_sd_rad=None if estimated.angle_sd_rad is None else estimated.angle_sd_rad[kept],
        rate_sd_radps=None if estimated.rate_sd_radps is None else estimated.rate_sd_radps[kept],
        true_angle_sd_rad=None if reference is None else np.interp(t[kept], reference.t_ns, reference.angle_sd_rad),
        true_rate_sd_radps=None if reference is None else np.interp(t[kept], reference.t_ns, reference.rate_sd_radps),
        samples_outside=int(outside.sum()),
        samples_in_gap=int(in_gap.sum()),
        samples_unready=int((known & ~ready).sum()),
        samples_interpolated=int((left != right)[kept].sum()),
    )


def choose_zero(estimated: Estimate | SpinReference, truth: Encoder | SpinReference, against: str = "") -> AngleZero:
    """Return what is subtracted from the angle by default.

    A reference that has its angle from gravity is absolute, and only whole turns are subtracted; otherwise the error of
    its first sample would count at all others. The zero of an encoder is its index, so against it the mean is
    subtracted. Every other angle counts from the first sample.
    """
    if not (isinstance(estimated, SpinReference) and _is_absolute(estimated)):
        return "start"
    if isinstance(truth, SpinReference):
        return "turns" if _is_absolute(truth) else "start"
    return "mean" if against == "encoder" else "turns"


def _is_absolute(reference: SpinReference) -> bool:
    """Return whether the angle of a reference comes from gravity: 0 where z points up."""
    return str(reference.diagnostics.get("angle", "")).startswith("from gravity")


def _read(truth: Encoder | SpinReference, t_ns: Times) -> tuple[Floats, Floats]:
    """Return angle and rate of the truth at stamps within its span; at its own stamps they are exact."""
    if len(truth.t_ns) < 2:
        return np.full(len(t_ns), truth.angle_rad[0]), np.full(len(t_ns), truth.rate_radps[0])
    zero_ns = truth.t_ns[0]
    t_s, at_s = (truth.t_ns - zero_ns) / 1e9, (t_ns - zero_ns) / 1e9
    angle = CubicHermiteSpline(t_s, truth.angle_rad, truth.rate_radps)(at_s)
    return np.asarray(angle), np.interp(at_s, t_s, truth.rate_radps)


def score_spin_comparison(c: SpinComparison) -> SpinScore:
    """Compute the figures of a comparison."""
    angle_deg, rate_degps = np.rad2deg(c.angle_error_rad), np.rad2deg(c.rate_error_radps)
    angle_nees, angle_coverage = _compute_consistency(c.angle_error_rad, c.angle_sd_rad)
    rate_nees, rate_coverage = _compute_consistency(c.rate_error_radps, c.rate_sd_radps)
    return SpinScore(
        estimated=c.estimated,
        against=c.against,
        recording=c.recording,
        zero=c.zero,
        angle_offset_deg=float(np.rad2deg(c.angle_offset_rad)),
        samples=len(c.t_ns),
        samples_outside=c.samples_outside,
        samples_in_gap=c.samples_in_gap,
        samples_unready=c.samples_unready,
        samples_interpolated=c.samples_interpolated,
        angle_max_deg=float(np.abs(angle_deg).max()),
        angle_rmse_deg=float(np.sqrt(np.mean(angle_deg**2))),
        angle_end_deg=float(angle_deg[-1]),
        rate_max_degps=float(np.abs(rate_degps).max()),
        rate_rmse_degps=float(np.sqrt(np.mean(rate_degps**2))),
        rate_mean_degps=float(rate_degps.mean()),
        angle_nees=angle_nees,
        angle_coverage95=angle_coverage,
        rate_nees=rate_nees,
        rate_coverage95=rate_coverage,
        reference_angle_sd_deg=_find_median_deg(c.true_angle_sd_rad),
        reference_rate_sd_degps=_find_median_deg(c.true_rate_sd_radps),
    )


def _compute_consistency(error: Floats, sd: Floats | None) -> tuple[float | None, float | None]:
    """Return NEES and 95 % coverage of the samples whose sd is above 0; an angle has none where it starts to count."""
    if sd is None or not (sd > 0).any():
        return None, None
    ratio = error[sd > 0] / sd[sd > 0]
    return float(np.mean(ratio**2)), float(np.mean(np.abs(ratio) <= _SD_95))


def _find_median_deg(sd_rad: Floats | None) -> float | None:
    return None if sd_rad is None else float(np.rad2deg(np.median(sd_rad)))


def spin_score_row(score: SpinScore) -> dict[str, Any]:
    """Return the score for machines: its fields, flat."""
    named = {"recording": score.recording, "method": score.estimated, "against": score.against}
    skipped = ("recording", "estimated", "against")
    return (
        named
        | {each.name: getattr(score, each.name) for each in fields(score) if each.name not in skipped}
        | {"error": None}
    )
