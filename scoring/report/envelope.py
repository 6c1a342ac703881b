"""Fewer points for the same picture: a long series drawn with a few points per pixel column keeps every peak."""

import numpy as np

from stillpoint.datasets.recording import Floats


def envelope(t: Floats, value: Floats, columns: int) -> tuple[Floats, Floats]:
    """First, least, greatest and last sample of each of ``columns`` equal stretches of time, in the order of time.

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
    """The series with a NaN wherever two neighbours are too far apart in time (a gap) or in value (a wrapped angle)."""
    at = np.flatnonzero((np.diff(t) > longest_step) | (np.abs(np.diff(value)) > largest_jump)) + 1
    return np.insert(t, at, (t[at - 1] + t[at]) / 2), np.insert(value, at, np.nan)
