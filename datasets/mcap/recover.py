"""Rescue what is readable of a damaged MCAP file: every chunk whose checksum is right.

A reader refuses a file in which one bit is wrong. Here chunks are found in three ways: by walking the records, by the
index in the summary, and by searching for the name of the compression that stands in each chunk. What a chunk without
damage holds is exact; what is lost is counted and said.
"""

import mmap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from mcap.records import (
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
from stillpoint.datasets.mcap.facts import from_json, to_json
from stillpoint.datasets.mcap.file import FOOTER_SIZE, INDEX_ENTRY, MAGIC, RECORD_HEAD, windows
from stillpoint.datasets.mcap.scan import Block, DamagedError, Scan, parse_record, unpack_chunk
from stillpoint.datasets.mcap.store import RECORD
from stillpoint.datasets.mcap.topics import TOPICS
from stillpoint.datasets.mcap.writer import write_blocks

_HEAD = RECORD_HEAD.itemsize
_MARKS = (b"\x04\x00\x00\x00zstd", b"\x03\x00\x00\x00lz4")  # name of the compression, as a chunk has it
_MARK_OFFSET = _HEAD + 28  # of that name from the start of the record
_LAST_OPCODE = 0x0F


@dataclass(frozen=True)
class Recovered:
    """The contents rescued from a file."""

    kept: Mapping[str, int]  # topic -> messages
    expected: Mapping[str, int]  # topic -> messages that the file says it had; empty where it does not say
    lost: tuple[str, ...]  # one line each


@dataclass
class _Found:
    """The sound and the damaged parts that the search found."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    chunk_starts: set[int] = field(default_factory=set)
    indexes: dict[int, ChunkIndex] = field(default_factory=dict)  # by the start of the chunk
    counts: dict[int, int] = field(default_factory=dict)  # messages by channel, as the statistics have them
    loose: list[tuple[int, int]] = field(default_factory=list)  # start and end of messages outside chunks
    lost: list[str] = field(default_factory=list)
    data_checksum_differs: bool = False


def recover_file(source: Path, target: Path) -> Recovered:
    """Write what is readable of ``source`` to ``target``, and return what was kept and lost.

    Raises :class:`BadFile` when there is nothing to rescue, or a file cannot be read or written.
    """
    try:
        with open(source, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            found = _search(data)
            blocks = list(_read_chunks(source, data, found))
    except (OSError, ValueError) as error:
        raise BadFile(f"{source}: cannot be opened ({error}); check the name") from error
    if not blocks:
        raise BadFile(f"{source}: no chunk of it is readable; there is nothing to rescue")
    if found.data_checksum_differs and not found.lost:
        found.lost.append("the checksum over all data differs and every chunk is right: check the facts in the result")
    kind, facts = _read_facts(found)
    expected = _read_expected_counts(found, facts)
    blocks = _drop_unpaired(blocks, found, kind)
    kept = _count_messages(blocks, found)
    for topic, count in expected.items():
        if kept.get(topic, 0) < count:
            found.lost.append(f"{topic}: {count - kept.get(topic, 0)} of {count} messages")
    if facts is not None:
        found.metadata[RECORD]["facts"] = to_json(_note_losses(facts, kind, kept, found.lost))
    channels = {number: channel for number, channel in found.channels.items() if kept.get(channel.topic)}
    used = {channel.schema_id for channel in channels.values()}
    write_blocks(
        target,
        [schema for number, schema in sorted(found.schemas.items()) if number in used],
        [channel for _, channel in sorted(channels.items())],
        found.metadata,
        found.attachments,
        (_pack_again(block) for block in blocks if block.heads),
    )
    return Recovered(kept, expected, tuple(found.lost))


def _search(data: mmap.mmap) -> _Found:
    """Return everything that can be located: by the records in their order, by the summary, by the marks in chunks."""
    found = _Found()
    _read_summary(data, found)
    for mark in _MARKS:
        at = data.find(mark)
        while at >= 0:
            if at >= _MARK_OFFSET and data[at - _MARK_OFFSET] == Opcode.CHUNK:
                found.chunk_starts.add(at - _MARK_OFFSET)
            at = data.find(mark, at + 1)
    _walk_records(data, found)
    return found


def _read_summary(data: mmap.mmap, found: _Found) -> None:
    """Take in the summary, when its checksum is right."""
    end = len(data) - len(MAGIC)
    if data[end:] != MAGIC or data[end - FOOTER_SIZE + len(MAGIC)] != Opcode.FOOTER:
        found.lost.append("the end of the file: the index of its chunks cannot be used")
        return
    footer = parse_record(Footer, data[end - 20 : end])
    if not 0 < footer.summary_start < end or footer.summary_crc != crc32(data[footer.summary_start : end - 4]):
        found.lost.append("the summary is damaged: the index of the chunks cannot be used")
        return
    for opcode, start, stop in _find_frames(data, footer.summary_start, end):
        body = data[start:stop]
        if opcode == Opcode.CHUNK_INDEX:
            index = parse_record(ChunkIndex, body)
            found.indexes[index.chunk_start_offset] = index
            found.chunk_starts.add(index.chunk_start_offset)
        elif opcode == Opcode.SCHEMA:
            schema = parse_record(Schema, body)
            found.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = parse_record(Channel, body)
            found.channels[channel.id] = channel
        elif opcode == Opcode.STATISTICS:
            found.counts = dict(parse_record(Statistics, body).channel_message_counts)
        elif opcode == Opcode.METADATA_INDEX:
            _take_fact_at(data, found, parse_record(MetadataIndex, body).offset)
        elif opcode == Opcode.ATTACHMENT_INDEX:
            _take_fact_at(data, found, parse_record(AttachmentIndex, body).offset)


def _take_fact_at(data: mmap.mmap, found: _Found, at: int) -> None:
    """Take in the metadata or the attachment to which the summary points, unless its own head is damaged."""
    if at + _HEAD <= len(data) and data[at] in (Opcode.METADATA, Opcode.ATTACHMENT):
        _take_fact(data, found, data[at], at + _HEAD, min(at + _HEAD + _read_length(data, at), len(data)))


def _walk_records(data: mmap.mmap, found: _Found) -> None:
    """Walk the data section; after an impossible record, continue at the next known chunk."""
    at, end = len(MAGIC), len(data)
    checksum_is_right: bool | None = None
    while at < end:
        stop = at
        for opcode, start, stop in _find_frames(data, at, end):
            if opcode == Opcode.CHUNK:
                found.chunk_starts.add(start - _HEAD)
            elif opcode == Opcode.MESSAGE:
                found.loose.append((start - _HEAD, stop))
            elif opcode == Opcode.DATA_END:
                crc = parse_record(DataEnd, data[start:stop]).data_section_crc
                checksum_is_right = crc in (0, crc32(data[: start - _HEAD]))
                stop = end
                break
            else:
                _take_fact(data, found, opcode, start, stop)
        if stop >= end:
            break
        found.lost.append(f"the record at byte {stop} makes no sense")
        at = min((start for start in found.chunk_starts if start > stop), default=end)
    found.data_checksum_differs = checksum_is_right is False


def _find_frames(data: mmap.mmap, at: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Yield kind, start and end of the bodies of records, as long as their heads make sense; ends with (0, at, at)."""
    while at + _HEAD <= end:
        opcode, length = data[at], _read_length(data, at)
        if not 0 < opcode <= _LAST_OPCODE or length > end - at - _HEAD:
            yield 0, at, at
            return
        yield opcode, at + _HEAD, at + _HEAD + length
        at += _HEAD + length


def _read_length(data: mmap.mmap, at: int) -> int:
    return int.from_bytes(data[at + 1 : at + _HEAD], "little")


def _take_fact(data: mmap.mmap, found: _Found, opcode: int, start: int, stop: int) -> None:
    """Take in a schema, a channel, metadata or an attachment that is not known yet; damaged ones are left out."""
    body = data[start:stop]
    try:
        if opcode == Opcode.SCHEMA:
            schema = parse_record(Schema, body)
            found.schemas.setdefault(schema.id, schema)
        elif opcode == Opcode.CHANNEL:
            channel = parse_record(Channel, body)
            found.channels.setdefault(channel.id, channel)
        elif opcode == Opcode.METADATA:
            metadata = parse_record(Metadata, body)
            found.metadata.setdefault(metadata.name, dict(metadata.metadata))
        elif opcode == Opcode.ATTACHMENT:
            reader = Scan(Path())
            reader.take_fact(opcode, body)
            found.attachments |= reader.attachments
    except DamagedError as error:
        found.lost.append(str(error))


def _read_chunks(path: Path, data: mmap.mmap, found: _Found) -> Iterator[Block]:
    """Yield the messages of every chunk whose checksum is right, in the order of the file."""
    reader = Scan(path)
    reader.schemas, reader.channels = found.schemas, found.channels
    for start in sorted(found.chunk_starts):
        try:
            chunk = parse_record(Chunk, _find_chunk_body(data, start))
            if not chunk.data and start not in found.indexes:
                continue  # bytes that look like a chunk by chance
            yield reader.read_block(unpack_chunk(chunk))
        except DamagedError as error:
            index = found.indexes.get(start)
            span = "" if index is None else f", {_format_span(index)}"
            found.lost.append(f"the chunk at byte {start}{span}: {error}")
    for start, stop in found.loose:
        try:
            yield reader.read_block(data[start:stop])
        except DamagedError as error:
            found.lost.append(f"the message at byte {start}: {error}")
    found.attachments |= reader.attachments


def _find_chunk_body(data: mmap.mmap, start: int) -> bytes:
    """Return the body of a chunk, by its own count of bytes: the length in front of the record may be damaged."""
    name_length = int.from_bytes(data[start + _MARK_OFFSET : start + _MARK_OFFSET + 4], "little")
    records_at = start + _MARK_OFFSET + 4 + min(name_length, 64)
    size = int.from_bytes(data[records_at : records_at + 8], "little")
    return data[start + _HEAD : min(records_at + 8 + size, len(data))]


def _format_span(index: ChunkIndex) -> str:
    seconds = (index.message_end_time - index.message_start_time) / 1e9
    return f"{seconds:.3f} s from {index.message_start_time / 1e9:.3f} s on"


def _read_facts(found: _Found) -> tuple[str, dict[str, Any] | None]:
    """Return kind and facts of a file of stillpoint; ("", None) for others, and where the facts are damaged."""
    record = found.metadata.get(RECORD)
    if record is None:
        return "", None
    try:
        facts = from_json(record["facts"])
        if not isinstance(facts["samples"], dict):
            raise ValueError("samples are of another shape")
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        found.lost.append(f"its facts ({error}): import the result with stillpoint import ros")
        del found.metadata[RECORD]
        return "", None
    return record.get("kind", ""), facts


def _read_expected_counts(found: _Found, facts: Mapping[str, Any] | None) -> dict[str, int]:
    """Return the messages per topic that the file should hold, by its facts, else by its statistics."""
    if facts is not None:
        return {str(topic): int(count) for topic, count in facts["samples"].items()}
    counts: dict[str, int] = {}
    for number, count in found.counts.items():
        if number in found.channels:
            topic = found.channels[number].topic
            counts[topic] = counts.get(topic, 0) + count
    return counts


def _drop_unpaired(blocks: list[Block], found: _Found, kind: str) -> list[Block]:
    """Drop the messages that lack their counterparts on the other topics of their stream.

    A stream of stillpoint may lie on several topics with the same stamps: course and position of a GPS, attitude and
    bias of a reference. Where a chunk of one is lost, the others go too.
    """
    partners: dict[str, list[int]] = {}
    for topic in TOPICS:
        numbers = [number for number, channel in found.channels.items() if channel.topic == topic.name]
        if topic.kind == kind and not topic.drawn and topic.stream != "mag_remainder" and numbers:
            partners.setdefault(topic.stream, []).extend(numbers)
    allowed: dict[int, NDArray[np.uint64]] = {}
    for numbers in partners.values():
        stamps = [_collect_stamps(blocks, number) for number in numbers]
        common = stamps[0]
        for more in stamps[1:]:
            common = np.intersect1d(common, more)
        allowed |= dict.fromkeys(numbers, common)
    for number, channel in found.channels.items():
        if channel.topic == "/imu/mag_remainder" and partners.get("mag"):
            allowed[number] = allowed[partners["mag"][0]]
    return [_select(block, allowed) for block in blocks]


def _collect_stamps(blocks: list[Block], number: int) -> NDArray[np.uint64]:
    """Return the log times (N,) in ns of a channel in all blocks."""
    found = [block.heads[number]["log_time"] for block in blocks if number in block.heads]
    return np.concatenate(found) if found else np.empty(0, np.uint64)


def _select(block: Block, allowed: Mapping[int, NDArray[np.uint64]]) -> Block:
    """Return the block with those messages only whose stamps are allowed on their channel."""
    keep = {
        number: np.isin(heads["log_time"], allowed[number]) if number in allowed else np.ones(len(heads), np.bool_)
        for number, heads in block.heads.items()
    }
    return Block(
        block.data,
        {number: block.offsets[number][kept] for number, kept in keep.items() if kept.any()},
        {number: block.heads[number][kept] for number, kept in keep.items() if kept.any()},
    )


def _count_messages(blocks: list[Block], found: _Found) -> dict[str, int]:
    """Return the messages per topic in the blocks."""
    kept: dict[str, int] = {}
    for block in blocks:
        for number, heads in block.heads.items():
            topic = found.channels[number].topic
            kept[topic] = kept.get(topic, 0) + len(heads)
    return kept


def _note_losses(facts: dict[str, Any], kind: str, kept: Mapping[str, int], lost: list[str]) -> dict[str, Any]:
    """Return the facts with the new counts, and with what was lost among the notes or diagnostics."""
    notes = [f"recovered from a damaged file; lost: {'; '.join(lost) or 'nothing'}"]
    samples = {topic: kept[topic] for topic in facts["samples"] if kept.get(topic)}
    if kind == "recording":
        facts["info"]["notes"] = [*facts["info"]["notes"], *notes]
    else:
        facts["diagnostics"] = {**facts["diagnostics"], "recovered": notes[0]}
    return {**facts, "samples": samples}


def _pack_again(block: Block) -> tuple[NDArray[np.uint8], dict[int, NDArray[np.void]]]:
    """Return the messages of a block packed in their order, and the message index of each channel, by time."""
    numbers = np.concatenate([np.full(len(heads), number) for number, heads in block.heads.items()])
    offsets = np.concatenate(list(block.offsets.values()))
    heads = np.concatenate(list(block.heads.values()))
    order = np.argsort(offsets, kind="stable")
    numbers, offsets, heads = numbers[order], offsets[order], heads[order]
    sizes = heads["length"].astype(np.int64) + _HEAD
    starts = np.cumsum(sizes) - sizes
    buffer = np.empty(int(sizes.sum()), np.uint8)
    for size in np.unique(sizes).tolist():
        rows = sizes == size
        windows(buffer, size)[starts[rows]] = windows(block.data, size)[offsets[rows]]
    indexes = {}
    for number in np.unique(numbers).tolist():
        own = numbers == number
        entries = np.empty(int(own.sum()), INDEX_ENTRY)
        entries["log_time"], entries["offset"] = heads["log_time"][own], starts[own]
        indexes[number] = entries[np.argsort(entries["log_time"], kind="stable")]
    return buffer, indexes
