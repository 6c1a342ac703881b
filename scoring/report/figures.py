"""Still figures of comparisons: functions ``(axes, view) -> None`` that draw and compute nothing new.

Colours are Okabe and Ito's, which colour-blind readers can tell apart; the truth is drawn in the colour of the text.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, MaxNLocator

from stillpoint.datasets.frames import EulerFrame, euler, rotation
from stillpoint.datasets.names import make_drawable
from stillpoint.datasets.recording import Floats, Times, Truth
from stillpoint.datasets.times import find_longest_step_ns
from stillpoint.datasets.trajectory import Reference, compute_total_sd_rad
from stillpoint.scoring.compare import Comparison, name_of
from stillpoint.scoring.errors import compute_attitude_error, compute_rotation_error_n
from stillpoint.scoring.report.plot_data import find_rest_spans
from stillpoint.scoring.score import Score

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#8C6BB1", "#A6761D")
ON_DARK = ("#4DA9E8", "#FF8B4A", "#2EC79A", "#E6A0C8", "#F2B632", "#9AD8F7", "#B9A0DB", "#D1A04D")  # the same, lighter
_SMALLEST_ERROR_DEG = 0.01  # lower end of a logarithmic axis
WRAP_DEG = 180.0
REST_GREY = "0.5"


@dataclass(frozen=True, eq=False)
class View:
    """Estimates compared with one truth, and the stretch of time to show."""

    comparisons: tuple[Comparison, ...]
    truth: Reference | Truth
    rests_ns: Times  # (R, 2)
    frame: EulerFrame
    zero_ns: int  # where the time axis starts
    span_ns: tuple[int, int]

    def seconds(self, t_ns: Times) -> Floats:
        """Return times on the axis of the figure, in s."""
        return (t_ns - self.zero_ns) / 1e9

    def select(self, t_ns: Times) -> slice:
        """Return the samples inside the span."""
        return slice(*np.searchsorted(t_ns, [self.span_ns[0], self.span_ns[1] + 1]))

    def find_busiest(self, seconds: float) -> "View":
        """Return the view of the stretch of this length in which the truth turns most."""
        t, rot = self.truth.t_ns, rotation(self.truth.q_nb)
        turned = np.append(0.0, np.cumsum((rot[:-1].inv() * rot[1:]).magnitude()))
        end = np.searchsorted(t, t + round(seconds * 1e9), side="right") - 1
        start = int(np.argmax(turned[end] - turned))
        return replace(self, span_ns=(int(t[start]), int(t[end[start]])))


def make_view(comparisons: Sequence[Comparison], truth: Reference | Truth, frame: EulerFrame, zero_ns: int) -> View:
    """Return a view of the whole run. A truth rests where it does not count as moving."""
    rests_ns = find_rest_spans(truth)
    first, last = int(truth.t_ns[0]), int(truth.t_ns[-1])
    return View(tuple(comparisons), truth, rests_ns, frame, zero_ns, (first, last))


def draw_angles(axes: Sequence[Axes], view: View) -> None:
    """Draw roll, pitch and yaw over time, one of the three axes each, with the truth on top of the estimates."""
    for k, c in enumerate(view.comparisons):
        error_rad = float(compute_attitude_error(c.q_est, c.q_true).total_rad.mean())
        on_top_of_worse = 3 - error_rad / np.pi
        style = {"label": make_drawable(c.estimated), "color": get_colour(k), "lw": 1.0, "zorder": on_top_of_worse}
        _draw_angle_lines(axes, view, c.t_ns, c.q_est, **style)
    truth = view.truth
    label, ink = make_drawable(name_of(truth)), rcParams["text.color"]
    _draw_angle_lines(axes, view, truth.t_ns, truth.q_nb, label=label, color=ink, lw=1.4, zorder=4.0)
    for ax, name in zip(axes, ("roll", "pitch", "yaw"), strict=True):
        ax.set_ylabel(f"{name} (deg)")
        ax.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 1.5, 3, 4.5, 6, 9, 10]))
        _format_time_axis(ax, view)


def draw_errors(axes: Sequence[Axes], view: View) -> None:
    """Draw the total error over time, one axes per estimate; the grey floor is the reference's standard deviation."""
    worst = max(float(compute_attitude_error(c.q_est, c.q_true).total_rad.max()) for c in view.comparisons)
    for k, (ax, comparison) in enumerate(zip(axes, view.comparisons, strict=True)):
        shown = view.select(comparison.t_ns)
        t_ns = comparison.t_ns[shown]
        total = compute_attitude_error(comparison.q_est[shown], comparison.q_true[shown]).total_rad
        _draw_series(
            ax, view, t_ns, np.maximum(np.rad2deg(total), _SMALLEST_ERROR_DEG), np.inf, color=get_colour(k), lw=1.0
        )
        ax.set_yscale("log")
        ax.set_ylim(_SMALLEST_ERROR_DEG, max(2 * np.rad2deg(worst), 10.0))
        ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        ax.minorticks_off()
        ax.set_ylabel("deg")
        ax.set_title(make_drawable(comparison.estimated), loc="left", color=get_colour(k), fontweight="bold")
        if comparison.true_cov_b_rad2 is not None:
            sd = np.rad2deg(compute_total_sd_rad(comparison.true_cov_b_rad2[shown]))
            t, floor = thin_line(view.seconds(t_ns), sd, count_columns(ax))
            ax.fill_between(t, _SMALLEST_ERROR_DEG, floor, color=REST_GREY, alpha=0.35, lw=0)
        _format_time_axis(ax, view)


