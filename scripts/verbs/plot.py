"""``stillpoint plot``: one figure for a paper, of a recording with its estimates or of a leaderboard."""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.frames import EulerFrame
from stillpoint.scoring import AlignKind
from stillpoint.scoring.report.figures import View, draw_angles, draw_errors, make_view
from stillpoint.scoring.report.page import Material, judge
from stillpoint.scoring.report.printed import COLUMN_IN, write_figure
from stillpoint.scripts.shared.companions import get_recording_name
from stillpoint.scripts.shared.flags import Inputs
from stillpoint.scripts.shared.inputs import SUFFIX, get_kind
from stillpoint.scripts.shared.output import print_line
from stillpoint.scripts.verbs.report import gather_material

if TYPE_CHECKING:  # imported where a leaderboard is drawn
    from matplotlib.axes import Axes

    from stillpoint.studies.leaderboard import Leaderboard, Table

Kind = Literal["angles", "errors", "ranking", "map"]
_BOARD_FILE = "leaderboard.json"
_ANGLE_ROW_IN, _ERROR_ROW_IN = 1.1, 0.8  # heights of axes


def plot(
    paths: Inputs,
    /,
    *,
    kind: Kind,
    out: Annotated[Path, Parameter(name=["--out", "-o"])],
    align: AlignKind = "heading",
    frame: EulerFrame = "nwu",
    from_s: Annotated[float | None, Parameter(name="--from")] = None,
    to_s: Annotated[float | None, Parameter(name="--to")] = None,
    table: str | None = None,
    width: float = COLUMN_IN,
) -> None:
    """Draw one figure for a paper.

    Writes a PDF, SVG or PNG at the width of a column, with type that stays readable there. The ranking of a leaderboard
    with several tables becomes a figure for each: OUT, OUT-2 and so on.

    Parameters
    ----------
    paths
        For angles and errors a recording, with the reference and the estimates beside it, or estimates of one
        recording. For ranking and map the leaderboard.json of stillpoint leaderboard, or its folder.
    kind
        angles: roll, pitch and yaw over time. errors: the total error over time, one row per estimate. ranking: the
        typical error of every estimator with its interval. map: the error of every estimator on every recording.
    out
        The file to write; .pdf, .svg or .png.
    align
        What may differ without being an error: none, heading, heading+mounting or heading+mounting+time.
    frame
        Frame of roll, pitch and yaw: nwu, ned or enu.
    from_s
        Begin of the shown stretch, in seconds from the start.
    to_s
        End of the shown stretch, in seconds from the start.
    table
        For ranking: the number of one table, or the tag or device of a group, to draw that one alone.
    width
        Width of the figure in inches.
    """
    if table is not None and kind != "ranking":
        raise BadParameter(f"--table {table}: chooses a ranking; give --kind ranking")
    if kind in ("ranking", "map"):
        _plot_board(_find_board_file(paths), kind, out, width, table)
    else:
        _plot_run(paths, kind, out, width, align, frame, (from_s, to_s))
        print_line(out)


def _plot_board(file: Path, kind: Kind, out: Path, width: float, wanted: str | None) -> None:
    """Draw the ranking or the map of a leaderboard; raises :class:`BadParameter` for another file."""
    from stillpoint.studies.leaderboard import Leaderboard
    from stillpoint.studies.publish.figures import draw_map, draw_ranking, get_map_height_in, get_ranking_height_in

    try:
        board = Leaderboard.from_json(json.loads(file.read_text(encoding="utf-8")))
    except (OSError, ValueError, KeyError, TypeError) as error:
        reason = f"{type(error).__name__}: {error}"
        raise BadParameter(f"{file}: is not a result of stillpoint leaderboard ({reason})") from None
    if kind == "map":
        write_figure(out, 1, get_map_height_in(board), lambda axes: draw_map(axes[0], board), width)
        print_line(out)
        return
    for k, table in enumerate(board.tables if wanted is None else _choose_tables(board, wanted)):
        target = out if k == 0 else out.with_stem(f"{out.stem}-{k + 1}")
        write_figure(target, 1, get_ranking_height_in(table), partial(_draw_on_first, draw_ranking, table), width)
        print_line(f"{target}: {_name_table(table)}")


