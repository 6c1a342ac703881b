"""Whole columns of ROS 2 messages into one MCAP file, with no Python loop over messages.

Per topic the messages are a numpy structured array (record head, then the CDR body); those of a chunk are scattered to
their places by time. Everything else goes through the record classes of ``mcap``. Layout: header, schemas, channels,
metadata, attachments, then chunks of 1 MiB (zstd, CRC) with their message indexes, then the summary; CRCs of the data
section and of the summary. Facts come before the chunks so that a file that was cut still says what it is.
"""

import math
import os
import struct
import threading
import zlib
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import IO, Any

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from numpy.typing import NDArray

from stillpoint.datasets.mcap import cdr
from stillpoint.datasets.mcap.file import INDEX_ENTRY, MAGIC, MESSAGE_HEAD, RECORD_HEAD, windows, write_file

_CHUNK_BYTES = 1 << 20  # unpacked; docs/mcap.md has the sizes and speeds that it and the level were chosen by
_CHUNK_SPAN_NS = 30_000_000_000  # of one chunk: a cut file loses at most this much of a slow sensor beside the others
ZSTD_LEVEL = 3
_PACKERS = min(os.cpu_count() or 1, 4)  # threads that pack chunks
_MOST_WAITING = 2 * _PACKERS  # chunks that wait to be packed: some MiB


@dataclass(frozen=True)
class Stream:
    """The messages of one topic: N stamps and, for each leaf that is not constant, N rows.

    ``columns`` maps a leaf (``angular_velocity.x``) to (N,) numbers, or (N, k) for an array or a sequence of length k.
    ``constants`` gives leaves that are the same in every message: numbers, strings, and the lengths of sequences of
    strings or messages. A leaf that is in neither is 0, "" or empty. ``header.stamp`` is the stamp itself.
    """

    topic: str
    type_name: str
    t_ns: NDArray[np.int64]  # (N,) not falling
    columns: Mapping[str, NDArray[Any]]
    constants: Mapping[str, Any] = field(default_factory=dict)
    metadata: Mapping[str, str] = field(default_factory=dict)  # of the channel
    group: str = ""  # topics of one group share chunks, so that one sensor can be fetched without the others


def write_mcap(
    path: Path,
    streams: Sequence[Stream],
    metadata: Mapping[str, Mapping[str, str]],
    attachments: Mapping[str, bytes],
    library: str = "stillpoint",
) -> None:
    """Write one file, atomically; the facts come before the messages.

    Within a group of streams, messages are ordered by time, and at equal times by the order of ``streams``; chunks are
    ordered by their first message. Raises :class:`~stillpoint.datasets.errors.BadFile` when the file cannot be written.
    """
    with open_mcap(path, library) as out:
        out.declare(streams)
        out.describe(metadata, attachments)
        out.add(streams)


@contextmanager
def open_mcap(path: Path, library: str = "stillpoint", level: int = ZSTD_LEVEL) -> "Iterator[MessageWriter]":
    """Open a file for messages that come piece by piece; it appears, atomically, when the block ends without an error.

    ``level`` is that of zstd. Raises :class:`~stillpoint.datasets.errors.BadFile` when the file cannot be written.
    """
    with write_file(path) as file, _open_writer(file, library, level) as out:
        messages = MessageWriter(out)
        yield messages
        messages.release(None)
        out.finish()


def write_blocks(
    path: Path,
    schemas: Sequence[Schema],
    channels: Sequence[Channel],
    metadata: Mapping[str, Mapping[str, str]],
    attachments: Mapping[str, bytes],
    blocks: Iterable[tuple[NDArray[np.uint8], Mapping[int, NDArray[np.void]]]],
) -> None:
    """Write messages that are packed already: blocks of message records, each with the message index of its channels.

    Raises :class:`~stillpoint.datasets.errors.BadFile` when the file cannot be written.
    """
    with write_file(path) as file, _open_writer(file, "stillpoint") as out:
        out.declare(schemas, channels)
        out.describe(metadata, attachments)
        for buffer, indexes in blocks:
            out.chunk(buffer, indexes)
        out.finish()


