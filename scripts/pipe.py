"""Samples from one pipe, estimates into another: line by line, each one flushed before the next is read."""

import json
import math
import os
import signal
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import perf_counter_ns
from types import FrameType
from typing import Any, BinaryIO, TextIO

from stillpoint.filters import RollAnswer
from stillpoint.filters.sample import Output
from stillpoint.scripts.latency import Latency
from stillpoint.scripts.live import Live
from stillpoint.scripts.sample_lines import ATTITUDE, Arrival, Layout, Lines, Malformed, SpinArrival

SHOWN = 20  # malformed lines said one by one; the others are counted


@dataclass
class Passed:
    """What went through."""

    n_lines: int = 0
    n_malformed: int = 0
    n_samples: int = 0
    update: Latency = field(default_factory=Latency)  # all estimators, without reading and writing
    whole: Latency = field(default_factory=Latency)  # from the line that was read to the lines that were written
    ended_by: str = "end of input"


def pipe(streams: Mapping[str, Live], source: BinaryIO, target: TextIO, layout: Layout = ATTITUDE) -> Passed:
    """Feed every sample to every stream and write what they say, until the input ends, or the output is closed.

    SIGINT and SIGTERM end it between two samples. Raises :class:`BadParameter` for a first line that names no samples.
    """
    passed, lines = Passed(), Lines(layout)
    with _signals_end(passed) as read:
        for raw in iter(lambda: read(source), b""):
            begun_ns = perf_counter_ns()
            passed.n_lines += 1
            try:
                is_first = not lines.ignored
                sample = lines.read(raw)
            except Malformed as error:
                passed.n_malformed += 1
                if passed.n_malformed <= SHOWN:
                    print(f"stillpoint: line {passed.n_lines}: {error}; left out", file=sys.stderr)
                continue
            if is_first and lines.ignored:
                print(f"stillpoint: not used: {', '.join(lines.ignored)}", file=sys.stderr)
            if sample is None:
                continue
            said = _update(streams, sample, passed)
            try:
                target.write(said)
                target.flush()
            except BrokenPipeError:
                passed.ended_by = "closed output"
                os.dup2(os.open(os.devnull, os.O_WRONLY), target.fileno())  # nothing is left to be flushed at exit
                break
            passed.whole.add(perf_counter_ns() - begun_ns)
    return passed


def _update(streams: Mapping[str, Live], sample: Arrival | SpinArrival, passed: Passed) -> str:
    begun_ns = perf_counter_ns()
    parts: tuple[Any, ...] = sample
    outputs = [stream.update(*parts) for stream in streams.values()]
    passed.update.add(perf_counter_ns() - begun_ns)
    passed.n_samples += 1
    return "".join(line(sample.t_ns, name, output) for name, output in zip(streams, outputs, strict=True))


def line(t_ns: int, name: str, output: Output | RollAnswer) -> str:
    """One estimate as NDJSON; a number that is not finite is null, what is not estimated is not there."""
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
    """A signal came while the next line was waited for."""


@contextmanager
def _signals_end(passed: Passed) -> Iterator[Any]:
    """A function that reads a line, and nothing more (``b""``) once there was a signal."""
    waiting = False

    def on_signal(number: int, _: FrameType | None) -> None:
        passed.ended_by = signal.Signals(number).name
        if waiting:
            raise _Ended

    def read(source: BinaryIO) -> bytes:
        nonlocal waiting
        if passed.ended_by != "end of input":
            return b""
        try:
            waiting = True
            return source.readline()
        except _Ended:
            return b""
        finally:
            waiting = False

    before = {number: signal.signal(number, on_signal) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield read
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
