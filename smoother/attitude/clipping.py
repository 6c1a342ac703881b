"""Readings at the end of a sensor's range: where they are, and what went on beyond.

A sensor that reads its largest value again and again did not turn evenly: it could not say more. What it would have
said is drawn by the curve of third degree that leaves the range as steeply as the readings before it rise, and comes
back as steeply as those after it fall. In swings that a gyro cuts off that halves the error; in running, an
accelerometer of 2 g misses peaks of 3 to 4 g. How far it may be wrong goes with how far it goes.
"""

from itertools import pairwise

import numpy as np

from stillpoint.datasets.recording import Floats

CLIP_COUNT = 5  # so many readings equal to the largest are clipping, fewer are chance
SLOPE_S = 0.01  # over which the rise before and the fall after are taken, or over one step where that is longer
FAR_S = 0.1  # a reading farther than that from the edge says nothing of it
FARTHEST = 2.0  # times the range that a peak may lie above it
UNSEEN_SHARE = 0.2  # of the range: by so much the peak may be higher even where the curve says little


def range_where_clipped(values: Floats, smallest_range: float) -> Floats:
    """The end of its range (N, 3) where an axis has met it, with its sign; 0 elsewhere.

    Both ends are looked at on their own: where a maker takes off an offset, they are not the same.
    """
    limits = np.zeros_like(values)
    for sign in (1.0, -1.0):
        outward = sign * values
        largest = outward.max(axis=0)
        at_end = outward >= largest - 1e-9 * np.abs(largest)
        stuck = (at_end.sum(axis=0) >= CLIP_COUNT) & (largest >= smallest_range)
        limits[at_end & stuck] = values[at_end & stuck]
    return limits


def extended(t_s: Floats, values: Floats, smallest_range: float) -> tuple[Floats, Floats]:
    """Readings (N, 3) with what lies beyond the range, and by how much they may be wrong there: 0 where not clipped."""
    limits = range_where_clipped(values, smallest_range)
    if not limits.any():
        return values, limits
    excess = _beyond(t_s, values, limits)
    return values + excess, np.abs(excess) + UNSEEN_SHARE * np.abs(limits)


def _beyond(t_s: Floats, values: Floats, limits: Floats) -> Floats:
    """By how much (N, 3) clipped readings fall short, with their sign; ``limits`` of :func:`range_where_clipped`."""
    excess = np.zeros_like(values)
    for axis in np.flatnonzero((limits != 0).any(axis=0)):
        end = limits[:, axis]
        edges = np.flatnonzero(np.diff(end, prepend=0.0, append=0.0))
        for first, stop in pairwise(edges):
            if end[first] != 0:
                sign = np.sign(end[first])
                excess[first:stop, axis] = sign * _arch(t_s, sign * values[:, axis], int(first), int(stop))
    return excess


def _arch(t_s: Floats, outward: Floats, first: int, stop: int) -> Floats:
    """Height above the end of the range of the samples ``first`` to ``stop - 1``; at most FARTHEST times the range."""
    limit = outward[first]
    rise, start_s = _edge(t_s, outward, first, -1)
    fall, end_s = _edge(t_s, outward, stop - 1, 1)
    rise, fall = rise or fall, fall or rise
    span_s = max(end_s - start_s, 1e-9)
    share = (t_s[first:stop] - start_s) / span_s
    return np.clip(span_s * share * (1 - share) * (rise * (1 - share) + fall * share), 0.0, FARTHEST * limit)


def _edge(t_s: Floats, outward: Floats, clipped: int, away: int) -> tuple[float, float]:
    """Slope towards the clipped sample at an edge of its run, 0 where none is known, and when the range was left."""
    limit, near = outward[clipped], clipped + away
    far = near
    while 0 <= far + away < len(t_s) and outward[far + away] < limit:
        far += away
        if abs(t_s[far] - t_s[near]) >= SLOPE_S:
            break
    if far == near or abs(t_s[far] - t_s[clipped]) > FAR_S:
        return 0.0, float(t_s[clipped])
    slope = float((outward[near] - outward[far]) / abs(t_s[near] - t_s[far]))
    if slope <= 0:
        return 0.0, float(t_s[clipped])
    reached_s = min((limit - outward[near]) / slope, abs(t_s[clipped] - t_s[near]))
    return slope, float(t_s[near] - away * reached_s)
