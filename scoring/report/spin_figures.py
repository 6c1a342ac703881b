"""Still figures of a spinning body: rates, errors within their stated bands, and readings of the accelerometers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from stillpoint.datasets.names import make_drawable
from stillpoint.datasets.recording import Encoder, Floats, Spin, Times
from stillpoint.datasets.times import find_longest_step_ns
from stillpoint.datasets.trajectory import SpinReference
from stillpoint.scoring.report.figures import REST_GREY, count_columns, draw_line, get_colour, thin_line
from stillpoint.scoring.spin import SpinComparison

_BAND_SHOWN = 3.0  # how far beyond its errors a band may be drawn: a wide one would hide them
_OBSERVATION = "observation"  # its noise is several times that of the rest
_WIDE_FROM = 3.0  # how far beyond the other methods' errors the observation's may be drawn


@dataclass(frozen=True, eq=False)
class RateSeries:
    """Rates about the spin axis over time, of the judge and of several methods."""

    t_s: Floats  # (N,)
    truth_radps: Floats  # (N,)
    rate_radps: Mapping[str, Floats]  # by method, (N,)


def make_rate_series(truth: Encoder | SpinReference, comparisons: Sequence[SpinComparison], zero_ns: int) -> RateSeries:
    """Return the rates at the stamps that all comparisons share."""
    t_ns = reduce(np.intersect1d, (c.t_ns for c in comparisons))
    true = np.interp(t_ns, truth.t_ns, truth.rate_radps)
    rates = {c.estimated: true + c.rate_error_radps[np.searchsorted(c.t_ns, t_ns)] for c in comparisons}
    return RateSeries((t_ns - zero_ns) / 1e9, true, rates)


def draw_error_band(axes: Sequence[Axes], c: SpinComparison, colour: int, zero_ns: int) -> None:
    """Draw the errors of angle and rate, one axes each, over three standard deviations as the estimate states them."""
    parts = (
        ("angle (deg)", c.angle_error_rad, c.angle_sd_rad),
        ("rate (deg/s)", c.rate_error_radps, c.rate_sd_radps),
    )
    t_s = (c.t_ns - zero_ns) / 1e9
    for ax, (label, error_rad, sd_rad) in zip(axes, parts, strict=True):
        error = np.rad2deg(error_rad)
        limit = max(_find_error_limit(error), 1e-6)
        if sd_rad is not None:
            band = 3 * np.rad2deg(sd_rad)
            limit = max(limit, min(1.1 * float(band.max()), _BAND_SHOWN * limit))
            t, edge = thin_line(t_s, band, count_columns(ax))
            ax.fill_between(t, -edge, edge, color=REST_GREY, alpha=0.3, lw=0, label="3 standard deviations")
        _draw_series(ax, c.t_ns, t_s, error, color=get_colour(colour), lw=1.0, label="error")
        ax.set_ylim(-limit, limit)
        ax.set_ylabel(label)
        ax.set_xlim(t_s[0], t_s[-1])
        ax.yaxis.set_major_locator(MaxNLocator(4))


def draw_accelerometers(axes: Sequence[Axes], spin: Spin) -> None:
    """Draw the readings of each accelerometer, one axes each; a missing value breaks the line."""
    t_s = (spin.t_ns - spin.t_ns[0]) / 1e9
    limits = spin.geometry.accel_range_mps2
    for k, ax in enumerate(axes):
        value = spin.accel_mps2[:, k]
        _draw_series(ax, spin.t_ns, t_s, value, color=get_colour(0), lw=0.8)
        if limits is not None and np.nanmax(np.abs(value)) > 0.7 * limits[k]:
            for sign in (-1, 1):
                if (sign * value > 0.5 * limits[k]).any():
                    ax.axhline(sign * limits[k], color=rcParams["text.color"], lw=1.0, ls=":")
        ax.set_title(f"accelerometer {k + 1}", loc="left")
        ax.set_ylabel("m/s²")
        ax.set_xlim(t_s[0], t_s[-1])
        ax.yaxis.set_major_locator(MaxNLocator(4))


def _draw_series(ax: Axes, t_ns: Times, t_s: Floats, value: Floats, **style: Any) -> None:
    draw_line(ax, t_s, value, find_longest_step_ns(t_ns) / 1e9, **style)


def draw_rates(axes: Sequence[Axes], series: RateSeries, methods: Mapping[str, int], against: str = "truth") -> None:
    """Draw the rates with the truth on top, and below them the error of each method on an axis of its own.

    ``methods`` gives each method its colour. All methods but the observation share one scale, so that a smaller error
    looks smaller; a title says how many samples exceed it.
    """
    truth_degps = np.rad2deg(series.truth_radps)
    errors = {method: np.rad2deg(series.rate_radps[method]) - truth_degps for method in methods}
    limits = {method: _find_error_limit(error) for method, error in errors.items()}
    shared = float(np.median([limits[method] for method in methods if method != _OBSERVATION] or [0.0]))
    for method, k in methods.items():
        rate_degps, label = np.rad2deg(series.rate_radps[method]), make_drawable(method)
        draw_line(axes[0], series.t_s, rate_degps, color=get_colour(k), lw=0.9, label=label)
    ink, label = rcParams["text.color"], make_drawable(against)
    draw_line(axes[0], series.t_s, truth_degps, color=ink, lw=1.4, label=label, zorder=4)
    margin = 0.06 * np.ptp(truth_degps) + _find_shown_spread(series, methods)
    axes[0].set_ylim(truth_degps.min() - margin, truth_degps.max() + margin)
    axes[0].set_ylabel("rate (deg/s)")
    for ax, (method, k) in zip(axes[1:], methods.items(), strict=True):
        error = errors[method]
        draw_line(ax, series.t_s, error, color=get_colour(k), lw=0.9)
        limit = limits[method] if method == _OBSERVATION else shared
        ax.set_ylim(-limit, limit)
        ax.set_ylabel("deg/s")
        beyond = int((np.abs(error) > limit).sum())
        samples = "sample" if beyond == 1 else "samples"
        note = f"  ({beyond} {samples} beyond, up to {np.abs(error).max():.0f} deg/s)" if beyond else ""
        ax.set_title(make_drawable(f"error of {method}{note}"), loc="left", color=get_colour(k), fontweight="bold")
    for ax in axes:
        ax.set_xlim(series.t_s[0], series.t_s[-1])
        ax.yaxis.set_major_locator(MaxNLocator(4))


def _find_error_limit(error: Floats) -> float:
    """Return half the height of an error's axis, which holds all but the worst thousandth, or all where that fits."""
    most = float(np.quantile(np.abs(error), 0.999)) * 1.5
    worst = float(np.abs(error).max())
    return 1.05 * worst if worst < _WIDE_FROM * most else most


def _find_shown_spread(series: RateSeries, methods: Mapping[str, int]) -> float:
    """Return the room above and below the truth, in deg/s, for the widest of the methods without its glitches."""
    truth = np.rad2deg(series.truth_radps)
    return max(_find_error_limit(np.rad2deg(series.rate_radps[method]) - truth) for method in methods)
