"""Warn when nothing holds the heading of a stream, because its output looks like any other."""

import sys
from collections.abc import Sequence

from stillpoint.filters.front.heading_source import Heading
from stillpoint.scripts.shared.output import print_line
from stillpoint.scripts.streaming.lines import Arrival, SpinArrival

_PATIENCE_NS = 5_000_000_000  # of the samples' time; slow magnetometers and fixes come once a second


class HeadingWatch:
    """Waits for the first field, or for the first fix where the heading comes from fixes."""

    def __init__(self, names: Sequence[str], heading: Heading) -> None:
        """Begin to watch; ``names`` are the estimators that use the heading."""
        self._of = ", ".join(names)
        self._by_course = heading == "gps-course"
        self._is_done = False
        self._begun_ns: int | None = None

    def see(self, sample: Arrival | SpinArrival) -> None:
        """Take one sample; warn once when the waiting time is over."""
        if self._is_done or not isinstance(sample, Arrival):
            return
        if sample.mag_b_ut is not None or (self._by_course and sample.course is not None):
            self._is_done = True
        elif self._begun_ns is None:
            self._begun_ns = sample.t_ns
        elif sample.t_ns - self._begun_ns >= _PATIENCE_NS:
            self._warn(f" in the first {_PATIENCE_NS // 10**9} s; until one comes")

    def end(self) -> None:
        """Warn at the end of the samples, where it is still due."""
        if not self._is_done and self._begun_ns is not None:
            self._warn(", so")

    def _warn(self, since: str) -> None:
        """Warn once that the heading is arbitrary."""
        self._is_done = True
        missing = "magnetometer (mx, my, mz)" + " or course (course_rad, speed_mps)" * self._by_course
        print_line(
            f"stillpoint: no {missing}{since} the heading of {self._of} is arbitrary and drifts",
            file=sys.stderr,
            flush=True,
        )
