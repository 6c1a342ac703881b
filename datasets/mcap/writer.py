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
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import IO, Any, Protocol

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
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
from zlib_ng.zlib_ng import crc32

from stillpoint.datasets.mcap import cdr
from stillpoint.datasets.mcap.file import INDEX_ENTRY, MAGIC, MESSAGE_HEAD, RECORD_HEAD, windows, write_file

_CHUNK_BYTES = 1 << 20  # unpacked; docs/mcap.md has the sizes and speeds that it and the level were chosen by
_CHUNK_SPAN_NS = 30_000_000_000  # of one chunk: a cut file loses at most this much of a slow sensor beside the others
ZSTD_LEVEL = 3
_FAST_HASH_LOG = 11  # of the levels below 0
_PACKERS = min(os.cpu_count() or 1, 4)  # threads that pack chunks
_MOST_WAITING = 2 * _PACKERS  # chunks that wait to be packed: some MiB
_LONG_LEAF = 64  # bytes: a covariance is not copied once more than needed
_SHORT_GAP = 8  # bytes between two leaves of a message that are copied along
_HEAD_AT = RECORD_HEAD.itemsize + 2  # in a message: where the sequence number is, behind the channel
_CHUNK_HEAD = struct.Struct("<BQQQQII4sQ")  # all of a chunk's record before its packed bytes
_INDEX_HEAD = struct.Struct("<BQHI")
_NO_BYTES = np.empty(0, np.uint8)


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
def open_mcap(
    path: Path, library: str = "stillpoint", level: int = ZSTD_LEVEL, leaves_cache: bool = False
) -> "Iterator[MessageWriter]":
    """Open a file for messages that come piece by piece; it appears, atomically, when the block ends without an error.

    ``level`` is that of zstd, ``leaves_cache`` that of :func:`~stillpoint.datasets.files.atomic.write_atomically`.
    Raises :class:`~stillpoint.datasets.errors.BadFile` when the file cannot be written.
    """
    with write_file(path, leaves_cache) as file, _open_writer(file, library, level) as out:
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
        for block in blocks:
            out.add_chunk(lambda block=block: block)  # type: ignore[misc]
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
        self._out.declare(*_make_declarations(streams))
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
            first = min(
                self._groups, key=lambda group: group.find_next_ns(until_ns)
            )  # the first of equals, as in one piece
            if not first.finished:
                return
            self._out.add_chunk(first.finished.popleft().lay_out)


class _Messages:
    """The records of one stream, made for a slice of its rows at a time.

    All messages of a stream are equal but for a few bytes. Those that lie side by side are one run, and a run of many
    messages is copied to its places at once.
    """

    def __init__(self, stream: Stream, channel: int) -> None:
        """Make the bytes of a message with all constants, and plan how the columns are copied into it."""
        self.topic, self.channel, self.done = stream.topic, channel, 0
        lengths: dict[str, int] = {}
        for leaf, value in stream.constants.items():
            lengths[leaf] = len(value.encode()) + 1 if isinstance(value, str) else np.size(value)
            if isinstance(value, int):
                lengths[leaf] = value  # of a sequence of messages or strings
        for leaf, column in stream.columns.items():
            lengths[leaf] = column.shape[1] if column.ndim > 1 else 1
        message_type = cdr.parse(stream.type_name, "ros2msg", cdr.get_definition(stream.type_name))
        layout = cdr.make_layout(message_type, lengths)
        dtype = np.dtype([*MESSAGE_HEAD.descr, ("body", layout.dtype)])
        blank = np.zeros(1, dtype)
        blank["opcode"], blank["length"] = Opcode.MESSAGE, dtype.itemsize - RECORD_HEAD.itemsize
        blank["channel"] = channel
        raw = blank.view(np.uint8)
        for leaf, value in stream.constants.items():
            if leaf in (layout.dtype.names or ()):
                blank["body"][leaf] = value.encode() if isinstance(value, str) else value
        for offset, word in layout.words:
            at = MESSAGE_HEAD.itemsize + offset
            raw[at : at + len(word)] = np.frombuffer(word, np.uint8)
        self.blank, self.size = raw, dtype.itemsize  # the bytes of a message, (size,)
        places: Any = layout.dtype.fields or {}
        stamp = places.get("header.stamp.sec")
        assert stamp is None or MESSAGE_HEAD.itemsize + stamp[1] == _HEAD_AT + 24, "a message begins with its header"
        self._head = np.dtype((np.void, 20 if stamp is None else 32))
        self._runs = _find_runs(dtype, raw, list(stream.columns))

    def take_numbers(self, count: int) -> int:
        """Return the sequence number of the next message, and count these many."""
        first = self.done
        self.done += count
        return first

    def fill(
        self, stream: Stream, rows: slice, heads: NDArray[np.uint32], buffer: NDArray[np.uint8], begin: int, step: int
    ) -> None:
        """Write what differs among the messages of some rows into a buffer that has the rest of them.

        The first message begins at byte ``begin``, each next one ``step`` bytes on; ``heads`` are those of all rows.
        """
        own = heads[rows]
        count = len(own)
        head: NDArray[np.void] = np.ndarray((count,), self._head, own, 0, (own.strides[0],))
        np.ndarray((count,), self._head, buffer, begin + _HEAD_AT, (step,))[...] = head
        for run in self._runs:
            values = run.join(stream.columns, rows, count)
            np.ndarray((count,), values.dtype, buffer, begin + run.offset, (step,))[...] = values


