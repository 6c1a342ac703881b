"""How true are references? The study that scores reference methods and offline peers against independent truth.

The one module of scoring that runs the smoother and the filters.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from statistics import mean, median
from time import perf_counter

import numpy as np

from stillpoint.datasets.errors import StillpointError, Unobservable, require_known
from stillpoint.datasets.recording import Recording, Truth
from stillpoint.datasets.trajectory import Estimate, Reference
from stillpoint.filters import ESTIMATORS, estimate
from stillpoint.scoring.align import AlignKind
from stillpoint.scoring.score import score
from stillpoint.smoother import METHODS, attitude_reference

FIGURES = (
    "total_rmse_deg",
    "heading_rmse_deg",
    "inclination_rmse_deg",
    "max_deg",
    "coverage95",
    "nees_per_dof",
    "seconds",
)

WARNINGS = ("field_disturbed", "magnetometer_left_out", "slow_log", "left_out", "contradicting_factors")  # diagnostics


@dataclass(frozen=True)
class Found:
    """The alignment that was removed; 0 where it was not asked for, None where there is no score."""

    heading_deg: float | None = None
    mounting_deg: float | None = None  # the angle of the mounting rotation
    time_s: float | None = None  # positive: the estimate is late against the truth


@dataclass(frozen=True)
class ValidationRow:
    """One recording with one method; figures as in :class:`~stillpoint.scoring.score.Score`, None when refused."""

    recording: str
    method: str
    align: str
    total_rmse_deg: float | None = None
    heading_rmse_deg: float | None = None
    inclination_rmse_deg: float | None = None
    max_deg: float | None = None
    coverage95: float | None = None  # None also for a method that states no covariance
    nees_per_dof: float | None = None  # the same
    seconds: float | None = None  # of making the reference or estimate
    found: Found = field(default_factory=Found)
    magnetometer_left_out: str | None = None  # why, where the method went on without it
    source: str = ""  # the dataset, app or simulator; "" where the recording could not be read or does not say
    warnings: tuple[str, ...] = ()  # those of WARNINGS that the reference carries
    error: str | None = None  # why there are no figures


def list_default_methods() -> list[str]:
    """Return every reference method and every offline peer."""
    return [*METHODS, *(name for name, entry in ESTIMATORS.items() if entry.offline)]


def check_methods(names: Sequence[str]) -> list[str]:
    """Return the names, each once; raises :class:`BadParameter` for one that is neither a method nor an estimator."""
    known = [*METHODS, *ESTIMATORS]
    for name in names:
        require_known(name, known, "reference method or estimator")
    return list(dict.fromkeys(names))


def validate(name: str, load: Callable[[], Recording], methods: Sequence[str], align: AlignKind) -> list[ValidationRow]:
    """Return one row per method for the recording that ``load`` gives; what is refused keeps its message in the row."""
    rows = [ValidationRow(name, method, align) for method in methods]
    try:
        recording = load()
        rows = [replace(row, source=recording.info.source) for row in rows]
        if recording.imu is None:
            raise Unobservable(f"{recording.name}: is of a spinning body; validate recordings of spins separately")
        if recording.truth is None:
            raise Unobservable(f"{recording.name}: has no independent truth; import it with one (--truth)")
    except StillpointError as error:
        return [replace(row, error=str(error)) for row in rows]
    return [_validate_row(recording, recording.truth, row, align) for row in rows]


def _validate_row(recording: Recording, truth: Truth, row: ValidationRow, align: AlignKind) -> ValidationRow:
    """Return the row with the score of its method, or with the error that it raised."""
    try:
        begun = perf_counter()
        made: Reference | Estimate = (
            attitude_reference(recording, row.method) if row.method in METHODS else estimate(recording, row.method)
        )
        seconds = perf_counter() - begun
        scored = score(made, truth, align)
    except StillpointError as error:
        return replace(row, error=str(error))
    return replace(
        row,
        total_rmse_deg=scored.total_rmse_deg,
        heading_rmse_deg=scored.heading_rmse_deg,
        inclination_rmse_deg=scored.inclination_rmse_deg,
        max_deg=scored.total_max_deg,
        coverage95=scored.coverage95,
        nees_per_dof=scored.nees_per_dof,
        seconds=seconds,
        found=Found(
            heading_deg=float(np.rad2deg(scored.alignment.heading_rad)),
            mounting_deg=float(np.rad2deg(np.linalg.norm(scored.alignment.mounting_rotvec_rad))),
            time_s=scored.alignment.time_offset_s,
        ),
        magnetometer_left_out=made.diagnostics.get("magnetometer_left_out"),
        warnings=tuple(name for name in WARNINGS if made.diagnostics.get(name)),
    )


def summarise_methods(rows: Sequence[ValidationRow]) -> list[dict[str, object]]:
    """Return mean, median and worst of each figure per method, over the recordings that it did not refuse.

    The worst coverage is the smallest, the worst of all others the largest.
    """
    table: list[dict[str, object]] = []
    for method in dict.fromkeys(row.method for row in rows):
        mine = [asdict(row) for row in rows if row.method == method]
        scored = [row for row in mine if row["error"] is None]
        columns = {figure: [row[figure] for row in scored if row[figure] is not None] for figure in FIGURES}
        for name, of in (("mean", mean), ("median", median), ("worst", max)):
            figures = {figure: of(values) if values else None for figure, values in columns.items()}
            if name == "worst" and columns["coverage95"]:
                figures["coverage95"] = min(columns["coverage95"])
            table.append({"statistic": name, "method": method, "scored": len(scored), "of": len(mine), **figures})
    return table


@dataclass(frozen=True)
class SourceSummary:
    """How one method does on the recordings of one source; figures are None where nothing gives them."""

    source: str
    method: str
    scored: int
    of: int
    total_mean_deg: float | None
    heading_mean_deg: float | None
    total_worst_deg: float | None
    coverage95_mean: float | None
    coverage95_least: float | None
    nees_per_dof_mean: float | None
    warned: dict[str, int]  # how many references carry each of WARNINGS


def summarise_sources(rows: Sequence[ValidationRow]) -> list[SourceSummary]:
    """Return one summary for each source and method, over the recordings that were not refused."""
    found = []
    for source, method in dict.fromkeys((row.source, row.method) for row in rows):
        mine = [row for row in rows if (row.method, row.source) == (method, source)]
        totals = [row.total_rmse_deg for row in mine if row.total_rmse_deg is not None]
        headings = [row.heading_rmse_deg for row in mine if row.heading_rmse_deg is not None]
        inside = [row.coverage95 for row in mine if row.coverage95 is not None]
        squares = [row.nees_per_dof for row in mine if row.nees_per_dof is not None]
        found.append(
            SourceSummary(
                source=source,
                method=method,
                scored=sum(row.error is None for row in mine),
                of=len(mine),
                total_mean_deg=mean(totals) if totals else None,
                heading_mean_deg=mean(headings) if headings else None,
                total_worst_deg=max(totals, default=None),
                coverage95_mean=mean(inside) if inside else None,
                coverage95_least=min(inside, default=None),
                nees_per_dof_mean=mean(squares) if squares else None,
                warned={name: sum(name in row.warnings for row in mine) for name in WARNINGS},
            )
        )
    return found
