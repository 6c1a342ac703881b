"""Our files in the readers of others; the files of other writers in ours; damage that no checksum sees."""

import struct
import zlib
from dataclasses import replace

import foxglove
import numpy as np
import pytest
import zstandard
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Chunk, MessageIndex
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as OfficialWriter
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer as Ros2Writer
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore

from stillpoint.datasets import BadFile, cdr, read
from stillpoint.datasets.mcap_reader import read_log, survey
from stillpoint.datasets.mcap_writer import Stream, write_mcap

STORE = get_typestore(Stores.ROS2_HUMBLE)
IMU, VECTOR, TF = "sensor_msgs/msg/Imu", "geometry_msgs/msg/Vector3Stamped", "tf2_msgs/msg/TFMessage"
N = 4000  # some 1.5 MB of Imu messages: several chunks
T_NS = np.arange(N, dtype=np.int64) * 2_500_000 + 1_700_000_000_000_000_000
RNG = np.random.default_rng(5)
GYRO, ACCEL, FIELD = RNG.normal(size=(3, N, 3))
XYZ = "xyz"


def header(t_ns, frame):
    stamp = STORE.types["builtin_interfaces/msg/Time"](int(t_ns // 10**9), int(t_ns % 10**9))
    return STORE.types["std_msgs/msg/Header"](stamp, frame)


def vector(values):
    return STORE.types["geometry_msgs/msg/Vector3"](*map(float, values))


def imu_message(k, frame="imu"):
    zeros = np.zeros(9)
    q = STORE.types["geometry_msgs/msg/Quaternion"](0.1, 0.2, 0.3, 0.4)
    return STORE.types[IMU](header(T_NS[k], frame), q, zeros, vector(GYRO[k]), zeros, vector(ACCEL[k]), zeros)


def with_lists(message):
    """As mcap-ros2-support wants it."""
    names = ("orientation_covariance", "angular_velocity_covariance", "linear_acceleration_covariance")
    return replace(message, **{name: getattr(message, name).tolist() for name in names})


def vector_message(k, frame="field"):
    return STORE.types[VECTOR](header(T_NS[k] + 5, frame), vector(FIELD[k]))


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


# --- ours, read by others


def test_the_official_reader_accepts_every_checksum(ours):
    with ours.open("rb") as file:
        reader = NonSeekingReader(file, validate_crcs=True)  # tests the data section's, too
        messages = list(reader.iter_messages(log_time_order=False))
    times = np.array([message.log_time for _, _, message in messages])
    assert len(messages) == N + len(T_NS[::3]) + 7 + 1
    assert (np.diff(times) >= 0).all()
    raw = ours.read_bytes()
    footer = struct.unpack("<BQQQI", raw[-37:-8])
    assert footer[4] == zlib.crc32(raw[footer[2] : -12]) != 0


def test_the_official_reader_finds_facts_by_its_indexes(ours):
    with ours.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        assert [record.metadata for record in reader.iter_metadata()] == [{"who": "tests", "é": "ü"}]
        assert {a.name: a.data for a in reader.iter_attachments()} == {"notes.txt": b"as it was", "empty": b""}
        summary = reader.get_summary()
        assert summary.statistics.message_count == sum(summary.statistics.channel_message_counts.values())
        assert summary.statistics.chunk_count == len(summary.chunk_indexes) > 1
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


# --- others', read by ours


def check_imu_and_field(path, rows=N, frame="imu"):
    log = read_log(path)
    imu, field = log.topics["/imu"], log.topics["/field"]
    assert log.lost == ""
    assert (imu.type_name, field.type_name) == (IMU, VECTOR)
    np.testing.assert_array_equal(imu.t_ns, T_NS[:rows])
    np.testing.assert_array_equal(imu.stamps_ns(), T_NS[:rows])
    np.testing.assert_array_equal(imu.vector("angular_velocity", XYZ), GYRO[:rows])
    np.testing.assert_array_equal(imu.vector("linear_acceleration", XYZ), ACCEL[:rows])
    np.testing.assert_array_equal(imu.vector("orientation", "wxyz"), np.tile([0.4, 0.1, 0.2, 0.3], (rows, 1)))
    np.testing.assert_array_equal(field.vector("vector", XYZ), FIELD[:rows])
    assert set(imu.text("header.frame_id")) == {frame}
    assert log.counts == {**log.counts, "/imu": rows, "/field": rows}
    return log


def bag(path, writer, rows=N):
    """Imu and Vector3Stamped messages through any writer with the call of mcap's."""
    schemas = {name: writer.register_schema(name, "ros2msg", cdr.definition(name).encode()) for name in (IMU, VECTOR)}
    imu = writer.register_channel("/imu", "cdr", schemas[IMU])
    field = writer.register_channel("/field", "cdr", schemas[VECTOR])
    for k in range(rows):
        for channel, name, message in ((imu, IMU, imu_message(k)), (field, VECTOR, vector_message(k))):
            little = k % 2 == 0 or "big" not in path.name
            body = bytes(STORE.serialize_cdr(message, name, little_endian=little))
            writer.add_message(channel, int(T_NS[k]), body, int(T_NS[k]))
    writer.finish()


OFFICIAL = {
    "zstd": {},
    "lz4": {"compression": CompressionType.LZ4, "chunk_size": 50_000},
    "none": {"compression": CompressionType.NONE},
    "no-chunks": {"use_chunking": False},
    "no-index": {"index_types": IndexType.NONE, "use_statistics": False},
    "no-summary": {"use_statistics": False, "use_summary_offsets": False, "repeat_channels": False},
    "no-crc": {"enable_crcs": False},
    "data-crc": {"enable_data_crcs": True},
    "big-endian-every-other": {},
}


@pytest.mark.parametrize("kind", OFFICIAL)
def test_files_of_the_official_writer(tmp_path, kind):
    path, rows = tmp_path / f"{kind}.mcap", 900
    with path.open("wb") as file:
        writer = OfficialWriter(file, **OFFICIAL[kind])
        writer.start(profile="ros2")
        bag(path, writer, rows)
    check_imu_and_field(path, rows)


def test_files_of_mcap_ros2_support(tmp_path):
    path = tmp_path / "x.mcap"
    with path.open("wb") as file:
        writer = Ros2Writer(file)
        imu, field = (writer.register_msgdef(name, cdr.definition(name)) for name in (IMU, VECTOR))
        for k in range(300):
            writer.write_message("/imu", imu, with_lists(imu_message(k)), log_time=int(T_NS[k]))
            writer.write_message("/field", field, vector_message(k), log_time=int(T_NS[k]))
        writer.finish()
    check_imu_and_field(path, 300)


def test_files_of_rosbags(tmp_path):
    with BagWriter(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        imu = writer.add_connection("/imu", IMU, typestore=STORE)
        field = writer.add_connection("/field", VECTOR, typestore=STORE)
        for k in range(N):
            writer.write(imu, int(T_NS[k]), STORE.serialize_cdr(imu_message(k), IMU))
            writer.write(field, int(T_NS[k]), STORE.serialize_cdr(vector_message(k), VECTOR))
    (path,) = (tmp_path / "bag").glob("*.mcap")
    check_imu_and_field(path)


def test_files_of_foxglove_sdk(tmp_path):
    path = tmp_path / "x.mcap"
    with foxglove.open_mcap(path):
        channels = {}
        for topic, name in (("/imu", IMU), ("/field", VECTOR)):
            schema = foxglove.Schema(name=name, encoding="ros2msg", data=cdr.definition(name).encode())
            channels[topic] = foxglove.Channel(topic, message_encoding="cdr", schema=schema)
        for k in range(300):
            for topic, name, message in (("/imu", IMU, imu_message(k)), ("/field", VECTOR, vector_message(k))):
                channels[topic].log(bytes(STORE.serialize_cdr(message, name)), log_time=int(T_NS[k]))
        foxglove.Channel("/words", message_encoding="json").log({"a": 1}, log_time=int(T_NS[0]))
    log = check_imu_and_field(path, 300)
    assert log.counts["/words"] == 1
    assert log.unread == {"/words": "its messages are json, not cdr"}


def one_topic(path, type_name, bodies, times=None, **options):
    """A file of raw messages on /x."""
    with path.open("wb") as file:
        writer = OfficialWriter(file, **options)
        writer.start(profile="ros2")
        schema = writer.register_schema(type_name, "ros2msg", cdr.definition(type_name).encode())
        channel = writer.register_channel("/x", "cdr", schema)
        for k, body in enumerate(bodies):
            t = k if times is None else int(times[k])
            writer.add_message(channel, t, body, t)
        writer.finish()
    return path


def test_frame_ids_may_change_from_message_to_message(tmp_path):
    frames = ["a", "imu_link", "", "b", "öl"] * 60
    bodies = [bytes(STORE.serialize_cdr(imu_message(k, frames[k]), IMU)) for k in range(300)]
    topic = read_log(one_topic(tmp_path / "x.mcap", IMU, bodies, chunk_size=9000)).topics["/x"]
    assert topic.text("header.frame_id").tolist() == frames
    np.testing.assert_array_equal(topic.vector("angular_velocity", XYZ), GYRO[:300])
    assert len(topic.parts) == 1


def test_messages_out_of_order_are_sorted_by_log_time(tmp_path):
    order = np.random.default_rng(2).permutation(300)
    frames = ["a", "much_longer"] * 150
    bodies = [bytes(STORE.serialize_cdr(imu_message(k, frames[k]), IMU)) for k in order]
    topic = read_log(one_topic(tmp_path / "x.mcap", IMU, bodies, order, chunk_size=9000)).topics["/x"]
    assert topic.t_ns.tolist() == list(range(300))
    np.testing.assert_array_equal(topic.vector("angular_velocity", XYZ), GYRO[:300])
    assert topic.text("header.frame_id").tolist() == frames


def test_transforms_of_changing_number_lie_in_parts(tmp_path):
    def transforms(k):
        kind, transform = STORE.types["geometry_msgs/msg/TransformStamped"], STORE.types["geometry_msgs/msg/Transform"]
        q = STORE.types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
        return [kind(header(T_NS[k], "map"), f"tag{j}", transform(vector(GYRO[k] + j), q)) for j in range(k % 3)]

    bodies = [bytes(STORE.serialize_cdr(STORE.types[TF](transforms(k)), TF)) for k in range(90)]
    topic = read_log(one_topic(tmp_path / "x.mcap", TF, bodies)).topics["/x"]
    assert sorted(len(part.rows) for part in topic.parts) == [30, 30, 30]
    for part in topic.parts:
        leaf = "transforms[1].transform.translation.x"
        if leaf in part.columns:
            np.testing.assert_array_equal(part.columns[leaf], GYRO[part.rows, 0] + 1)
            assert (part.rows % 3 == 2).all()
    with pytest.raises(BadFile, match=r"/x .*has no transforms\[0\]"):
        topic.column("transforms[0].child_frame_id")


def test_sequences_that_change_their_length_are_refused_as_a_column(tmp_path):
    name = "std_msgs/msg/Float64MultiArray"
    layout = STORE.types["std_msgs/msg/MultiArrayLayout"]([], 0)
    bodies = [bytes(STORE.serialize_cdr(STORE.types[name](layout, np.zeros(1 + k % 2)), name)) for k in range(4)]
    topic = read_log(one_topic(tmp_path / "x.mcap", name, bodies)).topics["/x"]
    with pytest.raises(BadFile, match="data changes its length"):
        topic.column("data")


def test_what_cannot_be_decoded_is_named_and_the_rest_is_read(tmp_path):
    path = tmp_path / "x.mcap"
    with path.open("wb") as file:
        writer = OfficialWriter(file)
        writer.start()
        json_schema = writer.register_schema("note", "jsonschema", b"{}")
        vectors = writer.register_schema(VECTOR, "ros2msg", cdr.definition(VECTOR).encode())
        flat = bytes(STORE.serialize_cdr(vector_message(0), VECTOR))
        rows = {
            "/good": ("cdr", vectors, flat),
            "/json": ("json", json_schema, b"{}"),
            "/xcdr2": ("cdr", vectors, b"\0\7" + flat[2:]),
            "/no-schema": ("cdr", 0, flat),
            "/cut": ("cdr", vectors, flat[:40]),
        }
        for topic, (encoding, schema, body) in rows.items():
            writer.add_message(writer.register_channel(topic, encoding, schema), 7, body, 7)
        writer.finish()
    log = read_log(path)
    assert list(log.topics) == ["/good"]
    reasons = {"/json": "json", "/xcdr2": "not plain CDR", "/no-schema": "no schema", "/cut": "ends within vector"}
    assert log.unread.keys() == reasons.keys()
    assert all(reasons[topic] in reason for topic, reason in log.unread.items())
    assert survey(path).counts == dict.fromkeys(rows, 1)
    assert survey(path).topics == {}


def test_a_foreign_file_is_named_with_what_it_holds_and_the_verb_that_takes_it(ours):
    with pytest.raises(
        BadFile, match=r"no file of stillpoint; it holds /imu \(sensor_msgs/msg/Imu, 4000 messages\)"
    ) as e:
        read(ours)
    assert "`stillpoint import ros " in str(e.value)


# --- damage


def test_a_writer_that_was_killed_leaves_its_whole_chunks(tmp_path):
    path = tmp_path / "killed.mcap"
    with path.open("wb") as file:
        writer = OfficialWriter(file, chunk_size=20_000)
        writer.start(profile="ros2")
        writer.finish = lambda: None
        bag(path, writer, 900)
    log = read_log(path)
    rows = len(log.topics["/imu"].t_ns)
    assert 700 < rows < 900
    np.testing.assert_array_equal(log.topics["/imu"].vector("angular_velocity", XYZ), GYRO[:rows])
    assert "cut short" in log.lost


def test_the_open_chunk_of_foxglove_sdk_is_left_out(tmp_path):
    """It writes 2^64 - 1 as the length of a chunk that it has not closed."""
    whole = one_topic(tmp_path / "x.mcap", VECTOR, [bytes(STORE.serialize_cdr(vector_message(0), VECTOR))] * 9)
    raw = whole.read_bytes()
    data_end = raw.rindex(struct.pack("<BQ", 15, 4))
    whole.write_bytes(raw[:data_end] + struct.pack("<BQ", 6, 2**64 - 1) + b"\0" * 100)
    log = read_log(whole)
    assert len(log.topics["/x"].t_ns) == 9
    assert "claims 18446744073709551615 bytes" in log.lost


def test_without_checksums_any_flipped_bit_gives_numbers_or_one_line(tmp_path):
    """Foreign files may lack every CRC: then a flip can pass, but never as another exception or a huge allocation."""
    bodies = [bytes(STORE.serialize_cdr(vector_message(k), VECTOR)) for k in range(20)]
    rng = np.random.default_rng(8)
    for options in ({"compression": CompressionType.NONE}, {}, {"use_chunking": False}):
        raw = one_topic(tmp_path / "x.mcap", VECTOR, bodies, enable_crcs=False, **options).read_bytes()
        for at in rng.integers(0, len(raw), 250):
            broken = bytearray(raw)
            broken[at] ^= 1 << int(rng.integers(8))
            (tmp_path / "y.mcap").write_bytes(broken)
            try:
                read_log(tmp_path / "y.mcap")
            except BadFile as error:
                assert "\n" not in str(error)  # noqa: PT017


def test_an_index_that_points_elsewhere_or_leaves_out_messages_does_not_mislead(tmp_path):
    bodies = [bytes(STORE.serialize_cdr(vector_message(k), VECTOR)) for k in range(20)]
    raw = one_topic(tmp_path / "x.mcap", VECTOR, bodies, enable_crcs=False).read_bytes()
    index = raw.index(struct.pack("<BQH", 7, 6 + 20 * 16, 1))
    for entry, offset in ((3, 5), (3, 2**63), (0, 0), (19, 2**40)):
        broken = bytearray(raw)
        struct.pack_into("<Q", broken, index + 15 + entry * 16 + 8, offset)
        (tmp_path / "y.mcap").write_bytes(broken)
        np.testing.assert_array_equal(read_log(tmp_path / "y.mcap").topics["/x"].vector("vector", XYZ), FIELD[:20])


def test_messages_of_one_topic_on_two_channels_are_joined(tmp_path):
    path = tmp_path / "x.mcap"
    with path.open("wb") as file:
        writer = OfficialWriter(file)
        writer.start()
        schema = writer.register_schema(VECTOR, "ros2msg", cdr.definition(VECTOR).encode())
        channels = [writer.register_channel("/x", "cdr", schema, {"node": str(k)}) for k in range(2)]
        for k in range(40):
            writer.add_message(channels[k % 2], k, bytes(STORE.serialize_cdr(vector_message(k), VECTOR)), k)
        writer.finish()
    topic = read_log(path).topics["/x"]
    assert topic.t_ns.tolist() == list(range(40))
    np.testing.assert_array_equal(topic.vector("vector", XYZ), FIELD[:40])


def test_topics_without_messages_and_files_without_topics(tmp_path):
    write_mcap(tmp_path / "none.mcap", [], {}, {})
    assert read_log(tmp_path / "none.mcap").topics == {}
    empty = Stream("/x", VECTOR, T_NS[:0], {f"vector.{a}": FIELD[:0, 0] for a in XYZ})
    write_mcap(tmp_path / "empty.mcap", [empty], {}, {})
    assert survey(tmp_path / "empty.mcap").counts == {"/x": 0}
