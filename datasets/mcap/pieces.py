"""A file of stillpoint in pieces of bounded size, front to back: what verbs read that work on recordings of any length.

Every piece holds all samples of all streams up to one time; each chunk is decoded once, and every checksum is tested,
as by :func:`stillpoint.datasets.mcap.store.read`. The size of a piece is bounded because the writer orders chunks by
time. A file that is no plain row of chunks with message indexes, or is behind a URL, comes as one piece.
"""

import struct
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, TypeVar

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata

from stillpoint.datasets.errors import BadFile
from stillpoint.datasets.files.remote import is_url
from stillpoint.datasets.mcap.file import INDEX_ENTRY, MAGIC, RECORD_HEAD
from stillpoint.datasets.mcap.indexed import Window, read_part
from stillpoint.datasets.mcap.reader import Log, read_log, read_pieces
from stillpoint.datasets.mcap.scan import DamagedError, Scan, parse_record
from stillpoint.datasets.mcap.store import (
    OWN_COLUMNS,
    RECORD,
    check_counts,
    check_readable,
    is_own_topic,
    make_checked,
    make_info,
    make_streams,
    make_trajectory,
    open_facts,
)
from stillpoint.datasets.mcap.topics import EXTRA, MAG_REMAINDER, TOPICS
from stillpoint.datasets.plausible import UnitCheck
from stillpoint.datasets.recording import Head, Info, Piece, Recording
from stillpoint.datasets.trajectory import Estimate, Reference, SpinReference

_PIECE_ROWS = 1 << 17  # messages of one topic in a piece, and up to a chunk more: 11 minutes at 200 Hz
AnyPiece = Piece | Reference | SpinReference | Estimate
OnePiece = TypeVar("OnePiece", bound=AnyPiece)
_CHUNK_HEAD = struct.Struct("<Q")  # message_start_time
_INDEX_HEAD = struct.Struct("<HI")  # channel, bytes of the entries


class PieceReader:
    """Reads a file of stillpoint in pieces; what is known before the first sample is there at once.

    Raises :class:`BadFile` as :func:`~stillpoint.datasets.mcap.store.read` does, at the latest after the last piece.
    """

    def __init__(self, path: Path | str, units_unchecked: bool = False, most: int = _PIECE_ROWS) -> None:
        """Read the facts of a file; one whose chunks cannot be read apart is read whole. Raises :class:`BadFile`."""
        self.path = Path(path)
        self._units_unchecked, self._most = units_unchecked, most
        self._whole: Log | None = None
        outline = None if is_url(path) else _find_outline(self.path)
        if outline is None:
            self._whole = read_log(path, is_own_topic, OWN_COLUMNS)
            outline = _Outline((), dict(self._whole.counts), self._whole.metadata)
        self._starts_ns = outline.starts_ns
        known = Log(self.path, {}, {}, dict.fromkeys(outline.counts, ""), outline.counts, outline.metadata, {}, "")
        self.kind, self.facts = open_facts(self._whole or known)
        self._samples, self._absent = self.facts.pop("samples"), self.facts.pop("absent")
        self._counts = outline.counts
        self._last: Log = self._whole or known

    @property
    def info(self) -> Info:
        """The provenance of a recording; after the last piece, with a note about what a cut file lost."""
        return make_checked(self._last, lambda: make_info(self._last, self.facts, self._samples, self._units_unchecked))

    @property
    def head(self) -> Head:
        """Return name, facts and sizes of the recording; raises :class:`BadFile` when the file holds none."""
        if self.kind != "recording":
            raise BadFile(f"{self.path}: holds one {self.kind}; this needs one recording")
        samples = {
            topic.stream: self._counts[topic.name]
            for topic in TOPICS
            if topic.kind == "recording" and topic.name != MAG_REMAINDER and self._counts.get(topic.name)
        }
        samples |= {
            f"extra {name.removeprefix(EXTRA)}": count
            for name, count in self._counts.items()
            if name.startswith(EXTRA) and count
        }
        pose = self.facts["base_pose"]
        return Head(self.facts["name"], self.info, samples, None if pose is None else np.array(pose, np.float64))

    def pieces(self) -> Iterator[AnyPiece]:
        """Yield the pieces of a file of any kind; raises :class:`BadFile`."""
        yield from self.recording() if self.kind == "recording" else self.trajectory()

    def recording(self) -> Iterator[Piece]:
        """Yield the pieces of a recording; raises :class:`BadFile`, also for sizes that do not fit their units."""
        head = self.head
        units = None if head.info.units_unchecked else UnitCheck(head.name, head.info.mag_uncalibrated)
        for log in self._read_logs():
            streams, extra = make_checked(log, lambda log=log: make_streams(log, self.facts, self._absent))  # type: ignore[misc]
            piece = Piece(**streams, extra=extra)
            if units is not None:
                units.add(piece.imu, piece.mag)
            yield piece
        if units is not None:
            make_checked(self._last, units.raise_doubt)

    def trajectory(self) -> Iterator[Reference | SpinReference | Estimate]:
        """Yield the pieces of a reference or estimate, each with all facts; raises :class:`BadFile`."""
        for log in self._read_logs():
            if log.lost:
                raise BadFile(f"{self.path}: {log.lost}; a {self.kind} that was cut cannot be used; make it again")
            if any(len(topic.t_ns) for topic in log.topics.values()):
                yield make_checked(log, lambda log=log: make_trajectory(log, self.kind, self.facts, self._absent))  # type: ignore[misc]

    def _read_logs(self) -> Iterator[Log]:
        """Yield the messages piece by piece; raises :class:`BadFile` where the pieces overlap in time."""
        logs = (
            read_pieces(Scan(self.path), is_own_topic, OWN_COLUMNS, self._starts_ns, self._most)
            if self._whole is None
            else iter([self._whole])
        )
        ends_ns: dict[str, int] = {}
        for log in logs:
            self._last = log
            check_readable(log)
            for name, topic in log.topics.items():
                if len(topic.t_ns) and topic.t_ns[0] <= ends_ns.get(name, -1):
                    raise BadFile(f"{self.path}: {name} has messages in a chunk that begins after them; write it again")
                ends_ns[name] = int(topic.t_ns[-1]) if len(topic.t_ns) else ends_ns.get(name, -1)
            yield log
        check_counts(self._last, self._samples)


