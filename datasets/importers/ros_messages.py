"""Columns of ROS messages, from bags (message by message) and from MCAP files (in bulk)."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.typesys import Stores, get_typestore

from stillpoint.datasets.errors import BadFile, BadParameter, BadSource
from stillpoint.datasets.importers.clock import Log, Series
from stillpoint.datasets.mcap.reader import read_log, survey

TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")  # lists of transforms


def _leaves(prefix: str, names: str) -> tuple[str, ...]:
    return tuple(f"{prefix}.{name}" for name in names)


def _pose(prefix: str) -> tuple[str, ...]:
    return (*_leaves(f"{prefix}.orientation", "wxyz"), *_leaves(f"{prefix}.position", "xyz"))


_TRANSFORM = (*_leaves("transform.rotation", "wxyz"), *_leaves("transform.translation", "xyz"))

# stream -> message type -> its numbers, in the order of the importer
LEAVES: dict[str, dict[str, tuple[str, ...]]] = {
    "imu": {"sensor_msgs/msg/Imu": (*_leaves("angular_velocity", "xyz"), *_leaves("linear_acceleration", "xyz"))},
    "mag": {"sensor_msgs/msg/MagneticField": _leaves("magnetic_field", "xyz")},
    "gps": {"sensor_msgs/msg/NavSatFix": ("latitude", "longitude", "altitude", "status.status")},
    "truth": {
        "geometry_msgs/msg/PoseStamped": _pose("pose"),
        "geometry_msgs/msg/PoseWithCovarianceStamped": _pose("pose.pose"),
        "nav_msgs/msg/Odometry": _pose("pose.pose"),
        "geometry_msgs/msg/TransformStamped": _TRANSFORM,
        "geometry_msgs/msg/QuaternionStamped": _leaves("quaternion", "wxyz"),
        **dict.fromkeys(TF, _TRANSFORM),
    },
}


class Source(Protocol):
    """What a bag and an MCAP file have in common."""

    @property
    def types(self) -> Mapping[str, str]:
        """Topic -> message type."""

    def read(self, topic: str, leaves: tuple[str, ...], child: str | None, log: Log) -> Series:
        """The numbers of a topic on the stamps of its headers."""


@contextmanager
def open_source(source: Path) -> Iterator[Source]:
    """A bag or an MCAP file; raises :class:`BadSource` for what is neither."""
    if source.is_file() and source.suffix == ".mcap":
        try:
            yield McapSource(source, dict(survey(source).types))
        except BadFile as error:
            raise BadSource(str(error)) from None
        return
    if source.is_file() and source.suffix not in (".bag", ".db3"):
        raise BadSource(f"{source}: is no bag; name a ROS 1 .bag, the folder of a ROS 2 bag, or an .mcap")
    if source.is_dir() and not (source / "metadata.yaml").is_file():
        raise BadSource(f"{source}: holds no metadata.yaml; name the folder of a ROS 2 bag, a ROS 1 .bag, or an .mcap")
    try:
        with AnyReader([source], default_typestore=get_typestore(Stores.LATEST)) as reader:
            yield BagSource(source, reader, {c.topic: c.msgtype for c in reader.connections})
    except (AnyReaderError, OSError, KeyError) as error:
        raise BadSource(
            f"{source}: cannot be read as a bag ({' '.join(str(error).split())}); record it again"
        ) from None


@dataclass(frozen=True)
class McapSource:
    """An MCAP file, read in bulk."""

    path: Path
    types: Mapping[str, str]

    def read(self, topic: str, leaves: tuple[str, ...], child: str | None, log: Log) -> Series:
        """The numbers of a topic; transforms, whose number differs per message, go one by one."""
        if self.types[topic] in TF:
            with AnyReader([self.path], default_typestore=get_typestore(Stores.LATEST)) as reader:
                return BagSource(self.path, reader, self.types).read(topic, leaves, child, log)
        found = read_log(self.path, [topic])
        if topic not in found.topics:
            reason = found.unread.get(topic, "it has no message")
            raise BadSource(f"{self.path}: {topic} cannot be read: {reason}; name another topic, or record it again")
        if found.lost:
            log.noted(f"{topic}: {found.lost}")
        columns = found.topics[topic]
        values = np.column_stack([np.asarray(columns.column(leaf), dtype=np.float64) for leaf in leaves])
        stamps = columns.stamps_ns()
        return Series(_stamped(stamps, columns.t_ns, topic, log), values)


@dataclass(frozen=True)
class BagSource:
    """A ROS 1 or ROS 2 bag, read message by message."""

    path: Path
    reader: AnyReader
    types: Mapping[str, str]

    def read(self, topic: str, leaves: tuple[str, ...], child: str | None, log: Log) -> Series:
        """The numbers of a topic; of a TF topic those of the one child frame."""
        rows: list[tuple[float, ...]] = []
        stamps: list[int] = []
        logged: list[int] = []
        children: set[str] = set()
        numbers = attrgetter(*leaves)
        for connection, log_ns, raw in self.reader.messages([c for c in self.reader.connections if c.topic == topic]):
            message: Any = self.reader.deserialize(raw, connection.msgtype)
            for part in message.transforms if connection.msgtype in TF else (message,):
                if connection.msgtype in TF:
                    children.add(part.child_frame_id)
                    if child not in (None, part.child_frame_id):
                        continue
                rows.append(numbers(part))
                stamps.append(part.header.stamp.sec * 1_000_000_000 + part.header.stamp.nanosec)
                logged.append(log_ns)
        if child is None and len(children) > 1:
            raise BadParameter(f"{self.path}: {topic} moves {', '.join(sorted(children))}; name one by --truth-child")
        if not rows:
            frames = f" for the child {child}; it has {', '.join(sorted(children))}" if children else ""
            raise BadSource(f"{self.path}: {topic} holds no message{frames}; name another")
        times = _stamped(np.array(stamps, dtype=np.int64), np.array(logged, dtype=np.int64), topic, log)
        return Series(times, np.array(rows, dtype=np.float64).reshape(len(rows), -1))


def _stamped(stamps_ns: np.ndarray, logged_ns: np.ndarray, topic: str, log: Log) -> np.ndarray:
    """The stamps of the headers, and the time of logging where a header has none."""
    missing = stamps_ns == 0
    # A single zero may be the true start of a simulated clock; several are an unset field.
    if missing.sum() > 1:
        log.noted(f"{topic}: {int(missing.sum())} headers without a stamp; the time of logging is used for them")
        return np.where(missing, logged_ns, stamps_ns)
    return stamps_ns
