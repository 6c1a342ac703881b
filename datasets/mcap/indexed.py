"""A part of an MCAP file by its index: one topic, or a range of time, without reading the rest.

Of a remote file only the summary and the chunks that hold what was asked for are fetched. Their checksums are tested,
and that of the summary; those of the parts that are not read are not. :func:`~stillpoint.datasets.mcap.reader.read_log`
reads and tests everything.
"""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

from mcap.opcode import Opcode
from mcap.records import Chunk, ChunkIndex, Footer, MetadataIndex, Statistics
from zlib_ng.zlib_ng import crc32

from stillpoint.datasets.errors import BadFile
from stillpoint.datasets.files.remote import RangedFile, is_url
from stillpoint.datasets.mcap.file import FOOTER_SIZE, MAGIC, RECORD_HEAD
from stillpoint.datasets.mcap.reader import Columns, Log, cut_topic, read_columns
from stillpoint.datasets.mcap.scan import (
    Block,
    DamagedError,
    Scan,
    iterate_records,
    parse_record,
    unpack_chunk,
)

_FIRST_FETCH = 64 << 10  # bytes of the end of the file: the summary of an hour's recording
_LARGEST_GAP = 32 << 10  # bytes between two chunks that are fetched with them, because a request costs as much
_HEAD = RECORD_HEAD.itemsize


class Source(Protocol):
    """Bytes by their place."""

    size: int

    def fetch(self, start: int, end: int) -> bytes:
        """Return the bytes from ``start`` to ``end``."""


class LocalFile:
    """A local file as a :class:`Source`."""

    def __init__(self, path: Path) -> None:
        """Find the size of the file; raises :class:`BadFile`."""
        self._path = path
        try:
            self.size = path.stat().st_size
        except OSError as error:
            raise BadFile(f"{path}: cannot be opened ({error.strerror}); check the name") from error

    def fetch(self, start: int, end: int) -> bytes:
        """Return the bytes from ``start`` to ``end``."""
        try:
            with open(self._path, "rb") as file:
                file.seek(start)
                return file.read(max(end - start, 0))
        except OSError as error:
            raise BadFile(f"{self._path}: cannot be read ({error.strerror}); check its permissions") from error


def _open_source(path: Path | str) -> Source:
    """Return the bytes of a local file, or of a file behind a URL."""
    return RangedFile(path) if is_url(path) else LocalFile(Path(path))


@dataclass(frozen=True)
class Window:
    """A range of log times, both ends included."""

    start_ns: int
    end_ns: int


def read_part(
    path: Path | str,
    topics: Collection[str] | None = None,
    window: Window | None = None,
    columns: Mapping[str, Columns] | None = None,
    source: Source | None = None,
) -> Log:
    """Read some topics, or the messages within a range of log times, through the index at the end of the file.

    ``source`` is where the bytes come from (by default the path itself, local or a URL); a
    :class:`~stillpoint.datasets.files.remote.RangedFile` counts what it fetched. Raises :class:`BadFile` when the
    file is damaged or has no index.
    """
    source = source or _open_source(path)
    log = read_columns(IndexedScan(Path(path), source, topics, window), topics, columns)
    if window is None:
        return log
    return replace(
        log, topics={name: cut_topic(topic, window.start_ns, window.end_ns) for name, topic in log.topics.items()}
    )


