"""One pass through an MCAP file, front to back: every checksum tested, every length bounded, whole chunks handed out.

Works for any writer: with or without chunks, message indexes, summary; zstd, lz4 or no compression. A file that was cut
(its end magic is missing) gives its whole chunks, and ``Scan.lost`` says what is not there. A file that is damaged
raises :class:`~stillpoint.datasets.errors.BadFile`.
"""

import bz2
import io
import struct
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, TypeVar

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from numpy.typing import NDArray
from zlib_ng.zlib_ng import crc32

from stillpoint.datasets.errors import BadFile
from stillpoint.datasets.files.limits import limit_chunk
from stillpoint.datasets.files.remote import open_binary
from stillpoint.datasets.mcap.file import FOOTER_SIZE, INDEX_ENTRY, MAGIC, MESSAGE_HEAD, RECORD_HEAD, take_records

LOOSE_BYTES = 1 << 20  # messages outside chunks are handed out in blocks of about this size
_MOST_IN_TURN = 16  # topics that follow each other in turn
_HEAD = struct.Struct("<BQ")
_CHANNEL = struct.Struct("<H")  # behind the head of a message
_CHUNK = struct.Struct("<QQQII")  # times of the first and the last message, size, checksum, letters of the compression
_MOST_LETTERS = 16
_LENGTH = struct.Struct("<Q")  # of the packed bytes of a chunk
Record = TypeVar(
    "Record", Schema, Channel, Chunk, ChunkIndex, Metadata, MetadataIndex, Attachment, AttachmentIndex, DataEnd, Footer,
    Statistics,
)  # fmt: skip


class DamagedError(Exception):
    """A fault in the bytes; becomes a BadFile, or the end of what a cut file still gives."""


@dataclass(frozen=True)
class Block:
    """The bytes of some message records, and by channel id where they start and their heads, in the file's order."""

    data: bytes
    offsets: dict[int, NDArray[np.int64]]
    heads: dict[int, NDArray[np.void]]  # MESSAGE_HEAD
    steps: dict[int, int] = field(default_factory=dict)  # of channels whose messages have one length and lie evenly