class MessageWriter:
    """Writes streams that come piece by piece; the bytes do not depend on where the pieces end.

    A piece holds, of every stream, all rows up to one time. Rows wait here until their chunk is full, and a chunk waits
    for the chunks of other groups that begin before it: some MiB, however long the streams are.
    """

    def __init__(self, out: "_Writer") -> None:
        self._out = out
        self._groups: list[_Group] = []

    def declare(self, streams: Sequence[Stream]) -> None:
        """Declare all streams of the file, once; their rows do not matter, their columns and constants do."""
        self._out.declare(*_declarations(streams))
        groups: dict[str, list[_Messages]] = {}
        for k, stream in enumerate(streams):
            groups.setdefault(stream.group, []).append(_Messages(stream, k + 1))
        self._groups = [_Group(makers) for makers in groups.values()]

    def describe(self, metadata: Mapping[str, Mapping[str, str]], attachments: Mapping[str, bytes]) -> None:
        """Write metadata and attachments: before the first piece, or after the last."""
        self.release(None)
        self._out.describe(metadata, attachments)

    def add(self, streams: Sequence[Stream], until_ns: int | None = None) -> None:
        """Take one piece of some or all declared streams; no later row lies before ``until_ns`` (None: the last piece).

        Chunks that are complete are written.
        """
        by_topic = {stream.topic: stream for stream in streams}
        for group in self._groups:
            group.take(by_topic)
        self.release(until_ns)

    def release(self, until_ns: int | None) -> None:
        """Write the chunks to which rows from ``until_ns`` on can add nothing; all of them for None."""
        for group in self._groups:
            group.close_before(until_ns)
        while self._groups:
            first = min(self._groups, key=lambda group: group.next_ns(until_ns))  # the first of equals, as in one piece
            if not first.finished:
                return
            self._out.chunk(*first.finished.popleft())


class _Messages:
    """The records of one stream, made for a slice of its rows at a time."""

    def __init__(self, stream: Stream, channel: int) -> None:
        self.topic, self.channel, self.done = stream.topic, channel, 0
        lengths: dict[str, int] = {}
        for leaf, value in stream.constants.items():
            lengths[leaf] = len(value.encode()) + 1 if isinstance(value, str) else np.size(value)
            if isinstance(value, int):
                lengths[leaf] = value  # of a sequence of messages or strings
        for leaf, column in stream.columns.items():
            lengths[leaf] = column.shape[1] if column.ndim > 1 else 1
        message_type = cdr.parse(stream.type_name, "ros2msg", cdr.definition(stream.type_name))
        layout = cdr.layout_for(message_type, lengths)
        self.dtype = np.dtype([*MESSAGE_HEAD.descr, ("body", layout.dtype)])
        blank = np.zeros(1, self.dtype)
        blank["opcode"], blank["length"] = Opcode.MESSAGE, self.dtype.itemsize - RECORD_HEAD.itemsize
        blank["channel"] = channel
        raw = blank.view(np.uint8)
        for leaf, value in stream.constants.items():
            if leaf in (layout.dtype.names or ()):
                blank["body"][leaf] = value.encode() if isinstance(value, str) else value
        for offset, word in layout.words:
            at = MESSAGE_HEAD.itemsize + offset
            raw[at : at + len(word)] = np.frombuffer(word, np.uint8)
        self.blank = blank.view((np.void, self.dtype.itemsize))
        self.stamped = "header.stamp.sec" in (layout.dtype.names or ())

    def fill(self, stream: Stream, rows: slice, room: NDArray[np.uint8], step: int) -> None:
        """Write the records of the next rows into the bytes of ``room``, each ``step`` bytes after the one before."""
        t_ns = stream.t_ns[rows]
        out: NDArray[np.void] = np.ndarray((len(t_ns),), self.dtype, room, strides=(step,))
        out.view(self.blank.dtype)[...] = self.blank
        out["sequence"] = np.arange(self.done, self.done + len(t_ns))
        self.done += len(t_ns)
        out["log_time"] = out["publish_time"] = t_ns
        body = out["body"]
        if self.stamped:
            body["header.stamp.sec"], body["header.stamp.nanosec"] = np.divmod(t_ns, 1_000_000_000)
        for leaf, column in stream.columns.items():
            body[leaf] = column[rows].reshape(body[leaf].shape)


