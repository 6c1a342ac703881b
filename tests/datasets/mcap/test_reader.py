"""MCAP files of other writers in our reader: the same numbers, or the reason why there are none."""

import foxglove
import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as OfficialWriter
from mcap_ros2.writer import Writer as Ros2Writer
from ros_messages import (
    ACCEL,
    FIELD,
    GYRO,
    IMU,
    STORE,
    T_NS,
    TF,
    VECTOR,
    XYZ,
    N,
    bag,
    header,
    imu_message,
    one_topic,
    vector,
    vector_message,
    with_lists,
)
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter

from stillpoint.datasets import BadFile, read
from stillpoint.datasets.mcap import cdr
from stillpoint.datasets.mcap.reader import read_log, survey
from stillpoint.datasets.mcap.writer import Stream, write_mcap


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
def test_files_of_the_official_writer_are_read(tmp_path, kind):
    path, rows = tmp_path / f"{kind}.mcap", 900
    with path.open("wb") as file:
        writer = OfficialWriter(file, **OFFICIAL[kind])
        writer.start(profile="ros2")
        bag(path, writer, rows)
    check_imu_and_field(path, rows)


def test_files_of_mcap_ros2_support_are_read(tmp_path):
    path = tmp_path / "x.mcap"
    with path.open("wb") as file:
        writer = Ros2Writer(file)
        imu, field = (writer.register_msgdef(name, cdr.get_definition(name)) for name in (IMU, VECTOR))
        for k in range(300):
            writer.write_message("/imu", imu, with_lists(imu_message(k)), log_time=int(T_NS[k]))
            writer.write_message("/field", field, vector_message(k), log_time=int(T_NS[k]))
        writer.finish()
    check_imu_and_field(path, 300)