def read_ahead(pieces: Iterator[OnePiece]) -> Iterator[OnePiece]:
    """Yield the pieces of an iterator; a thread reads the next one while the caller works on this one."""
    with ThreadPoolExecutor(1, thread_name_prefix="read") as reader:
        coming = reader.submit(next, pieces, None)
        while (piece := coming.result()) is not None:
            coming = reader.submit(next, pieces, None)
            yield piece


def read_window(path: Path | str, window: Window, units_unchecked: bool = False) -> Recording:
    """Return the samples of a recording within a range of time, through the index of the file, as a recording.

    Raises :class:`BadFile` when there is no sample of gyro and accelerometer, or of a spinning body's sensors.
    """
    log = read_part(path, window=window, columns=OWN_COLUMNS)
    log = replace(log, topics={name: topic for name, topic in log.topics.items() if is_own_topic(name)})
    kind, facts = open_facts(log)
    if kind != "recording":
        raise BadFile(f"{path}: holds one {kind}; this needs one recording")
    check_readable(log)
    samples, absent = facts.pop("samples"), facts.pop("absent")

    def make_recording() -> Recording:
        """Return the part of the recording that was read."""
        streams, extra = make_streams(log, facts, absent)
        info = make_info(log, facts, samples, units_unchecked)
        pose = None if facts["base_pose"] is None else np.array(facts["base_pose"], np.float64)
        return Recording(facts["name"], base_pose=pose, info=info, extra=extra, **streams)

    return make_checked(log, make_recording)


@dataclass(frozen=True)
class _Outline:
    """Hold the contents of a file as the heads of its records state them."""

    starts_ns: tuple[int, ...]  # of its whole chunks
    counts: dict[str, int]  # topic -> messages
    metadata: dict[str, dict[str, str]]


def _find_outline(path: Path) -> _Outline | None:
    """Return the outline of a local file, of which its heads alone are read; None where it has to be read whole.

    Raises :class:`BadFile` when it cannot be opened.
    """
    try:
        with open(path, "rb") as file:
            return _walk_heads(file)
    except OSError as error:
        hint = "check the name" if isinstance(error, FileNotFoundError) else "check that it is a readable file"
        raise BadFile(f"{path}: cannot be opened ({error.strerror}); {hint}") from error
    except DamagedError:
        return None


def _walk_heads(file: IO[bytes]) -> _Outline | None:
    """Return where the chunks begin and what the file holds, from the heads of its records; None for another file."""
    if file.read(len(MAGIC)) != MAGIC:
        return None
    size, at = file.seek(0, 2), len(MAGIC)
    starts_ns: list[int] = []
    counts: dict[int, int] = {}
    topics: dict[int, str] = {}
    metadata: dict[str, dict[str, str]] = {}
    indexed = True  # the last chunk has message indexes
    while True:
        file.seek(at)
        head = file.read(RECORD_HEAD.itemsize)
        if len(head) < RECORD_HEAD.itemsize:
            break
        opcode, length = struct.unpack("<BQ", head)
        at += RECORD_HEAD.itemsize + length
        if opcode == Opcode.DATA_END or at > size:
            break
        if opcode == Opcode.MESSAGE or (opcode == Opcode.CHUNK and not indexed):
            return None
        if opcode == Opcode.CHUNK:
            starts_ns.append(_CHUNK_HEAD.unpack(file.read(_CHUNK_HEAD.size))[0])
            indexed = False
        elif opcode == Opcode.MESSAGE_INDEX:
            channel, room = _INDEX_HEAD.unpack(file.read(_INDEX_HEAD.size))
            counts[channel] = counts.get(channel, 0) + room // INDEX_ENTRY.itemsize
            indexed = True
        elif opcode == Opcode.CHANNEL:
            record = parse_record(Channel, file.read(length))
            topics[record.id] = record.topic
        elif opcode == Opcode.METADATA:
            kept = parse_record(Metadata, file.read(length))
            metadata[kept.name] = kept.metadata
    if not indexed or not starts_ns or RECORD not in metadata or not set(counts) <= set(topics):
        return None
    by_topic: dict[str, int] = {}
    for channel, topic in topics.items():
        by_topic[topic] = by_topic.get(topic, 0) + counts.get(channel, 0)
    return _Outline(tuple(starts_ns), by_topic, metadata)
