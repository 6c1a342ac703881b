"""Find the time shift at which a loss over windows is smallest, and how well the data fixes it."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from stillpoint.datasets.recording import Floats

REACH_S = 0.25  # lags up to this are looked for
COARSE_S = 0.025
BLOCKS = 10  # the recording is cut into so many parts, and each left out once, for the standard error
MIN_CONTRAST = 0.1  # share of the loss that the best lag takes away from the worst; below, nothing is said


@dataclass(frozen=True)
class Lag:
    """The stamps are late by ``lag_s``, with its standard error."""

    lag_s: float
    sd_s: float

    @property
    def clear(self) -> bool:
        """Well above its standard error."""
        return abs(self.lag_s) > 5 * self.sd_s


def find_lag(loss: Callable[[float], Floats | None]) -> Lag | None:
    """Minimise the sum of ``loss(lag_s)`` (n,), the same n windows for every lag; None when it hardly depends on it.

    A coarse search over +-0.25 s, then two finer ones, then a parabola; the standard error is a jackknife over
    ten parts of the recording.
    """
    grid = np.arange(-REACH_S, REACH_S + COARSE_S / 2, COARSE_S)
    step, table = COARSE_S, _table(loss, grid)
    if table is None:
        return None
    total = table.sum(axis=1)
    if total.max() <= 0 or (total.max() - total.min()) / total.max() < MIN_CONTRAST:
        return None
    for _ in range(2):
        centre = grid[int(total.argmin())]
        step /= 5
        grid = centre + step * np.arange(-4, 5)
        grid = grid[np.abs(grid) <= REACH_S]
        table = _table(loss, grid)
        if table is None:
            return None
        total = table.sum(axis=1)
    bounds = np.linspace(0, table.shape[1], BLOCKS + 1).astype(int)
    blocks = np.stack([table[:, a:b].sum(axis=1) for a, b in pairwise(bounds)], axis=1)
    best = _bottom(grid, total)
    without = np.array([_bottom(grid, total - block) for block in blocks.T])
    sd = float(np.sqrt((BLOCKS - 1) / BLOCKS * np.sum((without - without.mean()) ** 2)))
    return Lag(best, sd)


def _table(loss: Callable[[float], Floats | None], grid: Floats) -> Floats | None:
    rows = [loss(float(lag_s)) for lag_s in grid]
    return None if any(row is None for row in rows) else np.array(rows)


def _bottom(grid: Floats, total: Floats) -> float:
    """Vertex of a parabola through the points around the smallest."""
    around = slice(max(0, int(total.argmin()) - 3), int(total.argmin()) + 4)
    if len(grid[around]) < 4:
        return float(grid[int(total.argmin())])
    curvature, slope, _ = np.polyfit(grid[around] - grid[int(total.argmin())], total[around], 2)
    if curvature <= 0:
        return float(grid[int(total.argmin())])
    shift = np.clip(-slope / (2 * curvature), grid[0] - grid[-1], grid[-1] - grid[0])
    return float(grid[int(total.argmin())] + shift)
