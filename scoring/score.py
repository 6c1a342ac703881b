"""One function, one frozen result: how far an estimate is from a truth or a reference, over the moving samples."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from stillpoint.datasets.errors import BadParameter, BadRecording
from stillpoint.datasets.frames import EULER_FRAMES, EulerFrame
from stillpoint.datasets.recording import Floats, Truth
from stillpoint.datasets.trajectory import Estimate, Reference, total_sd_rad
from stillpoint.scoring.align import AlignKind, Alignment
from stillpoint.scoring.compare import Comparison, compare
from stillpoint.scoring.errors import attitude_error, euler_error, near_gimbal, normalised_square, rotation_error_b
from stillpoint.scoring.turns import TurnError, turn_errors

CHI2_3_95 = float(chdtri(3, 0.05))  # scipy.stats has it too, and takes half a second to import


@dataclass(frozen=True, eq=False)
class Score:
    """Errors over the moving samples after alignment. total, heading and inclination as in BROAD, each >= 0;
    roll, pitch and yaw are estimate minus truth in ``frame``.
    """

    estimated: str  # name of the estimator, or "reference (method)"
    against: str  # "truth" or "reference (method)"
    recording: str
    alignment: Alignment
    frame: EulerFrame

    samples: int  # moving samples of the truth that were scored
    samples_outside: int  # moving, but before the estimate's first or after its last sample
    samples_in_gap: int  # moving, but between two samples of the estimate more than 5 median steps apart
    samples_unready: int  # moving, but the estimator said that it was still starting
    moving_share: float  # of all samples of the truth

    total_rmse_deg: float
    total_max_deg: float
    total_mean_deg: float
    total_variance_deg2: float
    total_p50_deg: float
    total_p95_deg: float
    total_p99_deg: float
    heading_rmse_deg: float
    heading_max_deg: float
    heading_mean_deg: float
    heading_variance_deg2: float
    heading_p50_deg: float
    heading_p95_deg: float
    heading_p99_deg: float
    inclination_rmse_deg: float
    inclination_max_deg: float
    inclination_mean_deg: float
    inclination_variance_deg2: float
    inclination_p50_deg: float
    inclination_p95_deg: float
    inclination_p99_deg: float

    roll_rmse_deg: float
    roll_maxae_deg: float
    roll_mean_deg: float
    roll_variance_deg2: float
    pitch_rmse_deg: float
    pitch_maxae_deg: float
    pitch_mean_deg: float
    pitch_variance_deg2: float
    yaw_rmse_deg: float
    yaw_maxae_deg: float
    yaw_mean_deg: float
    yaw_variance_deg2: float
    near_gimbal_share: float  # scored samples whose true pitch is beyond +-80 deg: there roll and yaw say nothing

    reference_sd_deg: float | None  # median sqrt(trace of the reference's covariance); None against a truth
    nees_per_dof: float | None  # mean d' C^-1 d / 3: 1 when the covariance is right; None without one
    coverage95: float | None  # share with d' C^-1 d below the 95 % point of chi-square(3)

    turns: tuple[TurnError, ...] = ()  # errors of turns over the times that were asked for


def score(
    estimated: Estimate | Reference,
    truth: Reference | Truth,
    align: AlignKind = "heading",
    frame: EulerFrame = "nwu",
    moving: NDArray[np.bool_] | None = None,
    over_s: Sequence[float] = (),
) -> Score:
    """Score an estimate (or a reference) against a truth (or a reference).

    The estimate is interpolated at the truth's stamps, within its span and never across a gap. ``moving`` (N,) says
    which samples of the truth count; by default ``truth.moving``, or outside a reference's rests. ``over_s`` are the
    times over which turns are compared too (:func:`~stillpoint.scoring.turns.turn_errors`).
    Raises :class:`BadParameter` for an unknown option, :class:`Unobservable` when nothing moves or overlaps,
    :class:`BadRecording` for a covariance that is none.
    """
    return score_of(compare(estimated, truth, align, moving), frame, over_s)


def score_of(comparison: Comparison, frame: EulerFrame = "nwu", over_s: Sequence[float] = ()) -> Score:
    """The figures of a comparison that is there already."""
    if frame not in EULER_FRAMES:
        raise BadParameter(f"frame: {frame!r} is not one of {', '.join(EULER_FRAMES)}")
    moving = comparison.moving
    q_est, q_true = comparison.q_est[moving], comparison.q_true[moving]
    error = attitude_error(q_est, q_true)
    figures: dict[str, float] = {}
    for name in ("total", "heading", "inclination"):
        figures |= _spread(name, np.rad2deg(getattr(error, f"{name}_rad")))
    for name, column_rad in zip(("roll", "pitch", "yaw"), euler_error(q_est, q_true, frame).T, strict=True):
        figures |= _signed(name, np.rad2deg(column_rad))
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
        **figures,
    )


def _spread(name: str, error_deg: Floats) -> dict[str, float]:
    p50, p95, p99 = np.percentile(error_deg, [50, 95, 99])
    return {
        f"{name}_rmse_deg": float(np.sqrt(np.mean(error_deg**2))),
        f"{name}_max_deg": float(error_deg.max()),
        f"{name}_mean_deg": float(error_deg.mean()),
        f"{name}_variance_deg2": float(error_deg.var()),
        f"{name}_p50_deg": float(p50),
        f"{name}_p95_deg": float(p95),
        f"{name}_p99_deg": float(p99),
    }


def _signed(name: str, error_deg: Floats) -> dict[str, float]:
    return {
        f"{name}_rmse_deg": float(np.sqrt(np.mean(error_deg**2))),
        f"{name}_maxae_deg": float(np.abs(error_deg).max()),
        f"{name}_mean_deg": float(error_deg.mean()),
        f"{name}_variance_deg2": float(error_deg.var()),
    }


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
    """The score for machines: its fields, flat, with ``align`` and what was ``found`` in place of the alignment."""
    named = {"recording": score.recording, "method": score.estimated, "against": score.against}
    skipped = ("recording", "estimated", "against", "alignment", "turns")
    figures = {column.name: getattr(score, column.name) for column in fields(score) if column.name not in skipped}
    turns = [asdict(turn) for turn in score.turns]
    found = score.alignment.found()
    return {**named, "align": score.alignment.kind, **figures, "turns": turns, "found": found, "error": None}
