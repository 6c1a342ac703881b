"""``python -m stillpoint.scripts.pages.figures.method VALIDATED.json... RECORDING.mcap...``: draw docs/history.md.

The JSON files are those of ``stillpoint validate --json``. Of the recordings, which hold a truth, the error over time
is drawn within the band that the graph states.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.mcap.store import read_recording
from stillpoint.scoring import AlignKind, compare
from stillpoint.scoring.report.figures import COLOURS, draw_band, make_view
from stillpoint.scripts.pages.figures.demo import STYLE
from stillpoint.scripts.program import run_program
from stillpoint.smoother import DEFAULT_METHOD, attitude_reference

_ALIGN: AlignKind = "heading+mounting+time"
_TRIALS, _BANDS = Path("docs/figures/method_trials.png"), Path("docs/figures/method_bands.png")
_MARKS = ("o", "s", "^", "D")
_DPI = 80


def main(*files: Path) -> None:
    """Draw both figures of docs/history.md. Raises :class:`BadParameter` without tables or recordings."""
    tables = [file for file in files if file.suffix == ".json"]
    recordings = [file for file in files if file.suffix == ".mcap"]
    if not tables or not recordings:
        raise BadParameter("method: name JSON files of stillpoint validate, and recordings")
    _TRIALS.parent.mkdir(parents=True, exist_ok=True)
    with mpl.rc_context(STYLE):
        _read_trials(tables).savefig(_TRIALS, dpi=_DPI, metadata={"Software": None})
        _draw_bands(recordings).savefig(_BANDS, dpi=_DPI, metadata={"Software": None})


def _read_trials(tables: Sequence[Path]) -> Figure:
    """Read the total RMSE of each recording and method, one panel per table."""
    rows = [json.loads(table.read_text(encoding="utf-8"))["rows"] for table in tables]
    widths = [len({row["recording"] for row in each}) for each in rows]
    figure = Figure(figsize=(10, 5), layout="constrained")
    axes = np.atleast_1d(figure.subplots(1, len(rows), sharey=True, width_ratios=widths))
    methods = list(dict.fromkeys(row["method"] for each in rows for row in each))
    for ax, each in zip(axes, rows, strict=True):
        _draw_trials(ax, each, methods)
    axes[0].set_ylabel("total RMSE (deg)")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper left", ncols=len(methods), frameon=False)
    return figure


def _draw_trials(ax: Axes, rows: Sequence[dict[str, Any]], methods: Sequence[str]) -> None:
    """Draw the RMSE of each method in each trial on a log axis."""
    names = list(dict.fromkeys(row["recording"] for row in rows))
    for k, method in enumerate(methods):
        found = {row["recording"]: row["total_rmse_deg"] for row in rows if row["method"] == method}
        values = [np.nan if found[name] is None else found[name] for name in names]
        ax.plot(values, _MARKS[k % len(_MARKS)], color=COLOURS[k], label=method, ms=7 if k == 0 else 5)
    ax.set_yscale("log")
    ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    ax.set_xticks(range(len(names)), names, rotation=60, ha="right", fontsize=7)
    ax.set_title(f"aligned: {rows[0]['align']}", loc="left", fontsize=9)


def _draw_bands(recordings: Sequence[Path]) -> Figure:
    """Draw a column per recording: the error about east, north and up."""
    figure = Figure(figsize=(10, 5), layout="constrained")
    axes = figure.subplots(3, len(recordings), squeeze=False, sharex="col")
    for column, file in zip(axes.T, recordings, strict=True):
        recording = read_recording(file)
        if recording.truth is None:
            raise BadParameter(f"{file}: has no independent truth to draw the error against")
        comparison = compare(attitude_reference(recording, DEFAULT_METHOD), recording.truth, _ALIGN)
        draw_band(list(column), make_view([comparison], recording.truth, "nwu", int(recording.truth.t_ns[0])))
        column[0].set_title(recording.name, loc="left", fontsize=9)
        column[-1].set_xlabel("time (s)")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=2, frameon=False)
    return figure


if __name__ == "__main__":
    run_program(main)
