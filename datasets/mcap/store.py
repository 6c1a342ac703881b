"""Recordings, references and estimates as MCAP files, and back, bit for bit.

Columns go to the topics of :mod:`stillpoint.datasets.mcap.topics`; everything else (names, provenance, parameters,
rests, calibration) goes as JSON into the metadata record ``stillpoint``. The same input gives the same bytes.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.cut import slice_stream
from stillpoint.datasets.errors import BadFile, BadRecording
from stillpoint.datasets.files.remote import hash_file
from stillpoint.datasets.mcap.facts import (
    KINDS,
    Kept,
    collect_facts,
    collect_recording_facts,
    from_json,
    get_kind,
    parse_info,
    parse_reference_facts,
    spin_geometry_from,
    to_json,
)
from stillpoint.datasets.mcap.reader import Log, read_log, survey
from stillpoint.datasets.mcap.topics import (
    EXTRA,
    MAG_FIELD,
    MAG_REMAINDER,
    TOPICS,
    Topic,
    make_extra_topic,
    to_microtesla,
    to_tesla,
)
from stillpoint.datasets.mcap.writer import ZSTD_LEVEL, MessageWriter, Stream, open_mcap
from stillpoint.datasets.recording import Encoder, Gps, Head, Imu, Info, Mag, Piece, Recording, Series, Spin, Truth
from stillpoint.datasets.trajectory import CONVENTION, Estimate, Reference, SpinReference

Made = TypeVar("Made")
OneKind = TypeVar("OneKind", Recording, Reference, SpinReference, Estimate)
RECORD = "stillpoint"  # name of the metadata record
_ORIGIN = "stillpoint-made"  # of the record that says what made a file
_FORMAT = "1"
_TRAJECTORY_LEVEL = -1  # of zstd, for estimates and references; docs/mcap.md has sizes and speeds
_ROWS_AT_ONCE = 1 << 17  # of a stream that are laid out as messages together
OWN_COLUMNS = {
    topic.name: {column.field: column.leaves for column in topic.columns if not column.derived} for topic in TOPICS
}
_OWN = {topic.name for topic in TOPICS if not topic.drawn}
_STREAMS: dict[str, type[Any]] = {
    "imu": Imu, "mag": Mag, "gps": Gps, "spin": Spin, "encoder": Encoder, "truth": Truth, "roll_truth": Encoder,
}  # fmt: skip


def write(
    path: Path | str,
    thing: Kept,
    attachments: Mapping[str, bytes] | None = None,
    origin: Mapping[str, str] | None = None,
) -> None:
    """Write a recording, reference or estimate to an MCAP file, whole or not at all; an old file is replaced.

    ``attachments`` are kept beside it, byte for byte, under their names. ``origin`` says what made the file, in a
    record of its own, which :func:`read_origin` returns. Raises :class:`BadFile` when the file cannot
    be written, :class:`BadRecording` when a parameter or diagnostic is no number, string, list or mapping.
    """
    kind = get_kind(thing)
    streams, absent = _make_templates(kind, thing)
    samples = _count_samples(kind, thing, [stream.topic for stream in streams])
    streams = [stream for stream in streams if samples.get(stream.topic)]
    level = ZSTD_LEVEL if kind == "recording" else _TRAJECTORY_LEVEL
    with open_mcap(Path(path), f"stillpoint {version('stillpoint')}", level) as out:
        out.declare(streams)
        record = _record(kind, collect_facts(thing), samples, absent)
        out.describe({RECORD: record, **({_ORIGIN: dict(origin)} if origin else {})}, attachments or {})
        for piece, until_ns in _cut_pieces(thing):
            out.add(_make_streams(kind, piece)[0], until_ns)


def write_pieces(path: Path | str, head: Head, pieces: Callable[[], Iterator[Piece]]) -> None:
    """Write a recording that comes in pieces, twice: the bytes are those of :func:`write` of the whole.

    A piece holds all samples of all streams in a range of time. Raises :class:`BadFile` when the file cannot be
    written.
    """
    first: dict[str, Any] = {}
    extra: dict[str, Series] = {}
    counts: Counter[str] = Counter()
    for piece in pieces():
        rows = _take_first_rows(piece)
        assert isinstance(rows, Piece)
        first = {name: getattr(rows, name) for name in _STREAMS if getattr(rows, name) is not None} | first
        extra = {**rows.extra, **extra}
        counts.update(
            _count_samples("recording", piece, [stream.topic for stream in _make_templates("recording", rows)[0]])
        )
    templates, absent = _make_templates("recording", Piece(**first, extra=extra))
    streams = [stream for stream in templates if counts[stream.topic]]
    samples = {stream.topic: counts[stream.topic] for stream in streams}
    with open_mcap(Path(path), f"stillpoint {version('stillpoint')}") as out:
        out.declare(streams)
        out.describe(
            {RECORD: _record("recording", collect_recording_facts(head, first.get("spin"), extra), samples, absent)}, {}
        )
        for piece in pieces():
            last_ns = max(int(t_ns[-1]) for _, t_ns in piece.streams())
            out.add(_make_streams("recording", piece)[0], last_ns + 1)


def write_trajectory_pieces(
    path: Path | str,
    pieces: Iterator[Reference | Estimate],
    samples: int,
    origin: Mapping[str, str] | None = None,
) -> None:
    """Write a reference or an estimate of so many samples that comes in pieces, each with all facts.

    The bytes are those of :func:`write`, whose ``origin`` and errors this function has.
    """
    first = next(pieces)
    kind = get_kind(first)
    streams, absent = _make_templates(kind, first)
    counts = {stream.topic: samples for stream in streams}
    with open_mcap(Path(path), f"stillpoint {version('stillpoint')}", _TRAJECTORY_LEVEL) as out:
        out.declare(streams)
        record = _record(kind, collect_facts(first), counts, absent)
        out.describe({RECORD: record, **({_ORIGIN: dict(origin)} if origin else {})}, {})
        for piece in chain([first], pieces):
            for part, _ in _cut_pieces(piece):
                assert isinstance(part, Reference | Estimate)
                out.add(_make_streams(kind, part)[0], int(part.t_ns[-1]) + 1)


def _make_templates(kind: str, thing: Kept | Piece) -> tuple[list[Stream], list[str]]:
    """Return one message of each topic, in the order of the file, and which fields are None.

    The exact remainder of the magnetometer has its topic, whether a row needs it or not.
    """
    streams, absent = _make_streams(kind, _take_first_rows(thing))
    mag = thing.mag if isinstance(thing, Recording | Piece) else None
    if mag is not None:
        topic = next(topic for topic in TOPICS if topic.name == MAG_REMAINDER)
        remainder = _make_stream(topic, mag.t_ns[:1], {"remainder_b_ut": mag.mag_b_ut[:1]})
        streams = [stream for stream in streams if stream.topic != MAG_REMAINDER]
        streams.insert([stream.topic for stream in streams].index(MAG_FIELD), remainder)
    return streams, absent


def _take_first_rows(thing: Kept | Piece) -> Kept | Piece:
    """Return the first sample of every stream."""
    if not isinstance(thing, Recording | Piece):
        return thing if len(thing.t_ns) <= _ROWS_AT_ONCE else slice_stream(thing, 0, 1)
    streams = {name: slice_stream(getattr(thing, name), 0, 1) for name in _STREAMS if getattr(thing, name) is not None}
    return Piece(**streams, extra={name: slice_stream(series, 0, 1) for name, series in thing.extra.items()})


def _count_samples(kind: str, thing: Kept | Piece, topics: Sequence[str]) -> dict[str, int]:
    """Return the number of messages of each of some topics that has any."""
    held = dict(thing.streams()) if isinstance(thing, Recording | Piece) else {}
    names = {topic.name: topic.stream for topic in TOPICS if topic.kind == kind}
    samples: dict[str, int] = {}
    for name in topics:
        if name == MAG_REMAINDER:
            assert isinstance(thing, Recording | Piece)
            assert thing.mag is not None
            count = sum(
                int((to_tesla(thing.mag.mag_b_ut[first : first + _ROWS_AT_ONCE])[1] != 0).any(axis=1).sum())
                for first in range(0, len(thing.mag.t_ns), _ROWS_AT_ONCE)
            )
        elif isinstance(thing, Recording | Piece):
            count = len(held[names.get(name) or f"extra {name.removeprefix(EXTRA)}"])
        else:
            count = len(thing.t_ns)
        if count:
            samples[name] = count
    return samples


def _cut_pieces(thing: Kept) -> Iterator[tuple[Kept | Piece, int | None]]:
    """Yield pieces of bounded size, each with the time before which no later piece has a sample (None: the last).

    A file is laid out from one piece at a time: a covariance takes four times the memory in its message.
    """
    if isinstance(thing, Recording):
        longest = max((t_ns for _, t_ns in thing.streams()), key=len)
        edges = [*longest[_ROWS_AT_ONCE::_ROWS_AT_ONCE].tolist(), None]
    else:
        edges = [*thing.t_ns[_ROWS_AT_ONCE::_ROWS_AT_ONCE].tolist(), None]
    start_ns = 0
    for end_ns in edges:
        yield (thing if len(edges) == 1 else _cut_time(thing, start_ns, end_ns)), end_ns
        start_ns = end_ns or 0


def _cut_time(thing: Kept, start_ns: int, end_ns: int | None) -> Kept | Piece:
    """Return the samples of all streams from one time to before another."""

    def cut(stream: Any) -> Any:
        """Return the samples of a stream between the two times."""
        last = len(stream.t_ns) if end_ns is None else int(np.searchsorted(stream.t_ns, end_ns))
        return slice_stream(stream, int(np.searchsorted(stream.t_ns, start_ns)), last)

    if not isinstance(thing, Recording):
        part: Kept = cut(thing)
        return part
    streams = {name: cut(getattr(thing, name)) for name in _STREAMS if getattr(thing, name) is not None}
    extra = {name: part for name, series in thing.extra.items() if (part := cut(series)) is not None}
    return Piece(**streams, extra=extra)


@contextmanager
def open_trajectory(path: Path | str) -> "Iterator[TrajectoryWriter]":
    """Open a file for a reference or an estimate that comes piece by piece; it appears when the block ends.

    Raises :class:`BadFile` when the file cannot be written.
    """
    with open_mcap(Path(path), f"stillpoint {version('stillpoint')}", _TRAJECTORY_LEVEL, leaves_cache=True) as out:
        yield TrajectoryWriter(out)


class TrajectoryWriter:
    """Writes a reference or an estimate piece by piece; facts that are known at the end come last.

    The bytes do not depend on where the pieces end.
    """

    def __init__(self, out: MessageWriter) -> None:
        self._out = out
        self._samples: dict[str, int] = {}

    def add(self, piece: Reference | SpinReference | Estimate) -> None:
        """Write the samples of a piece, which come after those before; its facts do not matter yet."""
        streams, _ = _make_streams(get_kind(piece), piece)
        if not self._samples:
            self._out.declare(streams)
        for stream in streams:
            self._samples[stream.topic] = self._samples.get(stream.topic, 0) + len(stream.t_ns)
        self._out.add(streams, int(piece.t_ns[-1]) + 1)

    def close(self, last: Reference | SpinReference | Estimate, origin: Mapping[str, str] | None = None) -> None:
        """Write the facts of the whole, which the last piece carries, and what made the file.

        Raises :class:`BadRecording` when a parameter or diagnostic is no number, string, list or mapping.
        """
        kind = get_kind(last)
        _, absent = _make_streams(kind, last)
        record = _record(kind, collect_facts(last), self._samples, absent)
        self._out.describe({RECORD: record, **({_ORIGIN: dict(origin)} if origin else {})}, {})


@contextmanager
def open_recording(path: Path | str, head: Head, first: Piece) -> "Iterator[RecordingWriter]":
    """Open a file for a recording that comes piece by piece; it appears when the block ends.

    ``first`` has a sample or more of every stream that comes (its own rows are not written), ``head`` what is known at
    the start: it stands before the messages, so that a file that was cut says what it is. Raises :class:`BadFile` when
    the file cannot be written.
    """
    with open_mcap(Path(path), f"stillpoint {version('stillpoint')}") as out:
        yield RecordingWriter(out, head, first)


class RecordingWriter:
    """Writes a recording piece by piece; the bytes do not depend on where the pieces end."""

    def __init__(self, out: MessageWriter, head: Head, first: Piece) -> None:
        """Declare the topics of the first piece, and describe the recording."""
        self._out, self._first = out, first
        streams, self._absent = _make_templates("recording", first)
        self._samples: dict[str, int] = {}
        out.declare(streams)
        out.describe({RECORD: self._make_record(head)}, {})

    def add(self, piece: Piece, until_ns: int) -> None:
        """Write the samples of a piece; no later one lies before ``until_ns``."""
        streams, _ = _make_streams("recording", piece)
        for stream in streams:
            self._samples[stream.topic] = self._samples.get(stream.topic, 0) + len(stream.t_ns)
        self._out.add(streams, until_ns)

    def close(self, head: Head) -> None:
        """Write the facts once more, as they are at the end, with the number of samples."""
        self._out.describe({RECORD: self._make_record(head)}, {})

    def _make_record(self, head: Head) -> dict[str, str]:
        facts = collect_recording_facts(head, self._first.spin, self._first.extra)
        return _record("recording", facts, self._samples, self._absent)


def make_contents(thing: Kept) -> tuple[list[Stream], dict[str, str]]:
    """Return the messages of a file, and its metadata record ``stillpoint``.

    Raises :class:`BadRecording` when a parameter or diagnostic is no number, string, list or mapping.
    """
    kind = get_kind(thing)
    streams, absent = _make_streams(kind, thing)
    samples = {stream.topic: len(stream.t_ns) for stream in streams}
    return streams, _record(kind, collect_facts(thing), samples, absent)


def _record(kind: str, facts: Mapping[str, Any], samples: Mapping[str, int], absent: Sequence[str]) -> dict[str, str]:
    """Return the metadata record of a file."""
    return {
        "kind": kind,
        "format": _FORMAT,
        "version": version("stillpoint"),
        "convention": CONVENTION,
        "facts": to_json({**facts, "samples": samples, "absent": absent}),
    }


def read(path: Path | str, units_unchecked: bool = False) -> Kept:
    """Return the recording, reference or estimate in a file.

    ``units_unchecked`` opens a recording whose sizes do not fit their units. A recording that was cut short gives its
    whole chunks, and its ``info.notes`` say what is lost; a reference or estimate that was cut is refused. Raises
    :class:`BadFile`.
    """
    log = read_log(path, is_own_topic, OWN_COLUMNS)
    kind, facts = open_facts(log)
    samples, absent = facts.pop("samples"), facts.pop("absent")
    if log.lost and kind != "recording":
        raise BadFile(f"{path}: {log.lost}; a {kind} that was cut cannot be used; make it again")
    check_readable(log)
    check_counts(log, samples)
    if kind == "recording":
        return make_checked(log, lambda: _make_recording(log, facts, samples, absent, units_unchecked))
    return make_checked(log, lambda: make_trajectory(log, kind, facts, absent))


def is_own_topic(name: str) -> bool:
    """Return whether a topic of this name is read back from a file of stillpoint."""
    return name in _OWN or name.startswith(EXTRA)


def check_readable(log: Log) -> None:
    """Raise :class:`BadFile` where the columns of a topic could not be read."""
    for name, reason in log.unread.items():
        raise BadFile(f"{log.path}: {name} cannot be read: {reason}; write the file again")


def check_counts(log: Log, samples: Mapping[str, int]) -> None:
    """Raise :class:`BadFile` where a whole file has another number of messages than its facts say."""
    for name, count in samples.items():
        if not log.lost and log.counts.get(name, 0) != count:
            raise BadFile(
                f"{log.path}: {name} should have {count} messages and has {log.counts.get(name, 0)}; make it again"
            )


def make_checked(log: Log, make: Callable[[], Made]) -> Made:
    """Return what ``make`` makes of a log; raises :class:`BadFile` where columns or facts of the file do not fit."""
    try:
        return make()
    except BadRecording as error:
        raise BadFile(f"{log.path}: {f'{log.lost}; ' if log.lost else ''}{error}") from error
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
        raise BadFile(
            f"{log.path}: its facts do not fit stillpoint {version('stillpoint')} ({type(error).__name__}: {error}); "
            f"stillpoint {log.metadata[RECORD].get('version', '?')} wrote it"
        ) from error


def read_recording(path: Path | str, units_unchecked: bool = False) -> Recording:
    """Return the recording in a file; raises :class:`BadFile` when it holds something else."""
    return _require_kind(path, Recording, read(path, units_unchecked))


def read_reference(path: Path | str) -> Reference:
    """Return the reference in a file; raises :class:`BadFile` when it holds something else."""
    return _require_kind(path, Reference, read(path))


def read_estimate(path: Path | str) -> Estimate:
    """Return the estimate in a file; raises :class:`BadFile` when it holds something else."""
    return _require_kind(path, Estimate, read(path))


@dataclass(frozen=True)
class Provenance:
    """The facts of a file about itself, without its columns."""

    kind: str  # recording, reference, roll reference, estimate
    version: str  # of the stillpoint that wrote it
    convention: str
    facts: Mapping[str, Any]
    topics: Mapping[str, tuple[str, int]]  # name -> type, number of messages
    attachments: Mapping[str, bytes]
    lost: str  # "" or what is missing of a file that was cut


def read_origin(path: Path | str) -> dict[str, str]:
    """Return what a file says made it, after testing all its checksums; empty where it does not say.

    Raises :class:`BadFile` when the file is damaged.
    """
    log = survey(path)
    return {} if log.lost else dict(log.metadata.get(_ORIGIN, {}))


def is_own_file(path: Path | str) -> bool:
    """Return whether an MCAP file was written by stillpoint; a file that cannot be read counts as one."""
    try:
        return RECORD in survey(path).metadata
    except BadFile:
        return True


def read_provenance(path: Path | str) -> Provenance:
    """Return what a file says about itself; all its checksums are tested. Raises :class:`BadFile`."""
    log = survey(path)
    kind, facts = open_facts(log)
    record = log.metadata[RECORD]
    return Provenance(
        kind=kind,
        version=record.get("version", ""),
        convention=record.get("convention", ""),
        facts=facts,
        topics={name: (log.types[name], log.counts[name]) for name in log.types},
        attachments=log.attachments,
        lost=log.lost,
    )


def sha256(path: Path | str) -> str:
    """Return the SHA-256 of a file, in hex; raises :class:`BadFile` when it cannot be read."""
    try:
        return hash_file(path)
    except OSError as error:
        raise BadFile(f"{path}: cannot be opened ({error.strerror}); check the name") from error


def _make_streams(kind: str, thing: Kept | Piece) -> tuple[list[Stream], list[str]]:
    """Return the messages of each topic, and which fields of them are None ("/truth/pose position_n_m")."""
    streams, absent = [], []
    for topic in TOPICS:
        if topic.kind != kind:
            continue
        if topic.name == MAG_REMAINDER:
            streams += _find_mag_remainder(topic, thing.mag if isinstance(thing, Recording | Piece) else None)
            continue
        holder: Any = getattr(thing, topic.stream) if topic.stream else thing
        if holder is None:
            continue
        given: dict[str, Any] = {column.field: getattr(holder, column.field, None) for column in topic.columns}
        if all(given[column.field] is None for column in topic.columns if not column.derived):
            continue
        if topic.stream == "mag":
            given["mag_b_ut"] = to_tesla(given["mag_b_ut"])[0]
        absent += [f"{topic.name} {name}" for name, values in given.items() if values is None]
        streams.append(_make_stream(topic, holder.t_ns, given))
    for name, series in thing.extra.items() if isinstance(thing, Recording | Piece) else ():
        streams.append(_make_stream(make_extra_topic(name, series.labels), series.t_ns, {"values": series.values}))
    return streams, absent


def _find_mag_remainder(topic: Topic, mag: Mag | None) -> list[Stream]:
    """Return the rows whose microtesla are no double in tesla times a million; see :func:`topics.to_tesla`."""
    if mag is None:
        return []
    remainder = to_tesla(mag.mag_b_ut)[1]
    rows = (remainder != 0).any(axis=1)
    return [_make_stream(topic, mag.t_ns[rows], {"remainder_b_ut": remainder[rows]})] if rows.any() else []


def _make_stream(topic: Topic, t_ns: NDArray[np.int64], given: Mapping[str, NDArray[Any] | None]) -> Stream:
    """Return the messages of one topic with the values (N, ...) of its fields."""
    columns: dict[str, NDArray[Any]] = {}
    constants = dict(topic.constants)
    contents = []
    for column in topic.columns:
        values = given[column.field]
        if values is None:
            continue
        if column.to_file is not None:
            values = column.to_file(values)
        flat = values.reshape(len(t_ns), -1)
        if len(column.leaves) == 1:
            columns[column.leaves[0]] = values if values.ndim == 1 else flat
        else:
            columns |= {leaf: flat[:, k] for k, leaf in enumerate(column.leaves)}
        if "layout.dim" in constants:
            constants |= {"layout.dim[0].size": flat.shape[1], "layout.dim[0].stride": flat.shape[1]}
        contents.append(f"{column.field} = {', '.join(column.leaves)} {column.unit}".strip())
    if topic.frame:
        constants["header.frame_id"] = topic.frame
    metadata = {"holds": topic.holds, "columns": "; ".join(contents)}
    group = topic.stream.removesuffix("_remainder")
    return Stream(topic.name, topic.type_name, t_ns, columns, constants, metadata, group)


def open_facts(log: Log) -> tuple[str, dict[str, Any]]:
    """Return kind and facts of a file of stillpoint; raises :class:`BadFile` for any other."""
    record = log.metadata.get(RECORD)
    if record is None:
        if log.lost:
            what = "the facts at its end are not there" if any(log.counts.values()) else "no chunk of it is whole"
            raise BadFile(f"{log.path}: {log.lost}; {what}")
        topics = [f"{name} ({log.types[name] or 'no type'}, {log.counts[name]} messages)" for name in log.types]
        more = f" and {len(topics) - 6} topics more" if len(topics) > 6 else ""
        raise BadFile(
            f"{log.path}: is no file of stillpoint; it holds {', '.join(topics[:6]) or 'no topic'}{more}; "
            f"`stillpoint import ros {log.path}` imports it"
        )
    kind = record.get("kind", "")
    if record.get("format") != _FORMAT or kind not in KINDS:
        raise BadFile(
            f"{log.path}: holds a {kind or 'thing'} in format {record.get('format', '?')}, written by stillpoint "
            f"{record.get('version', '?')}; this is stillpoint {version('stillpoint')}: install the newer one"
        )
    try:
        facts = from_json(record["facts"])
        if not isinstance(facts["samples"], dict) or not isinstance(facts["absent"], list):
            raise ValueError("samples and absent are of another shape")
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise BadFile(f"{log.path}: its facts cannot be read ({error}); write it again") from error
    return kind, facts


def _read_columns(log: Log, topic: Topic, absent: Sequence[str]) -> tuple[NDArray[np.int64], dict[str, Any]]:
    """Return stamps and columns of one topic, in the shapes that they have in memory."""
    found = log.topics[topic.name]
    columns: dict[str, Any] = {}
    for column in topic.columns:
        if column.derived or f"{topic.name} {column.field}" in absent:
            continue
        values = found.column(column.field)
        if column.from_file is not None:
            values = column.from_file(values)
        columns[column.field] = values.reshape(len(found.t_ns), *column.shape)
    return found.t_ns, columns


def _join_columns(log: Log, kind: str, absent: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return per stream ("" for the thing itself) ``t_ns`` and columns, joined from their topics.

    Where a cut file lacks the last messages of one topic of a stream, the others are cut to the same length.
    """
    holders: dict[str, dict[str, Any]] = {}
    for topic in TOPICS:
        if topic.kind != kind or topic.drawn or topic.name not in log.topics or not len(log.topics[topic.name].t_ns):
            continue
        t_ns, columns = _read_columns(log, topic, absent)
        holder = holders.setdefault(topic.stream, {"t_ns": t_ns})
        n = min(len(t_ns), len(holder["t_ns"]))
        if not np.array_equal(t_ns[:n], holder["t_ns"][:n]) or (not log.lost and len(t_ns) != len(holder["t_ns"])):
            raise BadFile(f"{log.path}: {topic.name} has other times than the rest of its stream; write it again")
        holders[topic.stream] = {name: values[:n] for name, values in (holder | columns).items()}
    return holders


