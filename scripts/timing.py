"""Seconds of things that are timed beside each other: the rows of ``stillpoint bench``."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Any


@dataclass(frozen=True)
class Timing:
    """One row: seconds of each run, and against which other row they count."""

    name: str
    seconds: Sequence[float]
    samples: int  # handled in one run
    against: "Timing | None" = None  # ratio = its median over ours: how many times faster we are
    extra: Mapping[str, Any] = field(default_factory=dict)  # further figures, which take the place of these

    @property
    def median_s(self) -> float:
        """The middle of all runs, in s."""
        return median(self.seconds)

    def row(self) -> dict[str, Any]:
        """The row as ``--json`` has it."""
        return {
            "name": self.name,
            "median_s": self.median_s,
            "min_s": min(self.seconds),
            "max_s": max(self.seconds),
            "runs": len(self.seconds),
            "per_sample_ns": self.median_s / self.samples * 1e9,
            "against": None if self.against is None else self.against.name,
            "ratio": None if self.against is None else self.against.median_s / self.median_s,
            **self.extra,
        }


def seconds_of(call: Callable[[], object]) -> float:
    """Wall-clock seconds of one call."""
    start = time.perf_counter()
    call()
    return time.perf_counter() - start
