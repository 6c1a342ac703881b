"""The result of a leaderboard: its data types and their JSON.

All errors are in degrees, over the moving samples, after the alignment of the leaderboard.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from itertools import islice
from typing import TYPE_CHECKING, Any, Literal

from stillpoint.scoring import AlignKind

if TYPE_CHECKING:
    import pandas as pd

DEFAULTS = "defaults"  # the parameters that an estimator's authors chose
RankedBy = Literal["total", "heading", "inclination"]
Verdict = Literal["a", "b", "undecided"]


@dataclass(frozen=True)
class Summary:
    """RMSE of one estimator over several recordings, in deg."""

    typical: float  # geometric mean over the rows (recordings of one device and one motion are one row)
    ci95: tuple[float, float]  # 95 % interval of the typical value
    mean: float  # over the recordings, like the next two
    median: float
    worst: float


@dataclass(frozen=True)
class Row:
    """One estimator with one kind of input: its place and its figures over the recordings of a table."""

    label: str  # unique in the table: the estimator, with its calibration where the table holds several
    estimator: str
    calibration: str  # "none", "reference", or the name of the calibration file
    against: str  # "truth", "reference", or "truth and reference"
    parameters: str  # "defaults", and what they were chosen or tuned on
    rank: tuple[int, int] | None  # best and worst; None when the estimator failed on a recording
    recordings: int  # of the table, including those on which the estimator failed
    failed: int
    total_rmse_deg: Summary | None  # None when the estimator failed on every recording
    heading_rmse_deg: Summary | None
    inclination_rmse_deg: Summary | None
    ns_per_sample: float | None  # median over the recordings
    nees_per_dof: float | None  # mean over the recordings; None where no covariance is stated
    coverage95: float | None  # mean over the recordings


@dataclass(frozen=True)
class Pair:
    """The comparison of two rows of a table by the ratio of their RMSE, a over b."""

    a: str  # labels of rows
    b: str
    against: str
    ratio: float
    ci95: tuple[float, float]
    verdict: Verdict  # which one is better


@dataclass(frozen=True)
class Table:
    """A ranking of the same estimators on the same recordings."""

    name: str  # "" for all recordings, otherwise the tag or device that they share
    against: str  # "truth", "reference", or "truth and reference"
    ranked_by: RankedBy
    why_ranked_by: str  # "" for total; otherwise why the total error has no meaning
    rows: tuple[Row, ...]  # ranked rows first, best first
    pairs: tuple[Pair, ...]
    general: bool  # True: holds for recordings like these; False: for these recordings only
    independent_rows: int  # recordings, with those of one device and one motion counted once
    recordings: tuple[str, ...]
    conclusion: str  # one sentence: what can be concluded and what cannot

    @property
    def inputs(self) -> str:
        """Say what input the rows have: "as recorded", "calibrated by the reference", or the name of a file."""
        words = {"none": "as recorded", "reference": "calibrated by the reference"}
        kinds = sorted({row.calibration for row in self.rows})
        return ", ".join(words.get(kind, f"calibrated by {kind}") for kind in kinds)

    @property
    def origins(self) -> str:
        """Say where the parameters of the rows come from, and on what they were chosen or tuned: one sentence."""
        labels: dict[str, list[str]] = {}
        for row in self.rows:
            labels.setdefault(row.parameters, []).append(row.label)
        named = [f"{', '.join(labels[origin])}: {origin}" for origin in labels if origin != DEFAULTS]
        if DEFAULTS in labels:
            named.append(f"{'all others' if named else 'all'}: {DEFAULTS}")
        return f"Parameters: {'; '.join(named)}."


@dataclass(frozen=True)
class Run:
    """One estimator on one recording against one judge."""

    recording: str
    estimator: str
    calibration: str
    label: str  # of its row
    against: str  # "truth" or "reference (METHOD)"
    total_rmse_deg: float | None = None  # None, like all figures below, when there is an error
    heading_rmse_deg: float | None = None
    inclination_rmse_deg: float | None = None
    total_p95_deg: float | None = None
    total_max_deg: float | None = None
    samples: int | None = None  # moving samples that were scored; the same for every estimator of the recording
    ns_per_sample: float | None = None
    nees_per_dof: float | None = None
    coverage95: float | None = None
    reference_sd_deg: float | None = None  # of the judge; None against a truth
    aligned_heading_deg: float | None = None  # what the alignment took away
    aligned_mounting_deg: float | None = None
    aligned_time_s: float | None = None
    magnetometer_left_out: str | None = None  # why the estimator got no magnetometer although there is one
    parameters: Mapping[str, Any] = field(default_factory=dict)
    judge_file: str | None = None  # the recording whose truth judged, or the reference
    estimate_key: str | None = None  # of the estimate in the folder of results
    score_key: str | None = None  # of the error over time: see `read_error_series`
    error: str | None = None


@dataclass(frozen=True)
class Source:
    """One recording of a leaderboard and where it is from."""

    recording: str
    file: str
    sha256: str
    source: str
    licence: str
    citation: str
    device: str  # "" when unknown
    motion: str  # "" when unknown: then the recording is a row of its own
    tags: tuple[str, ...]
    magnetometer: str  # "calibrated", "uncalibrated" or "none"
    truth: bool
    lost: str = ""  # what a file that was cut short lacks
    error: str | None = None  # why the recording cannot be used


@dataclass(frozen=True)
class Leaderboard:
    """Everything a page, a table or a paper shows."""

    against: str  # "truth", "reference", "both", or "truth and reference"
    align: AlignKind
    # Over all recordings: one per judge, and rows whose input lacks a magnetometer apart, ranked by inclination.
    tables: tuple[Table, ...]
    groups: tuple[Table, ...]  # by tag and by device
    runs: tuple[Run, ...]  # every estimator on every recording, failures included
    sources: tuple[Source, ...]
    version: str  # of stillpoint
    study: Mapping[str, Any] = field(default_factory=dict)  # the complete study, as in study.toml

    @property
    def failures(self) -> tuple[Run, ...]:
        """The runs that have no figures."""
        return tuple(run for run in self.runs if run.error is not None)

    @property
    def first_rows(self) -> tuple[Row, ...]:
        """The rows of all tables of the first judge."""
        against = self.tables[0].against
        shared = [table for table in self.tables if self.against != "both" or table.against == against]
        return tuple(row for table in shared for row in table.rows)

    @property
    def common_error(self) -> RankedBy:
        """The error by which all rows may be compared: inclination where the heading of some has no meaning."""
        return next((table.ranked_by for table in self.tables if table.ranked_by != "total"), "total")

    def __str__(self) -> str:
        from stillpoint.studies.publish.tables import format_text

        return format_text(self)

    def _repr_html_(self) -> str:
        from stillpoint.studies.publish.tables import format_html

        return format_html(self)

    def to_frame(self) -> "pd.DataFrame":
        """Return every row with all its figures as a pandas frame.

        Raises :class:`BadParameter` when pandas is not installed.
        """
        from stillpoint.studies.publish.tables import make_frame

        return make_frame(self)

    def to_json(self) -> dict[str, Any]:
        """Return the layout of ``leaderboard.json``; numbers that are not finite become null."""
        content = {
            "against": self.against,
            "align": self.align,
            "rows": [asdict(row) for table in self.tables for row in table.rows],
            "pairs": [asdict(pair) for table in self.tables for pair in table.pairs],
            "general": all(table.general for table in self.tables),
            "conclusion": " ".join(table.conclusion for table in self.tables),
            "recordings": [asdict(run) for run in self.runs],
            "tables": [_count_rows(table) for table in self.tables],
            "groups": [asdict(table) for table in self.groups],
            "sources": [asdict(source) for source in self.sources],
            "version": self.version,
            "study": self.study,
        }
        plain: dict[str, Any] = _drop_non_finite(content)
        return plain

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> "Leaderboard":
        """Return the leaderboard that :meth:`to_json` wrote."""
        rows = iter([_parse_row(row) for row in content["rows"]])
        pairs = iter([_parse_pair(pair) for pair in content["pairs"]])
        tables = []
        for table in content["tables"]:
            named = {name: value for name, value in table.items() if name not in ("row_count", "pair_count")}
            mine = list(islice(rows, table["row_count"]))
            tables.append(_parse_table(named, mine, list(islice(pairs, table["pair_count"]))))
        return cls(
            against=content["against"],
            align=content["align"],
            tables=tuple(tables),
            groups=tuple(
                _parse_table(
                    group, [_parse_row(row) for row in group["rows"]], [_parse_pair(pair) for pair in group["pairs"]]
                )
                for group in content["groups"]
            ),
            runs=tuple(Run(**run) for run in content["recordings"]),
            sources=tuple(Source(**{**source, "tags": tuple(source["tags"])}) for source in content["sources"]),
            version=content["version"],
            study=content["study"],
        )


def _count_rows(table: Table) -> dict[str, Any]:
    """Return a table with the numbers of its rows and pairs, which are in one list with those of the others."""
    kept = {each.name: getattr(table, each.name) for each in fields(table) if each.name not in ("rows", "pairs")}
    return {**kept, "row_count": len(table.rows), "pair_count": len(table.pairs)}


def _parse_table(content: Mapping[str, Any], rows: list[Row], pairs: list[Pair]) -> Table:
    named = {**content, "recordings": tuple(content["recordings"]), "rows": tuple(rows), "pairs": tuple(pairs)}
    return Table(**named)


def _parse_row(content: Mapping[str, Any]) -> Row:
    """Return a row from its JSON."""
    summaries = {name: _parse_summary(content[name]) for name in content if name.endswith("_rmse_deg")}
    rank = None if content["rank"] is None else tuple(content["rank"])
    return Row(**{**content, **summaries, "rank": rank})


def _parse_summary(content: Mapping[str, Any] | None) -> Summary | None:
    return None if content is None else Summary(**{**content, "ci95": tuple(content["ci95"])})


def _parse_pair(content: Mapping[str, Any]) -> Pair:
    return Pair(**{**content, "ci95": tuple(content["ci95"])})


def _drop_non_finite(value: Any) -> Any:
    """Return plain values with None for every number that is not finite, as JSON has none."""
    if isinstance(value, Mapping):
        return {str(key): _drop_non_finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_drop_non_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