def draw_band(axes: Sequence[Axes], view: View) -> None:
    """Draw the error of the first comparison about east, north and up, with the 3-sigma band of its covariance."""
    comparison = view.comparisons[0]
    shown = view.select(comparison.t_ns)
    t_ns, q_est = comparison.t_ns[shown], comparison.q_est[shown]
    error_deg = np.rad2deg(compute_rotation_error_n(q_est, comparison.q_true[shown]))
    turn = rotation(q_est).as_matrix()
    for k, (ax, name) in enumerate(zip(axes, ("east", "north", "up"), strict=True)):
        if comparison.cov_b_rad2 is not None:
            row = turn[:, k]
            sd = np.rad2deg(np.sqrt(np.einsum("ni,nij,nj->n", row, comparison.cov_b_rad2[shown], row)))
            t, band = thin_line(view.seconds(t_ns), 3 * sd, count_columns(ax))
            ax.fill_between(t, -band, band, color=get_colour(5), alpha=0.35, lw=0, label="3 standard deviations")
        _draw_series(ax, view, t_ns, error_deg[:, k], WRAP_DEG, color=get_colour(0), lw=1.0, label="error")
        ax.set_ylabel(f"about {name} (deg)")
        _format_time_axis(ax, view)


def draw_scores(ax: Axes, scores: Sequence[Score]) -> None:
    """Draw the RMSE of each estimate, best on top: total, heading and inclination on one logarithmic axis."""
    ordered = sorted(scores, key=lambda s: -s.total_rmse_deg)
    marks = {"total": ("o", 70), "heading": ("^", 45), "inclination": ("s", 38)}
    rows = np.arange(len(ordered))
    floor_deg = _SMALLEST_ERROR_DEG
    for k, (name, (marker, size)) in enumerate(marks.items()):
        values = np.maximum([getattr(s, f"{name}_rmse_deg") for s in ordered], floor_deg)
        if name == "total":
            ax.hlines(rows, floor_deg / 2, values, color=get_colour(k), lw=2, alpha=0.5, zorder=1)
            for row, value in zip(rows, values, strict=True):
                ax.annotate(f"{value:.2f}°", (value, row), (9, 0), textcoords="offset points", va="center")
        ax.scatter(values, rows, marker=marker, s=size, color=get_colour(k), label=name, zorder=3)
    ax.set_xscale("log")
    least = min(min(s.heading_rmse_deg, s.inclination_rmse_deg, s.total_rmse_deg) for s in ordered)
    most = max(s.total_rmse_deg for s in ordered)
    ax.set_xlim(max(least, floor_deg) / 1.6, max(most, floor_deg) * 2.5)
    sd_deg = ordered[0].reference_sd_deg
    if sd_deg is not None:
        ax.axvspan(ax.get_xlim()[0], max(sd_deg, ax.get_xlim()[0]), color=REST_GREY, alpha=0.25, lw=0, zorder=0)
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.set_yticks(rows, [make_drawable(s.estimated) for s in ordered])
    ax.set_ylim(-0.6, len(ordered) - 0.4)
    ax.set_xlabel("RMSE over the moving samples (deg)")
    ax.grid(axis="y", visible=False)


