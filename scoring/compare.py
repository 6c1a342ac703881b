"""Compare an estimate with a truth: align it, pair both at the sparser one's stamps, count what is left out."""

from dataclasses import dataclass

import numpy as np

from stillpoint.datasets.errors import BadParameter, Unobservable
from stillpoint.datasets.frames import rotation
from stillpoint.datasets.recording import Floats, Times, Truth
from stillpoint.datasets.times import is_inside
from stillpoint.datasets.trajectory import Estimate, Reference
from stillpoint.scoring.align import AlignKind, Alignment, pair_and_align
from stillpoint.scoring.match import Mask, match, track


@dataclass(frozen=True, eq=False)
class Comparison:
    """N times, moving or not, at which there are a truth and an estimate; both in the truth's axes."""

    estimated: str  # name of the estimator, or "reference (method)"
    against: str  # "truth" or "reference (method)"
    recording: str
    alignment: Alignment
    t_ns: Times  # (N,) on the truth's clock; stamps of the truth, or of an estimate that is sparser
    q_est: Floats  # (N, 4) after alignment
    q_true: Floats  # (N, 4)
    cov_b_rad2: Floats | None  # (N, 3, 3) of the estimate, in the truth's body axes; all that was not aligned
    true_cov_b_rad2: Floats | None  # (N, 3, 3) of the reference; None against a truth
    moving: Mask  # (N,) the samples that are scored
    moving_share: float  # of all samples of the truth, with or without an estimate
    samples_outside: int  # moving samples left out: beyond the estimate's ends
    samples_in_gap: int  # ... between two samples of the estimate that are too far apart
    samples_unready: int  # ... while the estimator said that it was starting


def compare(
    estimated: Estimate | Reference,
    truth: Reference | Truth,
    align: AlignKind = "heading",
    moving: Mask | None = None,
) -> Comparison:
    """Align on the moving samples, then pair both at the stamps of the sparser one.

    ``moving`` (N,) says which samples of the truth count; by default ``truth.moving``, or outside a reference's rests.
    Raises :class:`BadParameter` for an unknown option, :class:`Unobservable` when nothing moves or overlaps.
    """
    source, judge, counted = track(estimated), track(truth), find_moving(truth, moving)
    if not counted.any():
        raise Unobservable(f"{name_of(truth)}: no sample of it moves, so there is nothing to score")
    pairs, alignment = pair_and_align(source, judge, counted, align)
    cov = pairs.cov_b_rad2
    if cov is not None and isinstance(estimated, Reference):
        cov = cov + _make_shared_covariance(estimated, pairs.q_est, align)
    matched = match(source, truth.t_ns[counted] + alignment.time_offset_ns)
    return Comparison(
        estimated=name_of(estimated),
        against=name_of(truth),
        recording=estimated.recording if isinstance(estimated, Estimate) else estimated.name,
        alignment=alignment,
        t_ns=pairs.t_ns,
        q_est=alignment.attitude(pairs.q_est),
        q_true=pairs.q_true,
        cov_b_rad2=None if cov is None else alignment.covariance(cov),
        true_cov_b_rad2=pairs.true_cov_b_rad2,
        moving=pairs.moving,
        moving_share=float(counted.mean()),
        samples_outside=int(matched.outside.sum()),
        samples_in_gap=int(matched.in_gap.sum()),
        samples_unready=int(matched.unready.sum()),
    )


def _make_heading_covariance(q_nb: Floats, heading_sd_rad: float) -> Floats:
    """Return the covariance (N, 3, 3) in body axes, at attitudes (N, 4), of a heading error that all samples share.

    It counts where no heading was aligned away; ``Reference.cov_b_rad2`` is relative to the mean heading.
    """
    up_b = rotation(q_nb).as_matrix()[:, 2]
    return heading_sd_rad**2 * up_b[:, :, None] * up_b[:, None, :]


def _make_shared_covariance(reference: Reference, q_nb: Floats, align: AlignKind) -> Floats:
    """Return the covariance (N, 3, 3), at attitudes (N, 4), of the shared errors that were not aligned away."""
    cov = np.zeros((len(q_nb), 3, 3))
    if "mounting" not in align:
        cov += reference.mounting_cov_b_rad2
    if align == "none":
        cov += _make_heading_covariance(q_nb, reference.heading_sd_rad)
    return cov


def name_of(thing: Estimate | Reference | Truth) -> str:
    """Return the name in tables: the estimator's name, "reference (method)" or "truth"."""
    if isinstance(thing, Truth):
        return "truth"
    return f"reference ({thing.method})" if isinstance(thing, Reference) else thing.name


def find_moving(truth: Reference | Truth, moving: Mask | None = None) -> Mask:
    """Return which samples (N,) count: the given ones, else the truth's mask, or those outside a reference's rests."""
    if moving is not None:
        if moving.shape != truth.t_ns.shape or moving.dtype != np.bool_:
            raise BadParameter(f"moving: is {moving.dtype} of shape {moving.shape}; give bool of {truth.t_ns.shape}")
        return moving
    if isinstance(truth, Truth):
        return truth.moving
    return ~is_inside(truth.t_ns, truth.rests_ns)
