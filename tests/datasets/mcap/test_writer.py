"""Our MCAP files in the readers of others: every checksum, every index, the same numbers."""

import struct
import zlib

import numpy as np
import pytest
import zstandard
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Chunk, MessageIndex
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
from ros_messages import ACCEL, FIELD, GYRO, IMU, T_NS, VECTOR, XYZ, N
from rosbags.highlevel import AnyReader

from stillpoint.datasets.mcap.writer import Stream, write_mcap


@pytest.fixture(scope="module")
def ours(tmp_path_factory):
    path = tmp_path_factory.mktemp("ours") / "ours.mcap"
    imu = {f"angular_velocity.{a}": GYRO[:, k] for k, a in enumerate(XYZ)}
    imu |= {f"linear_acceleration.{a}": ACCEL[:, k] for k, a in enumerate(XYZ)}
    streams = [
        Stream("/imu", IMU, T_NS, imu, {"header.frame_id": "imu", "orientation.w": 1.0}),
        Stream("/field", VECTOR, T_NS[::3] + 5, {f"vector.{a}": FIELD[::3, k] for k, a in enumerate(XYZ)}),
        Stream(
            "/wheel",
            "sensor_msgs/msg/JointState",
            T_NS[:7],
            {"position": FIELD[:7, :2]},
            {"name": 2, "name[0]": "left", "name[1]": "right"},
        ),
        Stream("/flag", "std_msgs/msg/Bool", T_NS[5:6], {"data": np.array([1], np.uint8)}),
    ]
    write_mcap(path, streams, {"facts": {"who": "tests", "é": "ü"}}, {"notes.txt": b"as it was", "empty": b""})
    return path


@pytest.mark.slow
def test_the_official_reader_accepts_every_checksum(ours):
    with ours.open("rb") as file:
        reader = NonSeekingReader(file, validate_crcs=True)  # tests the data section's, too
        messages = list(reader.iter_messages(log_time_order=False))
    times = np.array([message.log_time for _, _, message in messages])
    assert len(messages) == N + len(T_NS[::3]) + 7 + 1
    assert (np.diff(times) >= 0).all()
    assert [message.sequence for _, channel, message in messages if channel.topic == "/imu"] == list(range(N))
    raw = ours.read_bytes()
    footer = struct.unpack("<BQQQI", raw[-37:-8])
    assert footer[4] == zlib.crc32(raw[footer[2] : -12]) != 0


def test_messages_of_one_time_stand_in_the_order_of_their_streams(tmp_path):
    names = ["/c", "/a", "/b"]
    streams = [Stream(name, "std_msgs/msg/Bool", T_NS[:400], {"data": np.ones(400, np.uint8)}) for name in names]
    write_mcap(tmp_path / "x.mcap", streams, {}, {})
    with (tmp_path / "x.mcap").open("rb") as file:
        found = NonSeekingReader(file).iter_messages(log_time_order=False)
        assert [channel.topic for _, channel, _ in found] == names * 400


def test_the_official_reader_finds_facts_by_its_indexes(ours):
    with ours.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        assert [record.metadata for record in reader.iter_metadata()] == [{"who": "tests", "é": "ü"}]
        assert {a.name: a.data for a in reader.iter_attachments()} == {"notes.txt": b"as it was", "empty": b""}
        summary = reader.get_summary()
        assert summary.statistics.message_count == sum(summary.statistics.channel_message_counts.values())
        assert summary.statistics.chunk_count == len(summary.chunk_indexes) > 1
        assert summary.statistics.message_start_time == T_NS[0]
        assert summary.statistics.message_end_time == max(T_NS[-1], T_NS[::3][-1] + 5)
        assert {c.metadata["offered_qos_profiles"] for c in summary.channels.values()} == {""}
        late = list(reader.iter_messages(topics=["/field"], starting_at=int(T_NS[N // 2])))
    assert [message.log_time for *_, message in late] == [t for t in (T_NS[::3] + 5).tolist() if t >= T_NS[N // 2]]


def test_every_message_index_points_at_its_message(ours):
    entries = 0
    with ours.open("rb") as file:
        chunk = b""
        for record in StreamReader(file, emit_chunks=True).records:
            if isinstance(record, Chunk):
                chunk = zstandard.decompress(record.data)
            elif isinstance(record, MessageIndex):
                for time, offset in record.records:
                    opcode, _, channel, _, log_time = struct.unpack_from("<BQHIQ", chunk, offset)
                    assert (opcode, channel, log_time) == (5, record.channel_id, time)
                    entries += 1
    assert entries == N + len(T_NS[::3]) + 8


@pytest.mark.slow
def test_mcap_ros2_support_decodes_the_same_numbers(ours):
    with ours.open("rb") as file:
        decoded = list(make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages())
    imu = [message for _, channel, _, message in decoded if channel.topic == "/imu"]
    assert [[m.angular_velocity.x, m.angular_velocity.y, m.angular_velocity.z] for m in imu] == GYRO.tolist()
    assert {(m.header.frame_id, m.orientation.w, m.orientation.x) for m in imu} == {("imu", 1.0, 0.0)}
    assert [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in imu] == T_NS.tolist()
    (wheel, *_) = [message for _, channel, _, message in decoded if channel.topic == "/wheel"]
    assert (wheel.name, list(wheel.position), list(wheel.velocity)) == (["left", "right"], FIELD[0, :2].tolist(), [])


def test_rosbags_decodes_the_same_numbers(ours):
    with AnyReader([ours]) as reader:
        connections = [c for c in reader.connections if c.topic == "/imu"]
        assert connections[0].msgtype == IMU
        found = [reader.deserialize(raw, IMU) for _, _, raw in reader.messages(connections)]
    assert [[m.linear_acceleration.x, m.linear_acceleration.z] for m in found] == ACCEL[:, [0, 2]].tolist()