def _make_recording(
    log: Log, facts: Mapping[str, Any], samples: Mapping[str, int], absent: Sequence[str], units_unchecked: bool
) -> Recording:
    """Return the recording in a file, from its messages and facts."""
    streams, extra = make_streams(log, facts, absent)
    base_pose = None if facts["base_pose"] is None else np.array(facts["base_pose"], np.float64)
    info = make_info(log, facts, samples, units_unchecked)
    return Recording(name=facts["name"], base_pose=base_pose, info=info, extra=extra, **streams)


def make_streams(log: Log, facts: Mapping[str, Any], absent: Sequence[str]) -> tuple[dict[str, Any], dict[str, Series]]:
    """Return the streams of a recording that a log has messages of, by name, and the further series."""
    holders = _join_columns(log, "recording", absent)
    remainder = holders.pop("mag_remainder", None)
    if "mag" in holders:
        holders["mag"] = _make_mag(log, holders["mag"], remainder)
    if "spin" in holders:
        holders["spin"]["geometry"] = spin_geometry_from(facts)
    streams = {name: _STREAMS[name](**holder) for name, holder in holders.items()}
    extra = {
        name: Series(topic.t_ns, topic.column("data").reshape(len(topic.t_ns), -1), tuple(labels))
        for name, labels in facts.get("extra", {}).items()
        if (topic := log.topics.get(f"{EXTRA}{name}")) is not None and len(topic.t_ns)
    }
    return streams, extra