class Scan:
    """Iterate over :meth:`blocks` to the end; then the other attributes are complete."""

    def __init__(self, path: Path) -> None:
        """Begin without messages; no file is opened."""
        self.path = path
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.attachments: dict[str, bytes] = {}
        self.counts: dict[int, int] = {}  # messages by channel id
        self.lost = ""  # what is missing of a file that was cut, "" for a whole one

    def blocks(self) -> Iterator[Block]:
        """Yield the messages of the file; raises :class:`BadFile`."""
        try:
            with open_binary(self.path) as file:
                yield from self._read(file)
        except OSError as error:
            hint = "check the name" if isinstance(error, FileNotFoundError) else "check that it is a readable file"
            raise BadFile(f"{self.path}: cannot be opened ({error.strerror}); {hint}") from error

    def _read(self, file: IO[bytes]) -> Iterator[Block]:
        """Yield the messages of an open file; raises :class:`BadFile` for damage other than a cut end."""
        size = file.seek(0, io.SEEK_END)
        file.seek(max(size - len(MAGIC), 0))
        whole = file.read() == MAGIC and size > len(MAGIC)
        file.seek(0)
        if file.read(len(MAGIC)) != MAGIC:
            what = "is empty" if size == 0 else "is not an MCAP file (its first bytes differ)"
            raise BadFile(f"{self.path}: {what}; name a file that stillpoint or a recorder wrote")
        records = _Records(file, size)
        try:
            yield from self._read_data(records)
            self._read_summary(file.read())
        except DamagedError as error:
            if whole or records.ended:
                where = f"{self.path}: is damaged near byte {records.start}"
                raise BadFile(f"{where}: {error}; restore it from a copy") from None
            self.lost = f"the file is cut short, nothing could be read from byte {records.start} of {size} on ({error})"

    def _read_data(self, records: "_Records") -> Iterator[Block]:
        """Yield all records up to the one that ends the data; what came whole before a damage is handed out first."""
        chunk: bytes | None = None
        listed: list[bytes] = []  # the message indexes of the chunk
        loose = bytearray()
        damage: DamagedError | None = None
        try:
            for opcode, body in records:
                if chunk is not None and opcode != Opcode.MESSAGE_INDEX:
                    yield self.read_block(chunk, listed)
                    chunk, listed = None, []
                if opcode == Opcode.MESSAGE:
                    loose += _HEAD.pack(opcode, len(body)) + body
                    if len(loose) > LOOSE_BYTES:
                        yield self.read_block(bytes(loose))
                        loose.clear()
                elif opcode == Opcode.CHUNK:
                    chunk = _unpack_record(body)
                elif opcode == Opcode.MESSAGE_INDEX:
                    listed.append(body)
                else:
                    self.take_fact(opcode, body)
        except DamagedError as error:
            damage = error
        if chunk is not None:
            yield self.read_block(chunk, listed)
        if loose:
            yield self.read_block(bytes(loose))
        if damage is not None:
            raise damage

    def take_fact(self, opcode: int, body: bytes) -> None:
        """Read a record that is not a message."""
        if opcode == Opcode.SCHEMA:
            schema = parse_record(Schema, body)
            self.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = parse_record(Channel, body)
            self.channels[channel.id] = channel
        elif opcode == Opcode.METADATA:
            metadata = parse_record(Metadata, body)
            self.metadata[metadata.name] = metadata.metadata
        elif opcode == Opcode.ATTACHMENT:
            attachment = parse_record(Attachment, body)
            crc = int.from_bytes(body[-4:], "little")
            if crc not in (0, crc32(body[:-4])):
                raise DamagedError(f"the checksum of the attachment {attachment.name} differs")
            self.attachments[attachment.name] = attachment.data

    def read_block(self, data: bytes, listed: Sequence[bytes] = ()) -> Block:
        """Find the messages in the bytes of a chunk; its message indexes are a hint."""
        block = _find_turns(data) or self._find_messages(data, listed)
        for channel, heads in block.heads.items():
            if channel not in self.channels:
                raise DamagedError(f"a message belongs to channel {channel}, which is not declared")
            self.counts[channel] = self.counts.get(channel, 0) + len(heads)
        return block

    def _find_messages(self, data: bytes, listed: Sequence[bytes]) -> Block:
        """Find the messages in the bytes of a chunk in any order, and take the other records in it."""
        places = [read_offsets(body) for body in listed]
        offsets, others = _find_records(data, np.concatenate(places) if places else np.empty(0, np.int64))
        for opcode, begin, end in others:
            self.take_fact(opcode, data[begin:end])
        block = Block(data, {}, {})
        channels = take_records(data, MESSAGE_HEAD.itemsize, offsets).view(MESSAGE_HEAD)["channel"]
        present = np.flatnonzero(np.bincount(channels)).tolist()
        for channel in present:
            own = offsets if len(present) == 1 else offsets[channels == channel]
            block.offsets[channel] = own
            block.heads[channel] = take_records(data, MESSAGE_HEAD.itemsize, own).view(MESSAGE_HEAD)
        return block

    def _read_summary(self, rest: bytes) -> None:
        """Test what follows the data: the summary, its checksum and its count of messages, the end magic."""
        body = rest[: -len(MAGIC)]
        sound = False
        if len(rest) >= FOOTER_SIZE and body[-FOOTER_SIZE + len(MAGIC) :][:9] == _HEAD.pack(Opcode.FOOTER, 20):
            footer = parse_record(Footer, body[-20:])
            sound = footer.summary_crc in (0, crc32(body[:-4]))
        if not rest.endswith(MAGIC) and not sound:
            self.lost = "the end of the file is cut off; all of its messages are there"
            return
        if not rest.endswith(MAGIC) or not sound:
            raise DamagedError("its summary or its last bytes are not as they were written")
        for opcode, record in _Records(io.BytesIO(body), len(body)).read_summary():
            if opcode == Opcode.STATISTICS:
                count, found = parse_record(Statistics, record).message_count, sum(self.counts.values())
                if count != found:
                    raise DamagedError(f"it should hold {count} messages and holds {found}")


