"""Bridge short stretches of missing samples by the readings on either side, and state the error of that.

A reading holds for the interval that ends at its stamp. If samples are missing, this interval is long and one reading
does not represent it: it is replaced by the mean of the readings before and after. The error of this mean is measured
in the recording itself, over stretches of the same length in which nothing is missing.
"""

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.recording import Floats
from stillpoint.datasets.times import GAP_STEPS

LONG_GAP_S = 0.5  # a longer gap is not integrated across


def bridge_gaps(dt_s: Floats, values: Floats, moving: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Return readings (N, 3) with those after a short gap replaced, and their error there (N, 3): 0 elsewhere.

    ``dt_s`` (N,) are the intervals that end at the samples; ``moving`` (N,) marks motion, in which errors are measured.
    """
    wrong = np.zeros(values.shape)  # pages of zeros take no memory until they are written
    step_s = float(np.median(dt_s))
    gaps = np.flatnonzero((dt_s > GAP_STEPS * step_s) & (dt_s <= LONG_GAP_S))
    gaps = gaps[gaps > 0]
    if not len(gaps):
        return values, wrong
    filled = values.copy()
    filled[gaps] = (values[gaps - 1] + values[gaps]) / 2
    missed = np.round(dt_s[gaps] / step_s).astype(np.int64)
    for steps in np.unique(missed):
        wrong[gaps[missed == steps]] = _measure_deviation(values, moving, int(steps))
    return filled, wrong


def _measure_deviation(values: Floats, moving: NDArray[np.bool_], steps: int) -> Floats:
    """Return the RMS (3,) of the mean over ``steps`` intervals minus the mean of its ends, if possible in motion."""
    if len(values) <= steps + 1:
        return np.asarray(values.std(axis=0))
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(values, axis=0)])
    mean = (total[steps + 1 :] - total[1:-steps]) / steps
    ends = (values[:-steps] + values[steps:]) / 2
    whole = moving[:-steps] & moving[steps:]
    off = (mean - ends)[whole if whole.any() else slice(None)]
    return np.asarray(np.sqrt(np.mean(off**2, axis=0)))
