"""Still figures as SVG text in the font and ink of a page, once for a desktop and once for a phone."""

import html
import io
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stillpoint.scoring.report.figures import COLOURS

_INK, _GRID = "#010203", "#040506"  # stand for the page's colours; no other thing has them
_PAGE_COLOURS = {colour.lower(): f"var(--line-{k})" for k, colour in enumerate(COLOURS)}
_WIDTHS_PX = {"wide": 1040, "narrow": 358}
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "text.color": _INK,
    "axes.labelcolor": _INK,
    "axes.edgecolor": _GRID,
    "xtick.color": _INK,
    "ytick.color": _INK,
    "xtick.major.size": 0,
    "ytick.major.size": 0,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": _GRID,
    "grid.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.spines.left": False,
    "font.size": 12,
    "axes.titlesize": 12,
    "legend.frameon": False,
    "lines.solid_joinstyle": "round",
    "path.simplify_threshold": 0.3,
}


@dataclass(frozen=True)
class Picture:
    """One figure in both widths, inline SVG."""

    title: str
    note: str
    wide: str
    narrow: str


def make_picture(
    title: str, note: str, rows: int, row_px: int, draw: Callable[[Sequence[Axes]], None], time_axis: bool = True
) -> Picture:
    """Draw the same axes, ``rows`` under each other, in both widths. ``draw`` gets the axes from top to bottom."""
    drawn = {}
    for name, width_px in _WIDTHS_PX.items():
        with mpl.rc_context(_STYLE):
            mpl.rcParams["svg.hashsalt"] = f"{title} {name}"
            figure = Figure(figsize=(width_px / 72, (rows * row_px + 70) / 72), layout="constrained")
            axes = list(figure.subplots(rows, 1, sharex=time_axis, squeeze=False)[:, 0])
            draw(axes)
            if time_axis:
                axes[-1].set_xlabel("time (s)")
            handles, labels = axes[0].get_legend_handles_labels()
            if len(labels) > 1:
                columns = min(len(labels), 8 if name == "wide" else 2)
                legend = figure.legend(handles, labels, loc="outside upper left", ncols=columns, handlelength=1.3)
                for line in legend.get_lines():
                    line.set_linewidth(3)
            drawn[name] = _render_svg(figure, title, name)
    return Picture(title, note, **drawn)


def _render_svg(figure: Figure, title: str, name: str) -> str:
    """Return a figure as SVG without metadata, with paths to 1/10 px and the colours of the page."""
    text = io.StringIO()
    figure.savefig(text, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    svg = text.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r'\bd="[^"]*"', lambda path: re.sub(r"(\.\d)\d+", r"\1", path[0]), svg)
    svg = re.sub(r'\bid="(?!m|p|C)[^"]*"', "", svg)
    for colour, of_page in {_INK: "currentColor", _GRID: "var(--grid)", **_PAGE_COLOURS}.items():
        svg = svg.replace(colour, of_page)
    return svg.replace("<svg", f'<svg class="{name}" role="img" aria-label="{html.escape(title)}"', 1)