class _Records:
    """The records of the data section one by one; ``start`` is the offset of the latest."""

    def __init__(self, file: IO[bytes], size: int) -> None:
        self.file, self.size = file, size
        self.start = self._end = file.tell()
        self.ended = False  # the record that ends the data was read

    def _read_next(self) -> tuple[bytes, bytes]:
        """Return head and body of the next record; raises :class:`DamagedError`."""
        self.start = self._end
        head = self.file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            raise DamagedError("it ends within a record")
        opcode, length = _HEAD.unpack(head)
        left = self.size - self.start - _HEAD.size
        if opcode == 0 or length > left:
            raise DamagedError(f"a record of kind {opcode} claims {length} bytes, {left} are left")
        self._end += _HEAD.size + length
        return head, self.file.read(length)

    def __iter__(self) -> Iterator[tuple[int, bytes]]:
        """Yield kind and body of the records of the data, and check its checksum at the end."""
        crc = crc32(MAGIC)
        while True:
            head, body = self._read_next()
            if head[0] == Opcode.DATA_END:
                self.ended = True
                if parse_record(DataEnd, body).data_section_crc not in (0, crc):
                    raise DamagedError("the checksum of its data differs")
                return
            if head[0] == Opcode.FOOTER:
                raise DamagedError("the record that ends its data is missing")
            yield head[0], body
            crc = crc32(body, crc32(head, crc))

    def read_summary(self) -> Iterator[tuple[int, bytes]]:
        """Yield the records of the summary."""
        while True:
            head, body = self._read_next()
            if head[0] == Opcode.FOOTER:
                return
            yield head[0], body


