"""Replay a recording live to Foxglove, with the estimates of streaming estimators.

The recording's own messages go out as they lie in the file (``cdr`` with ``ros2msg`` schemas), so the same layout shows
the file and the replay. Beside them are one transform ``map`` -> ``imu_link/NAME`` and one pose per estimator.
"""

import heapq
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from threading import Event
from typing import Any

import foxglove
from foxglove import Channel, Context, Schema
from foxglove.channels import FrameTransformsChannel, PoseInFrameChannel
from foxglove.messages import FrameTransform, FrameTransforms, Pose, PoseInFrame, Quaternion, Timestamp, Vector3
from foxglove.websocket import Capability, ChannelView, Client, ServerListener
from mcap.reader import make_reader

from stillpoint.datasets import Recording
from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.mcap.topics import BODY_FRAME, LOCAL_FRAME
from stillpoint.filters import Stream
from stillpoint.scripts.shared.output import print_line
from stillpoint.scripts.streaming.lines import Arrival
from stillpoint.scripts.streaming.streams import replay_samples

_ORIGIN = Vector3(x=0.0, y=0.0, z=0.0)
_POSES_HZ = 60.0  # of real time: no screen shows more
_PATIENCE_S = 0.5  # for a client to ask for all its topics, and for the last messages to leave
_BACKLOG = 16384  # messages that wait for a slow client


class _FirstClient(ServerListener):
    """Signals when the first client has subscribed."""

    def __init__(self) -> None:
        self.is_there = Event()

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        self.is_there.set()


def replay_live(
    file: Path, recording: Recording, streams: Mapping[str, Stream], host: str, port: int, speed: float
) -> int:
    """Wait for a client, then send the recording at ``speed`` times its own pace. Return the number of samples.

    Ends with the recording, or by Ctrl-C. Raises :class:`BadParameter` when the port cannot be listened on.
    """
    context, client = Context(), _FirstClient()
    estimates = _Estimates(streams, context)
    raw = _RawMessages(file, context)
    try:
        server = foxglove.start_server(
            name=f"stillpoint {file.name}",
            host=host,
            port=port,
            capabilities=[Capability.Time],
            server_listener=client,
            context=context,
            message_backlog_size=_BACKLOG,
        )
    except Exception as error:  # the package has no class of its own for it
        raise BadParameter(
            f"--foxglove {port}: cannot listen on {host} ({error}); name another port or host"
        ) from error
    try:
        print_line(f"stillpoint: waiting for Foxglove to open ws://{host}:{server.port}", file=sys.stderr, flush=True)
        while not client.is_there.wait(0.1):
            pass
        time.sleep(_PATIENCE_S)
        stamped = ((sample.t_ns, sample) for sample in replay_samples(recording))
        _send_messages(heapq.merge(raw, stamped, key=lambda timed: timed[0]), server, raw, estimates, speed)
        time.sleep(_PATIENCE_S)
    except KeyboardInterrupt:
        pass  # the ordinary way to end it early
    finally:
        server.stop()
    return estimates.n_samples


def _send_messages(
    timed: Iterator[tuple[int, Any]], server: Any, raw: "_RawMessages", estimates: "_Estimates", speed: float
) -> None:
    """Send each message when its time has come."""
    begun, first_ns = time.monotonic(), None
    for t_ns, what in timed:
        first_ns = t_ns if first_ns is None else first_ns
        ahead_s = (t_ns - first_ns) / 1e9 / speed - (time.monotonic() - begun)
        if ahead_s > 0:
            time.sleep(ahead_s)
        if isinstance(what, Arrival):
            estimates.update(what)
            server.broadcast_time(t_ns)
        else:
            raw.send(t_ns, *what)


class _RawMessages:
    """The messages of a file with their log times, and a channel for each topic."""

    def __init__(self, file: Path, context: Context) -> None:
        """Declare the channels of a file in the context of a server."""
        self._file = file
        self._channels: dict[int, Channel] = {}
        with file.open("rb") as stream:
            summary = make_reader(stream).get_summary()
        assert summary is not None, "a file that was read has a summary"
        for number, channel in summary.channels.items():
            schema = summary.schemas.get(channel.schema_id)
            described = None
            if schema is not None:
                described = Schema(name=schema.name, encoding=schema.encoding, data=schema.data)
            self._channels[number] = Channel(
                channel.topic, schema=described, message_encoding=channel.message_encoding, context=context
            )

    def __iter__(self) -> Iterator[tuple[int, Any]]:
        with self._file.open("rb") as stream:
            for _, channel, message in make_reader(stream).iter_messages():
                yield message.log_time, (channel.id, message.data)

    def send(self, t_ns: int, number: int, data: bytes) -> None:
        """Send one message as it is in the file."""
        self._channels[number].log(data, log_time=t_ns)


class _Estimates:
    """The streams of estimators, and a channel for each."""

    def __init__(self, streams: Mapping[str, Stream], context: Context) -> None:
        """Open channels for the transforms and for the pose of each stream."""
        self._streams = streams
        self._transforms = FrameTransformsChannel("/tf", context=context)
        self._poses = {name: PoseInFrameChannel(f"/estimate/{name}/pose", context=context) for name in streams}
        self._sent = 0.0
        self.n_samples = 0

    def update(self, sample: Arrival) -> None:
        """Feed one sample to every stream; send to Foxglove no more often than a screen shows it."""
        estimates = {name: stream.update(*sample) for name, stream in self._streams.items()}
        self.n_samples += 1
        if time.monotonic() - self._sent < 1 / _POSES_HZ:
            return
        self._sent = time.monotonic()
        stamp = Timestamp(sec=sample.t_ns // 10**9, nsec=sample.t_ns % 10**9)
        transforms = []
        for name, output in estimates.items():
            w, x, y, z = output.q_nb
            turned = Quaternion(x=x, y=y, z=z, w=w)
            transforms.append(
                FrameTransform(
                    timestamp=stamp,
                    parent_frame_id=LOCAL_FRAME,
                    child_frame_id=f"{BODY_FRAME}/{name}",
                    translation=_ORIGIN,
                    rotation=turned,
                )
            )
            pose = PoseInFrame(timestamp=stamp, frame_id=LOCAL_FRAME, pose=Pose(position=_ORIGIN, orientation=turned))
            self._poses[name].log(pose, log_time=sample.t_ns)
        self._transforms.log(FrameTransforms(transforms=transforms), log_time=sample.t_ns)
