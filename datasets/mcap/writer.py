"""Whole columns of ROS 2 messages into one MCAP file, with no Python loop over messages.

Per topic the messages are a numpy structured array (record head, then the CDR body); those of a chunk are scattered to
their places by time. Everything else goes through the record classes of ``mcap``. Layout: header, schemas, channels,
metadata, attachments, then chunks of 1 MiB (zstd, CRC) with their message indexes, then the summary; CRCs of the data
section and of the summary. Facts come before the chunks so that a file that was cut still says what it is.
"""

import heapq
import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
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

CHUNK_BYTES = 1 << 20  # unpacked; docs/mcap.md has the sizes and speeds that it and the level were chosen by
CHUNK_SPAN_NS = 30_000_000_000  # of one chunk: a cut file loses at most this much of a slow sensor beside the others
ZSTD_LEVEL = 3


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
    """Write one file, atomically.

    Within a group of streams, messages are ordered by time, and at equal times by the order of ``streams``; chunks are
    ordered by their first message. Raises :class:`~stillpoint.datasets.errors.BadFile` when the file cannot be written.
    """
    with write_file(path) as file:
        out = _Writer(file)
        out.file_bytes(MAGIC)
        out.record(Header(profile="ros2", library=library))
        out.declare(*_declarations(streams))
        out.describe(metadata, attachments)
        for buffer, indexes in _chunks(streams):
            out.chunk(buffer, indexes)
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
    with write_file(path) as file:
        out = _Writer(file)
        out.file_bytes(MAGIC)
        out.record(Header(profile="ros2", library="stillpoint"))
        out.declare(schemas, channels)
        out.describe(metadata, attachments)
        for buffer, indexes in blocks:
            out.chunk(buffer, indexes)
        out.finish()


class _Messages:
    """The records of one stream, made for a slice of its rows at a time."""

    def __init__(self, stream: Stream, channel: int) -> None:
        self.stream, self.channel = stream, channel
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

    def records(self, rows: slice) -> NDArray[np.void]:
        """Return the records of these rows, packed one after the other."""
        t_ns = self.stream.t_ns[rows]
        out = np.repeat(self.blank, len(t_ns)).view(self.dtype)
        out["sequence"] = np.arange(rows.start, rows.stop)
        out["log_time"] = out["publish_time"] = t_ns
        body = out["body"]
        if self.stamped:
            body["header.stamp.sec"], body["header.stamp.nanosec"] = np.divmod(t_ns, 1_000_000_000)
        for leaf, column in self.stream.columns.items():
            body[leaf] = column[rows].reshape(body[leaf].shape)
        return out


def _chunks(streams: Sequence[Stream]) -> Iterator[tuple[NDArray[np.uint8], dict[int, NDArray[np.void]]]]:
    """Yield the bytes of each chunk, and per channel its message index; each group of streams has chunks of its own."""
    groups: dict[str, list[_Messages]] = {}
    for k, stream in enumerate(streams):
        groups.setdefault(stream.group, []).append(_Messages(stream, k + 1))
    yield from heapq.merge(*map(_chunks_of_group, groups.values()), key=lambda chunk: _first_time(chunk[1]))


def _first_time(indexes: Mapping[int, NDArray[np.void]]) -> int:
    return min(int(entries["log_time"][0]) for entries in indexes.values())


def _chunks_of_group(makers: Sequence[_Messages]) -> Iterator[tuple[NDArray[np.uint8], dict[int, NDArray[np.void]]]]:
    """Yield the chunks of streams that share them, by time."""
    streams = [maker.stream for maker in makers]
    times = np.concatenate([np.asarray(stream.t_ns) for stream in streams]) if streams else np.empty(0, np.int64)
    which = np.repeat(np.arange(len(streams), dtype=np.int32), [len(stream.t_ns) for stream in streams])
    order = np.argsort(times, kind="stable")
    which = which[order]
    sizes = np.array([maker.dtype.itemsize for maker in makers], np.int64)
    end = np.cumsum(sizes[which])
    start = end - sizes[which]
    total = int(end[-1]) if len(end) else 0
    cuts = np.searchsorted(end, np.arange(CHUNK_BYTES, total, CHUNK_BYTES))
    spans = np.empty(0, np.int64)
    if total:
        spans = np.flatnonzero(np.diff((times[order] - times.min()) // CHUNK_SPAN_NS)) + 1
    bounds = np.unique(np.concatenate([[0], cuts, spans, [len(end)]]).astype(np.int64))
    done = [0] * len(streams)
    for first, last in pairwise(bounds):
        base = start[first]
        buffer = np.empty(int(end[last - 1] - base), np.uint8)
        of_chunk = which[first:last]
        indexes = {}
        for k, maker in enumerate(makers):
            offsets = (start[first:last] - base)[of_chunk == k]
            if not len(offsets):
                continue
            rows = slice(done[k], done[k] + len(offsets))
            done[k] = rows.stop
            windows(buffer, maker.dtype.itemsize)[offsets] = maker.records(rows).view((np.void, maker.dtype.itemsize))
            entries = np.empty(len(offsets), INDEX_ENTRY)
            entries["log_time"], entries["offset"] = maker.stream.t_ns[rows], offsets
            indexes[maker.channel] = entries
        yield buffer, indexes


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


class _Writer:
    """Puts records into the file and remembers what the summary has to say."""

    def __init__(self, file: IO[bytes]) -> None:
        self.file, self.position, self.crc = file, 0, 0
        self.compress = zstandard.ZstdCompressor(level=ZSTD_LEVEL).compress
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
        """Write one chunk and its message indexes."""
        first = _first_time(indexes)
        last = max(int(entries["log_time"][-1]) for entries in indexes.values())
        raw = buffer.data
        packed = self.compress(raw)
        chunk = Chunk(
            compression="zstd",
            data=packed,
            message_start_time=first,
            message_end_time=last,
            uncompressed_crc=zlib.crc32(raw),
            uncompressed_size=len(raw),
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
                uncompressed_size=len(raw),
            )
        )

    def finish(self) -> None:
        """Write the end of the data section, the summary with its CRC, the footer."""
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