def iterate_records(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the records in some bytes, which end with a whole one or with a footer; raises :class:`DamagedError`."""
    at = 0
    while at < len(data):
        if len(data) - at < _HEAD.size:
            raise DamagedError("it ends within a record")
        opcode, length = _HEAD.unpack_from(data, at)
        stop = at + _HEAD.size + length
        if stop > len(data):
            raise DamagedError(f"a record of kind {opcode} claims {length} bytes, {len(data) - at} are left")
        yield opcode, data[at + _HEAD.size : stop]
        at = stop


class _Bytes(ReadDataStream):
    """The bytes of one record; reading past its end is an error, where the base class gives fewer bytes."""

    def __init__(self, data: bytes) -> None:
        super().__init__(io.BytesIO(data))
        self.left = len(data)

    def read(self, length: int) -> bytes:
        """Return the next bytes; raises ``ValueError`` beyond the end."""
        self.left -= length
        if self.left < 0:
            raise ValueError("a length points past its end")
        return super().read(length)


def parse_record(kind: type[Record], body: bytes) -> Record:
    """Return the record of this kind; raises :class:`DamagedError` when the bytes make no sense."""
    try:
        return kind.read(_Bytes(body))
    except (McapError, struct.error, ValueError, OverflowError) as error:
        raise DamagedError(f"a {kind.__name__} record makes no sense ({error})") from error


def unpack_chunk(chunk: Chunk) -> bytes:
    """Return the bytes of a chunk, tested against its length and its checksum."""
    return _unpack_checked(chunk.data, chunk.compression, chunk.uncompressed_size, chunk.uncompressed_crc)


def _unpack_record(body: bytes) -> bytes:
    """Return what :func:`unpack_chunk` returns, from the body of a chunk's record, which is not copied."""
    if len(body) >= _CHUNK.size:
        _, _, size, crc, letters = _CHUNK.unpack_from(body)
        begin = _CHUNK.size + letters + _LENGTH.size
        if letters <= _MOST_LETTERS and begin <= len(body):
            name = body[_CHUNK.size : _CHUNK.size + letters].decode("utf-8", "replace")
            (length,) = _LENGTH.unpack_from(body, begin - _LENGTH.size)
            if begin + length == len(body):
                return _unpack_checked(memoryview(body)[begin:], name, size, crc)
    return unpack_chunk(parse_record(Chunk, body))


def _unpack_checked(packed: bytes | memoryview, compression: str, size: int, crc: int) -> bytes:
    """Return the records of a chunk; raises :class:`DamagedError` where they cannot be unpacked or differ."""
    try:
        data = unpack(packed, compression, size)
    except ValueError as error:
        raise DamagedError(str(error)) from error
    if crc not in (0, crc32(data)):
        raise DamagedError("the checksum of a chunk differs")
    return data


def unpack(packed: bytes | memoryview, compression: str, size: int) -> bytes:
    """Return ``size`` bytes from their packed form; no more memory is taken than that.

    ``compression`` is zstd, lz4, bz2 or none (also ""). Raises ``ValueError`` for any other size, for one above the
    limit, and for damaged bytes.
    """
    if size > limit_chunk(len(packed)):
        raise ValueError(f"a chunk of {len(packed)} bytes claims {size} bytes, unpacked; give --large if this is right")
    try:
        if compression == "zstd":
            if packed and zstandard.frame_content_size(packed) not in (-1, size):
                raise ValueError(f"a chunk claims {size} and {zstandard.frame_content_size(packed)} bytes")
            data = _find_decompressor().decompress(packed, max_output_size=size) if packed else b""
        elif compression == "lz4":
            data = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1)
        elif compression == "bz2":
            data = bz2.BZ2Decompressor().decompress(packed, max_length=size + 1)
        elif compression in ("", "none"):
            data = bytes(packed)
        else:
            raise ValueError(f"a chunk is compressed by {compression!r}, which is not known here")
    except (zstandard.ZstdError, RuntimeError, EOFError, OSError, MemoryError) as error:
        raise ValueError(f"a chunk cannot be unpacked ({error})") from error
    if len(data) > size:
        raise ValueError(f"a chunk has more than the {size} bytes that it claims")
    if len(data) < size:
        raise ValueError(f"a chunk has {len(data)} bytes where it claims {size}")
    return data


_OF_THREAD = threading.local()


def _find_decompressor() -> zstandard.ZstdDecompressor:
    """Return the decompressor of this thread: making one takes as long as to unpack a short chunk."""
    if not hasattr(_OF_THREAD, "decompressor"):
        _OF_THREAD.decompressor = zstandard.ZstdDecompressor()
    made: zstandard.ZstdDecompressor = _OF_THREAD.decompressor
    return made


