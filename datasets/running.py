"""Statistics of columns that come piece by piece, in memory that does not grow with the column."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

MOST_VALUES = 1 << 20  # of a column: its median is then known to a thousandth of its spread


class ThinnedValues:
    """Keeps all values of a column up to a limit, and every 2^k-th of a longer one.

    Which values are kept depends on their places alone, not on where the pieces end.
    """

    def __init__(self, most: int = MOST_VALUES) -> None:
        self.count = 0  # of all values
        self.stride = 1  # one value of so many is kept
        self._most = most
        self._kept: list[NDArray[Any]] = []

    def add(self, values: NDArray[Any]) -> None:
        """Take the next values (N,) or rows (N, k)."""
        self._kept.append(values[-self.count % self.stride :: self.stride].copy())
        self.count += len(values)
        while sum(map(len, self._kept)) > self._most:
            self._kept = [self.values()[::2].copy()]
            self.stride *= 2

    def values(self) -> NDArray[Any]:
        """Return the values that are kept, in their order; raises ``ValueError`` when none was given."""
        if len(self._kept) > 1:
            self._kept = [np.concatenate(self._kept)]
        return self._kept[0] if self._kept else np.empty(0)