@dataclass
class _OpenChunk:
    """A chunk to which the next piece may add: its bytes and its message indexes, as they came."""

    key: tuple[int, int]  # which of the chunks by size, and by time, since the first message of its group
    parts: list[NDArray[np.uint8]] = field(default_factory=list)
    entries: dict[int, list[NDArray[np.void]]] = field(default_factory=dict)
    size: int = 0

    def add(self, part: NDArray[np.uint8], indexes: Mapping[int, NDArray[np.void]]) -> None:
        """Add bytes, and the message indexes of them by channel."""
        for channel, entries in indexes.items():
            entries["offset"] += self.size
            self.entries.setdefault(channel, []).append(entries)
        self.parts.append(part)
        self.size += len(part)

    def close(self) -> "_Packed":
        """Return the bytes of the chunk, and its message indexes in the order of their channels."""
        indexes = {channel: _join(self.entries[channel]) for channel in sorted(self.entries)}
        return _join(self.parts), indexes


def _join(parts: Sequence[NDArray[Any]]) -> NDArray[Any]:
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


_Packed = tuple[NDArray[np.uint8], dict[int, NDArray[np.void]]]  # the bytes of a chunk, and its message indexes


class _Group:
    """The streams that share chunks, and the chunks that are not written yet."""

    def __init__(self, makers: Sequence[_Messages]) -> None:
        self.makers = makers
        self.finished: deque[_Packed] = deque()
        self.open: _OpenChunk | None = None
        self.size = 0  # bytes of all messages so far
        self.start_ns: int | None = None  # of the first message

    def next_ns(self, until_ns: int | None) -> float:
        """Return the time at which the next chunk begins, or, where there is no message yet, cannot begin before."""
        if self.finished:
            return _first_time(self.finished[0][1])
        if self.open is not None:
            return min(int(entries[0]["log_time"][0]) for entries in self.open.entries.values())
        return math.inf if until_ns is None else until_ns

    def close_before(self, until_ns: int | None) -> None:
        """Finish the open chunk where messages from ``until_ns`` on (None: there are none) cannot belong to it."""
        if self.open is None or self.start_ns is None:
            return
        if until_ns is None or (until_ns - self.start_ns) // _CHUNK_SPAN_NS > self.open.key[1]:
            self.finished.append(self.open.close())
            self.open = None

    def take(self, by_topic: Mapping[str, Stream]) -> None:
        """Add the messages of one piece, by time; chunks end at multiples of their size and of their span."""
        makers = [maker for maker in self.makers if maker.topic in by_topic and len(by_topic[maker.topic].t_ns)]
        if not makers:
            return
        streams = [by_topic[maker.topic] for maker in makers]
        times, which, in_turn = _merge([np.asarray(stream.t_ns) for stream in streams])
        if self.start_ns is None:
            self.start_ns = int(times[0])
        sizes = np.array([maker.dtype.itemsize for maker in makers], np.int64)[which]
        end = self.size + np.cumsum(sizes)
        start = end - sizes
        self.size = int(end[-1])
        numbers, spans = end // _CHUNK_BYTES, (times - self.start_ns) // _CHUNK_SPAN_NS
        bounds = np.flatnonzero((np.diff(numbers) > 0) | (np.diff(spans) > 0)) + 1
        done, turn = [0] * len(makers), sum(maker.dtype.itemsize for maker in makers)
        for first, last in pairwise([0, *bounds.tolist(), len(end)]):
            buffer = np.empty(int(end[last - 1] - start[first]), np.uint8)
            offsets, of_chunk = start[first:last] - start[first], which[first:last]
            indexes = {}
            for k, (maker, stream) in enumerate(zip(makers, streams, strict=True)):
                own = offsets[(k - first) % len(makers) :: len(makers)] if in_turn else offsets[of_chunk == k]
                rows = slice(done[k], done[k] + len(own))
                done[k] = rows.stop
                if not len(own):
                    continue
                size = maker.dtype.itemsize
                if in_turn:  # the records lie evenly, so that they are written where they belong
                    maker.fill(stream, rows, buffer[int(own[0]) :], turn)
                else:
                    records = np.empty(len(own) * size, np.uint8)
                    maker.fill(stream, rows, records, size)
                    windows(buffer, size)[own] = records.view((np.void, size))
                entries = np.empty(len(own), INDEX_ENTRY)
                entries["log_time"], entries["offset"] = stream.t_ns[rows], own
                indexes[maker.channel] = entries
            self._append((int(numbers[first]), int(spans[first])), buffer, indexes)

    def _append(self, key: tuple[int, int], buffer: NDArray[np.uint8], indexes: dict[int, NDArray[np.void]]) -> None:
        if self.open is not None and self.open.key != key:
            self.finished.append(self.open.close())
            self.open = None
        if self.open is None:
            self.open = _OpenChunk(key)
        self.open.add(buffer, indexes)


