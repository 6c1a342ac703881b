"""Summarise a file of stillpoint from its index and a few chunks, in memory that does not grow with the file.

Counts come from the statistics in the summary section, stamps and steps from the heads of the messages in a few chunks
of each topic. Only what is read is tested against its checksums; gaps and rests between these chunks are not seen.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import ChunkIndex
from numpy.typing import NDArray

from stillpoint.datasets.errors import BadFile
from stillpoint.datasets.mcap.indexed import IndexedScan
from stillpoint.datasets.mcap.reader import Log
from stillpoint.datasets.mcap.scan import DamagedError
from stillpoint.datasets.mcap.store import open_facts
from stillpoint.datasets.mcap.topics import TOPICS

CHUNKS_PER_TOPIC = 6  # the first, the last, and four between


@dataclass(frozen=True)
class StreamSummary:
    """One stream of a file: its count, the span of its stamps, and its usual step."""

    name: str
    samples: int
    first_ns: int
    last_ns: int
    step_ns: float  # median over the chunks that were read; 0 for a single sample


@dataclass(frozen=True)
class FileSummary:
    """The summary of a file from its index."""

    kind: str  # recording, reference, roll reference, estimate
    facts: dict[str, Any]
    streams: tuple[StreamSummary, ...]
    chunks: int
    chunks_read: int


def summarise(path: Path | str) -> FileSummary:
    """Return the summary of a file of stillpoint, from its index and a few chunks of each topic.

    Raises :class:`BadFile` when the file is damaged where it is read, was cut, or is no file of stillpoint.
    """
    scan = IndexedScan.open(path)
    try:
        chunks = scan.read_summary()
        names = {number: channel.topic for number, channel in scan.channels.items()}
        types = dict.fromkeys(names.values(), "")
        counts = dict.fromkeys(types, 0)
        for number, count in scan.total_counts.items():
            counts[names[number]] += count
        kind, facts = open_facts(Log(scan.path, {}, {}, types, counts, scan.metadata, {}, ""))
        stamps = _read_stamps(scan, chunks, names)
    except DamagedError as error:
        raise BadFile(f"{path}: is damaged: {error}; `stillpoint recover` rescues what is readable") from None
    streams = tuple(
        _summarise_stream(stream, counts[topic], stamps[topic])
        for topic, stream in _list_streams(kind, counts)
        if stamps.get(topic)
    )
    return FileSummary(kind, facts, streams, len(chunks), len(_choose_chunks(chunks, names)))


def _list_streams(kind: str, counts: dict[str, int]) -> Iterator[tuple[str, str]]:
    """Yield one topic and the stream that it holds, for each stream of the file."""
    listed: set[str] = set()
    for topic in TOPICS:
        if topic.kind == kind and counts.get(topic.name) and not topic.drawn and topic.stream not in listed:
            listed.add(topic.stream)
            if not topic.stream.endswith("_remainder"):
                yield topic.name, topic.stream or topic.columns[0].field


def _choose_chunks(chunks: Sequence[ChunkIndex], names: dict[int, str]) -> list[ChunkIndex]:
    """Return the first chunk of each topic, its last, and some evenly between."""
    chosen: set[int] = set()
    for number in names:
        own = [k for k, chunk in enumerate(chunks) if number in chunk.message_index_offsets]
        places = np.linspace(0, len(own) - 1, min(CHUNKS_PER_TOPIC, len(own))).astype(int)
        chosen |= {own[place] for place in places}
    return [chunks[k] for k in sorted(chosen)]


def _read_stamps(
    scan: IndexedScan, chunks: Sequence[ChunkIndex], names: dict[int, str]
) -> dict[str, list[NDArray[np.int64]]]:
    """Return the stamps of each topic, one array for each chunk that was read."""
    stamps: dict[str, list[NDArray[np.int64]]] = {}
    for block in scan.read_chunks(_choose_chunks(chunks, names)):
        for number, heads in block.heads.items():
            stamps.setdefault(names[number], []).append(heads["log_time"].ravel().astype(np.int64))
    return stamps


def _summarise_stream(name: str, samples: int, stamps: Sequence[NDArray[np.int64]]) -> StreamSummary:
    """Return samples, span in ns and median step in ns of a stream, from its stamps in parts."""
    steps = np.concatenate([np.diff(part) for part in stamps])
    return StreamSummary(
        name,
        samples,
        int(min(part[0] for part in stamps)),
        int(max(part[-1] for part in stamps)),
        float(np.median(steps)) if len(steps) else 0.0,
    )