def test_files_of_rosbags_are_read(tmp_path):
    with BagWriter(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        imu = writer.add_connection("/imu", IMU, typestore=STORE)
        field = writer.add_connection("/field", VECTOR, typestore=STORE)
        for k in range(N):
            writer.write(imu, int(T_NS[k]), STORE.serialize_cdr(imu_message(k), IMU))
            writer.write(field, int(T_NS[k]), STORE.serialize_cdr(vector_message(k), VECTOR))
    (path,) = (tmp_path / "bag").glob("*.mcap")
    check_imu_and_field(path)


def test_files_of_foxglove_sdk_are_read(tmp_path):
    path = tmp_path / "x.mcap"
    with foxglove.open_mcap(path):
        channels = {}
        for topic, name in (("/imu", IMU), ("/field", VECTOR)):
            schema = foxglove.Schema(name=name, encoding="ros2msg", data=cdr.get_definition(name).encode())
            channels[topic] = foxglove.Channel(topic, message_encoding="cdr", schema=schema)
        for k in range(300):
            for topic, name, message in (("/imu", IMU, imu_message(k)), ("/field", VECTOR, vector_message(k))):
                channels[topic].log(bytes(STORE.serialize_cdr(message, name)), log_time=int(T_NS[k]))
        foxglove.Channel("/words", message_encoding="json").log({"a": 1}, log_time=int(T_NS[0]))
    log = check_imu_and_field(path, 300)
    assert log.counts["/words"] == 1
    assert log.unread == {"/words": "its messages are json, not cdr or ros1"}


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


def test_messages_of_one_time_keep_the_order_of_the_file(tmp_path):
    times = np.arange(300)[::-1] // 50
    bodies = [bytes(STORE.serialize_cdr(vector_message(k), VECTOR)) for k in range(300)]
    topic = read_log(one_topic(tmp_path / "x.mcap", VECTOR, bodies, times)).topics["/x"]
    order = np.arange(300).reshape(6, 50)[::-1].ravel()
    np.testing.assert_array_equal(topic.vector("vector", XYZ), FIELD[order])


def test_a_log_time_that_int64_cannot_hold_is_named(tmp_path):
    body = bytes(STORE.serialize_cdr(vector_message(0), VECTOR))
    log = read_log(one_topic(tmp_path / "x.mcap", VECTOR, [body] * 2, [2**63 - 1, 2**63]))
    assert log.unread == {"/x": "a log time lies beyond 2^63 ns"}


def test_a_topic_of_two_types_is_named(tmp_path):
    path = tmp_path / "x.mcap"
    with path.open("wb") as file:
        writer = OfficialWriter(file)
        writer.start()
        for name, message in ((VECTOR, vector_message(0)), (IMU, imu_message(0))):
            schema = writer.register_schema(name, "ros2msg", cdr.get_definition(name).encode())
            channel = writer.register_channel("/x", "cdr", schema)
            writer.add_message(channel, 0, bytes(STORE.serialize_cdr(message, name)), 0)
        writer.finish()
    log = read_log(path)
    assert (log.topics, log.unread) == ({}, {"/x": "its channels are of several types"})
    assert log.counts == {"/x": 2}


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


def test_a_leaf_that_all_parts_have_is_joined_in_the_order_of_the_messages(tmp_path):
    """Longer and shorter arrays beside it make parts of the topic; what they share is one column."""
    name = "sensor_msgs/msg/JointState"
    bodies = []
    for k in range(30):
        message = STORE.types[name](header(T_NS[k], "f" * (k % 4)), [], FIELD[k, :1], np.zeros(k % 3), np.zeros(0))
        bodies.append(bytes(STORE.serialize_cdr(message, name)))
    topic = read_log(one_topic(tmp_path / "x.mcap", name, bodies)).topics["/x"]
    assert len(topic.parts) == 3
    np.testing.assert_array_equal(topic.column("position"), FIELD[:30, :1])
    np.testing.assert_array_equal(topic.stamps_ns(), T_NS[:30])
    assert topic.text("header.frame_id").tolist() == ["f" * (k % 4) for k in range(30)]


def test_without_a_header_the_log_times_are_the_stamps(tmp_path):
    flag = bytes(STORE.serialize_cdr(STORE.types["std_msgs/msg/Bool"](True), "std_msgs/msg/Bool"))
    topic = read_log(one_topic(tmp_path / "x.mcap", "std_msgs/msg/Bool", [flag] * 3, [5, 7, 9])).topics["/x"]
    assert topic.stamps_ns().tolist() == [5, 7, 9]


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
        vectors = writer.register_schema(VECTOR, "ros2msg", cdr.get_definition(VECTOR).encode())
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


def test_a_foreign_file_is_named_with_what_it_holds_and_the_verb_that_takes_it(tmp_path):
    path = one_topic(tmp_path / "x.mcap", VECTOR, [bytes(STORE.serialize_cdr(vector_message(0), VECTOR))] * 9)
    with pytest.raises(BadFile, match=r"it holds /x \(geometry_msgs/msg/Vector3Stamped, 9 messages\)") as caught:
        read(path)
    assert "`stillpoint import ros " in str(caught.value)


def test_messages_of_one_topic_on_two_channels_are_joined(tmp_path):
    path = tmp_path / "x.mcap"
    with path.open("wb") as file:
        writer = OfficialWriter(file)
        writer.start()
        schema = writer.register_schema(VECTOR, "ros2msg", cdr.get_definition(VECTOR).encode())
        channels = [writer.register_channel("/x", "cdr", schema, {"node": str(k)}) for k in range(2)]
        for k in range(40):
            writer.add_message(channels[k % 2], k, bytes(STORE.serialize_cdr(vector_message(k), VECTOR)), k)
        writer.finish()
    topic = read_log(path).topics["/x"]
    assert topic.t_ns.tolist() == list(range(40))
    np.testing.assert_array_equal(topic.vector("vector", XYZ), FIELD[:40])


def test_empty_topics_and_empty_files_are_listed(tmp_path):
    write_mcap(tmp_path / "none.mcap", [], {}, {})
    assert read_log(tmp_path / "none.mcap").topics == {}
    empty = Stream("/x", VECTOR, T_NS[:0], {f"vector.{a}": FIELD[:0, 0] for a in XYZ})
    write_mcap(tmp_path / "empty.mcap", [empty], {}, {})
    assert survey(tmp_path / "empty.mcap").counts == {"/x": 0}
