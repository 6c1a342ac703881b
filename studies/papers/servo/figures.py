"""Figures of the servo bench: sensors at rest, drift of the gyro, angles by accelerometer and filter."""

from collections.abc import Mapping, Sequence

from matplotlib import rcParams
from matplotlib.axes import Axes

from stillpoint.datasets.recording import Floats
from stillpoint.scoring.report.figures import get_colour
from stillpoint.studies.papers.servo.study import GYRO, Series, restart_at

_AXES = "xyz"
Span = tuple[float, float]


def draw_sensors(axes: Sequence[Axes], series: Series, span: Span) -> None:
    """Draw figure 4: rate, specific force and field on the three axes."""
    shown = (
        (series.t_s, series.gyro_b_degps, "rate (deg/s)"),
        (series.t_s, series.accel_b_g, "force (g)"),
        (series.mag_t_s, series.mag_b_ut, "field (uT)"),
    )
    for ax, (t_s, columns, name) in zip(axes, shown, strict=True):
        rows = slice(*t_s.searchsorted(span))
        for k, axis in enumerate(_AXES):
            ax.plot(t_s[rows], columns[rows, k], color=get_colour(k), lw=0.8, label=axis)
        ax.set_ylabel(name)


def draw_drift(axes: Sequence[Axes], series: Series, span: Span, colour: int) -> None:
    """Draw figure 5: the gyro's roll from the start of the span on, and its error."""
    rows = _find_rows(series, span)
    roll = restart_at(series, GYRO, span[0])
    _draw_line(axes[0], series, roll, rows, get_colour(colour), GYRO)
    _draw_truth(axes[0], series, rows)
    _draw_line(axes[1], series, roll - series.true_roll_deg, rows, get_colour(colour), GYRO)
    axes[0].set_ylabel("roll (deg)")
    axes[1].set_ylabel("error (deg)")


def draw_rolls(axes: Sequence[Axes], series: Series, methods: Mapping[str, int], spans: Sequence[Span]) -> None:
    """Draw figures 6 and 7: roll by each method over each of the spans, the truth on top."""
    for ax, span in zip(axes, spans, strict=True):
        rows = _find_rows(series, span)
        for method, colour in methods.items():
            roll = restart_at(series, method, span[0]) if method == GYRO else series.roll_deg[method]
            _draw_line(ax, series, roll, rows, get_colour(colour), method)
        _draw_truth(ax, series, rows)
        ax.set_ylabel("roll (deg)")
    axes[-1].set_xlabel("time (s)")


def _find_rows(series: Series, span: Span) -> slice:
    first, last = series.t_s.searchsorted(span)
    return slice(int(first), int(last))


def _draw_line(ax: Axes, series: Series, values: Floats, rows: slice, colour: str, label: str) -> None:
    ax.plot(series.t_s[rows], values[rows], color=colour, lw=1.0, label=label)


def _draw_truth(ax: Axes, series: Series, rows: slice) -> None:
    ax.plot(series.t_s[rows], series.true_roll_deg[rows], color=rcParams["text.color"], lw=1.1, label="truth")