def _make_heads(t_ns: NDArray[np.int64], number: int) -> NDArray[np.uint32]:
    """Return what stands at the begin of each message from the sequence number to the stamp in its header, (N, 8).

    These are the number (``number`` for the first), log time and publish time in two words each, the four bytes before
    a body in CDR, and the stamp in seconds and nanoseconds. Messages without a header have the first five.
    """
    heads = np.empty((len(t_ns), 8), "<u4")
    heads[:, 0] = np.arange(number, number + len(t_ns))
    words = np.ascontiguousarray(t_ns, "<i8").view("<u4").reshape(-1, 2)
    seconds = t_ns // 1_000_000_000
    for place, column in ((1, words[:, 0]), (2, words[:, 1]), (3, words[:, 0]), (4, words[:, 1]), (6, seconds)):
        heads[:, place] = column
    heads[:, 5] = int.from_bytes(b"\0\1\0\0", "little")
    heads[:, 7] = t_ns - seconds * 1_000_000_000
    return heads


def _make_heads_once(streams: Sequence[Stream], numbers: Sequence[int]) -> list[NDArray[np.uint32]]:
    """Return the heads of each stream; those that have the same times and numbers share them."""
    made: dict[tuple[int, int], NDArray[np.uint32]] = {}
    for stream, number in zip(streams, numbers, strict=True):
        key = id(stream.t_ns), number
        if key not in made:
            made[key] = _make_heads(stream.t_ns, number)
    return [made[id(stream.t_ns), number] for stream, number in zip(streams, numbers, strict=True)]


@dataclass(frozen=True)
class _Run:
    """Leaves that lie side by side in a message, or nearly."""

    offset: int
    leaves: tuple[str, ...]
    form: np.dtype[Any]  # with a field for each leaf
    between: NDArray[np.void] | None  # (1,) what lies between the leaves; None: nothing

    def join(self, columns: Mapping[str, NDArray[Any]], rows: slice, count: int) -> NDArray[np.void]:
        """Return the bytes of these leaves for some messages, (count,)."""
        whole = np.dtype((np.void, self.form.itemsize))
        if len(self.leaves) == 1:
            column = columns[self.leaves[0]][rows]
            if column.dtype == self.form[0].base and column.flags.c_contiguous:
                return column.reshape(-1).view(whole)  # as it is in memory
        values = np.empty(count, whole)
        if self.between is not None:
            values[...] = self.between
        by_leaf = values.view(self.form)
        for name in self.leaves:
            room = by_leaf[name]
            room[...] = columns[name][rows].reshape(room.shape)
        return values


