"""Figures of the underwater mission: angles with zooms, errors of the heading, and gains over time."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, MaxNLocator

from stillpoint.datasets.recording import Floats
from stillpoint.filters.complementary.gains import Gains
from stillpoint.scoring.report.figures import REST_GREY, WRAP_DEG, draw_line, get_colour
from stillpoint.studies.papers.auv.study import Series, compute_difference_deg

_PARTS = ("roll", "pitch", "heading")
_RANGE = {"kp_per_s": (0.005, 20.0), "ki_per_s2": (3e-6, 30.0)}  # of the axes, around the bounds of the gains
Span = tuple[float, float]


def draw_mission(axes: Sequence[Axes], series: Series) -> None:
    """Draw the path over the sea from above, then the depth over time."""
    assert series.place_n_m is not None
    east_m, north_m, up_m = series.place_n_m.T
    axes[0].plot(east_m, north_m, color=rcParams["text.color"], lw=1.2)
    axes[0].plot([east_m[0], east_m[-1]], [north_m[0], north_m[-1]], color=get_colour(0), marker="o", lw=0)
    axes[0].set_aspect("equal", adjustable="datalim")
    axes[0].set_xlabel("east (m)")
    axes[0].set_ylabel("north (m)")
    span = (float(series.t_s[0]), float(series.t_s[-1]))
    _draw_line(axes[1], series, -up_m, span, color=rcParams["text.color"], lw=1.2)
    axes[1].invert_yaxis()
    _finish(axes[1], series, span, "depth (m)")
    axes[1].set_xlabel("time (s)")


def draw_angle(
    axes: Sequence[Axes], series: Series, part: int, methods: Mapping[str, int], spans: Sequence[Span]
) -> None:
    """Draw one angle over each of the spans: measured (roll and pitch), estimates in colour, the truth on top."""
    for ax, span in zip(axes, spans, strict=True):
        if part < 2:
            _draw_line(ax, series, series.measured_deg[:, part], span, color=REST_GREY, lw=0.7, label="measured")
        for method, colour in methods.items():
            _draw_line(
                ax, series, series.estimated_deg[method][:, part], span, color=get_colour(colour), lw=1.0, label=method
            )
        _draw_line(ax, series, series.true_deg[:, part], span, color=rcParams["text.color"], lw=1.2, label="truth")
        if part == 2:
            _draw_fixes(ax, series, span, series.course_deg)
        _finish(ax, series, span, f"{_PARTS[part]} (deg)")
    axes[-1].set_xlabel("time (s)")


def draw_heading_errors(axes: Sequence[Axes], series: Series, methods: Mapping[str, int]) -> None:
    """Draw the heading errors of estimates and GPS courses; below without the gyro, whose error hides the others."""
    span = (float(series.t_s[0]), float(series.t_s[-1]))
    true = np.interp(series.fix_s, series.t_s, np.unwrap(series.true_deg[:, 2], period=360.0))
    for ax, shown in zip(axes, (methods, {m: k for m, k in methods.items() if m != "gyro"}), strict=True):
        _draw_fixes(ax, series, span, compute_difference_deg(series.course_deg, true))
        for method, colour in shown.items():
            error = compute_difference_deg(series.estimated_deg[method][:, 2], series.true_deg[:, 2])
            _draw_line(ax, series, error, span, color=get_colour(colour), lw=1.0, label=method)
        _finish(ax, series, span, "error (deg)")
    axes[1].set_ylim(-6, 6)


def draw_gains(axes: Sequence[Axes], series: Series, which: str, methods: Mapping[str, int], unit: str) -> None:
    """Draw ``kp_per_s`` or ``ki_per_s2`` of roll, pitch and heading, logarithmic, one axes each."""
    span = (float(series.t_s[0]), float(series.t_s[-1]))
    for part, ax in enumerate(axes):
        for method, colour in methods.items():
            gain = get_gain(series.gains[method], which)[:, part]
            _draw_line(
                ax, series, np.maximum(gain, _RANGE[which][0]), span, color=get_colour(colour), lw=1.0, label=method
            )
        _finish(ax, series, span, f"{_PARTS[part]} ({unit})")
        ax.set_yscale("log")
        ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        ax.set_ylim(*_RANGE[which])
        ax.minorticks_off()


def get_gain(gains: Gains, which: str) -> Floats:
    """Return one of the two gains (N, 3)."""
    return np.asarray(getattr(gains, which))


def _draw_fixes(ax: Axes, series: Series, span: Span, value_deg: Floats) -> None:
    """Draw a value in deg at the stamps of the GPS fixes within a span."""
    inside = (series.fix_s >= span[0]) & (series.fix_s <= span[1])
    style: dict[str, Any] = {"color": REST_GREY, "marker": ".", "ms": 3, "lw": 0, "zorder": 1}
    ax.plot(series.fix_s[inside], value_deg[inside], label="GPS course", **style)


def _draw_line(ax: Axes, series: Series, value: Floats, span: Span, **style: Any) -> None:
    """Draw a value in deg over a span; a wrap by 360 deg breaks the line."""
    inside = slice(*np.searchsorted(series.t_s, span))
    draw_line(ax, series.t_s[inside], value[inside], largest_jump=WRAP_DEG, **style)


def _finish(ax: Axes, series: Series, span: Span, label: str) -> None:
    """Set limits and label, and shade the time under water in grey."""
    when = series.phases_s
    first, last = max(when["dive_s"], span[0]), min(when["surfaced_s"], span[1])
    if first < last:
        ax.axvspan(first, last, color=REST_GREY, alpha=0.12, lw=0, zorder=0)
    ax.set_xlim(*span)
    ax.set_ylabel(label)
    ax.xaxis.set_major_locator(MaxNLocator(8))