class IndexedScan(Scan):
    """The chunks of a file that hold what is wanted, found by its index; a container for :func:`read_columns`."""

    def __init__(self, path: Path, source: Source, topics: Collection[str] | None, window: Window | None) -> None:
        super().__init__(path)
        self._source, self._topics, self._window = source, topics, window
        self.total_counts: dict[int, int] = {}  # messages of the whole file by channel id

    @classmethod
    def open(cls, path: Path | str) -> "IndexedScan":
        """Return a scan over all topics of a local file or of a URL."""
        return cls(Path(path), _open_source(path), None, None)

    def blocks(self) -> Iterator[Block]:
        """Yield the messages of the chunks that are needed; raises :class:`BadFile`."""
        try:
            yield from self.read_chunks(self._select_chunks(self.read_summary()))
        except DamagedError as error:
            raise BadFile(f"{self.path}: is damaged: {error}; restore it from a copy") from None

    def read_chunks(self, chunks: list[ChunkIndex]) -> Iterator[Block]:
        """Yield the messages of some chunks; raises :class:`DamagedError`."""
        for index, data in self._fetch_chunks(chunks):
            yield self.read_block(*_unpack(data, index))

    def read_summary(self) -> list[ChunkIndex]:
        """Take in schemas, channels and metadata from the end of the file; returns the index of its chunks."""
        size = self._source.size
        tail_start = max(size - _FIRST_FETCH, 0)
        tail = self._source.fetch(tail_start, size)
        at = len(tail) - FOOTER_SIZE
        if at < 0 or not tail.endswith(MAGIC) or tail[at] != Opcode.FOOTER:
            raise DamagedError("it has no end, and so no index; it was cut, or is no MCAP file")
        footer = parse_record(Footer, tail[at + _HEAD : -len(MAGIC)])
        start = footer.summary_start
        if not 0 < start < size:
            raise DamagedError("it has no summary")
        if start < tail_start:
            tail = self._source.fetch(start, tail_start) + tail
            tail_start = start
        summary = tail[start - tail_start : len(tail) - len(MAGIC)]
        if footer.summary_crc not in (0, crc32(summary[:-4])):
            raise DamagedError("the checksum of its summary differs")
        chunks: list[ChunkIndex] = []
        for opcode, body in iterate_records(summary):
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self.take_fact(opcode, body)
            elif opcode == Opcode.CHUNK_INDEX:
                chunks.append(parse_record(ChunkIndex, body))
            elif opcode == Opcode.STATISTICS:
                self.total_counts = dict(parse_record(Statistics, body).channel_message_counts)
            elif opcode == Opcode.METADATA_INDEX:
                index = parse_record(MetadataIndex, body)
                record = self._source.fetch(index.offset, min(index.offset + index.length, size))
                self.take_fact(Opcode.METADATA, record[_HEAD:])
        if not chunks:
            raise DamagedError("its summary lists no chunk")
        return chunks

    def _select_chunks(self, chunks: list[ChunkIndex]) -> list[ChunkIndex]:
        """Return the chunks that may hold wanted topics within the window, in the order of the file."""
        numbers = {
            number for number, channel in self.channels.items() if self._topics is None or channel.topic in self._topics
        }
        window = self._window
        return [
            chunk
            for chunk in sorted(chunks, key=lambda each: each.chunk_start_offset)
            if (not chunk.message_index_offsets or numbers & set(chunk.message_index_offsets))
            and (window is None or chunk.message_start_time <= window.end_ns)
            and (window is None or chunk.message_end_time >= window.start_ns)
        ]

    def _fetch_chunks(self, chunks: list[ChunkIndex]) -> Iterator[tuple[ChunkIndex, bytes]]:
        """Yield each chunk with its message indexes; those that lie close together come in one request."""
        runs: list[list[ChunkIndex]] = []
        for chunk in chunks:
            if runs and chunk.chunk_start_offset - _find_chunk_end(runs[-1][-1]) <= _LARGEST_GAP:
                runs[-1].append(chunk)
            else:
                runs.append([chunk])
        for run in runs:
            start, end = run[0].chunk_start_offset, _find_chunk_end(run[-1])
            if not 0 < start < end <= self._source.size:
                raise DamagedError("the index of its chunks points beyond its end")
            data = self._source.fetch(start, end)
            for chunk in run:
                yield chunk, data[chunk.chunk_start_offset - start : _find_chunk_end(chunk) - start]


def _find_chunk_end(chunk: ChunkIndex) -> int:
    """Return the offset behind a chunk and its message indexes."""
    return chunk.chunk_start_offset + chunk.chunk_length + chunk.message_index_length


def _unpack(data: bytes, index: ChunkIndex) -> tuple[bytes, list[bytes]]:
    """Return the bytes of a chunk, and the message indexes behind it."""
    unpacked = b""
    listed = []
    for opcode, body in iterate_records(data):
        if opcode == Opcode.CHUNK:
            unpacked = unpack_chunk(parse_record(Chunk, body))
        elif opcode == Opcode.MESSAGE_INDEX:
            listed.append(body)
    if len(unpacked) != index.uncompressed_size:
        raise DamagedError("a chunk has another size than its index says")
    return unpacked, listed