def _find_runs(message: np.dtype[Any], blank: NDArray[np.uint8], leaves: Sequence[str]) -> list[_Run]:
    """Return leaves of the body in runs: neighbours with few bytes between them together, long sequences alone."""
    fields: Any = message["body"].fields or {}
    places = {leaf: (fields[leaf][0], MESSAGE_HEAD.itemsize + fields[leaf][1]) for leaf in leaves}
    runs: list[list[str]] = []
    end = -message.itemsize
    for leaf, (dtype, offset) in sorted(places.items(), key=lambda one: one[1][1]):
        if dtype.itemsize == 0:
            continue
        alone = dtype.itemsize > _LONG_LEAF
        if alone or offset - end > _SHORT_GAP:
            runs.append([])
        runs[-1].append(leaf)
        end = -message.itemsize if alone else offset + dtype.itemsize
    found = []
    for run in runs:
        first, (last, last_at) = places[run[0]][1], places[run[-1]]
        spec: Any = {
            "names": run,
            "formats": [places[leaf][0] for leaf in run],
            "offsets": [places[leaf][1] - first for leaf in run],
            "itemsize": last_at + last.itemsize - first,
        }
        form = np.dtype(spec)
        between = blank[first : first + form.itemsize].copy().view((np.void, form.itemsize))
        is_full = sum(places[leaf][0].itemsize for leaf in run) == form.itemsize
        found.append(_Run(first, tuple(run), form, None if is_full else between))
    return found


_Laid = tuple[NDArray[np.uint8], Mapping[int, NDArray[np.void]]]  # the bytes of messages, and their message indexes


@dataclass(frozen=True)
class _Rows:
    """Rows of one topic in a part of a chunk, the heads of all rows of its piece, and where the messages begin."""

    maker: _Messages
    stream: Stream
    rows: slice
    heads: NDArray[np.uint32]
    offsets: NDArray[np.int64]


@dataclass(frozen=True)
class _Part:
    """Messages of one piece that lie side by side in a chunk. Threads lay them out."""

    size: int  # bytes
    turn: int  # from a message to the next of its topic, where the topics follow each other in turn; else 0
    blank: NDArray[np.uint8]  # (size,) the bytes where the topics follow each other in turn, without what differs
    topics: Sequence[_Rows]

    def lay_out(self) -> _Laid:
        """Return the messages and their indexes."""
        buffer = self.blank.copy() if self.turn else np.empty(self.size, np.uint8)
        indexes = {}
        for one in self.topics:
            maker, count = one.maker, len(one.offsets)
            if self.turn:
                maker.fill(one.stream, one.rows, one.heads, buffer, int(one.offsets[0]), self.turn)
            else:
                records = np.tile(maker.blank, count)
                maker.fill(one.stream, one.rows, one.heads, records, 0, maker.size)
                windows(buffer, maker.size)[one.offsets] = records.view((np.void, maker.size))
            entries = np.empty(count, INDEX_ENTRY)
            entries["log_time"], entries["offset"] = one.stream.t_ns[one.rows], one.offsets
            indexes[maker.channel] = entries
        return buffer, indexes


@dataclass
class _OpenChunk:
    """A chunk to which the next piece may add."""

    key: tuple[int, int]  # which of the chunks by size, and by time, since the first message of its group
    first_ns: int
    parts: list[_Part] = field(default_factory=list)
    laid: list[_Laid] = field(default_factory=list)  # of pieces before
    size: int = 0

    def add(self, part: _Part) -> None:
        """Add messages."""
        self.parts.append(part)
        self.size += part.size

    def settle(self) -> None:
        """Lay out what is there, so that the arrays of its piece are no longer needed."""
        self.laid += [part.lay_out() for part in self.parts]
        self.parts = []

    def lay_out(self) -> _Laid:
        """Return the bytes of the chunk, and its message indexes in the order of their channels."""
        self.settle()
        found: dict[int, list[NDArray[np.void]]] = {}
        at = 0
        for buffer, indexes in self.laid:
            for channel, entries in indexes.items():
                entries["offset"] += at
                found.setdefault(channel, []).append(entries)
            at += len(buffer)
        return _join_arrays([buffer for buffer, _ in self.laid]), {
            channel: _join_arrays(found[channel]) for channel in sorted(found)
        }


def _join_arrays(parts: Sequence[NDArray[Any]]) -> NDArray[Any]:
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


