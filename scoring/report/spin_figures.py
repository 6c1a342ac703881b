"""Pictures of a spinning body's page: errors within their stated bands, and what its accelerometers read."""

from collections.abc import Sequence
from functools import reduce
from typing import Any

import numpy as np
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from stillpoint.datasets.recording import Encoder, Floats, Spin, Times
from stillpoint.datasets.times import longest_step_ns
from stillpoint.datasets.trajectory import RollReference
from stillpoint.scoring.report.envelope import envelope
from stillpoint.scoring.report.figures import REST_GREY, colour_of, columns_of, draw_line
from stillpoint.scoring.spin import RollComparison
from stillpoint.studies.papers.spin.figures import error_limit
from stillpoint.studies.papers.spin.study import Series

BAND_SHOWN = 3.0  # how far beyond its errors a band may be drawn: a wide one would hide them


def series_of(truth: Encoder | RollReference, comparisons: Sequence[RollComparison], zero_ns: int) -> Series:
    """Rates at the stamps that all comparisons share."""
    t_ns = reduce(np.intersect1d, (c.t_ns for c in comparisons))
    true = np.interp(t_ns, truth.t_ns, truth.rate_radps)
    rates = {c.estimated: true + c.rate_error_radps[np.searchsorted(c.t_ns, t_ns)] for c in comparisons}
    return Series((t_ns - zero_ns) / 1e9, true, rates)


def draw_error_band(axes: Sequence[Axes], c: RollComparison, colour: int, zero_ns: int) -> None:
    """Errors of angle and rate, one axes each, over three standard deviations as the estimate states them."""
    parts = (
        ("angle (deg)", c.angle_error_rad, c.angle_sd_rad),
        ("rate (deg/s)", c.rate_error_radps, c.rate_sd_radps),
    )
    t_s = (c.t_ns - zero_ns) / 1e9
    for ax, (label, error_rad, sd_rad) in zip(axes, parts, strict=True):
        error = np.rad2deg(error_rad)
        limit = max(error_limit(error), 1e-6)
        if sd_rad is not None:
            band = 3 * np.rad2deg(sd_rad)
            limit = max(limit, min(1.1 * float(band.max()), BAND_SHOWN * limit))
            t, edge = envelope(t_s, band, columns_of(ax))
            ax.fill_between(t, -edge, edge, color=REST_GREY, alpha=0.3, lw=0, label="3 standard deviations")
        _line(ax, c.t_ns, t_s, error, color=colour_of(colour), lw=1.0, label="error")
        ax.set_ylim(-limit, limit)
        ax.set_ylabel(label)
        ax.set_xlim(t_s[0], t_s[-1])
        ax.yaxis.set_major_locator(MaxNLocator(4))


def draw_accelerometers(axes: Sequence[Axes], spin: Spin) -> None:
    """What each accelerometer read, one axes each; a value that is missing breaks the line."""
    t_s = (spin.t_ns - spin.t_ns[0]) / 1e9
    limits = spin.geometry.accel_range_mps2
    for k, ax in enumerate(axes):
        value = spin.accel_mps2[:, k]
        _line(ax, spin.t_ns, t_s, value, color=colour_of(0), lw=0.8)
        if limits is not None and np.nanmax(np.abs(value)) > 0.7 * limits[k]:
            for sign in (-1, 1):
                if (sign * value > 0.5 * limits[k]).any():
                    ax.axhline(sign * limits[k], color=rcParams["text.color"], lw=1.0, ls=":")
        ax.set_title(f"accelerometer {k + 1}", loc="left")
        ax.set_ylabel("m/s²")
        ax.set_xlim(t_s[0], t_s[-1])
        ax.yaxis.set_major_locator(MaxNLocator(4))


def _line(ax: Axes, t_ns: Times, t_s: Floats, value: Floats, **style: Any) -> None:
    draw_line(ax, t_s, value, longest_step_ns(t_ns) / 1e9, **style)
