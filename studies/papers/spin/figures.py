"""Figures of the experiments with a spinning body: bars of an error per trial."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator

from stillpoint.scoring.report.figures import get_colour
from stillpoint.studies.papers.spin.study import Trial

_MANY_DECADES = 300.0  # ratio above which only powers of ten are labelled
_GROUP = 0.8  # share of the room of a trial that its bars take
_LOGARITHMIC_FROM = 30.0  # ratio of the largest to the smallest bar


def draw_bars(ax: Axes, trials: Sequence[Trial], metric: str, methods: Mapping[str, int], unit: str) -> None:
    """Draw one group of bars per trial, a bar per method in its colour; logarithmic where the sizes differ much."""
    values = np.array([[_get_figure(one, method, metric) for method in methods] for one in trials])
    width = _GROUP / len(methods)
    low, high = np.nanmin(values), np.nanmax(values)
    logarithmic = bool(high > _LOGARITHMIC_FROM * low)
    for k, (method, colour) in enumerate(methods.items()):
        at = np.arange(len(trials)) + (k - (len(methods) - 1) / 2) * width
        ax.bar(at, values[:, k], width * 0.92, color=get_colour(colour), label=method)
    if logarithmic:
        ax.set_yscale("log")
        ax.set_ylim(low / 2, high * 1.5)
        ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < _MANY_DECADES * low else (1.0,)))
        ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        ax.minorticks_off()
    ax.set_xticks(range(len(trials)), [str(one.seed) for one in trials])
    ax.set_xlim(-0.6, len(trials) - 0.4)
    ax.set_xlabel("trial (seed)")
    ax.set_ylabel(f"{unit}, logarithmic" if logarithmic else unit)
    ax.grid(axis="x", visible=False)


def _get_figure(one: Trial, method: str, metric: str) -> float:
    return float(getattr(one.scores[method], metric)) if method in one.scores else float("nan")
