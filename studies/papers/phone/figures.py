"""Figures of the phone experiments: angles over time, and the errors of the judges."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from stillpoint.datasets.recording import Floats
from stillpoint.scoring.report.figures import REST_GREY, WRAP_DEG, draw_line, get_colour
from stillpoint.studies.papers.phone.study import AXES, Series

Span = tuple[float, float]


def draw_angles(
    axes: Sequence[Axes], series: Series, methods: Mapping[str, int], parts: Sequence[str], span: Span
) -> None:
    """Draw one angle per axes over the span: the methods in their colours, the benchmark on top."""
    for ax, part in zip(axes, parts, strict=True):
        k = AXES.index(part)
        for name, colour in methods.items():
            _line(ax, series.t_s, series.angles_deg[name][:, k], span, color=get_colour(colour), lw=1.0, label=name)
        _line(
            ax,
            series.t_s,
            series.angles_deg["benchmark"][:, k],
            span,
            color=rcParams["text.color"],
            lw=1.3,
            label="benchmark",
        )
        ax.set_ylabel(f"{part} (deg)")
        ax.yaxis.set_major_locator(MaxNLocator(4))
        _finish(ax, series, span)


def draw_judges(ax: Axes, series: Series, references: Mapping[str, int]) -> None:
    """Draw the total error of the references against the truth."""
    span = (float(series.t_s[0]), float(series.t_s[-1]))
    for name, colour in references.items():
        t_s, error_deg = series.errors[name]
        _line(ax, t_s, error_deg, span, color=get_colour(colour), lw=1.0, label=name)
    ax.set_ylim(bottom=0)
    ax.set_ylabel("deg")
    _finish(ax, series, span)


def _line(ax: Axes, t_s: Floats, value: Floats, span: Span, **style: Any) -> None:
    inside = slice(*np.searchsorted(t_s, span))
    draw_line(ax, t_s[inside], value[inside], largest_jump=WRAP_DEG, **style)


def _finish(ax: Axes, series: Series, span: Span) -> None:
    """Set limits, and shade the rests in grey."""
    for first, last in series.rests_s:
        if last > span[0] and first < span[1]:
            ax.axvspan(max(first, span[0]), min(last, span[1]), color=REST_GREY, alpha=0.16, lw=0, zorder=0)
    ax.set_xlim(*span)
    ax.xaxis.set_major_locator(MaxNLocator(8))
