"""The containers of ROS messages: MCAP files, ROS 1 bags and the SQLite files of ROS 2 bags, as columns per topic.

All of them hand out blocks of message records in the layout of MCAP, so that one reader decodes them in bulk. What was
cut off is read as far as it is whole, and noted.
"""

import sqlite3
import struct
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any
from urllib.parse import quote

import numpy as np
import zstandard
from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from stillpoint.datasets.errors import BadFile, BadSource
from stillpoint.datasets.files.limits import LARGEST_CHUNK, raise_limit
from stillpoint.datasets.importers.clock import find_wild_stamps
from stillpoint.datasets.importers.files import reading
from stillpoint.datasets.importers.series import Log as ImportLog
from stillpoint.datasets.importers.series import Series
from stillpoint.datasets.mcap.file import MESSAGE_HEAD, RECORD_HEAD
from stillpoint.datasets.mcap.reader import Container, Log, read_batches, read_columns
from stillpoint.datasets.mcap.scan import Block, Scan, unpack

_BAG_MAGIC = b"#ROSBAG V2.0\n"
_MESSAGE, _CHUNK, _CONNECTION = 0x02, 0x05, 0x07  # operations of ROS 1 bags
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_BLOCK_BYTES = 4 << 20  # messages of a bag are handed out in blocks of about this size
_UNSYNCED_NS = 86_400_000_000_000  # a stamp this far from the time of receipt was made before the clock was set
_LONGEST_HEADER = 1 << 20  # bytes: connection headers hold a message definition of some kB
_HEAD = struct.Struct("<BQHIQQ")


@dataclass(frozen=True)
class RosFiles:
    """The files of one recording, in the order of time."""

    source: Path
    files: tuple[Path, ...]
    open: Callable[[Path], Container]
    types: dict[str, str]  # topic -> message type, sensor_msgs/msg/Imu
    counts: dict[str, int]
    notes: tuple[str, ...]

    def read(self, topics: Collection[str]) -> list[Log]:
        """Return the topics of each file. Raises :class:`BadSource`."""
        try:
            return [read_columns(self.open(file), list(topics)) for file in self.files]
        except BadFile as error:
            raise BadSource(str(error)) from None

    def read_batches(self, topics: Collection[str], most: int) -> Iterator[Log]:
        """Yield the topics of all files in batches of about ``most`` messages. Raises :class:`BadSource`."""
        try:
            for file in self.files:
                yield from read_batches(self.open(file), list(topics), most)
        except BadFile as error:
            raise BadSource(str(error)) from None


def open_ros(source: Path) -> RosFiles:
    """Return the files of a ROS 1 bag, a ROS 2 bag or an MCAP file; raises :class:`BadSource` for what is neither."""
    files, open_file = _find_files(source)
    types: dict[str, str] = {}
    counts: dict[str, int] = defaultdict(int)
    notes = []
    if source.is_dir() and not (source / "metadata.yaml").is_file():
        notes.append(f"no metadata.yaml; {len(files)} files read in the order of their names")
    for file in files:
        try:
            log = read_columns(open_file(file), topics=())
        except BadFile as error:
            raise BadSource(str(error)) from None
        types |= {topic: _complete_type(kind) for topic, kind in log.types.items()}
        for topic, count in log.counts.items():
            counts[topic] += count
        if log.lost:
            notes.append(f"{log.lost} ({file.name})")
    if not sum(counts.values()) and log.lost:
        raise BadSource(f"{file}: {log.lost}; no chunk of it is whole: copy or record it again")
    return RosFiles(source, tuple(files), open_file, types, dict(counts), tuple(notes))


def _complete_type(kind: str) -> str:
    """Return ``sensor_msgs/msg/Imu`` for the ROS 1 name ``sensor_msgs/Imu``."""
    package, _, name = kind.partition("/")
    return kind if "/msg/" in kind or not name else f"{package}/msg/{name}"


