"""The curves of a leaderboard's page, from the results that the leaderboard kept."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from stillpoint.scoring.report.curves import Curve, coarsen_curve
from stillpoint.scoring.report.plot_data import encode_errors, make_recording_entry
from stillpoint.studies.leaderboard import ErrorOverTime, Leaderboard, Run, read_error_series

PAGE_BYTES = 2_400_000  # of all curves of a page
_BYTES_PER_COLUMN = 8  # three 16-bit integers in base64
_FEWEST_COLUMNS, _MOST_COLUMNS = 100, 1000


def read_entries(out: Path, board: Leaderboard) -> dict[str, Any]:
    """Return the entry of each recording in the page's data, by name; by name and judge where there are several.

    ``out`` is the output folder of the leaderboard. A page shows all errors of a few runs, the ranked one of many.
    """
    runs = [run for run in board.runs if run.error is None]
    keys = _choose_errors(board, len(runs))
    columns = PAGE_BYTES // (_BYTES_PER_COLUMN * max(len(runs) * len(keys), 1))
    columns = min(max(columns, _FEWEST_COLUMNS), _MOST_COLUMNS)
    judged: dict[str, dict[str, Run]] = {}
    for run in runs:
        name = run.recording if board.against != "both" else f"{run.recording}, {run.against}"
        judged.setdefault(name, {})[run.label] = run
    entries = {}
    for name, of_label in judged.items():
        series = {label: found for label, run in of_label.items() if (found := read_error_series(out, run)) is not None}
        if series:
            entries[name] = _make_entry(series, keys, columns)
    return entries


def _choose_errors(board: Leaderboard, runs: int) -> list[str]:
    """Return total, heading and inclination where there is room for all three, else what the runs are ranked by."""
    every = ["total", "heading", "inclination"]
    room = PAGE_BYTES // (_BYTES_PER_COLUMN * max(runs, 1) * len(every))
    return every if room >= 4 * _FEWEST_COLUMNS else [board.common_error]


def _make_entry(series: Mapping[str, ErrorOverTime], keys: list[str], columns: int) -> dict[str, Any]:
    """Return the entry of one recording; its times count from the first sample of any estimate."""
    zero_ns = min(one.zero_ns for one in series.values())
    wanted = {*keys, *(f"{key}:sd" for key in keys)}
    reduced: dict[str, dict[str, Curve]] = {}
    end_s = 0.0
    for label, one in series.items():
        late_s = (one.zero_ns - zero_ns) / 1e9
        reduced[label] = {
            key: coarsen_curve(replace(curve, start_s=curve.start_s + late_s), columns, "rms")
            for key, curve in one.curves.items()
            if key in wanted
        }
        first = next(iter(one.curves.values()))
        end_s = max(end_s, late_s + first.start_s + first.step_s * len(first.middle))
    rests_s = (next(iter(series.values())).rests_ns - zero_ns) / 1e9
    return make_recording_entry((0.0, end_s), rests_s, encode_errors(reduced))
