"""A long bag in pieces, with the recording that :func:`~stillpoint.datasets.importers.ros.read_ros` makes.

Each batch of messages is read as a bag of its own. That gives the same recording where nothing depends on the whole:
one topic of an IMU, at most one of a magnetometer, no fixes, no truth, stamps that rise, one frame. Whatever else
a batch shows is left to the reading of the whole, which needs memory for the whole.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.errors import BadRecording, BadSource, StillpointError
from stillpoint.datasets.files.scratch import ScratchStore
from stillpoint.datasets.importers.columns import STANDARD_GRAVITY_MPS2
from stillpoint.datasets.importers.files import hash_files
from stillpoint.datasets.importers.imported import LEAST_NORM, make_device_estimate
from stillpoint.datasets.importers.long_recording import Collector, LongRecording, NotInPiecesError
from stillpoint.datasets.importers.ros import (
    IMU,
    IMU_LEAVES,
    MAG,
    MAG_LEAVES,
    RosOptions,
    choose_topics,
    read_imu,
    read_mag,
)
from stillpoint.datasets.importers.ros_files import Messages, collect_messages, open_ros
from stillpoint.datasets.importers.ros_frames import StaticFrames
from stillpoint.datasets.importers.series import Log, Series
from stillpoint.datasets.mcap.reader import Log as McapLog
from stillpoint.datasets.recording import Imu, Info, Recording
from stillpoint.datasets.trajectory import Estimate

BATCH_MESSAGES = 1 << 16
_MOST_LATE_NS = 3_600_000_000_000  # spread of the times between stamp and receipt; more may be a clock that was set
_MIXED_SHARE = 0.05  # of accelerations of the size of g, and of about 1, from which the whole is looked at


def read_ros_pieces(source: Path, options: RosOptions) -> LongRecording | None:
    """Return the recording of a bag, in memory that does not grow with it; None where it has to be read whole.

    Raises :class:`BadSource` for sizes that do not fit the units.
    """
    others = (options.gyro_topic, options.accel_topic, options.gps_topic, options.truth_topic, options.truth_parent,
              options.truth_child, options.frame, options.body_frame)  # fmt: skip
    if any(one is not None for one in others):
        return None
    try:
        return _Reader(source, options).read()
    except BadSource as error:
        if isinstance(error.__cause__, BadRecording):
            raise
        return None
    except (StillpointError, NotInPiecesError):
        return None


class _Reader:
    """Reads one bag."""

    def __init__(self, source: Path, options: RosOptions) -> None:
        """Open the bag, and choose its topics; raises :class:`NotInPiecesError` where it has to be in memory whole."""
        self._source, self._options = source, options
        self._bag = open_ros(source)
        self._log = Log(notes=list(self._bag.notes))
        chosen = choose_topics(self._bag, options, self._log)
        if len(chosen.imu) != 1 or chosen.gps is not None or chosen.truth is not None:
            raise NotInPiecesError
        self._imu_topic, self._mag_topic = chosen.imu[0], chosen.mag
        self._found = Collector(source.stem, options)
        self._late_ns: dict[str, tuple[int, int]] = {}
        self._frames: dict[str, str] = {}
        self._sizes = np.zeros(3, np.int64)  # accelerations: all, near g in m/s^2, near 1
        self._device = ScratchStore()
        self._device_range: NDArray[np.float64] | None = None  # (2, 4) least and largest of each component
        self._has_device: bool | None = None

    def read(self) -> LongRecording:
        """Return the recording of all batches."""
        topics = [topic for topic in (self._imu_topic, self._mag_topic) if topic is not None]
        for batch in self._bag.read_batches(topics, BATCH_MESSAGES):
            if any(len(topic.t_ns) for topic in batch.topics.values()) or batch.unread:
                self._add_piece([batch])
        if self._sizes[1:].min() > _MIXED_SHARE * self._sizes[0]:
            raise NotInPiecesError
        for line in self._found.conversions:
            self._log.add_conversion(line)
        sha256 = hash_files(self._bag.files, self._source.parent if self._source.is_file() else self._source)
        estimate = self._make_estimate(sha256)
        long = self._found.close(f"ROS bag {self._source.name}", str(self._source), sha256, self._log)
        if estimate is None:
            return long
        return replace(long, estimates=_Estimates(estimate, self._device).pieces)

    def _add_piece(self, logs: Sequence[McapLog]) -> None:
        """Add the messages of one piece; raises :class:`NotInPiecesError` where they need the whole recording."""
        log = Log()
        messages = collect_messages(self._imu_topic, IMU, logs, IMU_LEAVES)
        self._check(messages)
        imu, device = read_imu(self._source, [messages], self._options, StaticFrames.none(), log)
        mag, uncalibrated = None, self._options.mag_uncalibrated
        if self._mag_topic is not None:
            fields = collect_messages(self._mag_topic, MAG, logs, MAG_LEAVES)
            self._check(fields)
            mag, uncalibrated = read_mag(fields, self._options, StaticFrames.none(), log)
        if log.notes or log.is_resampled or len(imu.t_ns) != len(messages.stamps_ns):
            raise NotInPiecesError
        if uncalibrated != self._options.mag_uncalibrated:
            raise NotInPiecesError
        self._count_sizes(imu)
        self._keep_device(imu, device)
        self._found.add(Recording(self._source.stem, imu=imu, mag=mag, info=Info(units_unchecked=True)), log)

    def _check(self, messages: Messages) -> None:
        """Raise where stamps or frames are such that only the whole tells what to do with them."""
        late_ns = messages.stamps_ns - messages.logged_ns
        least, most = self._late_ns.get(messages.topic, (int(late_ns.min()), int(late_ns.max())))
        least, most = min(least, int(late_ns.min())), max(most, int(late_ns.max()))
        self._late_ns[messages.topic] = least, most
        frame = self._frames.setdefault(messages.topic, str(messages.frames[0]))
        if most - least > _MOST_LATE_NS or not messages.stamps_ns.all() or (messages.frames != frame).any():
            raise NotInPiecesError

    def _count_sizes(self, imu: Imu) -> None:
        """Count samples with a specific force near 1 g in m/s^2, and near 1, for the check of the unit."""
        size = np.linalg.norm(imu.accel_b_mps2, axis=1)
        near = [int((np.abs(size / gravity - 1) < 0.15).sum()) for gravity in (STANDARD_GRAVITY_MPS2, 1.0)]
        self._sizes += [len(size), *near]

    def _keep_device(self, imu: Imu, device: Series | None) -> None:
        """Keep the attitude of the device, which every message gives, or none."""
        if self._has_device is None:
            self._has_device = device is not None
        if self._has_device != (device is not None):
            raise NotInPiecesError
        if device is None:
            return
        norm = np.linalg.norm(device.values, axis=1)
        if len(norm) != len(imu.t_ns) or not (np.isfinite(norm) & (norm > LEAST_NORM)).all():
            raise NotInPiecesError
        ends = np.stack([device.values.min(axis=0), device.values.max(axis=0)])
        if self._device_range is not None:
            both = np.stack([self._device_range, ends])
            ends = np.stack([both[:, 0].min(axis=0), both[:, 1].max(axis=0)])
        self._device_range = ends
        rows = np.empty(len(norm), [("t_ns", np.int64), ("q_nb", np.float64, 4)])
        rows["t_ns"], rows["q_nb"] = device.t_ns, device.values
        self._device.append(rows)

    def _make_estimate(self, sha256: dict[str, str]) -> Estimate | None:
        """Return an estimate of two samples with the facts of the whole, and say in the log what became of it."""
        if self._device_range is None:
            return None
        pair = np.zeros((2, 4))
        pair[:, 0] = 1.0
        if np.ptp(self._device_range, axis=0).max() > 0:
            pair[1] = [0.0, 1.0, 0.0, 0.0]
        made = make_device_estimate(
            np.array([0, 1]), pair, self._source.stem, f"orientation of {self._imu_topic}", sha256, self._log
        )
        return made[0] if made else None


@dataclass(frozen=True)
class _Estimates:
    """The attitude of the device in pieces."""

    facts: Estimate
    store: ScratchStore

    def pieces(self) -> Iterator[Estimate]:
        """Yield the pieces; can be called several times."""
        for rows in self.store:
            q_nb = np.ascontiguousarray(rows["q_nb"])
            norm = np.linalg.norm(q_nb, axis=1)
            yield replace(self.facts, t_ns=np.ascontiguousarray(rows["t_ns"]), q_nb=q_nb / norm[:, None])
