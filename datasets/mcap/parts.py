"""A long recording in parts of equal length, and back: the joined recording equals the whole one bit for bit."""

from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from stillpoint.datasets.cut import find_start_ns, slice_stream
from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.mcap.store import read_recording
from stillpoint.datasets.recording import TRUTHS, Recording

_STREAMS = ("imu", "mag", "gps", "spin", "encoder", *TRUTHS)
_WHOLE, _PART = "split_from", "split_part"  # of ``Info.extra``: the name of the whole recording; "3 of 24"


def split_recording(recording: Recording, span_s: float) -> list[Recording]:
    """Split a recording into parts of this length, NAME-001, NAME-002 and so on; a short one stays as it is.

    Parts begin at multiples of ``span_s`` after the first sample. One without a sample of gyro and accelerometer (of a
    spinning body's sensors) is joined to the part before. Raises :class:`BadParameter` for a span that is not above 0.
    """
    if not span_s > 0:
        raise BadParameter(f"--split: {span_s:g} s; give a length above 0")
    main = recording.imu or recording.spin
    assert main is not None  # a recording has one of them
    start_ns, step_ns = find_start_ns(recording), round(span_s * 1e9)
    numbers = np.unique((main.t_ns - start_ns) // step_ns)
    edges_ns = [start_ns + int(number) * step_ns for number in numbers[1:]]
    if not edges_ns:
        return [recording]
    parts = []
    for k in range(len(edges_ns) + 1):
        start, end = edges_ns[k - 1] if k else None, edges_ns[k] if k < len(edges_ns) else None
        named = {name: getattr(recording, name) for name in _STREAMS}
        streams = {name: _cut(stream, start, end) for name, stream in named.items() if stream is not None}
        others = {name: _cut(series, start, end) for name, series in recording.extra.items()}
        others = {name: series for name, series in others.items() if series is not None}
        extra = {**recording.info.extra, _WHOLE: recording.name, _PART: f"{k + 1} of {len(edges_ns) + 1}"}
        name = f"{recording.name}-{k + 1:03d}"
        parts.append(replace(recording, name=name, info=replace(recording.info, extra=extra), extra=others, **streams))
    return parts


def _cut(stream: Any, start_ns: int | None, end_ns: int | None) -> Any:
    """Return the samples of a stream from ``start_ns`` to before ``end_ns``; None without one."""
    first = 0 if start_ns is None else int(np.searchsorted(stream.t_ns, start_ns))
    last = len(stream.t_ns) if end_ns is None else int(np.searchsorted(stream.t_ns, end_ns))
    return slice_stream(stream, first, last)


def join_recordings(parts: Sequence[Recording]) -> Recording:
    """Join the parts of a recording that :func:`split_recording` made, in any order.

    Raises :class:`BadParameter` when one is missing, or belongs to another recording.
    """
    wholes = {part.info.extra.get(_WHOLE) for part in parts}
    whole = wholes.pop()
    if wholes or whole is None:
        raise BadParameter(
            f"{', '.join(part.name for part in parts[:3])}: are not parts of one recording; name those of one"
        )
    numbered = {part.info.extra[_PART]: part for part in parts}
    count = int(parts[0].info.extra[_PART].rpartition(" ")[2])
    missing = [k for k in range(1, count + 1) if f"{k} of {count}" not in numbered]
    if missing or len(numbered) != len(parts):
        which = f"part {missing[0]} of {count} is missing" if missing else "a part is given twice"
        raise BadParameter(f"{whole}: {which}; give every part once")
    ordered = [numbered[f"{k} of {count}"] for k in range(1, count + 1)]
    streams: dict[str, Any] = {}
    for name in _STREAMS:
        pieces = [one for part in ordered if (one := getattr(part, name)) is not None]
        streams[name] = join_streams(pieces) if pieces else None
    names = dict.fromkeys(name for part in ordered for name in part.extra)
    others = {name: join_streams([part.extra[name] for part in ordered if name in part.extra]) for name in names}
    info = ordered[0].info
    extra = {key: value for key, value in info.extra.items() if key not in (_WHOLE, _PART)}
    return replace(ordered[0], name=whole, info=replace(info, extra=extra), extra=others, **streams)


def read_parts(paths: Sequence[Path]) -> Recording:
    """Read the parts of a recording from their files, as one; raises :class:`BadParameter` and :class:`BadFile`."""
    return join_recordings([read_recording(path) for path in paths])


def join_streams(pieces: Sequence[Any]) -> Any:
    """Return the samples of the same stream in several parts, as one stream."""
    columns: dict[str, Any] = {}
    for each in fields(pieces[0]):
        values = [getattr(piece, each.name) for piece in pieces]
        if isinstance(values[0], np.ndarray):
            columns[each.name] = np.concatenate(values)
    return replace(pieces[0], **columns)