def _merge(times: Sequence[NDArray[np.int64]]) -> tuple[NDArray[np.int64], NDArray[np.int32], bool]:
    """Return the stamps of all streams by time, which stream each is of, and whether each stream follows in its turn.

    At equal times the order is that of the streams.
    """
    count = len(times)
    if all(np.array_equal(own, times[0]) for own in times[1:]):  # as of most groups, and much faster
        return np.repeat(times[0], count), np.tile(np.arange(count, dtype=np.int32), len(times[0])), True
    together = np.concatenate(times)
    which = np.repeat(np.arange(count, dtype=np.int32), [len(own) for own in times])
    order = np.argsort(together, kind="stable")
    return together[order], which[order], False


def _first_time(indexes: Mapping[int, NDArray[np.void]]) -> int:
    return min(int(entries["log_time"][0]) for entries in indexes.values())


def _declarations(streams: Sequence[Stream]) -> tuple[list[Schema], list[Channel]]:
    """Return the schemas of the streams' types, and one channel per stream."""
    schemas: dict[str, Schema] = {}
    channels = []
    for k, stream in enumerate(streams):
        if stream.type_name not in schemas:
            text = cdr.definition(stream.type_name).encode()
            schemas[stream.type_name] = Schema(
                id=len(schemas) + 1, name=stream.type_name, encoding="ros2msg", data=text
            )
        channels.append(
            Channel(
                id=k + 1,
                topic=stream.topic,
                message_encoding="cdr",
                schema_id=schemas[stream.type_name].id,
                metadata={"offered_qos_profiles": "", **stream.metadata},
            )
        )
    return list(schemas.values()), channels


@contextmanager
def _open_writer(file: IO[bytes], library: str, level: int = ZSTD_LEVEL) -> "Iterator[_Writer]":
    """Begin a file; chunks are packed by threads meanwhile, which end with the block."""
    with ThreadPoolExecutor(_PACKERS, thread_name_prefix="pack") as packers:
        out = _Writer(file, packers, level)
        out.file_bytes(MAGIC)
        out.record(Header(profile="ros2", library=library))
        yield out


_OF_THREAD = threading.local()


def _pack(raw: memoryview, level: int) -> tuple[bytes, int]:
    """Return the packed bytes of a chunk and its checksum; both are computed without the interpreter's lock."""
    if not hasattr(_OF_THREAD, "compressor"):  # one cannot work for two threads; a file has threads of its own
        _OF_THREAD.compressor = zstandard.ZstdCompressor(level=level)
    return _OF_THREAD.compressor.compress(raw), zlib.crc32(raw)


@dataclass(frozen=True)
class _Waiting:
    """A chunk that is being packed."""

    packed: "Future[tuple[bytes, int]]"
    size: int
    indexes: Mapping[int, NDArray[np.void]]