def make_info(log: Log, facts: Mapping[str, Any], samples: Mapping[str, int], units_unchecked: bool) -> Info:
    """Return the provenance of a recording, with a note about what is lost of a file that was cut."""
    info = parse_info(facts)
    if log.lost:
        less = [
            f"{name} {log.counts.get(name, 0)} of {count}"
            for name, count in samples.items()
            if log.counts.get(name, 0) < count
        ]
        notes = f"{log.lost}; messages read: {', '.join(less) or 'all'}"
        info = replace(info, notes=(*info.notes, notes))
    return replace(info, units_unchecked=True) if units_unchecked else info


def _make_mag(log: Log, tesla_columns: Mapping[str, Any], remainder: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return stamps and field (N, 3) in µT, exactly as written: tesla and, where it exists, their remainder."""
    t_ns, field_t = tesla_columns["t_ns"], tesla_columns["mag_b_ut"]
    if remainder is None:
        return {"t_ns": t_ns, "mag_b_ut": to_microtesla(field_t)}
    rest = np.full_like(field_t, -0.0)
    known = remainder["t_ns"] <= t_ns[-1]  # a cut file may end between the two topics
    rows = np.searchsorted(t_ns, remainder["t_ns"][known])
    if not np.array_equal(t_ns[rows], remainder["t_ns"][known]) or (not known.all() and not log.lost):
        raise BadFile(
            f"{log.path}: {MAG_REMAINDER} has times that the magnetometer does not have; write the file again"
        )
    rest[rows] = remainder["remainder_b_ut"][known]
    return {"t_ns": t_ns, "mag_b_ut": to_microtesla(field_t, rest)}


def make_trajectory(log: Log, kind: str, facts: Mapping[str, Any], absent: Sequence[str]) -> Kept:
    """Return the reference or estimate that facts and the messages of a log make."""
    columns = _join_columns(log, kind, absent)[""]
    keywords = parse_reference_facts(facts) if kind == "reference" else dict(facts)
    return KINDS[kind](**columns, **keywords)


def _require_kind(path: Path | str, wanted: type[OneKind], thing: Kept) -> OneKind:
    """Return the thing; raises :class:`BadFile` when it is of another kind."""
    if isinstance(thing, wanted):
        return thing
    needed = next(kind for kind, of_kind in KINDS.items() if of_kind is wanted)
    raise BadFile(f"{path}: holds one {get_kind(thing)}; this needs one {needed}")
