"""Figures of a spin rig: accuracy over its lever arms, and its accelerometers' variances per trial."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from stillpoint.datasets.constants import STANDARD_GRAVITY_MPS2
from stillpoint.scoring.report.figures import COLOURS
from stillpoint.studies.rig.design import Placement, Rig, compute_limits_m, evaluate_placement
from stillpoint.studies.rig.identify import Identified

STYLE: dict[Any, Any] = {"axes.grid": True, "grid.alpha": 0.3, "axes.spines.top": False, "axes.spines.right": False}
DPI = 110
_CHOSEN, _LIMIT = "o", ":"
_ABOVE, _BELOW = (4, 4), (4, -28)  # of a curve, its label in points; filtered and raw may lie close
_BESIDE = 0.2  # of the room of a trial, between its markers
_LABEL_AT = 12  # of the points of a curve
_LINES = 7  # of equal error in a map
_POINTS, _MAP_POINTS = 60, 30  # of a curve, and of a map in each direction


def draw_radial(ax: Axes, rig: Rig, chosen: Placement) -> None:
    """Draw the error of the rate over d1: of one sample, of the filter, and for a bias of 1 mg."""
    limit_m = compute_limits_m(rig)[0]
    arms_m = np.linspace(min(0.01, chosen.d1_m / 2), max(1.4 * limit_m, 1.2 * chosen.d1_m), _POINTS)
    found = [evaluate_placement(rig, float(arm), chosen.d2_m) for arm in arms_m]
    for values, colour, label, above in (
        ([one.raw_rate_sd_radps for one in found], COLOURS[0], "one sample", _ABOVE),
        ([one.filtered_rate_sd_radps for one in found], COLOURS[1], f"filtered, d2 = {chosen.d2_m:g} m", _BELOW),
        ([STANDARD_GRAVITY_MPS2 / 1e3 * one.rate_per_bias for one in found], COLOURS[2], "per mg of bias", _ABOVE),
    ):
        ax.plot(arms_m, np.rad2deg(values), color=colour)
        at = (arms_m[_LABEL_AT], np.rad2deg(values[_LABEL_AT]))
        ax.annotate(label, at, xytext=above, textcoords="offset points", color=colour)
    _mark_range(ax, limit_m, rig.headroom)
    ax.plot(chosen.d1_m, np.rad2deg(chosen.raw_rate_sd_radps), _CHOSEN, color=COLOURS[0])
    ax.set(xlabel="d1 (m)", ylabel="error of the rate (deg/s)", yscale="log", title="radial accelerometer F4")


def draw_tangential(ax: Axes, rig: Rig, chosen: Placement) -> None:
    """Draw the standard deviation of the angular acceleration over d2."""
    limit_m = compute_limits_m(rig)[1]
    arms_m = np.linspace(min(0.02, chosen.d2_m / 2), max(1.2 * limit_m, 1.2 * chosen.d2_m), _POINTS)
    sds = [np.sqrt(evaluate_placement(rig, chosen.d1_m, float(arm)).q_rad2ps4) for arm in arms_m]
    ax.plot(arms_m, np.rad2deg(sds), color=COLOURS[0])
    _mark_range(ax, limit_m, rig.headroom)
    ax.plot(chosen.d2_m, np.rad2deg(np.sqrt(chosen.q_rad2ps4)), _CHOSEN, color=COLOURS[0])
    ax.set(xlabel="d2 (m)", ylabel="sd of the acceleration (deg/s²)", yscale="log", title="tangential accelerometer F5")


def draw_both(ax: Axes, rig: Rig, chosen: Placement) -> None:
    """Draw lines of equal error of the filtered rate over both arms; grey where range, headroom or room end."""
    d1_m = np.linspace(min(0.02, chosen.d1_m / 2), 1.3 * compute_limits_m(rig)[0], _MAP_POINTS)
    d2_m = np.linspace(min(0.05, chosen.d2_m / 2), 1.2 * compute_limits_m(rig)[1], _MAP_POINTS)
    found = [[evaluate_placement(rig, float(one), float(other)) for one in d1_m] for other in d2_m]
    sd_degps = np.rad2deg([[one.filtered_rate_sd_radps for one in row] for row in found])
    levels = np.geomspace(sd_degps.min(), sd_degps.max(), _LINES + 2)[1:-1]
    lines = ax.contour(d1_m, d2_m, sd_degps, levels=levels, colors=COLOURS[0], linewidths=0.9)
    ax.clabel(lines, fmt="%.2g", fontsize=7)
    longest_m = [min((1 - rig.headroom) * limit_m, rig.room_m) for limit_m in compute_limits_m(rig)]
    ax.axvspan(longest_m[0], d1_m[-1], color="0.85", lw=0, zorder=0)
    ax.axhspan(longest_m[1], d2_m[-1], color="0.85", lw=0, zorder=0)
    ax.plot(chosen.d1_m, chosen.d2_m, _CHOSEN, color=COLOURS[1])
    ax.set(xlim=(d1_m[0], d1_m[-1]), ylim=(d2_m[0], d2_m[-1]))
    ax.set(xlabel="d1 (m)", ylabel="d2 (m)", title="filtered rate, sd (deg/s); grey does not fit")


def _mark_range(ax: Axes, limit_m: float, headroom: float) -> None:
    """Shade the arms beyond the range, and mark the range and the one with headroom."""
    last_m = ax.get_xlim()[1]
    ax.axvspan(limit_m, last_m, color="0.85", lw=0)
    ax.set_xlim(right=last_m)
    for at_m, colour, label in (
        (limit_m, "0.3", "range"),
        (limit_m * (1 - headroom), "0.6", f"{100 * headroom:.0f} % to spare"),
    ):
        ax.axvline(at_m, color=colour, lw=1, ls=_LIMIT)
        ax.text(at_m, 0.98, label, transform=ax.get_xaxis_transform(), rotation=90, va="top", ha="right", fontsize=8)


def draw_variances(ax: Axes, found: Identified, which: str) -> None:
    """Draw the variance of one accelerometer in each trial, and the maximum: figures 7 (radial) and 8 of the paper."""
    residuals = [getattr(one, which) for one in found.trials]
    numbers = np.arange(1, len(residuals) + 1)
    series: list[tuple[Sequence[float], dict[str, Any]]] = [
        ([one.variance_m2ps4 for one in residuals], {"marker": "o", "color": COLOURS[0], "label": "variance"}),
        ([one.robust_m2ps4 for one in residuals], {"marker": "s", "color": COLOURS[2], "label": "without glitches"}),
    ]
    if which == "tangential":
        alone = [one.tangential_alone_m2ps4 for one in found.trials]
        series.append((alone, {"marker": "^", "color": COLOURS[1], "label": "without the encoder's noise"}))
    for k, (values, style) in enumerate(series):
        ax.plot(numbers + _BESIDE * (k - (len(series) - 1) / 2), values, ls="none", **style)
    most = found.d4_m2ps4 if which == "radial" else found.d5_m2ps4
    highest = max(most, *(max(values) for values, _ in series))
    ax.axhline(most, color=COLOURS[0], lw=1, ls=_LIMIT, label="maximum")
    ax.set(xlabel="trial", ylabel="variance ((m/s²)²)", ylim=(0, 1.15 * highest))
    ax.set_xlim(0.5, len(residuals) + 0.5)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set_title({"radial": "F4, eq (28)", "tangential": "F5, eq (30)"}[which])
    ax.legend(frameon=False)
