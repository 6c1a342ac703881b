"""Pair an estimate with a truth at the stamps of the sparser of the two. Interpolation never crosses a gap."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.errors import BadRecording, Unobservable
from stillpoint.datasets.frames import slerp
from stillpoint.datasets.recording import Floats, Times, Truth
from stillpoint.datasets.times import GAP_STEPS
from stillpoint.datasets.trajectory import Estimate, Reference

Mask = NDArray[np.bool_]

_SPARSER = 1.05  # ratio of median steps: rates that differ by jitter count as equal


@dataclass(frozen=True, eq=False)
class Track:
    """An attitude on its own clock, as scores read it: of an estimate, a reference or a truth; whole, or a part of it.

    ``step_ns`` and ``span_ns`` are those of the whole.
    """

    label: str  # "vqf of run7", for messages
    t_ns: Times  # (N,)
    q_nb: Floats  # (N, 4)
    cov_b_rad2: Floats | None  # (N, 3, 3)
    unready: Mask  # (N,)
    step_ns: float  # the median step between samples; 0 for a single one
    span_ns: tuple[int, int]  # the first and the last stamp

    @property
    def longest_step_ns(self) -> float:
        """The longest interval that is not a gap."""
        return GAP_STEPS * self.step_ns


@dataclass(frozen=True, eq=False)
class Pairs:
    """K times at which both an estimate and a truth can be read, and both attitudes there."""

    t_ns: Times  # (K,) on the truth's clock
    q_est: Floats  # (K, 4)
    q_true: Floats  # (K, 4)
    cov_b_rad2: Floats | None  # (K, 3, 3) of the estimate
    true_cov_b_rad2: Floats | None  # (K, 3, 3) of the truth
    moving: Mask  # (K,) the truth moves there


@dataclass(frozen=True, eq=False)
class Match:
    """Whether a trajectory can be read at M times, and if not, why. At most one of the masks is set."""

    outside: Mask  # (M,) before the first or after the last sample
    in_gap: Mask  # (M,) between two samples that are too far apart
    unready: Mask  # (M,) a neighbouring sample says that the estimator is still starting

    @property
    def found(self) -> Mask:
        """(M,) True where the estimate can be read."""
        return ~(self.outside | self.in_gap | self.unready)

    def counts(self) -> tuple[int, int, int]:
        """Return how many times are outside, in a gap, and not ready."""
        return int(self.outside.sum()), int(self.in_gap.sum()), int(self.unready.sum())


def track(thing: Estimate | Reference | Truth) -> Track:
    """Return the attitude of a thing; raises :class:`BadRecording` for an estimate that has only an angle."""
    t_ns = thing.t_ns
    cov = None if isinstance(thing, Truth) else thing.cov_b_rad2
    step_ns = float(np.median(np.diff(t_ns))) if len(t_ns) > 1 else 0.0
    span_ns = int(t_ns[0]), int(t_ns[-1])
    return Track(label_of(thing), t_ns, get_attitude(thing), cov, find_unready(thing), step_ns, span_ns)


def label_of(thing: Estimate | Reference | Truth) -> str:
    """Return the name of a thing in messages."""
    if isinstance(thing, Truth):
        return "truth"
    return f"reference of {thing.name}" if isinstance(thing, Reference) else f"{thing.name} of {thing.recording}"


def get_attitude(thing: Estimate | Reference | Truth) -> Floats:
    """Return the attitudes (N, 4) of a thing; raises :class:`BadRecording` for an estimate that has only an angle."""
    if thing.q_nb is None:
        raise BadRecording(f"{label_of(thing)}: is an angle about one axis; give an estimate with an attitude")
    return thing.q_nb


def find_unready(thing: Estimate | Reference | Truth) -> Mask:
    """Return at which samples (N,) an estimator says that it is still starting."""
    if isinstance(thing, Estimate) and thing.ready is not None:
        return ~thing.ready
    return np.zeros(len(thing.t_ns), dtype=np.bool_)


def match(source: Track, at_ns: Times) -> Match:
    """Find which of the times ``at_ns`` (M,) lie between two near samples of the track that are both ready."""
    t = source.t_ns
    outside = (at_ns < source.span_ns[0]) | (at_ns > source.span_ns[1])
    left, right = _find_neighbours(t, at_ns)
    in_gap = ~outside & (t[right] - t[left] > source.longest_step_ns)
    unready = ~outside & ~in_gap & (source.unready[left] | source.unready[right])
    return Match(outside, in_gap, unready)


def require_some(source: Track, matched: Match) -> Mask:
    """Return ``matched.found``; raises :class:`Unobservable` with the reasons when it is False everywhere."""
    if not matched.found.any():
        raise Unobservable(describe_none(source.label, len(matched.found), matched.counts()))
    return matched.found


def describe_none(label: str, n: int, counts: tuple[int, int, int]) -> str:
    """Return the error of a trajectory that covers none of n moving samples, with the counts of a :class:`Match`."""
    reasons = zip(counts, ("outside its span", "in its gaps", "not ready"), strict=True)
    counted = ", ".join(f"{count} {reason}" for count, reason in reasons if count)
    return (
        f"{label}: covers none of the {n} moving samples of the truth ({counted}); "
        "are both of one recording and on one clock?"
    )


def is_sparser(estimated: Track, truth: Track) -> bool:
    """Return whether the estimate has clearly longer steps than the truth, so that the truth is the one to
    interpolate.
    """
    return estimated.step_ns > _SPARSER * truth.step_ns


def pair_up(estimated: Track, truth: Track, moving: Mask, offset_ns: int = 0) -> Pairs:
    """Read both trajectories at the stamps of the sparser one, where the other can be interpolated.

    ``moving`` (N,) belongs to the truth's samples; ``offset_ns`` is how late the estimate's clock is. Interpolating
    the sparser side would count the curvature of the path between its poses as an error of the estimate.
    """
    if not is_sparser(estimated, truth):
        at_ns = truth.t_ns + offset_ns
        kept = match(estimated, at_ns).found
        at_ns = at_ns[kept]
        true_cov = None if truth.cov_b_rad2 is None else truth.cov_b_rad2[kept]
        q_est, cov = interpolate_attitude(estimated, at_ns), interpolate_covariance(estimated, at_ns)
        return Pairs(truth.t_ns[kept], q_est, truth.q_nb[kept], cov, true_cov, moving[kept])
    at_ns = estimated.t_ns - offset_ns
    kept = match(truth, at_ns).found & ~estimated.unready
    at_ns = at_ns[kept]
    cov = None if estimated.cov_b_rad2 is None else estimated.cov_b_rad2[kept]
    left, right = _find_neighbours(truth.t_ns, at_ns)
    q_true, true_cov = interpolate_attitude(truth, at_ns), interpolate_covariance(truth, at_ns)
    return Pairs(at_ns, estimated.q_nb[kept], q_true, cov, true_cov, moving[left] & moving[right])


def interpolate_attitude(source: Track, at_ns: Times) -> Floats:
    """Return attitudes (M, 4) at times within the track's span, along the great circle between neighbours."""
    return slerp(source.t_ns, source.q_nb, at_ns)


def interpolate_covariance(source: Track, at_ns: Times) -> Floats | None:
    """Return covariances (M, 3, 3), linear between neighbours (so positive definite); None where there are none."""
    if source.cov_b_rad2 is None:
        return None
    left, right = _find_neighbours(source.t_ns, at_ns)
    step = np.maximum(source.t_ns[right] - source.t_ns[left], 1)
    share = ((at_ns - source.t_ns[left]) / step)[:, None, None]
    return source.cov_b_rad2[left] * (1 - share) + source.cov_b_rad2[right] * share


def _find_neighbours(t_ns: Times, at_ns: Times) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the samples at or before, and at or after, each time; an exact hit gives the same one twice."""
    left = np.clip(np.searchsorted(t_ns, at_ns, side="right") - 1, 0, len(t_ns) - 1)
    right = np.clip(np.searchsorted(t_ns, at_ns, side="left"), 0, len(t_ns) - 1)
    return left, right
