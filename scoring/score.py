"""Score an estimate against a truth or a reference over the moving samples: one function, one frozen result."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from stillpoint.datasets.errors import BadParameter, BadRecording
from stillpoint.datasets.frames import EULER_FRAMES, EulerFrame, compose, heading_rotation, quaternion, rotation
from stillpoint.datasets.recording import Floats, Truth
from stillpoint.datasets.trajectory import Estimate, Reference, compute_total_sd_rad
from stillpoint.scoring.align import AlignKind, Alignment, align_pairs
from stillpoint.scoring.blocks import Store, find_quantiles, list_blocks, split_rows, sum_blocks
from stillpoint.scoring.compare import Comparison, compare
from stillpoint.scoring.conversions import ABSURD_DEG, choose_rows, find_conversion
from stillpoint.scoring.errors import (
    compute_attitude_error,
    compute_euler_error,
    compute_normalised_square,
    compute_rotation_error_b,
    find_near_gimbal,
)
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
        return cls.of_blocks(split_rows(error_deg), len(error_deg))

    @classmethod
    def of_blocks(cls, blocks: Iterable[Floats], count: int) -> "ErrorStats":
        """Return the statistics of ``count`` errors in blocks, which are gone through several times."""
        mean = float(sum_blocks(blocks)) / count
        p50, p95, p99 = find_quantiles(_Sizes(blocks), count, (0.5, 0.95, 0.99))
        return cls(
            rmse_deg=float(np.sqrt(sum_blocks(error**2 for error in blocks) / count)),
            max_deg=float(max(np.abs(error).max() for error in blocks)),
            mean_deg=mean,
            variance_deg2=float(sum_blocks((error - mean) ** 2 for error in blocks)) / count,
            p50_deg=p50,
            p95_deg=p95,
            p99_deg=p99,
        )


@dataclass(frozen=True, eq=False)
class _Sizes:
    """The sizes of errors in blocks."""

    blocks: Iterable[Floats]

    def __iter__(self) -> Iterator[Floats]:
        return (np.abs(block) for block in self.blocks)


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
        """Return a figure by its flat name, for example ``heading_rmse_deg``; raises ``AttributeError``."""
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
    moving = comparison.moving
    columns = (comparison.q_est, comparison.q_true, comparison.cov_b_rad2, comparison.true_cov_b_rad2)
    scored = ScoredPairs(*(None if column is None else column[moving] for column in columns))  # type: ignore[arg-type]
    names = ("estimated", "against", "recording", "samples_outside", "samples_in_gap", "samples_unready")
    found = score_blocks(
        scored.split(),
        len(scored.q_est),
        comparison.alignment,
        frame,
        {name: getattr(comparison, name) for name in (*names, "moving_share")},
    )
    return replace(found, turns=turn_errors(comparison, over_s))


@dataclass(frozen=True, eq=False)
class ScoredPairs:
    """K moving samples of a truth, and the aligned estimate there."""

    q_est: Floats  # (K, 4)
    q_true: Floats  # (K, 4)
    cov_b_rad2: Floats | None  # (K, 3, 3) of the estimate, in the truth's body axes
    true_cov_b_rad2: Floats | None  # (K, 3, 3) of the truth

    def split(self) -> "Iterator[ScoredPairs]":
        """Yield them as blocks (:mod:`stillpoint.scoring.blocks`)."""
        for rows in list_blocks(len(self.q_est)):
            cov, true_cov = (None if one is None else one[rows] for one in (self.cov_b_rad2, self.true_cov_b_rad2))
            yield ScoredPairs(self.q_est[rows], self.q_true[rows], cov, true_cov)


def score_blocks(
    blocks: Iterable[ScoredPairs],
    count: int,
    alignment: Alignment,
    frame: EulerFrame,
    facts: Mapping[str, Any],
    new_store: Callable[[], Store] = list,
) -> Score:
    """Compute the figures of ``count`` aligned pairs that come in blocks, once.

    ``facts`` are names and counts of the comparison; ``new_store`` makes what keeps the errors, of which quantiles need
    several passes. Raises :class:`BadParameter` for an unknown frame, :class:`BadRecording` for a covariance that is
    none.
    """
    if frame not in EULER_FRAMES:
        raise BadParameter(f"frame: {frame!r} is not one of {', '.join(EULER_FRAMES)}")
    errors_deg, true_sd_rad = {name: new_store() for name in (*_SPLIT, *_EULER)}, new_store()
    sampled, consistency = _Sampled(count), _Consistency()
    n_gimbal, has_true_cov = 0, False
    for pairs in blocks:
        error = compute_attitude_error(pairs.q_est, pairs.q_true)
        for name in _SPLIT:
            errors_deg[name].append(np.rad2deg(getattr(error, f"{name}_rad")))
        for name, column in zip(_EULER, compute_euler_error(pairs.q_est, pairs.q_true, frame).T, strict=True):
            errors_deg[name].append(np.rad2deg(column))
        n_gimbal += int(find_near_gimbal(pairs.q_true, frame).sum())
        sampled.add(pairs)
        consistency.add(pairs)
        if pairs.true_cov_b_rad2 is not None:
            has_true_cov = True
            true_sd_rad.append(compute_total_sd_rad(pairs.true_cov_b_rad2))
    nees, coverage = consistency.close(f"{facts['estimated']} of {facts['recording']}")
    parts = {name: ErrorStats.of_blocks(store, count) for name, store in errors_deg.items()}
    return Score(
        **facts,
        alignment=alignment,
        frame=frame,
        samples=count,
        near_gimbal_share=n_gimbal / count,
        reference_sd_deg=float(np.rad2deg(find_quantiles(true_sd_rad, count, (0.5,))[0])) if has_true_cov else None,
        nees_per_dof=nees,
        coverage95=coverage,
        conversion=sampled.find_conversion(alignment) if parts["total"].rmse_deg > ABSURD_DEG else None,
        total=parts["total"],
        heading=parts["heading"],
        inclination=parts["inclination"],
        roll=parts["roll"],
        pitch=parts["pitch"],
        yaw=parts["yaw"],
    )


class _Sampled:
    """Pairs spread evenly over all, to look for a fixed conversion of the estimate as it was before the alignment."""

    def __init__(self, count: int) -> None:
        self._rows = choose_rows(count)
        self._pairs: list[tuple[Floats, Floats]] = []
        self._done = 0

    def add(self, pairs: ScoredPairs) -> None:
        """Keep the chosen rows of the next pairs."""
        end = self._done + len(pairs.q_est)
        rows = self._rows[(self._rows >= self._done) & (self._rows < end)] - self._done
        self._pairs.append((pairs.q_est[rows], pairs.q_true[rows]))
        self._done = end

    def find_conversion(self, alignment: Alignment) -> str | None:
        """Return the conversion that explains the error, in words."""
        aligned, q_true = (np.concatenate(column) for column in zip(*self._pairs, strict=True))
        raw = compose(compose(heading_rotation(alignment.heading_rad), rotation(aligned)), alignment.mounting)

        def compute_rmse_deg(q_est: Floats, q_true: Floats) -> float:
            """Return the total RMSE in deg after the alignment is found anew."""
            again = align_pairs(q_est, q_true, alignment.kind).attitude(q_est)
            return float(np.rad2deg(np.sqrt(np.mean(compute_attitude_error(again, q_true).total_rad ** 2))))

        return find_conversion(quaternion(raw), q_true, compute_rmse_deg)


class _Consistency:
    """Counts how well the covariances of an estimate fit its errors."""

    def __init__(self) -> None:
        self._count = self._bad = self._inside = 0
        self._sum = 0.0

    def add(self, pairs: ScoredPairs) -> None:
        """Take the next pairs."""
        if pairs.cov_b_rad2 is None:
            return
        self._count += len(pairs.q_est)
        self._bad += int((np.linalg.eigvalsh(pairs.cov_b_rad2)[:, 0] <= 0).sum())
        if not self._bad:
            square = compute_normalised_square(compute_rotation_error_b(pairs.q_est, pairs.q_true), pairs.cov_b_rad2)
            self._sum += float(square.sum())
            self._inside += int((square <= CHI2_3_95).sum())

    def close(self, whose: str) -> tuple[float | None, float | None]:
        """Return d' C^-1 d / 3 and the share below the 95 % point; raises :class:`BadRecording`."""
        if self._bad:
            raise BadRecording(
                f"{whose}: its covariance is not positive definite at {self._bad} of {self._count} samples; "
                "leave cov_b_rad2 out where none is stated"
            )
        if not self._count:
            return None, None
        return self._sum / self._count / 3.0, self._inside / self._count


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