class _Group:
    """The streams that share chunks, and the chunks that are not written yet."""

    def __init__(self, makers: Sequence[_Messages]) -> None:
        self.makers = makers
        self.finished: deque[_OpenChunk] = deque()
        self.open: _OpenChunk | None = None
        self.size = 0  # bytes of all messages so far
        self.start_ns: int | None = None  # of the first message
        self.blanks: dict[tuple[int, ...], NDArray[np.uint8]] = {}  # by the channels that follow each other in turn

    def find_next_ns(self, until_ns: int | None) -> float:
        """Return when the next chunk begins; without a message yet, the earliest time at which it can."""
        if self.finished:
            return self.finished[0].first_ns
        if self.open is not None:
            return self.open.first_ns
        return math.inf if until_ns is None else until_ns

    def close_before(self, until_ns: int | None) -> None:
        """Finish the open chunk where messages from ``until_ns`` on (None: there are none) cannot belong to it."""
        if self.open is None or self.start_ns is None:
            return
        if until_ns is None or (until_ns - self.start_ns) // _CHUNK_SPAN_NS > self.open.key[1]:
            self.finished.append(self.open)
            self.open = None
        else:
            self.open.settle()

    def take(self, by_topic: Mapping[str, Stream]) -> None:
        """Add the messages of one piece, by time; chunks end at multiples of their size and of their span."""
        makers = [maker for maker in self.makers if maker.topic in by_topic and len(by_topic[maker.topic].t_ns)]
        if not makers:
            return
        streams = [by_topic[maker.topic] for maker in makers]
        order = _put_in_order([np.asarray(stream.t_ns) for stream in streams], [maker.size for maker in makers])
        heads = _make_heads_once(
            streams, [maker.take_numbers(len(stream.t_ns)) for maker, stream in zip(makers, streams, strict=True)]
        )
        if self.start_ns is None:
            self.start_ns = order.get_time(0)
        first = 0
        while first < order.count:
            number = (self.size + order.get_end(first)) // _CHUNK_BYTES
            span = (order.get_time(first) - self.start_ns) // _CHUNK_SPAN_NS
            last = min(
                order.find_end((number + 1) * _CHUNK_BYTES - self.size),
                order.find_time(self.start_ns + (span + 1) * _CHUNK_SPAN_NS),
            )
            rows = []
            for k, (maker, stream) in enumerate(zip(makers, streams, strict=True)):
                own, offsets = order.find_rows(k, first, last)
                if len(offsets):
                    rows.append(_Rows(maker, stream, own, heads[k], offsets))
            begin = order.get_end(first - 1) if first else 0
            size = order.get_end(last - 1) - begin
            blank = self._find_blank(makers, begin % order.turn, size) if order.turn else _NO_BYTES
            part = _Part(size, order.turn, blank, rows)
            self._append_part((number, span), order.get_time(first), part)
            first = last
        self.size += order.get_end(order.count - 1)

    def _find_blank(self, makers: Sequence[_Messages], begin: int, size: int) -> NDArray[np.uint8]:
        """Return the constant bytes of messages that follow each other in turn, from a byte of the first turn on."""
        key = tuple(maker.channel for maker in makers)
        have = self.blanks.get(key)
        if have is None or len(have) < begin + size:
            turn = np.concatenate([maker.blank for maker in makers])
            have = self.blanks[key] = np.tile(turn, -(-(begin + max(size, _CHUNK_BYTES)) // len(turn)) + 1)
        return have[begin : begin + size]

    def _append_part(self, key: tuple[int, int], first_ns: int, part: _Part) -> None:
        """Add messages to the open chunk; a part that belongs to another chunk finishes it."""
        if self.open is not None and self.open.key != key:
            self.finished.append(self.open)
            self.open = None
        if self.open is None:
            self.open = _OpenChunk(key, first_ns)
        self.open.add(part)


class _Order(Protocol):
    """The order of the messages of one piece: message m of ``count`` is of one of the streams."""

    count: int
    turn: int  # bytes from a message to the next of its stream; 0 where the streams do not follow each other in turn

    def get_time(self, m: int) -> int:
        """Return the time of message m."""

    def get_end(self, m: int) -> int:
        """Return the bytes of all messages up to m, with it."""

    def find_end(self, size: int) -> int:
        """Return the first message whose end is ``size`` bytes or more; ``count`` where there is none."""

    def find_time(self, t_ns: int) -> int:
        """Return the first message at ``t_ns`` or later; ``count`` where there is none."""

    def find_rows(self, stream: int, first: int, last: int) -> tuple[slice, NDArray[np.int64]]:
        """Return the rows of a stream among some messages, and their offsets from the beginning of the first one."""


class _InTurn:
    """Streams of the same times: each has a message in its turn. So it is in most groups, and needs no sorting."""

    def __init__(self, t_ns: NDArray[np.int64], sizes: Sequence[int]) -> None:
        self._t_ns, self._ends = t_ns, np.cumsum(sizes)
        self._streams = len(sizes)
        self.count, self.turn = len(t_ns) * self._streams, int(self._ends[-1])

    def get_time(self, m: int) -> int:
        return int(self._t_ns[m // self._streams])

    def get_end(self, m: int) -> int:
        return m // self._streams * self.turn + int(self._ends[m % self._streams])

    def find_end(self, size: int) -> int:
        turns, rest = divmod(size - 1, self.turn)
        return min(turns * self._streams + int(np.searchsorted(self._ends, rest + 1)), self.count)

    def find_time(self, t_ns: int) -> int:
        return _find_time(self._t_ns, t_ns) * self._streams

    def find_rows(self, stream: int, first: int, last: int) -> tuple[slice, NDArray[np.int64]]:
        """Return the rows of a stream among some messages, and their offsets from the beginning of the first one."""
        own = first + (stream - first) % self._streams
        count = max(-(-(last - own) // self._streams), 0)
        row = own // self._streams
        begin = (self.get_end(own - 1) if own else 0) - (self.get_end(first - 1) if first else 0)
        return slice(row, row + count), begin + self.turn * np.arange(count, dtype=np.int64)


class _Merged:
    """Streams of different times, merged by time; at equal times the order is that of the streams."""

    def __init__(self, times: Sequence[NDArray[np.int64]], sizes: Sequence[int]) -> None:
        """Sort the messages of all streams by time; at equal times in the order of the streams."""
        together = np.concatenate(times)
        which = np.repeat(np.arange(len(times), dtype=np.int32), [len(own) for own in times])
        order = np.argsort(together, kind="stable")
        self._times, which = together[order], which[order]
        self._ends = np.cumsum(np.array(sizes, np.int64)[which])
        self._begins = self._ends - np.array(sizes, np.int64)[which]
        self._own = [np.flatnonzero(which == k) for k in range(len(times))]
        self.count, self.turn = len(together), 0

    def get_time(self, m: int) -> int:
        return int(self._times[m])

    def get_end(self, m: int) -> int:
        return int(self._ends[m])

    def find_end(self, size: int) -> int:
        return int(np.searchsorted(self._ends, size))

    def find_time(self, t_ns: int) -> int:
        return _find_time(self._times, t_ns)

    def find_rows(self, stream: int, first: int, last: int) -> tuple[slice, NDArray[np.int64]]:
        """Return the rows of a stream among some messages, and their offsets from the beginning of the first one."""
        own = self._own[stream]
        rows = slice(*np.searchsorted(own, [first, last]).tolist())
        return rows, self._begins[own[rows]] - self._begins[first]


def _find_time(times: NDArray[np.int64], t_ns: int) -> int:
    """Return the first of some times that is ``t_ns``, which may lie beyond 64 bits, or later."""
    return len(times) if t_ns > np.iinfo(np.int64).max else int(np.searchsorted(times, t_ns))


def _put_in_order(times: Sequence[NDArray[np.int64]], sizes: Sequence[int]) -> _Order:
    """Return the order of the messages of some streams, of which each has one size."""
    if all(np.array_equal(own, times[0]) for own in times[1:]):
        return _InTurn(times[0], sizes)
    return _Merged(times, sizes)


def _make_declarations(streams: Sequence[Stream]) -> tuple[list[Schema], list[Channel]]:
    """Return the schemas of the streams' types, and one channel per stream."""
    schemas: dict[str, Schema] = {}
    channels = []
    for k, stream in enumerate(streams):
        if stream.type_name not in schemas:
            text = cdr.get_definition(stream.type_name).encode()
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
        out.write_bytes(MAGIC)
        out.record(Header(profile="ros2", library=library))
        yield out


_OF_THREAD = threading.local()


@dataclass(frozen=True)
class _Packed:
    """The record of a chunk and those of its message indexes, as they go into the file, and what the summary says."""

    records: bytes
    index: ChunkIndex  # with offsets from the beginning of ``records``
    counts: Mapping[int, int]  # messages by channel


def _pack(lay_out: Callable[[], _Laid], level: int) -> _Packed:
    """Lay out a chunk, and return it packed; most of it is computed without the interpreter's lock."""
    if not hasattr(_OF_THREAD, "compressor"):  # one cannot work for two threads; a file has threads of its own
        _OF_THREAD.compressor = _make_compressor(level)
    buffer, indexes = lay_out()
    data, crc = _OF_THREAD.compressor.compress(buffer.data), crc32(buffer.data)
    first = min(int(entries["log_time"][0]) for entries in indexes.values())
    last = max(int(entries["log_time"][-1]) for entries in indexes.values())
    length = _CHUNK_HEAD.size - RECORD_HEAD.itemsize + len(data)
    records = [_CHUNK_HEAD.pack(Opcode.CHUNK, length, first, last, len(buffer), crc, 4, b"zstd", len(data)), data]
    end = chunk_length = _CHUNK_HEAD.size + len(data)
    offsets, counts = {}, {}
    for channel, entries in indexes.items():
        offsets[channel], counts[channel] = end, len(entries)
        records += [_INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + entries.nbytes, channel, entries.nbytes), entries.data]
        end += _INDEX_HEAD.size + entries.nbytes
    index = ChunkIndex(
        message_start_time=first,
        message_end_time=last,
        chunk_start_offset=0,
        chunk_length=chunk_length,
        message_index_offsets=offsets,
        message_index_length=end - chunk_length,
        compression="zstd",
        compressed_size=len(data),
        uncompressed_size=len(buffer),
    )
    return _Packed(b"".join(records), index, counts)


def _make_compressor(level: int) -> zstandard.ZstdCompressor:
    """Return a compressor of chunks; at the fast levels, with a table of matches that stays in the first cache."""
    if level > 0:
        return zstandard.ZstdCompressor(level=level)
    settings = zstandard.ZstdCompressionParameters.from_level(level, source_size=_CHUNK_BYTES, hash_log=_FAST_HASH_LOG)
    return zstandard.ZstdCompressor(compression_params=settings)


class _Writer:
    """Puts records into the file and remembers what the summary has to say."""

    def __init__(self, file: IO[bytes], packers: ThreadPoolExecutor, level: int) -> None:
        self.file, self.position, self.crc = file, 0, 0
        self.packers, self.level = packers, level
        self.waiting: deque[Future[_Packed]] = deque()
        self.schemas: list[McapRecord] = []
        self.channels: list[McapRecord] = []
        self.metadata: list[McapRecord] = []
        self.attachments: list[McapRecord] = []
        self.chunks: list[ChunkIndex] = []
        self.counts: dict[int, int] = {}

    def write_bytes(self, data: bytes) -> None:
        """Write bytes, and add them to position and checksum."""
        self.file.write(data)
        self.position += len(data)
        self.crc = crc32(data, self.crc)

    def record(self, record: McapRecord) -> tuple[int, int]:
        """Write it; returns its offset and length in the file."""
        builder = RecordBuilder()
        record.write(builder)
        at, data = self.position, builder.end()
        self.write_bytes(data)
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

    def add_chunk(self, lay_out: Callable[[], _Laid]) -> None:
        """Take one chunk, which a thread lays out and packs, and write the oldest of those that wait for that."""
        self.waiting.append(self.packers.submit(_pack, lay_out, self.level))
        if len(self.waiting) > _MOST_WAITING:
            self._write_chunk(self.waiting.popleft().result())

    def flush(self) -> None:
        """Write the chunks that wait."""
        while self.waiting:
            self._write_chunk(self.waiting.popleft().result())

    def _write_chunk(self, packed: _Packed) -> None:
        """Write one chunk and its message indexes."""
        at = self.position
        self.write_bytes(packed.records)
        places = {channel: at + offset for channel, offset in packed.index.message_index_offsets.items()}
        self.chunks.append(replace(packed.index, chunk_start_offset=at, message_index_offsets=places))
        for channel, count in packed.counts.items():
            self.counts[channel] = self.counts.get(channel, 0) + count

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
        crc = crc32(struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offsets_start), crc32(summary))
        self.file.write(summary)
        self.record(Footer(summary_start=start, summary_offset_start=offsets_start, summary_crc=crc))
        self.file.write(MAGIC)