def _draw_on_first(draw: "Callable[[Axes, Table], None]", table: "Table", axes: "Sequence[Axes]") -> None:
    draw(axes[0], table)


def _choose_tables(board: "Leaderboard", wanted: str) -> "Sequence[Table]":
    """Return the table with a number as they are printed, or those of a group; raises :class:`BadParameter`."""
    numbered = {str(k): table for k, table in enumerate(board.tables, 1)}
    chosen = [numbered[wanted]] if wanted in numbered else [group for group in board.groups if group.name == wanted]
    if not chosen:
        listed = [f"{k} ({_name_table(table)})" for k, table in numbered.items()]
        known = ", ".join([*listed, *dict.fromkeys(group.name for group in board.groups)])
        raise BadParameter(f"--table {wanted}: there is no such table; there are {known}")
    return chosen


def _name_table(table: "Table") -> str:
    """Return group, order, judge and input of a table in words."""
    whose = f"{table.name}, " if table.name else ""
    return f"{whose}by {table.ranked_by} against {table.against}, input {table.inputs}"


def _find_board_file(paths: Sequence[Path]) -> Path:
    """Return the result of a leaderboard in a folder; raises :class:`BadParameter` for none or several paths."""
    if len(paths) != 1:
        raise BadParameter(f"plot: {len(paths)} files; --kind ranking and map take one {_BOARD_FILE}")
    file = paths[0] / _BOARD_FILE if paths[0].is_dir() else paths[0]
    if not file.is_file():
        raise BadParameter(f"{file}: there is no such file; make it first: stillpoint leaderboard")
    return file


def _plot_run(
    paths: Sequence[Path],
    kind: Kind,
    out: Path,
    width: float,
    align: AlignKind,
    frame: EulerFrame,
    span_s: tuple[float | None, float | None],
) -> None:
    """Draw angles or errors of the estimates of one recording."""
    verdicts = judge(_gather_material(paths), align, frame)
    if not verdicts:
        raise BadParameter(f"{paths[0]}: nothing to draw; make estimates of it: stillpoint estimate")
    first = verdicts[0]
    view = _cut_view(make_view(first.comparisons, first.truth, frame, int(first.truth.t_ns[0])), span_s)
    if kind == "angles":
        write_figure(out, 3, _ANGLE_ROW_IN, lambda axes: draw_angles(axes, view), width, time_axis=True)
    else:
        rows = len(view.comparisons)
        write_figure(out, rows, _ERROR_ROW_IN, lambda axes: draw_errors(axes, view), width, time_axis=True)


def _gather_material(paths: Sequence[Path]) -> Material:
    """Return a recording with all files beside it, or only with the named estimates."""
    kinds = {get_kind(path) for path in paths}
    names = {get_recording_name(path) for path in paths}
    if len(names) != 1 or not kinds <= {"recording", "estimate"}:
        raise BadParameter("plot: name one recording, or estimates of one recording")
    (name,) = names
    missing = next((path for path in paths if not path.is_file()), None)
    if missing is not None:
        raise BadParameter(f"{missing}: there is no such file")
    material = gather_material(paths[0].parent / f"{name}{SUFFIX}")
    if not isinstance(material, Material):
        raise BadParameter(f"{paths[0]}: is of a spinning body; its figures are in its report: stillpoint report")
    if kinds == {"recording"}:
        return material
    wanted = {path.name.removeprefix(f"{name}.").removesuffix(".estimate.mcap") for path in paths}
    return replace(material, estimates=tuple(one for one in material.estimates if one.name in wanted))


def _cut_view(view: View, span_s: tuple[float | None, float | None]) -> View:
    """Return the view between two times in s from its start. Raises :class:`BadParameter` when nothing is left."""
    ends = [
        end if asked is None else view.zero_ns + round(asked * 1e9)
        for end, asked in zip(view.span_ns, span_s, strict=True)
    ]
    first, last = max(ends[0], view.span_ns[0]), min(ends[1], view.span_ns[1])
    if first >= last:
        raise BadParameter(f"--from, --to: select nothing of its {(view.span_ns[1] - view.span_ns[0]) / 1e9:.1f} s")
    return replace(view, span_ns=(first, last))