class _Writer:
    """Puts records into the file and remembers what the summary has to say."""

    def __init__(self, file: IO[bytes], packers: ThreadPoolExecutor, level: int) -> None:
        self.file, self.position, self.crc = file, 0, 0
        self.packers, self.level = packers, level
        self.waiting: deque[_Waiting] = deque()
        self.schemas: list[McapRecord] = []
        self.channels: list[McapRecord] = []
        self.metadata: list[McapRecord] = []
        self.attachments: list[McapRecord] = []
        self.chunks: list[ChunkIndex] = []
        self.counts: dict[int, int] = {}

    def file_bytes(self, data: bytes) -> None:
        self.file.write(data)
        self.position += len(data)
        self.crc = zlib.crc32(data, self.crc)

    def record(self, record: McapRecord) -> tuple[int, int]:
        """Write it; returns its offset and length in the file."""
        builder = RecordBuilder()
        record.write(builder)
        at, data = self.position, builder.end()
        self.file_bytes(data)
        return at, len(data)

    def declare(self, schemas: Sequence[Schema], channels: Sequence[Channel]) -> None:
        """Write schemas and channels."""
        for record in (*schemas, *channels):
            self.record(record)
        self.schemas += schemas
        self.channels += channels

    def describe(self, metadata: Mapping[str, Mapping[str, str]], attachments: Mapping[str, bytes]) -> None:
        """Write metadata and attachments."""
        self.flush()
        for name, facts in metadata.items():
            at, length = self.record(Metadata(name=name, metadata=dict(facts)))
            self.metadata.append(MetadataIndex(offset=at, length=length, name=name))
        for name, data in attachments.items():
            self.attach(name, data)

    def attach(self, name: str, data: bytes) -> None:
        """Write an attachment; its times are 0, so that the same input gives the same bytes."""
        kind = "application/json" if name.endswith(".json") else "application/octet-stream"
        at, length = self.record(Attachment(create_time=0, log_time=0, name=name, media_type=kind, data=data))
        self.attachments.append(
            AttachmentIndex(
                offset=at, length=length, log_time=0, create_time=0, data_size=len(data), name=name, media_type=kind
            )
        )

    def chunk(self, buffer: NDArray[np.uint8], indexes: Mapping[int, NDArray[np.void]]) -> None:
        """Take one chunk and its message indexes, and write the oldest of those that wait to be packed."""
        self.waiting.append(_Waiting(self.packers.submit(_pack, buffer.data, self.level), len(buffer), indexes))
        if len(self.waiting) > _MOST_WAITING:
            self._write_chunk(self.waiting.popleft())

    def flush(self) -> None:
        """Write the chunks that wait."""
        while self.waiting:
            self._write_chunk(self.waiting.popleft())

    def _write_chunk(self, waiting: _Waiting) -> None:
        """Write one chunk and its message indexes."""
        packed, crc = waiting.packed.result()
        indexes = waiting.indexes
        first = _first_time(indexes)
        last = max(int(entries["log_time"][-1]) for entries in indexes.values())
        chunk = Chunk(
            compression="zstd",
            data=packed,
            message_start_time=first,
            message_end_time=last,
            uncompressed_crc=crc,
            uncompressed_size=waiting.size,
        )
        at, length = self.record(chunk)
        offsets, start = {}, self.position
        for channel, entries in indexes.items():
            offsets[channel] = self.position
            data = entries.tobytes()
            self.file_bytes(struct.pack("<BQHI", Opcode.MESSAGE_INDEX, 6 + len(data), channel, len(data)) + data)
            self.counts[channel] = self.counts.get(channel, 0) + len(entries)
        self.chunks.append(
            ChunkIndex(
                message_start_time=first,
                message_end_time=last,
                chunk_start_offset=at,
                chunk_length=length,
                message_index_offsets=offsets,
                message_index_length=self.position - start,
                compression="zstd",
                compressed_size=len(packed),
                uncompressed_size=waiting.size,
            )
        )

    def finish(self) -> None:
        """Write the chunks that wait, the end of the data section, the summary with its CRC, the footer."""
        self.flush()
        self.record(DataEnd(self.crc))
        statistics = Statistics(
            attachment_count=len(self.attachments),
            channel_count=len(self.channels),
            channel_message_counts=self.counts,
            chunk_count=len(self.chunks),
            message_count=sum(self.counts.values()),
            message_start_time=min((chunk.message_start_time for chunk in self.chunks), default=0),
            message_end_time=max((chunk.message_end_time for chunk in self.chunks), default=0),
            metadata_count=len(self.metadata),
            schema_count=len(self.schemas),
        )
        groups: list[tuple[Opcode, Sequence[McapRecord]]] = [
            (Opcode.SCHEMA, self.schemas),
            (Opcode.CHANNEL, self.channels),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self.chunks),
            (Opcode.ATTACHMENT_INDEX, self.attachments),
            (Opcode.METADATA_INDEX, self.metadata),
        ]
        start, builder, offsets = self.position, RecordBuilder(), []
        for opcode, records in groups:
            begin = builder.count
            for record in records:
                record.write(builder)
            if records:
                offsets.append(SummaryOffset(opcode, start + begin, builder.count - begin))
        offsets_start = start + builder.count
        for offset in offsets:
            offset.write(builder)
        summary = builder.end()
        crc = zlib.crc32(struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offsets_start), zlib.crc32(summary))
        self.file.write(summary)
        self.record(Footer(summary_start=start, summary_offset_start=offsets_start, summary_crc=crc))
        self.file.write(MAGIC)