def read_offsets(body: bytes) -> NDArray[np.int64]:
    """Return the offsets of a message index."""
    usable = (len(body) - 6) // INDEX_ENTRY.itemsize * INDEX_ENTRY.itemsize
    if usable <= 0:
        return np.empty(0, np.int64)
    return np.frombuffer(body, INDEX_ENTRY, offset=6, count=usable // INDEX_ENTRY.itemsize)["offset"].astype(np.int64)


def _find_turns(data: bytes) -> Block | None:
    """Return the messages of a chunk whose channels follow each other in turn, each with one length; else None.

    So the messages of one sensor nearly always lie, and those of topics with the same times.
    """
    first = _read_first_turn(data)
    if not first:
        return None
    turn = sum(size for _, _, size in first)
    offsets, heads = {}, {}
    covered = 0
    for channel, at, size in sorted(first):
        count = (len(data) - at - size) // turn + 1
        covered += count * size
        # The eleven bytes of opcode, length and channel, as two overlapping numbers.
        for begin in (at, at + _HEAD.size + _CHANNEL.size - 8):
            numbers: NDArray[np.uint64] = np.ndarray((count,), np.dtype("<u8"), data, begin, (turn,))
            if not bool((numbers == numbers[0]).all()):
                return None
        offsets[channel] = np.arange(at, at + count * turn, turn, dtype=np.int64)
        heads[channel] = np.ndarray((count,), MESSAGE_HEAD, data, at, (turn,))
    if covered != len(data):
        return None
    return Block(data, offsets, heads, dict.fromkeys(offsets, turn))


def _read_first_turn(data: bytes) -> list[tuple[int, int, int]]:
    """Return channel, offset and size of the first messages, up to that before the first channel comes again.

    Empty where another record is among them, or where a channel comes twice.
    """
    found: list[tuple[int, int, int]] = []
    at = 0
    while at + MESSAGE_HEAD.itemsize <= len(data):
        opcode, length = _HEAD.unpack_from(data, at)
        (channel,) = _CHANNEL.unpack_from(data, at + _HEAD.size)
        size = _HEAD.size + length
        if opcode != Opcode.MESSAGE or size < MESSAGE_HEAD.itemsize or at + size > len(data):
            return []
        if any(channel == before for before, _, _ in found):
            return found if channel == found[0][0] else []
        found.append((channel, at, size))
        if len(found) > _MOST_IN_TURN:
            return []
        at += size
    return found if at == len(data) else []


def _find_records(data: bytes, listed: NDArray[np.int64]) -> tuple[NDArray[np.int64], list[tuple[int, int, int]]]:
    """Return offsets of all messages in ``data``, and (opcode, begin, end) of its other records.

    ``listed`` comes from message indexes and is only a hint: what it leaves out is found by walking the gaps, and
    where it points at something else, everything is walked.
    """
    size = len(data)
    listed = np.sort(listed, kind="stable")  # runs, one per channel: merged in no time
    heads: Any = None
    ends = listed
    sound = bool(len(listed)) and listed[0] >= 0 and listed[-1] <= size - MESSAGE_HEAD.itemsize
    if sound:
        heads = take_records(data, RECORD_HEAD.itemsize, listed).view(RECORD_HEAD)
        lengths = np.minimum(heads["length"], np.uint64(size + 1)).astype(np.int64)
        ends = listed + RECORD_HEAD.itemsize + lengths
        sound = bool(
            (heads["opcode"] == Opcode.MESSAGE).all()
            and (ends - listed >= MESSAGE_HEAD.itemsize).all()
            and (ends <= np.append(listed[1:], size)).all()
        )
    if not sound:
        messages, others = _walk(data, 0, size)
        return np.array(messages, np.int64), others
    begins = np.append(0, ends)
    stops = np.append(listed, size)
    found, rest = [], []
    for gap in np.flatnonzero(begins != stops):
        messages, others = _walk(data, int(begins[gap]), int(stops[gap]))
        found += messages
        rest += others
    return np.sort(np.append(listed, np.array(found, np.int64))) if found else listed, rest


def _walk(data: bytes, begin: int, end: int) -> tuple[list[int], list[tuple[int, int, int]]]:
    """Return the records between two offsets, by reading each head."""
    messages, others = [], []
    while begin < end:
        if end - begin < _HEAD.size:
            raise DamagedError("a chunk ends within a record")
        opcode, length = _HEAD.unpack_from(data, begin)
        stop = begin + _HEAD.size + length
        if stop > end or (opcode == Opcode.MESSAGE and length < MESSAGE_HEAD.itemsize - RECORD_HEAD.itemsize):
            raise DamagedError("a record in a chunk claims more bytes than there are, or too few")
        if opcode == Opcode.MESSAGE:
            messages.append(begin)
        else:
            others.append((opcode, begin + _HEAD.size, stop))
        begin = stop
    return messages, others
