"""Find readings at the end of a sensor's range, and estimate the motion beyond it.

A sensor that repeats its largest value was clipped. The clipped readings are replaced by the cubic that leaves the
range with the slope of the readings before, and returns with the slope of those after. In swings that a gyro clips this
halves the error; in running, an accelerometer of 2 g misses peaks of 3 to 4 g. The error of a replaced reading is taken
to be proportional to how far it lies beyond the range.
"""

from itertools import pairwise

import numpy as np

from stillpoint.datasets.recording import Floats

_CLIP_COUNT = 5  # readings equal to the largest: this many are clipping, fewer are chance
_SLOPE_S = 0.01  # over which the slopes before and after are taken, or over one step where that is longer
_FAR_S = 0.1  # a reading farther from the edge than this does not show the slope there
FARTHEST = 2.0  # largest height of a peak above the range, in ranges
UNSEEN_SHARE = 0.2  # of the range: error of a replaced reading, even where the cubic is low


def find_range_ends(values: Floats, smallest_range: float) -> Floats:
    """Return the end of the range (N, 3), with its sign, where an axis has reached it; 0 elsewhere.

    Both ends are found separately: they differ where the maker subtracts an offset.
    """
    limits = np.zeros(values.shape)  # pages of zeros take no memory until they are written
    for axis in range(values.shape[1]):
        column = np.ascontiguousarray(values[:, axis])
        for sign, largest in ((1.0, column.max()), (-1.0, -column.min())):
            if largest >= smallest_range:
                at_end = sign * column >= largest * (1 - 1e-9)
                if at_end.sum() >= _CLIP_COUNT:
                    limits[at_end, axis] = column[at_end]
    return limits


def extend_clipped(t_s: Floats, values: Floats, smallest_range: float) -> tuple[Floats, Floats]:
    """Return readings (N, 3) with clipped ones replaced, and by how much these may be wrong: 0 where not clipped."""
    limits = find_range_ends(values, smallest_range)
    if not limits.any():
        return values, limits
    excess = _estimate_excess(t_s, values, limits)
    return values + excess, np.abs(excess) + UNSEEN_SHARE * np.abs(limits)


def _estimate_excess(t_s: Floats, values: Floats, limits: Floats) -> Floats:
    """Return by how much (N, 3) clipped readings fall short, with sign; ``limits`` from :func:`find_range_ends`."""
    excess = np.zeros_like(values)
    for axis in np.flatnonzero((limits != 0).any(axis=0)):
        end = limits[:, axis]
        edges = np.flatnonzero(np.diff(end, prepend=0.0, append=0.0))
        for first, stop in pairwise(edges):
            if end[first] != 0:
                sign = np.sign(end[first])
                excess[first:stop, axis] = sign * _draw_arch(t_s, sign * values[:, axis], int(first), int(stop))
    return excess


def _draw_arch(t_s: Floats, outward: Floats, first: int, stop: int) -> Floats:
    """Return the height above the range of the samples ``first`` to ``stop - 1``, at most FARTHEST times the range."""
    limit = outward[first]
    rise, start_s = _find_edge(t_s, outward, first, -1)
    fall, end_s = _find_edge(t_s, outward, stop - 1, 1)
    rise, fall = rise or fall, fall or rise
    span_s = max(end_s - start_s, 1e-9)
    share = (t_s[first:stop] - start_s) / span_s
    return np.clip(span_s * share * (1 - share) * (rise * (1 - share) + fall * share), 0.0, FARTHEST * limit)


def _find_edge(t_s: Floats, outward: Floats, clipped: int, away: int) -> tuple[float, float]:
    """Return the slope at an edge of a clipped run, 0 if unknown, and the time at which the range was left."""
    limit, near = outward[clipped], clipped + away
    far = near
    while 0 <= far + away < len(t_s) and outward[far + away] < limit:
        far += away
        if abs(t_s[far] - t_s[near]) >= _SLOPE_S:
            break
    if far == near or abs(t_s[far] - t_s[clipped]) > _FAR_S:
        return 0.0, float(t_s[clipped])
    slope = float((outward[near] - outward[far]) / abs(t_s[near] - t_s[far]))
    if slope <= 0:
        return 0.0, float(t_s[clipped])
    reached_s = min((limit - outward[near]) / slope, abs(t_s[clipped] - t_s[near]))
    return slope, float(t_s[near] - away * reached_s)
