"""Write a leaderboard for a paper: the table as LaTeX, CSV and Markdown, and figures as PDF and SVG."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes

from stillpoint.datasets.files.atomic import write_atomically
from stillpoint.scoring.report.printed import write_figure
from stillpoint.studies.leaderboard import Leaderboard
from stillpoint.studies.publish.figures import draw_map, draw_ranking, get_map_height_in, get_ranking_height_in
from stillpoint.studies.publish.tables import format_csv, format_latex, format_markdown

_TABLES = {"table.tex": format_latex, "table.csv": format_csv, "table.md": format_markdown}


def write_paper(folder: Path, board: Leaderboard) -> list[Path]:
    """Write tables and figures into a folder that is there, and return their paths."""
    written = []
    for name, make in _TABLES.items():
        target = folder / name
        with write_atomically(target) as file:
            file.write(make(board).encode())
        written.append(target)
    for ending in (".pdf", ".svg"):
        for k, table in enumerate(board.tables):
            target = folder / f"ranking{'' if k == 0 else f'-{k + 1}'}{ending}"
            write_figure(target, 1, get_ranking_height_in(table), partial(_draw_first, draw=draw_ranking, what=table))
            written.append(target)
        target = folder / f"map{ending}"
        write_figure(target, 1, get_map_height_in(board), partial(_draw_first, draw=draw_map, what=board))
        written.append(target)
    return written


def _draw_first(axes: Sequence[Axes], draw: Callable[[Axes, Any], None], what: Any) -> None:
    draw(axes[0], what)
