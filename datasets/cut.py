"""Parts of a recording: a span of time, or the stretches between the gaps of its sensors. Samples keep their bits."""

from collections.abc import Iterator
from dataclasses import fields, replace
from typing import Any

import numpy as np

from stillpoint.datasets.errors import BadRecording
from stillpoint.datasets.recording import TRUTHS, Recording, Times
from stillpoint.datasets.times import find_longest_step_ns

_SHORTEST_GAP_NS = 1_000_000_000  # a shorter pause is bridged by the gyro; cutting there would cost more than it helps


def find_start_ns(recording: Recording) -> int:
    """Return the first stamp of any stream but the truths; seconds on the command line count from it."""
    return min(int(t_ns[0]) for name, t_ns in recording.streams() if name not in TRUTHS)


def cut_recording(recording: Recording, first_ns: int, last_ns: int, name: str) -> Recording:
    """Return the samples of all streams with ``first_ns <= t_ns <= last_ns`` as a recording called ``name``.

    A stream without a sample there is left out, which a note says. Raises :class:`BadRecording` when no sample of
    gyro and accelerometer, or of a spinning body's sensors, is left.
    """
    start_ns = find_start_ns(recording)
    span = f"{(first_ns - start_ns) / 1e9:.3f} s to {(last_ns - start_ns) / 1e9:.3f} s"
    kept: dict[str, Any] = {}
    extra: dict[str, Any] = {}
    empty = []
    for stream, t_ns in recording.streams():
        first, last = np.searchsorted(t_ns, first_ns), np.searchsorted(t_ns, last_ns, side="right")
        is_extra = stream.startswith("extra ")
        whole = recording.extra[stream.removeprefix("extra ")] if is_extra else getattr(recording, stream)
        part = slice_stream(whole, int(first), int(last))
        if part is None:
            empty.append(stream)
        if is_extra:
            extra |= {} if part is None else {stream.removeprefix("extra "): part}
        else:
            kept[stream] = part
    main = "imu" if recording.imu is not None else "spin"
    if kept[main] is None:
        raise BadRecording(
            f"{recording.name}: no sample of {main} from {span}; give times within its {recording.duration_s:.3f} s"
        )
    notes = [f"cut from {recording.name}: {span}"]
    notes += [f"cut: no sample of {', '.join(empty)} is left"] if empty else []
    return replace(
        recording, name=name, info=replace(recording.info, notes=(*recording.info.notes, *notes)), extra=extra, **kept
    )


def slice_stream(stream: Any, first: int, last: int) -> Any:
    """Return rows of every array of a stream that has one row a stamp; None without a row."""
    if last <= first:
        return None
    count = len(stream.t_ns)
    columns = {field.name: getattr(stream, field.name) for field in fields(stream)}
    rows = {name: values[first:last] for name, values in columns.items() if _has_rows(values, count)}
    return replace(stream, **rows)


def _has_rows(values: Any, count: int) -> bool:
    """Return whether a value is an array with one row per sample."""
    return isinstance(values, np.ndarray) and values.ndim > 0 and len(values) == count


def find_stretches(recording: Recording) -> Iterator[tuple[int, int]]:
    """Yield the first and last stamp of each stretch of gyro and accelerometer without a gap.

    A gap is longer than five lost samples and than ``_SHORTEST_GAP_NS``.
    """
    stream = recording.imu if recording.imu is not None else recording.spin
    if stream is None:
        return
    t_ns: Times = stream.t_ns
    gaps = np.flatnonzero(np.diff(t_ns) > max(find_longest_step_ns(t_ns), _SHORTEST_GAP_NS))
    for first, last in zip(np.append(0, gaps + 1), np.append(gaps, len(t_ns) - 1), strict=True):
        yield int(t_ns[first]), int(t_ns[last])
