"""The rows of ``stillpoint bench``: seconds of what is timed, and of what it is compared with."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Any, Literal


@dataclass(frozen=True)
class Timing:
    """One row: seconds of each run, and the row that it is compared with."""

    name: str
    seconds: Sequence[float]
    samples: int | None  # handled in one run; None where a run is no work on samples
    against: "Timing | None" = None
    ratio_is: Literal["times as fast", "times as long"] = "times as fast"  # as the other: what a reader asks for
    extra: Mapping[str, Any] = field(default_factory=dict)  # further figures, which take the place of these
    note: str = ""  # the further figures in words, for the table

    @property
    def median_s(self) -> float:
        """The median of all runs, in s."""
        return median(self.seconds)

    @property
    def ratio(self) -> float | None:
        """The ratio of the medians, in the sense of ``ratio_is``."""
        if self.against is None:
            return None
        faster = self.against.median_s / self.median_s
        return faster if self.ratio_is == "times as fast" else 1 / faster

    def make_row(self) -> dict[str, Any]:
        """Return the row as ``--json`` writes it."""
        return {
            "name": self.name,
            "median_s": self.median_s,
            "min_s": min(self.seconds),
            "max_s": max(self.seconds),
            "runs": len(self.seconds),
            "per_sample_ns": None if self.samples is None else self.median_s / self.samples * 1e9,
            "against": None if self.against is None else self.against.name,
            "ratio": self.ratio,
            "ratio_is": None if self.against is None else self.ratio_is,
            "note": self.note,
            **self.extra,
        }


def time_call(call: Callable[[], object]) -> float:
    """Return the wall-clock seconds of one call."""
    start = time.perf_counter()
    call()
    return time.perf_counter() - start
