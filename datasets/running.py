"""Statistics of columns that come piece by piece, in memory that does not grow with the column."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

_MOST_VALUES = 1 << 20  # of a column: its median is then known to a thousandth of its spread


class ThinnedValues:
    """Keeps all values of a column up to a limit, and every 2^k-th of a longer one.

    Which values are kept depends on their places alone, not on where the pieces end.
    """

    def __init__(self, most: int = _MOST_VALUES) -> None:
        self.count = 0  # of all values
        self.stride = 1  # one value of so many is kept
        self._most = most
        self._kept: list[NDArray[Any]] = []

    def add(self, values: NDArray[Any], measure: Callable[[NDArray[Any]], NDArray[Any]] | None = None) -> None:
        """Take the next values (N,) or rows (N, k); ``measure`` makes the values of the rows that are kept."""
        kept = values[-self.count % self.stride :: self.stride].copy()
        self._kept.append(kept if measure is None else measure(kept))
        self.count += len(values)
        while sum(map(len, self._kept)) > self._most:
            self._kept = [self.values()[::2].copy()]
            self.stride *= 2

    def values(self) -> NDArray[Any]:
        """Return the values that are kept, in their order; raises ``ValueError`` when none was given."""
        if len(self._kept) > 1:
            self._kept = [np.concatenate(self._kept)]
        return self._kept[0] if self._kept else np.empty(0)


@dataclass(frozen=True)
class ClockFacts:
    """Hold the facts about the clock of a stream."""

    samples: int
    first_ns: int
    last_ns: int
    step_ns: float  # median; 0 for a single sample
    gaps: int  # intervals longer than GAP_STEPS median steps
    longest_gap_ns: int  # 0 without a gap


class RunningClock:
    """Gathers the facts of a clock whose stamps come piece by piece.

    A median of the whole that is less than half of what it was for a time makes gaps of steps that were not kept; then
    ``has_all_gaps`` is False, and a second pass with ``step_ns`` = ``median_step_ns`` finds them all.
    """

    def __init__(self, gap_steps: float, step_ns: float | None = None) -> None:
        self._gap_steps, self._given_ns = gap_steps, step_ns
        self._steps = ThinnedValues()
        self._long: list[NDArray[np.int64]] = []
        self._least_ns = 0.0  # steps up to here may not be among the long ones
        self._samples, self._first_ns, self._last_ns = 0, 0, 0

    def add(self, t_ns: NDArray[np.int64]) -> None:
        """Take the next stamps."""
        if self._samples == 0:
            self._first_ns = self._last_ns = int(t_ns[0])
        steps = np.diff(t_ns, prepend=self._last_ns)[0 if self._samples else 1 :]
        self._samples, self._last_ns = self._samples + len(t_ns), int(t_ns[-1])
        if len(steps):
            self._steps.add(steps)
            least_ns = self._gap_steps * self.median_step_ns * (0.5 if self._given_ns is None else 1.0)
            self._least_ns = max(self._least_ns, least_ns)
            self._long.append(steps[steps > least_ns])

    @property
    def median_step_ns(self) -> float:
        """The median step so far, or the one that was given; 0 for a single sample."""
        if self._given_ns is not None:
            return self._given_ns
        return float(np.median(self._steps.values())) if self._steps.count else 0.0

    @property
    def has_all_gaps(self) -> bool:
        """Whether every step that is a gap was kept."""
        return self._gap_steps * self.median_step_ns >= self._least_ns

    def facts(self) -> ClockFacts:
        """Return the facts of all stamps."""
        found = np.concatenate(self._long) if self._long else np.empty(0, np.int64)
        found = found[found > self._gap_steps * self.median_step_ns]
        longest_ns = int(found.max()) if len(found) else 0
        return ClockFacts(self._samples, self._first_ns, self._last_ns, self.median_step_ns, len(found), longest_ns)
