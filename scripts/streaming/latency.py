"""Statistics of the time per sample, in memory that does not grow."""

from dataclasses import dataclass, field

import numpy as np

_PER_OCTAVE = 32  # bins: a quantile is good to 2 %
_OCTAVES = 40  # up to 2^40 ns, 18 minutes


@dataclass
class Latency:
    """A histogram of durations, with bins that grow with what they hold."""

    n: int = 0
    max_ns: int = 0
    bins: np.ndarray = field(default_factory=lambda: np.zeros(_PER_OCTAVE * _OCTAVES, dtype=np.int64))

    def add(self, ns: int) -> None:
        """Count one sample."""
        self.n += 1
        self.max_ns = max(self.max_ns, ns)
        self.bins[min(int(np.log2(max(ns, 1)) * _PER_OCTAVE), len(self.bins) - 1)] += 1

    def find_quantile_us(self, share: float) -> float:
        """Return the duration that this share of the samples did not exceed, in µs; NaN without samples."""
        if self.n == 0:
            return float("nan")
        row = int(np.searchsorted(np.cumsum(self.bins), share * self.n))
        return float(min(2.0 ** ((row + 0.5) / _PER_OCTAVE), self.max_ns)) / 1e3

    def facts(self) -> dict[str, float]:
        """Return median, 99th percentile and maximum in µs."""
        return {
            "median_us": self.find_quantile_us(0.5),
            "p99_us": self.find_quantile_us(0.99),
            "max_us": self.max_ns / 1e3,
        }
