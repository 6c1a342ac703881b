"""Score an estimate against a truth or a reference over the moving samples: one function, one frozen result."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from stillpoint.datasets.errors import BadParameter, BadRecording
from stillpoint.datasets.frames import EULER_FRAMES, EulerFrame, heading_rotation, quaternion, rotation
from stillpoint.datasets.recording import Floats, Truth
from stillpoint.datasets.trajectory import Estimate, Reference, total_sd_rad
from stillpoint.scoring.align import AlignKind, Alignment, align_pairs
from stillpoint.scoring.compare import Comparison, compare
from stillpoint.scoring.conversions import ABSURD_DEG, find_conversion
from stillpoint.scoring.errors import attitude_error, euler_error, near_gimbal, normalised_square, rotation_error_b
from stillpoint.scoring.position import PositionScore, score_position
from stillpoint.scoring.score_table import format_score, format_score_html, make_score_frame
from stillpoint.scoring.turns import TurnError, turn_errors

if TYPE_CHECKING:
    import pandas as pd

CHI2_3_95 = float(chdtri(3, 0.05))  # scipy.stats has it too, and takes half a second to import


@dataclass(frozen=True)
class ErrorStats:
    """Statistics of one kind of error over the scored samples, in deg.

    ``max_deg`` and the percentiles are of the error's size; ``mean_deg`` and ``variance_deg2`` keep its sign.
    """

    rmse_deg: float
    max_deg: float
    mean_deg: float
    variance_deg2: float
    p50_deg: float
    p95_deg: float
    p99_deg: float

    @classmethod
    def of(cls, error_deg: Floats) -> "ErrorStats":
        """Return the statistics of errors (N,)."""
        size = np.abs(error_deg)
        p50, p95, p99 = np.percentile(size, [50, 95, 99])
        return cls(
            rmse_deg=float(np.sqrt(np.mean(error_deg**2))),
            max_deg=float(size.max()),
            mean_deg=float(error_deg.mean()),
            variance_deg2=float(error_deg.var()),
            p50_deg=float(p50),
            p95_deg=float(p95),
            p99_deg=float(p99),
        )


_SPLIT = ("total", "heading", "inclination")  # errors of the rotation, each >= 0
_EULER = ("roll", "pitch", "yaw")  # estimate minus truth, with a sign
# The flat names of JSON and of the attributes: total_rmse_deg stands for total.rmse_deg. The papers call the largest
# absolute error of an angle its MaxAE.
_FLAT: dict[str, tuple[str, str]] = {
    f"{part}_{figure.name}": (part, figure.name) for part in _SPLIT for figure in fields(ErrorStats)
} | {
    f"{part}_{name}": (part, figure)
    for part in _EULER
    for name, figure in {
        "rmse_deg": "rmse_deg",
        "maxae_deg": "max_deg",
        "mean_deg": "mean_deg",
        "variance_deg2": "variance_deg2",
    }.items()
}


@dataclass(frozen=True, eq=False)
class Score:
    """Errors over the moving samples after alignment.

    Every figure also has a flat name: ``score.total_rmse_deg`` is ``score.total.rmse_deg``, ``score.roll_maxae_deg``
    is ``score.roll.max_deg``.
    """

    estimated: str  # name of the estimator, or "reference (method)"
    against: str  # "truth" or "reference (method)"
    recording: str
    alignment: Alignment
    frame: EulerFrame

    samples: int  # moving samples that were compared, at the stamps of the sparser side
    samples_outside: int  # moving samples of the truth before the estimate's first or after its last sample
    samples_in_gap: int  # ... between two samples of the estimate more than 5 median steps apart
    samples_unready: int  # ... while the estimator said that it was still starting
    moving_share: float  # of all samples of the truth

    total: ErrorStats  # total, heading and inclination as in BROAD
    heading: ErrorStats
    inclination: ErrorStats
    roll: ErrorStats  # estimate minus truth in ``frame``
    pitch: ErrorStats
    yaw: ErrorStats
    near_gimbal_share: float  # scored samples whose true pitch is beyond +-80 deg: there roll and yaw say nothing

    reference_sd_deg: float | None  # median sqrt(trace of the reference's covariance); None against a truth
    nees_per_dof: float | None  # mean d' C^-1 d / 3: 1 when the covariance is right; None without one
    coverage95: float | None  # share with d' C^-1 d below the 95 % point of chi-square(3)

    turns: tuple[TurnError, ...] = ()  # errors of turns over the times that were asked for
    conversion: str | None = None  # the fixed conversion that would explain an absurd error, in words
    position: PositionScore | None = None  # where both have positions

    def __getattr__(self, name: str) -> float:
        if name not in _FLAT:
            raise AttributeError(f"Score has no figure {name!r}")
        part, figure = _FLAT[name]
        return float(getattr(getattr(self, part), figure))

    def __str__(self) -> str:
        return format_score(self)

    def _repr_html_(self) -> str:
        return format_score_html(self)

    def to_frame(self) -> "pd.DataFrame":
        """Return the statistics as a pandas frame; raises :class:`BadParameter` when pandas is not installed."""
        return make_score_frame(self)


def score(
    estimated: Estimate | Reference,
    truth: Reference | Truth,
    align: AlignKind = "heading",
    frame: EulerFrame = "nwu",
    moving: NDArray[np.bool_] | None = None,
    over_s: Sequence[float] = (),
) -> Score:
    """Score an estimate (or a reference) against a truth (or a reference).

    Both are compared at the stamps of the sparser one; the other is interpolated, never across a gap. ``moving`` (N,)
    says which samples of the truth count; by default ``truth.moving``, or outside a reference's rests. ``over_s`` are
    the times over which turns are compared too (:func:`~stillpoint.scoring.turns.turn_errors`).
    Raises :class:`BadParameter` for an unknown option, :class:`Unobservable` when nothing moves or overlaps,
    :class:`BadRecording` for a covariance that is none.
    """
    scored = score_of(compare(estimated, truth, align, moving), frame, over_s)
    return replace(scored, position=score_position(estimated, truth))


def score_of(comparison: Comparison, frame: EulerFrame = "nwu", over_s: Sequence[float] = ()) -> Score:
    """Compute the figures of a comparison."""
    if frame not in EULER_FRAMES:
        raise BadParameter(f"frame: {frame!r} is not one of {', '.join(EULER_FRAMES)}")
    moving = comparison.moving
    q_est, q_true = comparison.q_est[moving], comparison.q_true[moving]
    error = attitude_error(q_est, q_true)
    parts = {name: ErrorStats.of(np.rad2deg(getattr(error, f"{name}_rad"))) for name in _SPLIT}
    euler_rad = euler_error(q_est, q_true, frame)
    parts |= {name: ErrorStats.of(np.rad2deg(column)) for name, column in zip(_EULER, euler_rad.T, strict=True)}
    nees, coverage = _consistency(comparison)
    return Score(
        estimated=comparison.estimated,
        against=comparison.against,
        recording=comparison.recording,
        alignment=comparison.alignment,
        frame=frame,
        samples=int(moving.sum()),
        samples_outside=comparison.samples_outside,
        samples_in_gap=comparison.samples_in_gap,
        samples_unready=comparison.samples_unready,
        moving_share=comparison.moving_share,
        near_gimbal_share=float(near_gimbal(q_true, frame).mean()),
        reference_sd_deg=_reference_sd_deg(comparison),
        nees_per_dof=nees,
        coverage95=coverage,
        turns=turn_errors(comparison, over_s),
        conversion=_find_conversion(comparison) if parts["total"].rmse_deg > ABSURD_DEG else None,
        total=parts["total"],
        heading=parts["heading"],
        inclination=parts["inclination"],
        roll=parts["roll"],
        pitch=parts["pitch"],
        yaw=parts["yaw"],
    )


def _find_conversion(comparison: Comparison) -> str | None:
    """Look for a fixed conversion of the estimate as it was before the alignment."""
    alignment, moving = comparison.alignment, comparison.moving
    raw = heading_rotation(alignment.heading_rad) * rotation(comparison.q_est[moving]) * alignment.mounting

    def rmse_after(q_est: Floats, q_true: Floats) -> float:
        aligned = align_pairs(q_est, q_true, alignment.kind).attitude(q_est)
        return float(np.rad2deg(np.sqrt(np.mean(attitude_error(aligned, q_true).total_rad ** 2))))

    return find_conversion(quaternion(raw), comparison.q_true[moving], rmse_after)


def _consistency(comparison: Comparison) -> tuple[float | None, float | None]:
    if comparison.cov_b_rad2 is None:
        return None, None
    moving = comparison.moving
    d_rad, cov = rotation_error_b(comparison.q_est[moving], comparison.q_true[moving]), comparison.cov_b_rad2[moving]
    bad = np.linalg.eigvalsh(cov)[:, 0] <= 0
    if bad.any():
        raise BadRecording(
            f"{comparison.estimated} of {comparison.recording}: its covariance is not positive definite at {bad.sum()} "
            f"of {len(bad)} samples; leave cov_b_rad2 out where none is stated"
        )
    square = normalised_square(d_rad, cov)
    return float(square.mean()) / 3.0, float((square <= CHI2_3_95).mean())


def _reference_sd_deg(comparison: Comparison) -> float | None:
    if comparison.true_cov_b_rad2 is None:
        return None
    return float(np.rad2deg(np.median(total_sd_rad(comparison.true_cov_b_rad2[comparison.moving]))))


def score_row(score: Score) -> dict[str, Any]:
    """Return the score for machines: flat, with ``align`` and what was ``found`` in place of the alignment."""
    named = {"recording": score.recording, "method": score.estimated, "against": score.against}
    counts = ("samples", "samples_outside", "samples_in_gap", "samples_unready", "moving_share")
    judged = ("near_gimbal_share", "reference_sd_deg", "nees_per_dof", "coverage95")
    return {
        **named,
        "align": score.alignment.kind,
        "frame": score.frame,
        **{name: getattr(score, name) for name in (*counts, *_FLAT, *judged)},
        "conversion": score.conversion,
        "position": None if score.position is None else asdict(score.position),
        "turns": [asdict(turn) for turn in score.turns],
        "found": score.alignment.found(),
        "error": None,
    }
