"""The map of a tuning: the typical error over two parameters."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stillpoint.datasets.names import make_drawable
from stillpoint.studies.tune import ParamRange, Tuning

_LEAST_FOR_CONTOURS = 8  # trials; fewer are shown as points alone
_LEVELS = 12
_BEST: dict[str, Any] = {"color": "C3", "markersize": 11, "zorder": 5, "clip_on": False, "label": "best common setting"}


def draw_tuning(tuning: Tuning) -> Figure:
    """Return a figure of the trials: over the two first parameters, or over the only one."""
    figure = Figure(figsize=(4.6, 3.6), layout="constrained")
    ax: Axes = figure.add_subplot()
    if len(tuning.ranges) == 1:
        _draw_curve(ax, tuning)
    else:
        _draw_map(figure, ax, tuning)
    ax.set_title(
        make_drawable(f"{tuning.estimator}: typical {tuning.figure} RMSE over {len(tuning.recordings)} recordings"),
        fontsize=9,
    )
    figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=7, frameon=False)
    return figure


def _draw_curve(ax: Axes, tuning: Tuning) -> None:
    """Draw the typical RMSE in deg over the one parameter that was tuned."""
    name = tuning.ranges[0].name
    ordered = sorted(tuning.trials, key=lambda trial: trial.params[name])
    ax.plot([t.params[name] for t in ordered], [t.typical_deg for t in ordered], ".-", linewidth=0.8)
    ax.axhline(tuning.defaults.typical_deg, color="0.5", linewidth=0.8, label="defaults")
    ax.plot(tuning.best.params[name], tuning.best.typical_deg, "*", **_BEST)
    ax.set(
        xlabel=make_drawable(name),
        ylabel="typical RMSE (deg)",
        yscale="log",
        xscale="log" if tuning.ranges[0].log else "linear",
    )


def _draw_map(figure: Figure, ax: Axes, tuning: Tuning) -> None:
    """Draw contours between the trials; with further parameters each trial shows one of their values."""
    first, second = tuning.ranges[:2]
    usable = [trial for trial in tuning.trials if np.isfinite(trial.typical_deg)]
    x = np.array([trial.params[first.name] for trial in usable])
    y = np.array([trial.params[second.name] for trial in usable])
    level = np.log10([trial.typical_deg for trial in usable])
    ax.set(xscale="log" if first.log else "linear", yscale="log" if second.log else "linear")
    if len(x) >= _LEAST_FOR_CONTOURS and len(tuning.ranges) == 2:
        filled: Any = ax.tricontourf(x, y, level, levels=_LEVELS, cmap="viridis_r")
    else:
        filled = ax.scatter(x, y, c=level, s=20, cmap="viridis_r")
    bar = figure.colorbar(filled, ax=ax, label="typical RMSE (deg)")
    bar.ax.yaxis.set_major_formatter(lambda value, _: f"{10**value:.3g}")
    ax.plot(x, y, ".", color="k", markersize=2)
    ax.plot(
        tuning.best.params[first.name], tuning.best.params[second.name], "*", color="C3", label="best common setting"
    )
    _draw_inside(ax, tuning, first, second)
    ax.set(xlabel=make_drawable(first.name), ylabel=make_drawable(second.name))


def _draw_inside(ax: Axes, tuning: Tuning, first: ParamRange, second: ParamRange) -> None:
    """Mark the defaults and the best setting of each recording."""
    each = tuning.best_per_recording
    mine = [trial.params[first.name] for trial in each], [trial.params[second.name] for trial in each]
    ax.plot(*mine, "o", color="w", markeredgecolor="k", markersize=4, clip_on=False, label="best of each recording")
    defaults = tuning.defaults.params
    if first.name in defaults and second.name in defaults:
        ax.plot(defaults[first.name], defaults[second.name], "s", color="C1", clip_on=False, label="defaults")
