"""Long series reduced for a page: least, greatest and middle value of equal stretches of time.

A page draws the band between least and greatest and a line through the middle values, so no peak is lost however many
samples fall on a pixel. It merges neighbouring stretches further where it shows many of them at once.
"""

import base64
import warnings
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from stillpoint.datasets.recording import Floats, Times
from stillpoint.datasets.times import find_longest_step_ns

_LEVELS = 65534  # values of a 16-bit integer beside 0, which stands for "no value"
LOWEST_DEG = 1e-3  # smaller errors are drawn as this on a logarithmic axis

Middle = Literal["rms", "mean"]


@dataclass(frozen=True, eq=False)
class Curve:
    """A series reduced to C stretches of equal length. NaN for a stretch in a gap."""

    start_s: float  # beginning of the first stretch
    step_s: float  # length of a stretch
    least: Floats  # (C,)
    greatest: Floats  # (C,)
    middle: Floats  # (C,) root mean square or mean; NaN where the line breaks


def reduce_series(t_ns: Times, value: Floats, zero_ns: int, columns: int, middle: Middle = "mean") -> Curve:
    """Reduce the samples ``value`` (N,) at ``t_ns`` (N,) to at most ``columns`` stretches.

    Times are counted from ``zero_ns``. A stretch without a sample gets the value of the straight line between its
    neighbours, as a drawn line would show it, unless it lies in a gap.
    """
    t_s = (t_ns - zero_ns) / 1e9
    columns = max(1, min(columns, len(t_s)))
    span_s = float(t_s[-1] - t_s[0]) or 1e-9
    column = np.minimum(((t_s - t_s[0]) / span_s * columns).astype(np.intp), columns - 1)
    filled = np.unique(column)
    first = np.searchsorted(column, filled)
    least, greatest, central = (np.full(columns, np.nan) for _ in range(3))
    least[filled] = np.minimum.reduceat(value, first)
    greatest[filled] = np.maximum.reduceat(value, first)
    count = np.diff(np.append(first, len(value)))
    if middle == "rms":
        central[filled] = np.sqrt(np.add.reduceat(value**2, first) / count)
    else:
        central[filled] = np.add.reduceat(value, first) / count
    step_s = span_s / columns
    centre_s = t_s[0] + (np.arange(columns) + 0.5) * step_s
    empty = np.setdiff1d(np.arange(columns), filled)
    between = empty[~_find_times_in_gaps(t_ns, t_s, centre_s[empty])]
    for kept in (least, greatest, central):
        kept[between] = np.interp(centre_s[between], t_s, value)
    return Curve(float(t_s[0]), step_s, least, greatest, central)


def reduce_angle(t_ns: Times, angle_deg: Floats, zero_ns: int, columns: int) -> Curve:
    """Reduce an angle (N,) in (-180, 180] deg; stretches in which it jumps from one end to the other are NaN."""
    curve = reduce_series(t_ns, angle_deg, zero_ns, columns)
    jumps = np.flatnonzero(np.abs(np.diff(angle_deg)) > 180.0) + 1
    at_s = (t_ns[jumps] - zero_ns) / 1e9
    broken = np.clip(((at_s - curve.start_s) / curve.step_s).astype(np.intp), 0, len(curve.middle) - 1)
    for kept in (curve.least, curve.greatest, curve.middle):
        kept[broken] = np.nan
    return curve


def coarsen_curve(curve: Curve, columns: int, middle: Middle = "mean") -> Curve:
    """Merge neighbouring stretches of a curve until at most ``columns`` remain."""
    group = -(-len(curve.middle) // columns)
    if group <= 1:
        return curve
    padding = -len(curve.middle) % group

    def make_groups(values: Floats) -> Floats:
        return np.pad(values, (0, padding), constant_values=np.nan).reshape(-1, group)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a stretch within a gap has no value
        least, greatest = np.nanmin(make_groups(curve.least), axis=1), np.nanmax(make_groups(curve.greatest), axis=1)
        parts = make_groups(curve.middle)
        central = np.sqrt(np.nanmean(parts**2, axis=1)) if middle == "rms" else np.nanmean(parts, axis=1)
    return Curve(curve.start_s, curve.step_s * group, least, greatest, central)


def encode_curve(curve: Curve, scale: Literal["log", "linear"] = "linear") -> dict[str, Any]:
    """Return the curve for the script of a page: 16-bit integers in base64, 0 for no value.

    With the scale "log" a value is kept to 0.02 %, with "linear" to 1/65534 of the curve's range.
    """
    values = np.concatenate([curve.least, curve.greatest, curve.middle])
    if scale == "log":
        values = np.log(np.maximum(values, LOWEST_DEG))
    known = np.isfinite(values)
    low, high = (float(values[known].min()), float(values[known].max())) if known.any() else (0.0, 0.0)
    whole = np.zeros(len(values), dtype="<u2")
    whole[known] = 1 + np.round((values[known] - low) / ((high - low) or 1.0) * (_LEVELS - 1))
    return {
        "start": round(curve.start_s, 6),
        "step": curve.step_s,
        "scale": scale,
        "low": low,
        "high": high,
        "data": base64.b64encode(whole.tobytes()).decode("ascii"),
    }


def _find_times_in_gaps(t_ns: Times, t_s: Floats, at_s: Floats) -> np.ndarray:
    """Return which of the times lie between two samples with a gap between them."""
    after = np.clip(np.searchsorted(t_s, at_s), 1, max(len(t_s) - 1, 1))
    return np.asarray((t_s[after % len(t_s)] - t_s[after - 1]) * 1e9 > find_longest_step_ns(t_ns))
