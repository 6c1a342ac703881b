"""Any MCAP file of ROS 2 messages as columns: ours, and those of ros2 bag, rosbags, foxglove-sdk, mcap-ros2-support.

For importers::

    log = read_log(path)                       # every topic; or topics=("/imu", "/gps")
    log.topics["/imu"].type_name               # "sensor_msgs/msg/Imu"
    log.topics["/imu"].t_ns                    # (N,) int64, log times, not falling
    log.topics["/imu"].stamps_ns()             # (N,) int64, header.stamp, or the log times where there is no header
    log.topics["/imu"].vector("angular_velocity", "xyz")      # (N, 3) float64, in the order of the letters
    log.topics["/imu"].vector("orientation", "wxyz")          # (N, 4): the order is yours, not the file's
    log.topics["/imu"].column("orientation_covariance")       # (N, 9)
    log.topics["/imu"].text("header.frame_id")                # (N,) str
    log.unread                                 # topic -> why its messages have no columns (JSON, protobuf, XCDR2 ...)
    log.lost                                   # "" or what is missing of a file that was cut

Messages whose strings and sequences differ in length from their neighbours' (two frame ids on one topic, a TFMessage
with one or three transforms) lie in several ``parts`` of the topic, each with its rows and its own leaves; ``column``
joins those that all parts have with one shape. ``survey(path)`` lists topics, types and counts without decoding.
Raises :class:`~stillpoint.datasets.errors.BadFile` for files that are damaged or are not MCAP.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from stillpoint.datasets.errors import BadFile
from stillpoint.datasets.mcap import cdr
from stillpoint.datasets.mcap.file import MESSAGE_HEAD, RECORD_HEAD, take_records
from stillpoint.datasets.mcap.scan import Block, Scan

Columns = Mapping[str, tuple[str, ...]]  # name of a column -> the leaves side by side in it


@dataclass(frozen=True)
class Part:
    """Messages of a topic that agree in what leaves they have and in their shapes."""

    rows: NDArray[np.int64]  # (M,) their places among the messages of the topic, rising
    columns: dict[str, NDArray[Any]]  # leaf -> (M,) or (M, k); strings as bytes


@dataclass(frozen=True)
class Topic:
    """The messages of one topic as columns, in the order of their log times."""

    path: Path
    name: str
    type_name: str
    t_ns: NDArray[np.int64]  # (N,) log times
    parts: tuple[Part, ...]

    def column(self, leaf: str) -> NDArray[Any]:
        """Return one leaf, (N,) or (N, k); raises :class:`BadFile` when not all messages have it with one shape."""
        if not self.parts or any(leaf not in part.columns for part in self.parts):
            some = ", ".join(list(self.parts[0].columns)[:8]) if self.parts else "no message"
            raise BadFile(f"{self.path}: {self.name} ({self.type_name}) has no {leaf} in all messages; it has {some} …")
        if len({part.columns[leaf].shape[1:] for part in self.parts}) > 1:
            raise BadFile(f"{self.path}: {self.name}: {leaf} changes its length from message to message")
        if len(self.parts) == 1:
            return self.parts[0].columns[leaf]
        joined = np.concatenate([part.columns[leaf] for part in self.parts])
        out = np.empty_like(joined)
        out[np.concatenate([part.rows for part in self.parts])] = joined
        return out

    def vector(self, path: str, axes: str) -> NDArray[np.float64]:
        """Return leaves ``path.x``, ``path.y`` … side by side, (N, len(axes)) float64."""
        return np.stack([self.column(f"{path}.{axis}") for axis in axes], axis=1).astype(np.float64, copy=False)

    def text(self, leaf: str) -> NDArray[np.str_]:
        """Return a string leaf, (N,)."""
        return np.char.decode(self.column(leaf), "utf-8", "replace")

    def has(self, leaf: str) -> bool:
        """Return whether every message has this leaf."""
        return bool(self.parts) and all(leaf in part.columns for part in self.parts)

    def stamps_ns(self, path: str = "header.stamp") -> NDArray[np.int64]:
        """Return stamps in the messages, (N,) ns; the log times where the type has none."""
        if not self.has(f"{path}.sec"):
            return self.t_ns
        seconds = self.column(f"{path}.sec").astype(np.int64)
        return seconds * 1_000_000_000 + self.column(f"{path}.nanosec").astype(np.int64)


Wanted = Collection[str] | Callable[[str], bool] | None  # names of topics, or a test of a name; None: all


@dataclass(frozen=True)
class Log:
    """The contents of a file."""

    path: Path
    topics: dict[str, Topic]
    unread: dict[str, str]  # topic -> why there are no columns
    types: dict[str, str]  # every topic of the file -> its type
    counts: dict[str, int]  # every topic of the file -> number of messages
    metadata: dict[str, dict[str, str]]
    attachments: dict[str, bytes]
    lost: str


def survey(path: Path | str) -> Log:
    """Return topics, types, counts, metadata and attachments; checks all checksums and decodes no message."""
    return read_log(path, topics=())


def read_log(path: Path | str, topics: Wanted = None, columns: Mapping[str, Columns] | None = None) -> Log:
    """Return the topics (all, those named, or those for which a function of the name is true) of an MCAP file.

    ``columns`` says per topic which leaves to take, and which to put side by side in one column; a topic that it does
    not name gives each of its leaves as a column. Several channels of one topic and type are joined.
    """
    return read_columns(Scan(Path(path)), topics, columns)


class Container(Protocol):
    """A file of messages: an MCAP file, or a bag that gives its messages as records of MCAP.

    After the last of its blocks the other attributes are complete.
    """

    path: Path
    schemas: dict[int, Schema]
    channels: dict[int, Channel]
    counts: dict[int, int]
    metadata: dict[str, dict[str, str]]
    attachments: dict[str, bytes]
    lost: str

    def blocks(self) -> Iterator[Block]:
        """Yield the messages."""


def read_columns(scan: Container, topics: Wanted = None, columns: Mapping[str, Columns] | None = None) -> Log:
    """Return the topics that are wanted of a container; see :func:`read_log`."""
    (log,) = read_pieces(scan, topics, columns)
    return log


def read_pieces(
    scan: Container,
    topics: Wanted = None,
    columns: Mapping[str, Columns] | None = None,
    starts_ns: Sequence[int] = (),
    most: int | None = None,
) -> Iterator[Log]:
    """Yield the topics that are wanted of a container in pieces that end at the same time for all topics.

    Each block is decoded once. A piece ends when a topic has ``most`` messages or more waiting (None: one piece of
    everything), at the latest time before which no later block has a message; ``starts_ns`` are the first times of all
    blocks, in their order. Counts, metadata and losses are those read so far, and complete in the last piece.
    """
    gathers: dict[tuple[str, str], _Gather] = {}
    later_ns = np.minimum.accumulate(np.array(starts_ns, np.int64)[::-1])[::-1]  # of this block and all after it
    for number, block in enumerate(scan.blocks()):
        _gather_block(scan, block, topics, columns, gathers)
        if (
            most is not None
            and number + 1 < len(later_ns)
            and max((one.count for one in gathers.values()), default=0) >= most
        ):
            yield _make_log(scan, gathers, int(later_ns[number + 1]))
    yield _make_log(scan, gathers, None)


def read_batches(scan: Container, topics: Wanted, most: int) -> Iterator[Log]:
    """Yield the topics that are wanted of a container, a batch whenever a topic has ``most`` messages or more waiting.

    Within a batch the messages are ordered by their log times; a later batch may hold earlier ones.
    """
    gathers: dict[tuple[str, str], _Gather] = {}
    for block in scan.blocks():
        _gather_block(scan, block, topics, None, gathers)
        if max((one.count for one in gathers.values()), default=0) >= most:
            yield _make_log(scan, gathers, None)
    yield _make_log(scan, gathers, None)


def _gather_block(
    scan: Container,
    block: Block,
    topics: Wanted,
    columns: Mapping[str, Columns] | None,
    gathers: dict[tuple[str, str], "_Gather"],
) -> None:
    """Take the messages of the wanted topics in one block."""
    for channel_id in block.offsets:
        channel = scan.channels[channel_id]
        if topics is not None and not (topics(channel.topic) if callable(topics) else channel.topic in topics):
            continue
        schema = scan.schemas.get(channel.schema_id)
        key = (channel.topic, schema.name if schema else "")
        if key not in gathers:
            gathers[key] = _Gather(channel, schema, (columns or {}).get(channel.topic))
        gathers[key].take(block, channel_id)


def _make_log(scan: Container, gathers: Mapping[tuple[str, str], "_Gather"], until_ns: int | None) -> Log:
    """Return what was gathered before a time (None: everything), and take it out of the gathers."""
    unread = {topic: gather.refusal for (topic, _), gather in gathers.items() if gather.refusal}
    for topic in [topic for topic, _ in gathers]:
        if sum(name == topic for name, _ in gathers) > 1:
            unread[topic] = "its channels are of several types"
    found = {}
    for (topic, type_name), gather in gathers.items():
        if topic not in unread:
            found[topic] = gather.release(scan.path, topic, type_name, until_ns)
    counts: dict[str, int] = {}
    types: dict[str, str] = {}
    for channel in scan.channels.values():
        counts[channel.topic] = counts.get(channel.topic, 0) + scan.counts.get(channel.id, 0)
        schema = scan.schemas.get(channel.schema_id)
        types[channel.topic] = schema.name if schema else ""
    return Log(scan.path, found, unread, types, counts, scan.metadata, scan.attachments, scan.lost)


class _Gather:
    """Collects the messages of one topic, block by block, already cut down to the wanted columns."""

    def __init__(self, channel: Channel, schema: Schema | None, columns: Columns | None) -> None:
        """Begin without messages; ``refusal`` says why those of a channel cannot be decoded."""
        self.columns = columns
        self.refusal = ""
        self.count = 0
        self.room = 0  # for how many messages arrays are made: as many as the last piece had
        self.t_ns = _Growing()
        self.rows: dict[Any, _Growing] = {}  # by the leaves and shapes that the messages agree in
        self.found: dict[Any, dict[str, _Growing]] = {}
        self.views: dict[int, _View] = {}  # by length of the record: the one that fitted last
        if channel.message_encoding not in ("cdr", "ros1"):
            self.refusal = f"its messages are {channel.message_encoding or 'of unnamed encoding'}, not cdr or ros1"
            return
        try:
            if schema is None:
                raise cdr.Undecodable("it has no schema")
            self.type = cdr.parse(schema.name, schema.encoding, schema.data.decode("utf-8", "replace"))
            if self.type.encoding != channel.message_encoding:
                raise cdr.Undecodable(
                    f"its messages are {channel.message_encoding} and its schema is {schema.encoding}"
                )
        except cdr.Undecodable as error:
            self.refusal = str(error)

    def take(self, block: Block, channel: int) -> None:
        """Take the messages of one channel in one block."""
        offsets = block.offsets[channel]
        rows = np.arange(self.count, self.count + len(offsets))
        self.count += len(offsets)
        if self.refusal:
            return
        heads = block.heads[channel]
        t_ns = self.t_ns.add(len(heads), np.dtype(np.int64))
        t_ns[...] = heads["log_time"]
        if (t_ns < 0).any():
            self.refusal = "a log time lies beyond 2^63 ns"
            return
        try:
            if channel in block.steps:
                size = int(heads["length"][0]) + RECORD_HEAD.itemsize
                form = np.dtype((np.void, size))
                step = (block.steps[channel],)
                self._take_equal(np.ndarray((len(rows),), form, block.data, int(offsets[0]), step), rows, size)
                return
            for length in _list_once(heads["length"]):
                same = heads["length"] == length
                some = slice(None) if same.all() else same
                size = length + RECORD_HEAD.itemsize
                self._take_equal(take_records(block.data, size, offsets[some]), rows[some], size)
        except cdr.Undecodable as error:
            self.refusal = str(error)
            self.found.clear()

    def _take_equal(self, records: NDArray[np.void], rows: NDArray[np.int64], size: int) -> None:
        """Take messages of equal length: those that one layout fits together, then the rest by the next layout."""
        view = self.views.get(size)
        while len(rows):
            if view is None:
                layout = cdr.find_layout(self.type, records[0].tobytes()[MESSAGE_HEAD.itemsize :])
                view = _View(layout, self.columns)
            fits = view.fits(records)
            if fits.all():
                self.views[size] = view
                self._keep(rows, records, view)
                return
            if fits.any():
                self._keep(rows[fits], records[fits], view)
                records, rows = records[~fits], rows[~fits]
            view = None

    def _keep(self, rows: NDArray[np.int64], records: NDArray[np.void], view: "_View") -> None:
        """Copy the wanted leaves of messages that one layout fits."""
        for name, room in self._make_room(rows, view.forms).items():
            view.copy(name, records, room)

    def _keep_columns(self, rows: NDArray[np.int64], columns: Mapping[str, NDArray[Any]]) -> None:
        """Keep rows that were taken before."""
        forms = {name: (values.dtype, values.shape[1:]) for name, values in columns.items()}
        for name, room in self._make_room(rows, forms).items():
            room[...] = columns[name]

    def _make_room(
        self, rows: NDArray[np.int64], forms: Mapping[str, tuple[np.dtype[Any], tuple[int, ...]]]
    ) -> dict[str, NDArray[Any]]:
        """Note the places of more messages with columns of these forms; return the room for each column."""
        key = tuple((name, base.kind, shape) for name, (base, shape) in forms.items())
        if key not in self.found:
            self.rows[key] = _Growing(self.room)
            self.found[key] = {name: _Growing(self.room) for name in forms}
        self.rows[key].add(len(rows), rows.dtype)[:] = rows
        return {name: self.found[key][name].add(len(rows), base, shape) for name, (base, shape) in forms.items()}

    def release(self, path: Path, name: str, type_name: str, until_ns: int | None) -> Topic:
        """Return what was collected before a time (None: everything), by time; the rest stays."""
        topic = self._make_topic(path, name, type_name)
        self.room = max(self.room, self.count)
        self.count, self.t_ns, self.rows, self.found = 0, _Growing(self.room), {}, {}
        if until_ns is None:
            return topic
        before = cut_topic(topic, last_ns=until_ns - 1)
        n = len(before.t_ns)
        self.count = len(topic.t_ns) - n
        if self.count:
            self.t_ns.add(self.count, np.dtype(np.int64))[:] = topic.t_ns[n:]
        for part in topic.parts:
            first = int(np.searchsorted(part.rows, n))
            if first < len(part.rows):
                rest = {leaf: values[first:] for leaf, values in part.columns.items()}
                self._keep_columns(part.rows[first:] - n, rest)
        return before

    def _make_topic(self, path: Path, name: str, type_name: str) -> Topic:
        """Return all messages of the channel, sorted by time."""
        t_ns = self.t_ns.whole()
        place = None
        if (np.diff(t_ns) < 0).any():
            order = np.argsort(t_ns, kind="stable")
            t_ns = t_ns[order]
            place = np.empty_like(order)
            place[order] = np.arange(len(order))
        parts = []
        for shape, found in self.found.items():
            rows = self.rows[shape].whole()
            columns = {column: grown.whole() for column, grown in found.items()}
            if place is not None:
                rows = place[rows]
            if (np.diff(rows) < 0).any():
                by_row = np.argsort(rows)
                rows = rows[by_row]
                columns = {column: values[by_row] for column, values in columns.items()}
            parts.append(Part(rows, columns))
        return Topic(path, name, type_name, t_ns, tuple(parts))


def cut_topic(topic: Topic, first_ns: int | None = None, last_ns: int | None = None) -> Topic:
    """Return the messages of a topic within a range of log times, both ends included."""
    first = 0 if first_ns is None else int(np.searchsorted(topic.t_ns, first_ns, side="left"))
    last = len(topic.t_ns) if last_ns is None else int(np.searchsorted(topic.t_ns, last_ns, side="right"))
    parts = []
    for part in topic.parts:
        inside = slice(*np.searchsorted(part.rows, [first, last]).tolist())
        rows = part.rows[inside]
        if len(rows):
            parts.append(Part(rows - first, {name: values[inside] for name, values in part.columns.items()}))
    return replace(topic, t_ns=topic.t_ns[first:last], parts=tuple(parts))


class _View:
    """The layout of whole records, and the columns to take from them.

    ``columns`` are the leaves of each column; None: each leaf is one. Raises :class:`cdr.Undecodable` where the layout
    lacks one.
    """

    def __init__(self, layout: cdr.Layout, columns: Columns | None) -> None:
        """Plan how the wanted columns are copied from messages of one layout."""
        self.dtype = np.dtype([*MESSAGE_HEAD.descr, ("body", layout.dtype)])
        self.words = [int.from_bytes(word, "little") for _, word in layout.words]
        self.of_words = np.dtype(
            {
                "names": [str(k) for k in range(len(layout.words))],
                "formats": [f"<u{len(word)}" for _, word in layout.words],
                "offsets": [MESSAGE_HEAD.itemsize + at for at, _ in layout.words],
                "itemsize": self.dtype.itemsize,
            }
        )
        leaves: Any = layout.dtype.fields or {}
        self._columns = {leaf: (leaf,) for leaf in leaves} if columns is None else columns
        self.forms: dict[str, tuple[np.dtype[Any], tuple[int, ...]]] = {}  # of each column: dtype, shape of a row
        self._rows: dict[str, np.dtype[Any]] = {}  # of columns that lie in the message as they do in memory
        for name, parts in self._columns.items():
            if not all(part in leaves for part in parts):
                raise cdr.Undecodable(f"its messages have no {', '.join(parts)}")
            base, shape = leaves[parts[0]][0].base, leaves[parts[0]][0].shape
            self.forms[name] = (base, shape) if len(parts) == 1 else (np.dtype(np.float64), (len(parts),))
            first = leaves[parts[0]][1]
            if len(parts) > 1 and all(
                leaves[part] == (np.dtype(np.float64), first + k * 8) for k, part in enumerate(parts)
            ):
                row: Any = {"names": ["row"], "formats": [(np.void, 8 * len(parts))]}
                row |= {"offsets": [MESSAGE_HEAD.itemsize + first], "itemsize": self.dtype.itemsize}
                self._rows[name] = np.dtype(row)

    def copy(self, name: str, records: NDArray[np.void], room: NDArray[Any]) -> None:
        """Copy one column of some records."""
        parts = self._columns[name]
        if name in self._rows:
            rows = records.view(self._rows[name])["row"]
            room.view(rows.dtype)[:, 0] = rows
            return
        body = records.view(self.dtype)["body"]
        if len(parts) == 1:
            room[...] = body[parts[0]]
        else:
            for k, part in enumerate(parts):
                room[:, k] = body[part]

    def fits(self, records: NDArray[np.void]) -> NDArray[np.bool_]:
        """Return which records have the lengths of the message that the layout was made from."""
        fits = np.ones(len(records), np.bool_)
        columns = records.view(self.of_words)
        for k, word in enumerate(self.words):
            fits &= columns[str(k)] == word
        return fits


def _list_once(values: NDArray[Any]) -> list[int]:
    """Return each value once, in the order in which they come."""
    if bool((values == values[0]).all()):
        return [int(values[0])]
    found, first = np.unique(values, return_index=True)
    return [int(value) for value in found[np.argsort(first)]]


class _Growing:
    """An array that grows at its end, in the byte order of this machine.

    It doubles its room when that is full; room that was never written to takes no memory, so that a file is held once
    and not twice, as pieces and as their sum.
    """

    def __init__(self, room: int = 0) -> None:
        self.array: NDArray[Any] = np.empty(0, np.int64)
        self.count, self._least = 0, room

    def add(self, n: int, dtype: np.dtype[Any], shape: tuple[int, ...] = ()) -> NDArray[Any]:
        """Return room for n more rows, to be filled; of strings, the wider ones widen all."""
        end = self.count + n
        if dtype != self.array.dtype:
            dtype = dtype.newbyteorder("=")
            if self.count:
                dtype = np.promote_types(dtype, self.array.dtype)
        if end > len(self.array) or dtype != self.array.dtype:
            array = np.empty((max(end, 2 * len(self.array), self._least), *shape), dtype)
            if self.count:
                array[: self.count] = self.array[: self.count]
            self.array = array
        room = self.array[self.count : end]
        self.count = end
        return room

    def whole(self) -> NDArray[Any]:
        """Return all rows, without the room that is left."""
        self.array.resize((self.count, *self.array.shape[1:]), refcheck=False)
        return self.array
