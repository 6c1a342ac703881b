"""The page of a leaderboard: one HTML file that needs no network."""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote

from stillpoint.scoring.report.figures import COLOURS, ON_DARK
from stillpoint.scoring.report.plot_data import ERROR_PANELS, make_page_data
from stillpoint.scoring.report.templates import embed_json, load_bokeh_scripts, load_page_script, load_template
from stillpoint.studies.leaderboard import Leaderboard, Row, Run, Summary, Table
from stillpoint.studies.leaderboard.estimates import WARM_UP_S

_AXIS_PX = 150.0  # width of a drawn interval
_TICKS_DEG = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)


def make_page_html(
    board: Leaderboard,
    recordings: Mapping[str, Any] | None = None,
    title: str = "Leaderboard",
    run_pages: Mapping[str, str] | None = None,
) -> str:
    """Return the page as text. The same leaderboard gives the same bytes.

    ``recordings`` holds the curves to draw by the name of the recording, as
    :func:`~stillpoint.scoring.report.plot_data.make_recording_entry` makes them. ``run_pages`` holds the addresses of
    the pages of single recordings, which the map and the table of runs then open.
    """
    entries = dict(recordings or {})
    labels = tuple(dict.fromkeys(row.label for table in board.tables for row in table.rows))
    panels = [panel for panel in ERROR_PANELS if any(panel.key in entry["curves"] for entry in entries.values())]
    costs = _list_costs(board)
    return load_template("stillpoint.studies.publish", "page.html.j2").render(
        title=title,
        board=board,
        labels=labels,
        notes=tuple(_list_notes(board)),
        axes=[_LogAxis.over(table) for table in board.tables],
        heat=_make_heat_map(board),
        groups=_make_group_table(board, labels),
        recordings=list(entries),
        run_pages=dict(run_pages or {}),
        has_costs=bool(costs),
        warm_up_s=round(WARM_UP_S),
        parameters=_list_parameters(board),
        study=json.dumps(board.study, indent=2, ensure_ascii=False, default=str),
        colours=COLOURS,
        colours_on_dark=ON_DARK,
        data=embed_json(make_page_data(panels, labels, entries, costs=costs)),
        bokeh=load_bokeh_scripts(),
        script=load_page_script(),
    )


@dataclass(frozen=True)
class _LogAxis:
    """A logarithmic axis for the intervals of one table."""

    low_deg: float
    high_deg: float

    @classmethod
    def over(cls, table: Table) -> "_LogAxis":
        """Return the axis that holds every interval of a table."""
        ends = [end for row in table.rows if (one := _get_ranking_summary(row, table)) is not None for end in one.ci95]
        known = [end for end in ends if math.isfinite(end) and end > 0]
        return cls(min(known, default=0.1), max(known, default=10.0))

    def place(self, value_deg: float) -> float:
        """Return the place of a value in px; values beyond the axis lie on its end."""
        share = math.log(max(value_deg, 1e-9) / self.low_deg) / (math.log(self.high_deg / self.low_deg) or 1.0)
        return round(4 + min(max(share, 0.0), 1.0) * (_AXIS_PX - 8), 1)

    @property
    def ticks(self) -> list[dict[str, Any]]:
        """Up to four round values with their places on the axis."""
        within = [tick for tick in _TICKS_DEG if self.low_deg <= tick <= self.high_deg]
        kept = within[:: max(1, math.ceil(len(within) / 4))]
        return [{"x": self.place(tick), "text": f"{tick:g}"} for tick in kept]


def _get_ranking_summary(row: Row, table: Table) -> Summary | None:
    """Return the summary that decides the rank of a row in a table."""
    summary: Summary | None = getattr(row, f"{table.ranked_by}_rmse_deg")
    return summary


def _list_notes(board: Leaderboard) -> Iterator[str]:
    """Yield what a reader has to know before the ranking."""
    left_out = dict.fromkeys(run.recording for run in board.runs if run.magnetometer_left_out)
    if left_out:
        reason = next(run.magnetometer_left_out for run in board.runs if run.magnetometer_left_out)
        yield (
            f"Estimators with uncalibrated input got no magnetometer on {len(left_out)} of {len(board.sources)} "
            f"recordings, so their heading errors there say little ({reason})."
        )
    if any(run.against.startswith("reference") for run in board.runs):
        yield (
            "An estimator that is fed with the reference's own gyro agrees with it too well, because both share that "
            "gyro's errors. Differences below the reference's own standard deviation mean nothing."
        )


def _make_heat_map(board: Leaderboard) -> dict[str, Any]:
    """Return rows of recordings with a cell per label: its RMSE, and a heat from the least (0) to the greatest (1)."""
    first = board.tables[0]
    columns = [row.label for row in board.first_rows]
    runs = {(run.recording, run.label): run for run in board.runs}
    if board.against == "both":
        runs = {(r.recording, r.label): r for r in board.runs if r.against.startswith(first.against.split()[0])}
    field = f"{board.common_error}_rmse_deg"
    sizes = [size for run in runs.values() if (size := getattr(run, field)) is not None and size > 0]
    low, high = min(sizes, default=1.0), max(sizes, default=1.0)
    rows = []
    for name in dict.fromkeys(run.recording for run in board.runs):
        cells = [_make_heat_cell(runs.get((name, label)), field, low, high) for label in columns]
        rows.append({"name": name, "link": quote(name, safe=""), "cells": cells})
    return {"columns": columns, "rows": rows, "what": board.common_error}


def _make_heat_cell(run: Run | None, field: str, low: float, high: float) -> dict[str, Any] | None:
    """Return a value with its place between the least and the largest on a log scale, from 0 to 1."""
    if run is None:
        return None
    value = getattr(run, field)
    if value is None:
        return {"value": None, "heat": 0.0}
    return {"value": value, "heat": math.log(max(value, low) / low) / (math.log(high / low) or 1.0)}


def _make_group_table(board: Leaderboard, labels: Sequence[str]) -> dict[str, Any]:
    """Return columns and rows of the table that shows each estimator in each group of recordings."""
    names = [group.name for group in board.groups]
    columns = [
        {
            "name": group.name,
            "size": len(group.recordings),
            "ranked_by": group.ranked_by,
            "input": f", {group.inputs}" if names.count(group.name) > 1 else "",
        }
        for group in board.groups
    ]
    rows = []
    for label in labels:
        found = [next((row for row in group.rows if row.label == label), None) for group in board.groups]
        cells = []
        for row, group in zip(found, board.groups, strict=True):
            summary = None if row is None else _get_ranking_summary(row, group)
            rank = None if row is None else row.rank
            cells.append(None if summary is None else {"typical": summary.typical, "rank": rank})
        rows.append({"label": label, "cells": cells})
    return {"columns": columns, "rows": rows}


def _list_costs(board: Leaderboard) -> list[dict[str, Any]]:
    """Return the points of the plot of accuracy against cost."""
    found = ((row.label, row.ns_per_sample, getattr(row, f"{board.common_error}_rmse_deg")) for row in board.first_rows)
    return [
        {"name": label, "cost": cost, "error": summary.typical}
        for label, cost, summary in found
        if cost is not None and math.isfinite(cost) and cost > 0 and summary is not None
    ]


def _list_parameters(board: Leaderboard) -> dict[str, str]:
    """Return the parameters of every label as text, from the first run that states them."""
    found: dict[str, str] = {}
    for run in board.runs:
        if run.parameters and run.label not in found:
            found[run.label] = "; ".join(f"{name} = {value}" for name, value in run.parameters.items())
    return found
