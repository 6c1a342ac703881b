"""Figures of the phone experiments: angles over time, and the errors of the judges."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from stillpoint.datasets.recording import Floats
from stillpoint.scoring.report.figures import REST_GREY, WRAP_DEG, draw_line, get_colour
from stillpoint.studies.papers.phone.parameters import (
    HIGHEST_HZ,
    LOWEST_HZ,
    MEAN_S,
    OMEGA0_RADPS,
    PRINTED,
    SLOWER,
    ZETA,
    compute_filter_gain,
    compute_mean_envelope,
    compute_mean_gain,
)
from stillpoint.studies.papers.phone.study import AXES, Series

Span = tuple[float, float]


def draw_angles(
    axes: Sequence[Axes], series: Series, methods: Mapping[str, int], parts: Sequence[str], span: Span
) -> None:
    """Draw one angle per axes over the span: the methods in their colours, the benchmark on top."""
    judge = "benchmark" if "benchmark" in series.angles_deg else "graph"
    for ax, part in zip(axes, parts, strict=True):
        k = AXES.index(part)
        for name, colour in methods.items():
            _draw_line(
                ax, series.t_s, series.angles_deg[name][:, k], span, color=get_colour(colour), lw=1.0, label=name
            )
        _draw_line(
            ax,
            series.t_s,
            series.angles_deg[judge][:, k],
            span,
            color=rcParams["text.color"],
            lw=1.3,
            label=judge,
        )
        ax.set_ylabel(f"{part} (deg)")
        ax.yaxis.set_major_locator(MaxNLocator(4))
        _finish(ax, series, span)


def draw_judges(ax: Axes, series: Series, references: Mapping[str, int]) -> None:
    """Draw the total error of the references against the truth."""
    span = (float(series.t_s[0]), float(series.t_s[-1]))
    for name, colour in references.items():
        t_s, error_deg = series.errors[name]
        _draw_line(ax, t_s, error_deg, span, color=get_colour(colour), lw=1.0, label=name)
    ax.set_ylim(bottom=0)
    ax.set_ylabel("deg")
    _finish(ax, series, span)


def draw_gains(ax: Axes) -> None:
    """Draw the size of F(s) for both pairs of parameters, and of the moving average with its envelope."""
    hz = np.geomspace(LOWEST_HZ, HIGHEST_HZ, 3000)
    for k, parameters in enumerate((PRINTED, SLOWER)):
        label = f"|F|, ω₀ = {parameters.omega0_radps:g} rad/s, ζ = {parameters.zeta:g}"
        ax.loglog(hz, compute_filter_gain(hz, parameters), color=get_colour(k), lw=1.4, label=label)
    ax.loglog(hz, compute_mean_gain(hz), color=REST_GREY, lw=0.5, label=f"mean over {MEAN_S:g} s")
    ax.loglog(hz, compute_mean_envelope(hz), color=rcParams["text.color"], lw=1.2, label="its envelope")
    ax.set_xlim(LOWEST_HZ, HIGHEST_HZ)
    ax.set_ylim(1e-4, 3)
    ax.set_xlabel("frequency (Hz)")
    ax.set_ylabel("gain")


def draw_map(axes: Sequence[Axes], map_deg: Floats, printed_deg: Sequence[float]) -> None:
    """Draw CF's RMSE (K, L, 3) over its parameters, one angle per axes; frames mark PRINTED and SLOWER."""
    for part, ax in enumerate(axes):
        values = map_deg[:, :, part]
        ax.imshow(values, norm=LogNorm(values.min(), values.max()), cmap="Greys", alpha=0.5, aspect="auto")
        for (row, column), value in np.ndenumerate(values):
            ax.text(column, row, f"{value:.2f}", ha="center", va="center", fontsize=9)
        for k, parameters in enumerate((PRINTED, SLOWER)):
            corner = ZETA.index(parameters.zeta) - 0.5, OMEGA0_RADPS.index(parameters.omega0_radps) - 0.5
            ax.add_patch(Rectangle(corner, 1, 1, fill=False, edgecolor=get_colour(k), lw=2))
        ax.set_xticks(range(len(ZETA)), [f"{zeta:g}" for zeta in ZETA])
        ax.set_yticks(range(len(OMEGA0_RADPS)), [f"{w0:g}" for w0 in OMEGA0_RADPS])
        ax.set_ylabel("ω₀ (rad/s)")
        ax.set_title(f"{AXES[part]}; the paper prints {printed_deg[part]:.2f} deg", loc="left")
        ax.grid(visible=False)
    axes[-1].set_xlabel("ζ")


def _draw_line(ax: Axes, t_s: Floats, value: Floats, span: Span, **style: Any) -> None:
    """Draw a value in deg over a span; a wrap by 360 deg breaks the line."""
    inside = slice(*np.searchsorted(t_s, span))
    draw_line(ax, t_s[inside], value[inside], largest_jump=WRAP_DEG, **style)


def _finish(ax: Axes, series: Series, span: Span) -> None:
    """Set limits, and shade the rests in grey."""
    for first, last in series.rests_s:
        if last > span[0] and first < span[1]:
            ax.axvspan(max(first, span[0]), min(last, span[1]), color=REST_GREY, alpha=0.16, lw=0, zorder=0)
    ax.set_xlim(*span)
    ax.xaxis.set_major_locator(MaxNLocator(8))