def _find_files(source: Path) -> tuple[list[Path], Callable[[Path], Container]]:
    """Return the files of a bag in order, and the class that reads them; raises :class:`BadSource` for none."""
    if source.is_file():
        readers: dict[str, Callable[[Path], Container]] = {".mcap": Scan, ".bag": _BagScan, ".db3": _Db3Scan}
        if source.suffix not in readers:
            raise BadSource(f"{source}: is not a bag; name a ROS 1 .bag, the folder of a ROS 2 bag, or an .mcap")
        return [source], readers[source.suffix]
    for suffix, scan in ((".mcap", Scan), (".db3", _Db3Scan)):
        files = sorted(source.glob(f"*{suffix}"), key=lambda file: (len(file.name), file.name))
        if files:
            return files, scan
    packed = next((file.name for pattern in ("*.mcap.zstd", "*.db3.zstd") for file in source.glob(pattern)), None)
    if packed:
        raise BadSource(f"{source}: {packed} is compressed as a whole; unpack it first: zstd -d")
    raise BadSource(f"{source}: holds no .mcap or .db3 file; name the folder of a ROS 2 bag, a ROS 1 .bag, or an .mcap")


class _Messages:
    """Collects messages into a block of MCAP message records."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.offsets: dict[int, list[int]] = defaultdict(list)
        self.size = 0

    def add(self, channel: int, log_ns: int, body: bytes) -> None:
        """Add one message."""
        length = len(body) + MESSAGE_HEAD.itemsize - RECORD_HEAD.itemsize
        self.offsets[channel].append(self.size)
        self.parts += (_HEAD.pack(Opcode.MESSAGE, length, channel, 0, log_ns, log_ns), body)
        self.size += MESSAGE_HEAD.itemsize + len(body)

    def take(self) -> Block:
        """Return what was collected and begin anew."""
        data = b"".join(self.parts)
        offsets = {channel: np.array(places, np.int64) for channel, places in self.offsets.items()}
        heads: dict[int, NDArray[np.void]] = {}
        for channel, places in offsets.items():
            bytes_at = np.frombuffer(data, np.uint8)[places[:, None] + np.arange(MESSAGE_HEAD.itemsize)]
            heads[channel] = np.ascontiguousarray(bytes_at).view(MESSAGE_HEAD)[:, 0]
        self.__init__()  # type: ignore[misc]
        return Block(data, offsets, heads)


class _MessageFile:
    """Base of the containers below."""

    def __init__(self, path: Path) -> None:
        """Begin without messages; no file is opened."""
        self.path = path
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.counts: dict[int, int] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.attachments: dict[str, bytes] = {}
        self.lost = ""

    def _declare(self, number: int, topic: str, kind: str, encoding: str, schema: str, definition: bytes) -> None:
        """Note a topic and the schema of its messages under a number."""
        number = number & 0xFFFF
        self.schemas[number] = Schema(number, definition, schema, kind)
        self.channels[number] = Channel(number, topic, encoding, {}, number)
        self.counts.setdefault(number, 0)


class _BagScan(_MessageFile):
    """A ROS 1 bag (format 2.0), read from front to back without its index, so that a cut one gives its whole chunks."""

    def blocks(self) -> Iterator[Block]:
        """Yield the messages; raises :class:`BadFile`."""
        with reading(self.path, "a ROS 1 bag"), open(self.path, "rb") as file:
            size = file.seek(0, 2)
            file.seek(0)
            if file.read(len(_BAG_MAGIC)) != _BAG_MAGIC:
                raise BadFile(f"{self.path}: cannot be read as a bag (it does not start with #ROSBAG V2.0)")
            messages = _Messages()
            while file.tell() < size:
                start = file.tell()
                record = _read_record(file, size)
                if record is None:
                    self.lost = f"the file is cut short, nothing could be read from byte {start} of {size} on"
                    break
                self._take_record(*record, messages)
                if messages.size > _BLOCK_BYTES:
                    yield messages.take()
            if messages.size:
                yield messages.take()

    def _take_record(self, header: dict[str, bytes], data: bytes, messages: _Messages) -> None:
        """Take the messages and connections of a record, and of the records in a chunk; raises :class:`BadFile`."""
        operation = header.get("op", b"\0")[0]
        if operation == _CHUNK:
            compression = header["compression"].decode("ascii", "replace")
            inner = unpack(data, compression, int.from_bytes(header["size"], "little"))
            for part_header, part in _split_records(inner):
                self._take_record(part_header, part, messages)
        elif operation == _CONNECTION:
            about = dict(_split_fields(data))
            self._declare(
                int.from_bytes(header["conn"], "little"),
                header["topic"].decode("utf-8", "replace"),
                about["type"].decode("utf-8", "replace"),
                "ros1",
                "ros1msg",
                about.get("message_definition", b""),
            )
        elif operation == _MESSAGE:
            connection = int.from_bytes(header["conn"], "little") & 0xFFFF
            if connection not in self.channels:
                raise BadFile(
                    f"{self.path}: a message belongs to connection {connection}, which is not declared; copy it again"
                )
            seconds, nanoseconds = struct.unpack("<II", header["time"])
            messages.add(connection, seconds * 1_000_000_000 + nanoseconds, data)
            self.counts[connection] += 1


def _read_record(file: IO[bytes], size: int) -> tuple[dict[str, bytes], bytes] | None:
    """Return header and data of the next record of a bag, or None where the file ends within it."""
    parts = []
    for limit in (_LONGEST_HEADER, raise_limit(LARGEST_CHUNK) * 4):
        word = file.read(4)
        length = int.from_bytes(word, "little")
        if len(word) < 4 or length > size - file.tell():
            return None
        if length > limit:
            raise ValueError(f"a record claims {length} bytes; --large reads it if this is right")
        parts.append(file.read(length))
    return dict(_split_fields(parts[0])), parts[1]


def _split_records(data: bytes) -> Iterator[tuple[dict[str, bytes], bytes]]:
    """Yield header and data of the records in a chunk."""
    at = 0
    while at < len(data):
        header_end = at + 4 + int.from_bytes(data[at : at + 4], "little")
        end = header_end + 4 + int.from_bytes(data[header_end : header_end + 4], "little")
        if end > len(data):
            raise ValueError("a record in a chunk claims more bytes than there are")
        yield dict(_split_fields(data[at + 4 : header_end])), data[header_end + 4 : end]
        at = end


def _split_fields(data: bytes) -> Iterator[tuple[str, bytes]]:
    """Yield names and values of a header."""
    at = 0
    while at < len(data):
        end = at + 4 + int.from_bytes(data[at : at + 4], "little")
        name, equals, value = data[at + 4 : end].partition(b"=")
        if end > len(data) or not equals:
            raise ValueError("a header claims more bytes than there are")
        yield name.decode("ascii", "replace"), value
        at = end


class _Db3Scan(_MessageFile):
    """The SQLite file of a ROS 2 bag."""

    def blocks(self) -> Iterator[Block]:
        """Yield the messages; raises :class:`BadSource`."""
        with reading(self.path, "a ROS 2 bag"):
            connection = sqlite3.connect(f"file:{quote(str(self.path.resolve()))}?mode=ro&immutable=1", uri=True)
            try:
                yield from self._read_blocks(connection)
            finally:
                connection.close()

    def _read_blocks(self, connection: sqlite3.Connection) -> Iterator[Block]:
        """Yield the messages of the database in blocks; raises ``ValueError`` or :class:`BadFile` for odd content."""
        definitions = self._read_definitions(connection)
        topics = connection.execute("SELECT id, name, type, serialization_format FROM topics")
        for number, name, kind, encoding in topics:
            if not (isinstance(number, int) and isinstance(name, str) and isinstance(kind, str)):
                raise ValueError("its table of topics holds other things than topics")
            self._declare(number, name, kind, encoding or "cdr", *definitions.get(kind, ("ros2msg", b"")))
        messages = _Messages()
        query = "SELECT topic_id, timestamp, data FROM messages ORDER BY id"
        for number, log_ns, data in connection.execute(query):
            if not (isinstance(number, int) and isinstance(log_ns, int) and isinstance(data, bytes)):
                raise ValueError("its table of messages holds other things than messages")
            channel = number & 0xFFFF
            if channel not in self.channels:
                raise BadFile(f"{self.path}: a message belongs to topic {number}, which is not declared; copy it again")
            if data[:4] == _ZSTD_MAGIC:
                size = zstandard.frame_content_size(data)
                data = unpack(data, "zstd", size) if size >= 0 else data
            messages.add(channel, max(log_ns, 0), data)
            self.counts[channel] += 1
            if messages.size > _BLOCK_BYTES:
                yield messages.take()
        if messages.size:
            yield messages.take()

    def _read_definitions(self, connection: sqlite3.Connection) -> dict[str, tuple[str, bytes]]:
        """Return what newer bags keep of each type; older ones keep nothing, and common types go by name."""
        tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        if "message_definitions" not in tables:
            return {}
        query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        return {kind: (encoding, text.encode()) for kind, encoding, text in connection.execute(query)}


@dataclass(frozen=True, eq=False)
class Messages:
    """The messages of one topic: stamps, frames and numbers, in the order of the file."""

    topic: str
    kind: str
    stamps_ns: NDArray[np.int64]  # (N,) of the headers
    logged_ns: NDArray[np.int64]  # (N,) when each was received
    frames: NDArray[Any]  # (N,) str, header.frame_id
    children: NDArray[Any]  # (N,) str, child_frame_id, or "" where the type has none
    numbers: dict[str, NDArray[np.float64]]  # name -> (N, k)

    def where(self, keep: NDArray[np.bool_]) -> "Messages":
        """Return the messages of a mask."""
        return replace(
            self,
            stamps_ns=self.stamps_ns[keep],
            logged_ns=self.logged_ns[keep],
            frames=self.frames[keep],
            children=self.children[keep],
            numbers={name: values[keep] for name, values in self.numbers.items()},
        )


def settle_stamps(messages: Messages, values: NDArray[np.float64], log: ImportLog) -> Series:
    """Return samples on the stamps of their headers; what is unset or absurd among them is dropped and noted."""
    stamps_ns, topic, n = messages.stamps_ns, messages.topic, len(messages.stamps_ns)
    unset = stamps_ns == 0
    if n > 1 and unset[0] and unset.sum() == 1 and stamps_ns[1] < 10**9:
        unset[0] = False  # the true start of a simulated clock
    if unset.sum() > n / 2:
        log.add_note(
            f"{topic}: {int(unset.sum())} of {n} headers without a stamp; the times of receipt are used for all"
        )
        return Series(messages.logged_ns, values)
    late_ns = stamps_ns - messages.logged_ns
    usual_ns = int(np.median(late_ns[~unset])) if n else 0
    unsynced = ~unset & (np.abs(late_ns - usual_ns) > _UNSYNCED_NS)
    if unsynced.mean() > 0.1:  # then the times of receipt are what is wrong
        unsynced[:] = False
    wild = np.zeros(n, dtype=np.bool_)
    wild[~unset] = find_wild_stamps(stamps_ns[~unset])
    wild |= unsynced
    if unset.any():
        log.add_note(f"{topic}: {int(unset.sum())} of {n} messages without a stamp dropped")
    if wild.any():
        log.add_note(f"{topic}: {int(wild.sum())} of {n} messages with a stamp far from all others dropped")
    keep = ~unset & ~wild
    return Series(stamps_ns[keep], values[keep])


Leaves = dict[str, tuple[str, ...]]  # name -> leaves of a message


def collect_messages(topic: str, kind: str, logs: Sequence[Log], leaves: Leaves, listed: str = "") -> Messages:
    """Return one topic of all files of a recording. ``listed`` is the field that holds a list of parts, as in TF.

    Raises :class:`BadSource` where the messages cannot be decoded or lack a leaf.
    """
    pieces = []
    for log in logs:
        if topic in log.unread:
            raise BadSource(f"{log.path}: {topic} cannot be read: {log.unread[topic]}; name another topic")
        if topic not in log.topics:
            continue
        found = log.topics[topic]
        for part in found.parts:
            for prefix in _list_prefixes(part.columns, listed):
                pieces.append(
                    _make_messages(found.path, topic, kind, part.columns, found.t_ns[part.rows], prefix, leaves)
                )
    if not pieces:
        raise BadSource(f"{logs[0].path}: {topic} holds no message; name another topic")
    return _join_pieces(topic, kind, pieces)


def _list_prefixes(columns: dict[str, NDArray[Any]], listed: str) -> list[str]:
    """Return the path of each element of a list in the messages, or one empty path without a list."""
    if not listed:
        return [""]
    count = 0
    while f"{listed}[{count}].header.stamp.sec" in columns:
        count += 1
    return [f"{listed}[{k}]." for k in range(count)]


def _make_messages(
    path: Path,
    topic: str,
    kind: str,
    columns: dict[str, NDArray[Any]],
    t_ns: NDArray[np.int64],
    prefix: str,
    leaves: Leaves,
) -> Messages:
    """Return the wanted leaves of messages of one form as numbers (n, k), with stamps and frames."""
    n = len(t_ns)

    def column(leaf: str) -> NDArray[np.float64]:
        """Return a leaf (n,); raises :class:`BadSource` where the messages have none."""
        name, bracket, place = leaf.partition("[")
        values = columns.get(prefix + name)
        if values is None:
            raise BadSource(
                f"{path}: {topic} ({kind}) has no {leaf} in all messages, as this type should; name another topic"
            )
        return np.asarray(values[:, int(place[:-1])] if bracket else values, np.float64)

    def text(leaf: str) -> NDArray[Any]:
        """Return a leaf of text (n,), empty where the messages have none."""
        values = columns.get(prefix + leaf)
        return np.full(n, "") if values is None else np.char.decode(values, "utf-8", "replace")

    stamps_ns = t_ns
    if f"{prefix}header.stamp.sec" in columns:
        seconds = columns[f"{prefix}header.stamp.sec"].astype(np.int64)
        stamps_ns = seconds * 1_000_000_000 + columns[f"{prefix}header.stamp.nanosec"].astype(np.int64)
    numbers = {name: np.column_stack([column(leaf) for leaf in parts]) for name, parts in leaves.items()}
    return Messages(topic, kind, stamps_ns, t_ns, text("header.frame_id"), text("child_frame_id"), numbers)


def _join_pieces(topic: str, kind: str, pieces: Sequence[Messages]) -> Messages:
    """Return the messages of all pieces in the order in which they were logged."""
    logged_ns = np.concatenate([piece.logged_ns for piece in pieces])
    order = np.argsort(logged_ns, kind="stable")

    def put_in_order(columns: Sequence[NDArray[Any]]) -> NDArray[Any]:
        return np.concatenate(columns)[order]

    numbers = {name: put_in_order([piece.numbers[name] for piece in pieces]) for name in pieces[0].numbers}
    return Messages(
        topic,
        kind,
        stamps_ns=put_in_order([piece.stamps_ns for piece in pieces]),
        logged_ns=logged_ns[order],
        frames=put_in_order([piece.frames for piece in pieces]),
        children=put_in_order([piece.children for piece in pieces]),
        numbers=numbers,
    )
