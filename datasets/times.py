"""Find gaps in a clock, and the stamps that lie in given spans."""

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.recording import Times

GAP_STEPS = 5.0  # an interval longer than this many median steps is a gap: 5 lost samples


def find_longest_step_ns(t_ns: Times) -> float:
    """Return the longest interval that is not a gap; 0 for a single stamp."""
    return GAP_STEPS * float(np.median(np.diff(t_ns))) if len(t_ns) > 1 else 0.0


def find_gaps(t_ns: Times) -> NDArray[np.bool_]:
    """Return which of the N - 1 intervals between stamps are gaps."""
    return np.asarray(np.diff(t_ns) > find_longest_step_ns(t_ns))


def is_inside(t_ns: Times, spans_ns: Times) -> NDArray[np.bool_]:
    """Return which stamps (N,) lie in one of the spans (R, 2), ends included."""
    mask = np.zeros(len(t_ns), dtype=np.bool_)
    for first, last in spans_ns:
        mask[np.searchsorted(t_ns, first) : np.searchsorted(t_ns, last, side="right")] = True
    return mask
