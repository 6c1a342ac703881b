"""Read samples from one pipe and write estimates to another, each line flushed before the next is read."""

import json
import math
import os
import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from time import perf_counter_ns
from types import FrameType
from typing import Any, BinaryIO, TextIO

from stillpoint.datasets.files.limits import LARGEST_LINE, raise_limit
from stillpoint.filters import SpinAnswer
from stillpoint.filters.sample import Output
from stillpoint.scripts.shared.output import print_line
from stillpoint.scripts.streaming.latency import Latency
from stillpoint.scripts.streaming.lines import ATTITUDE, Arrival, Layout, Lines, Malformed, SpinArrival
from stillpoint.scripts.streaming.streams import Live

_SHOWN = 20  # malformed lines said one by one; the others are counted
_PATIENCE_S = 1.0  # after a signal, for an output that is not read
_END = "end of input"


@dataclass
class Counts:
    """Counts of a run of the pipe."""

    n_lines: int = 0
    n_malformed: int = 0
    n_samples: int = 0
    update: Latency = field(default_factory=Latency)  # all estimators, without reading and writing
    whole: Latency = field(default_factory=Latency)  # from the line that was read to the lines that were written
    ended_by: str = _END
    failure: str = ""  # what went wrong with a pipe, where that ended it


def run_pipe(
    streams: Mapping[str, Live],
    source: BinaryIO,
    target: TextIO,
    layout: Layout = ATTITUDE,
    see: Callable[[Arrival | SpinArrival], None] | None = None,
) -> Counts:
    """Feed every sample to every stream and write the estimates, until the input ends or the output is closed.

    ``see`` gets each sample too. SIGINT and SIGTERM end it between two samples; an output that nobody reads is waited
    for ``_PATIENCE_S`` then, or until the second signal. Raises :class:`BadParameter` for a first line that names no
    samples.
    """
    passed, lines = Counts(), Lines(layout)
    with _end_at_signals(passed, target) as (read, write):
        for raw in iter(lambda: read(source), b""):
            begun_ns = perf_counter_ns()
            passed.n_lines += 1
            try:
                is_first = not lines.ignored
                sample = lines.read(raw)
            except Malformed as error:
                passed.n_malformed += 1
                if passed.n_malformed <= _SHOWN:
                    print_line(f"stillpoint: line {passed.n_lines}: {error}; left out", file=sys.stderr)
                continue
            if is_first and lines.ignored:
                print_line(f"stillpoint: not used: {', '.join(lines.ignored)}", file=sys.stderr)
            if sample is None:
                continue
            if see is not None:
                see(sample)
            if not write(_update_streams(streams, sample, passed)):
                break
            passed.whole.add(perf_counter_ns() - begun_ns)
    return passed


def _update_streams(streams: Mapping[str, Live], sample: Arrival | SpinArrival, passed: Counts) -> str:
    """Give a sample to all streams, and return their estimates as lines."""
    begun_ns = perf_counter_ns()
    parts: tuple[Any, ...] = sample
    outputs = [stream.update(*parts) for stream in streams.values()]
    passed.update.add(perf_counter_ns() - begun_ns)
    passed.n_samples += 1
    return "".join(_format_estimate(sample.t_ns, name, output) for name, output in zip(streams, outputs, strict=True))


def _format_estimate(t_ns: int, name: str, output: Output | SpinAnswer) -> str:
    """Return one estimate as NDJSON; a number that is not finite is null, and what is not estimated is left out."""
    facts: dict[str, Any] = {"t_ns": t_ns, "estimator": name}
    for field_name, value in output._asdict().items():
        if isinstance(value, tuple):
            facts[field_name] = [each if math.isfinite(each) else None for each in value]
        elif isinstance(value, float) and not math.isfinite(value):
            facts[field_name] = None
        elif value is not None:
            facts[field_name] = value
    return json.dumps(facts, separators=(",", ":")) + "\n"


class _Ended(Exception):
    """Raised when a signal comes while a pipe is waited for."""


@contextmanager
def _end_at_signals(
    passed: Counts, target: TextIO
) -> Iterator[tuple[Callable[[BinaryIO], bytes], Callable[[str], bool]]]:
    """Yield two functions: one reads a line, or ``b""`` after a signal, and one writes a line if it can."""
    waits_for = ""

    def end_at_signal(number: int, _: FrameType | None) -> None:
        """End the stream at the first signal; a later one also interrupts output that is not read."""
        is_over = passed.ended_by != _END
        if not is_over:
            passed.ended_by = signal.Signals(number).name
            signal.setitimer(signal.ITIMER_REAL, _PATIENCE_S, _PATIENCE_S)  # again and again: it may be no wait yet
        if waits_for == "input" or (waits_for == "output" and is_over):
            raise _Ended

    def read(source: BinaryIO) -> bytes:
        """Return the next line, empty at the end of the input, and note why it ended."""
        nonlocal waits_for
        if passed.ended_by != _END:
            return b""
        try:
            waits_for = "input"
            longest = raise_limit(LARGEST_LINE)
            line = source.readline(longest + 1)
            if len(line) <= longest:
                return line
            passed.ended_by = "failed input"
            passed.failure = (
                f"standard input: a line is longer than {longest} bytes; give one sample a line, or --large"
            )
            return b""
        except OSError as error:
            passed.ended_by, passed.failure = "failed input", f"standard input: cannot be read ({error.strerror})"
            return b""
        finally:
            waits_for = ""

    def write(text: str) -> bool:
        """Write text at once; return False, and note why, where the output is closed or cannot be written."""
        nonlocal waits_for
        try:
            waits_for = "output"
            target.write(text)
            target.flush()
            return True
        except BrokenPipeError:
            passed.ended_by = "closed output"
        except OSError as error:
            passed.ended_by, passed.failure = "failed output", f"standard output: cannot be written ({error.strerror})"
        except _Ended:
            passed.ended_by += ", the output was not read"
        finally:
            waits_for = ""
        os.dup2(os.open(os.devnull, os.O_WRONLY), target.fileno())  # nothing is left to be flushed at exit
        return False

    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)
    before = {number: signal.signal(number, end_at_signal) for number in numbers}
    try:
        with suppress(_Ended):
            yield read, write
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in before.items():
            signal.signal(number, handler)
