"""Figures of a leaderboard: the ranking with its intervals, and the map of recordings and estimators."""

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter

from stillpoint.datasets.names import make_drawable
from stillpoint.scoring.report.figures import COLOURS
from stillpoint.studies.leaderboard import Leaderboard, Table

_ROW_IN, _MAP_ROW_IN = 0.17, 0.12  # heights of a row of a printed figure
_MAP_COLOURS = "YlOrBr"  # readable in grey, and for colour-blind readers


def draw_ranking(ax: Axes, table: Table) -> None:
    """Draw the typical RMSE of every row with its 95 % interval, best on top, on a logarithmic axis."""
    field = f"{table.ranked_by}_rmse_deg"
    rows = [row for row in table.rows if getattr(row, field) is not None][::-1]
    summaries = [getattr(row, field) for row in rows]
    places = np.arange(len(rows))
    ax.hlines(places, [one.ci95[0] for one in summaries], [one.ci95[1] for one in summaries], color=COLOURS[0], lw=1.4)
    ax.plot([one.typical for one in summaries], places, "o", color=COLOURS[0], ms=3.5)
    ax.set_yticks(places, [make_drawable(row.label) for row in rows])
    ax.set_ylim(-0.6, len(rows) - 0.4)
    ax.set_xscale("log")
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.xaxis.set_minor_formatter(FuncFormatter(lambda value, _: f"{value:g}" if _is_round(value) else ""))
    ax.set_xlabel(make_drawable(f"{table.ranked_by} RMSE against {table.against} (deg)"))
    ax.grid(axis="y", visible=False)


def get_ranking_height_in(table: Table) -> float:
    """Return the height of the axes of a printed ranking."""
    return _ROW_IN * max(len(table.rows), 3)


def get_map_height_in(board: Leaderboard) -> float:
    """Return the height of the axes of a printed map, with room for the names below it."""
    return _MAP_ROW_IN * max(len(board.sources), 4) + 0.6


def draw_map(ax: Axes, board: Leaderboard) -> None:
    """Draw the RMSE of every run as a cell, recordings down and rows of the first table across."""
    first = board.tables[0]
    field = f"{board.common_error}_rmse_deg"
    labels = [row.label for row in board.first_rows]
    names = list(dict.fromkeys(run.recording for run in board.runs))
    sizes = np.full((len(names), len(labels)), np.nan)
    for run in board.runs:
        size = getattr(run, field)
        if size is not None and run.label in labels and _is_judged_alike(run.against, first.against):
            sizes[names.index(run.recording), labels.index(run.label)] = size
    logged = np.log10(np.maximum(sizes, 1e-3))
    ax.imshow(logged, cmap=_MAP_COLOURS, aspect="auto", vmax=np.nanmax(logged) + 0.5 if len(names) else None)
    for row, column in np.ndindex(*sizes.shape):
        size = sizes[row, column]
        text = "–" if math.isnan(size) else f"{size:.1f}" if size < 10 else f"{size:.0f}"
        ax.text(column, row, text, ha="center", va="center", fontsize=6)
    ax.set_xticks(range(len(labels)), list(map(make_drawable, labels)), rotation=60, ha="right", rotation_mode="anchor")
    ax.set_yticks(range(len(names)), list(map(make_drawable, names)), fontsize=6)
    ax.tick_params(length=0)
    ax.grid(visible=False)
    ax.set_title(f"{board.common_error} RMSE (deg)", loc="left")


def _is_judged_alike(against: str, wanted: str) -> bool:
    """Return whether a run's judge is one of a table's: "reference (graph)" is in "truth and reference"."""
    return against.split(" ")[0] in wanted


def _is_round(value: float) -> bool:
    """Return whether a number begins with 2 or 5, as ticks between decades do."""
    return f"{value:e}"[0] in "25"