def get_colour(k: int) -> str:
    """Return the colour of the k-th estimate, the same in every figure of a page."""
    return COLOURS[k % len(COLOURS)]


def count_columns(ax: Axes) -> int:
    """Return how many stretches of time the axes can resolve: one per 2/72 inch."""
    return max(round(ax.get_window_extent().width / ax.figure.dpi * 36), 50)


def draw_line(
    ax: Axes, t_s: Floats, value: Floats, longest_step_s: float = np.inf, largest_jump: float = np.inf, **style: Any
) -> None:
    """Draw a series (N,), broken at gaps and at wrapped angles, with as many points as the axes can show."""
    ax.plot(*thin_line(*break_line(t_s, value, longest_step_s, largest_jump), count_columns(ax)), **style)


def thin_line(t: Floats, value: Floats, columns: int) -> tuple[Floats, Floats]:
    """Keep the first, least, greatest and last sample of each of ``columns`` equal stretches of time.

    ``t`` (N,) rising, ``value`` (N,), may hold NaN where a line breaks; returns the kept (t, value). A line through
    them covers the same pixels as one through all samples (Jugel et al., "M4", VLDB 2014).
    """
    if len(t) <= 4 * columns:
        return t, value
    column = np.minimum(((t - t[0]) / (t[-1] - t[0]) * columns).astype(np.intp), columns - 1)
    first = np.flatnonzero(np.diff(column, prepend=-1))
    last = np.append(first[1:], len(t)) - 1
    order = np.lexsort((value, column))  # within a column by size, NaN last
    finite = np.add.reduceat(np.isfinite(value), first)
    least, greatest = order[first], order[first + np.maximum(finite - 1, 0)]
    broken = np.flatnonzero(np.isnan(value))
    kept = np.unique(np.concatenate([first, least, greatest, last, broken]))
    return t[kept], value[kept]


def break_line(t: Floats, value: Floats, longest_step: float, largest_jump: float) -> tuple[Floats, Floats]:
    """Return the series with a NaN where two neighbours are too far apart in time (a gap) or in value (a wrap)."""
    at = np.flatnonzero((np.diff(t) > longest_step) | (np.abs(np.diff(value)) > largest_jump)) + 1
    return np.insert(t, at, (t[at - 1] + t[at]) / 2), np.insert(value, at, np.nan)


def _draw_angle_lines(axes: Sequence[Axes], view: View, t_ns: Times, q_nb: Floats, **style: Any) -> None:
    """Draw roll, pitch and yaw in deg of attitudes (N, 4), one axes each."""
    shown = view.select(t_ns)
    for ax, column_rad in zip(axes, euler(q_nb[shown], view.frame).T, strict=True):
        _draw_series(ax, view, t_ns[shown], np.rad2deg(column_rad), WRAP_DEG, **style)


def _draw_series(ax: Axes, view: View, t_ns: Times, value: Floats, jump: float, **style: Any) -> None:
    draw_line(ax, view.seconds(t_ns), value, find_longest_step_ns(t_ns) / 1e9, jump, **style)


def _format_time_axis(ax: Axes, view: View) -> None:
    """Shade the rests, and set the limits and ticks of the time axis."""
    start_s, end_s = view.seconds(np.array(view.span_ns))
    for first_s, last_s in view.seconds(view.rests_ns):
        if last_s > start_s and first_s < end_s:
            ax.axvspan(max(first_s, start_s), min(last_s, end_s), color=REST_GREY, alpha=0.16, lw=0, zorder=0)
    ax.set_xlim(start_s, end_s)
    ax.xaxis.set_major_locator(MaxNLocator(max(count_columns(ax) // 30, 4)))
