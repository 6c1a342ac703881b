"""Pictures of roll experiments: bars of a figure per trial, and rates over time with their errors."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator

from stillpoint.datasets.recording import Floats
from stillpoint.scoring.report.figures import colour_of, draw_line
from stillpoint.studies.papers.spin.study import Series, Trial

MANY_DECADES = 300.0  # ratio above which only powers of ten are labelled
GROUP = 0.8  # share of the room of a trial that its bars take
LOGARITHMIC_FROM = 30.0  # ratio of the largest to the smallest bar
OBSERVATION = "observation"  # its noise is several times that of the rest
WIDE_FROM = 3.0  # how far beyond the other methods' errors the observation's may be drawn


def draw_bars(ax: Axes, trials: Sequence[Trial], metric: str, methods: Mapping[str, int], unit: str) -> None:
    """One group of bars per trial, one bar per method in its colour; logarithmic where the sizes differ too much."""
    values = np.array([[_figure(one, method, metric) for method in methods] for one in trials])
    width = GROUP / len(methods)
    low, high = np.nanmin(values), np.nanmax(values)
    logarithmic = bool(high > LOGARITHMIC_FROM * low)
    for k, (method, colour) in enumerate(methods.items()):
        at = np.arange(len(trials)) + (k - (len(methods) - 1) / 2) * width
        ax.bar(at, values[:, k], width * 0.92, color=colour_of(colour), label=method)
    if logarithmic:
        ax.set_yscale("log")
        ax.set_ylim(low / 2, high * 1.5)
        ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < MANY_DECADES * low else (1.0,)))
        ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        ax.minorticks_off()
    ax.set_xticks(range(len(trials)), [str(one.seed) for one in trials])
    ax.set_xlim(-0.6, len(trials) - 0.4)
    ax.set_xlabel("trial (seed)")
    ax.set_ylabel(f"{unit}, logarithmic" if logarithmic else unit)
    ax.grid(axis="x", visible=False)


def _figure(one: Trial, method: str, metric: str) -> float:
    return float(getattr(one.scores[method], metric)) if method in one.scores else float("nan")


def draw_rates(axes: Sequence[Axes], series: Series, methods: Mapping[str, int], against: str = "truth") -> None:
    """On top the rates, the truth over them; below, the error of each method on an axis of its own.

    ``methods`` gives each method its colour. The observation has a scale of its own, all others share one, so that what
    looks smaller is smaller; how many samples exceed it is said.
    """
    truth_degps = np.rad2deg(series.truth_radps)
    errors = {method: np.rad2deg(series.rate_radps[method]) - truth_degps for method in methods}
    limits = {method: error_limit(error) for method, error in errors.items()}
    shared = float(np.median([limits[method] for method in methods if method != OBSERVATION] or [0.0]))
    for method, k in methods.items():
        draw_line(axes[0], series.t_s, np.rad2deg(series.rate_radps[method]), color=colour_of(k), lw=0.9, label=method)
    draw_line(axes[0], series.t_s, truth_degps, color=rcParams["text.color"], lw=1.4, label=against, zorder=4)
    margin = 0.06 * np.ptp(truth_degps) + spread(series, methods)
    axes[0].set_ylim(truth_degps.min() - margin, truth_degps.max() + margin)
    axes[0].set_ylabel("rate (deg/s)")
    for ax, (method, k) in zip(axes[1:], methods.items(), strict=True):
        error = errors[method]
        draw_line(ax, series.t_s, error, color=colour_of(k), lw=0.9)
        limit = limits[method] if method == OBSERVATION else shared
        ax.set_ylim(-limit, limit)
        ax.set_ylabel("deg/s")
        beyond = int((np.abs(error) > limit).sum())
        samples = "sample" if beyond == 1 else "samples"
        note = f"  ({beyond} {samples} beyond, up to {np.abs(error).max():.0f} deg/s)" if beyond else ""
        ax.set_title(f"error of {method}{note}", loc="left", color=colour_of(k), fontweight="bold")
    for ax in axes:
        ax.set_xlim(series.t_s[0], series.t_s[-1])
        ax.yaxis.set_major_locator(MaxNLocator(4))


def error_limit(error: Floats) -> float:
    """Half the height of an error's axis: all but the worst thousandth with room, or everything where that fits."""
    most = float(np.quantile(np.abs(error), 0.999)) * 1.5
    worst = float(np.abs(error).max())
    return 1.05 * worst if worst < WIDE_FROM * most else most


def spread(series: Series, methods: Mapping[str, int]) -> float:
    """Room above and below the truth, in deg/s, for the widest of the methods without its glitches."""
    truth = np.rad2deg(series.truth_radps)
    return max(error_limit(np.rad2deg(series.rate_radps[method]) - truth) for method in methods)
