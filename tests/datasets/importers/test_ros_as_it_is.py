"""ROS files as people have them: several frames, missing parts, odd stamps, cut files."""

from collections.abc import Iterable

import numpy as np
import pytest
from bags import write_bag
from known import START_NS, Known, only
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from stillpoint.datasets import BadParameter, BadSource
from stillpoint.datasets.frames import local_from_enu, quaternion, rotation, to_xyzw
from stillpoint.datasets.importers.ros import RosOptions
from stillpoint.datasets.importers.table import IMPORTERS

IMU, TF, ODOMETRY = "sensor_msgs/msg/Imu", "tf2_msgs/msg/TFMessage", "nav_msgs/msg/Odometry"
ROS2, ROS1 = get_typestore(Stores.ROS2_HUMBLE), get_typestore(Stores.ROS1_NOETIC)
ROS1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
NINE = np.zeros(9)
NOT_GIVEN = np.array([-1.0, *np.zeros(8)])


class Ros:
    """Builds messages of one ROS version and writes them to an MCAP file."""

    def __init__(self, store=ROS2, ros1: bool = False) -> None:
        self.types, self.store, self.ros1 = store.types, store, ros1
        self.messages: list[tuple[str, str, int, object]] = []

    def header(self, t_ns: int, frame: str):
        stamp = self.types["builtin_interfaces/msg/Time"](sec=t_ns // 10**9, nanosec=t_ns % 10**9)
        return self.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame, **({"seq": 0} if self.ros1 else {}))

    def quaternion(self, q_wxyz):
        return self.types["geometry_msgs/msg/Quaternion"](*to_xyzw(np.asarray(q_wxyz, float)).tolist())

    def vector(self, values):
        return self.types["geometry_msgs/msg/Vector3"](*map(float, values))

    def imu(self, topic, t_ns, gyro, accel, frame="imu", q=(1.0, 0, 0, 0), given=(NINE, NINE, NINE), logged=None):
        parts = (self.quaternion(q), given[0], self.vector(gyro), given[1], self.vector(accel), given[2])
        self.messages.append(
            (topic, IMU, logged or t_ns or START_NS, self.types[IMU](self.header(t_ns, frame), *parts))
        )

    def mag(self, topic, t_ns, field, frame="imu"):
        kind = "sensor_msgs/msg/MagneticField"
        message = self.types[kind](self.header(t_ns, frame), self.vector(field), NINE)
        self.messages.append((topic, kind, t_ns, message))

    def tf(self, topic, t_ns, *transforms):
        """Transforms are (parent, child, quaternion), or with a translation in m as a fourth part."""
        stamped, moved = self.types["geometry_msgs/msg/TransformStamped"], self.types["geometry_msgs/msg/Transform"]
        parts = [
            stamped(
                self.header(t_ns, parent), child, moved(self.vector(more[0] if more else (0, 0, 0)), self.quaternion(q))
            )
            for parent, child, q, *more in transforms
        ]
        self.messages.append((topic, TF, t_ns, self.types[TF](parts)))

    def odometry(self, topic, t_ns, q):
        types = self.types
        pose = types["geometry_msgs/msg/Pose"](types["geometry_msgs/msg/Point"](0.0, 0.0, 0.0), self.quaternion(q))
        covered = types["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36))
        twist = types["geometry_msgs/msg/Twist"](self.vector((0, 0, 0)), self.vector((0, 0, 0)))
        moved = types["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36))
        message = types[ODOMETRY](self.header(t_ns, "odom"), "base_link", covered, moved)
        self.messages.append((topic, ODOMETRY, t_ns, message))

    def write(self, path, empty_schema: bool = False, chunk_size: int = 1 << 20):
        with path.open("wb") as file:
            writer = McapWriter(file, chunk_size=chunk_size, compression=CompressionType.ZSTD)
            writer.start(profile="ros1" if self.ros1 else "ros2")
            channels = {}
            for topic, kind, t_ns, message in self.messages:
                if topic not in channels:
                    text = self.store.generate_msgdef(kind, ros_version=1 if self.ros1 else 2)[0]
                    name = kind.replace("/msg/", "/") if self.ros1 else kind
                    data = b"" if empty_schema else text.encode()
                    schema = writer.register_schema(name, "ros1msg" if self.ros1 else "ros2msg", data)
                    channels[topic] = writer.register_channel(topic, "ros1" if self.ros1 else "cdr", schema)
                serialize = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
                writer.add_message(channels[topic], t_ns, bytes(serialize(message, kind)), t_ns)
            writer.finish()
        return path


def samples(known: Known) -> Iterable[tuple[int, np.ndarray, np.ndarray, np.ndarray]]:
    t_ns = (known.t_ns + START_NS).tolist()
    return zip(t_ns, known.gyro_b_radps, known.accel_b_mps2, known.q_nb, strict=True)


def refuse(source, options: RosOptions | None, kind: type[Exception], *said: str) -> None:
    with pytest.raises(kind) as caught:
        list(IMPORTERS["ros"](source, options))
    for word in said:
        assert word in str(caught.value), str(caught.value)
    assert "\n" not in str(caught.value)


# --- frames


def test_two_imus_on_one_topic_are_told_apart_by_their_frames(known, tmp_path):
    ros, turn = Ros(), Rotation.from_euler("z", 90, degrees=True)
    for k, (t, gyro, accel, _) in enumerate(samples(known)):
        other = k % 2
        ros.imu("/imu", t, turn.apply(gyro) if other else gyro, accel, frame="imu_b" if other else "imu_a")
        ros.mag("/mag", t, 1e-6 * known.mag_b_ut[k], frame="mag")
    file = ros.write(tmp_path / "run.mcap")
    refuse(file, None, BadParameter, "imu_a (300)", "imu_b (300)", "--frame")
    refuse(file, RosOptions(frame="imu_c"), BadParameter, "--frame imu_c", "imu_a (300)")
    recording = only("ros", file, RosOptions(frame="imu_b"))
    np.testing.assert_allclose(recording.imu.gyro_b_radps, turn.apply(known.gyro_b_radps[1::2]))
    assert len(recording.mag.t_ns) == 600


def test_a_child_of_tf_with_two_parents_is_chosen_by_its_parent(known, tmp_path):
    ros = Ros()
    for k, (t, gyro, accel, q) in enumerate(samples(known)):
        ros.imu("/imu", t, gyro, accel)
        ros.tf("/tf", t, ("odom" if k % 2 else "map", "phone", q), ("map", "table", (1.0, 0, 0, 0)))
    file = ros.write(tmp_path / "run.mcap")
    assert only("ros", file).truth is None  # TF holds whatever moves
    refuse(file, RosOptions(truth_topic="/tf"), BadParameter, "phone (600)", "table (600)", "--truth-child")
    refuse(file, RosOptions(truth_child="phone"), BadParameter, "map (300)", "odom (300)", "--truth-parent")
    truth = only("ros", file, RosOptions(truth_child="phone", truth_parent="odom")).truth
    assert (truth.t_ns == known.t_ns[1::2] + START_NS).all()
    assert (rotation(truth.q_nb.copy()) * rotation(known.q_nb[1::2]).inv()).magnitude().max() < 1e-9


CORRECTION = Rotation.from_euler("ZYX", [35, -20, 10], degrees=True)  # of map <- odom: no two axes alike
CORRECTION_M = np.array([3.0, -2.0, 0.5])
BODY = Rotation.from_euler("ZYX", [-70, 40, 5], degrees=True)  # of phone <- imu
BODY_M = np.array([0.1, 0.2, -0.3])


def write_chain(known, path, every=10, drift_rad=0.0, hole=None, more=()):
    """map <- odom turns slowly and comes with every tenth sample, odom <- phone with each, phone <- imu is fixed."""
    ros = Ros()
    ros.tf("/tf_static", START_NS, ("phone", "imu", BODY.as_quat(scalar_first=True), BODY_M))
    n = len(known.q_nb)
    for k, (t, gyro, accel, q) in enumerate(samples(known)):
        ros.imu("/imu", t, gyro, accel)
        correction = Rotation.from_rotvec([0, 0, drift_rad * k / n]) * CORRECTION
        phone = correction.inv() * rotation(q) * BODY.inv()
        phone_m = correction.inv().apply(-rotation(q).apply(BODY.inv().apply(BODY_M)) - CORRECTION_M)
        parts = [("odom", "phone", phone.as_quat(scalar_first=True), phone_m), *more]
        if k % every == 0 and not (hole and hole[0] <= k < hole[1]):
            parts.append(("/map", "odom", correction.as_quat(scalar_first=True), CORRECTION_M))
        ros.tf("/tf", t, *parts)
    return ros.write(path)


def test_a_chain_of_frames_is_composed(known, tmp_path):
    """The attitude of the imu in the map is the known one, and it stays where the map begins."""
    file = write_chain(known, tmp_path / "run.mcap", drift_rad=0.3)
    recording = only("ros", file, RosOptions(truth_parent="map", truth_child="imu"))
    truth = recording.truth
    end = 590  # the last of the slow link is sample 590 of 600; nothing is extrapolated
    assert (truth.t_ns == known.t_ns[: end + 1] + START_NS).all()
    assert (rotation(truth.q_nb.copy()) * rotation(known.q_nb[: end + 1]).inv()).magnitude().max() < 1e-7
    assert np.abs(truth.position_n_m).max() < 1e-6
    told = " ".join((*recording.info.conversions, *recording.info.notes))
    assert "chain map <- odom <- phone <- imu, at the stamps of odom <- phone" in told
    assert "map <- odom (60 transforms) interpolated at 531 of 600 stamps" in told
    assert "9 of 600 stamps dropped" in told


def test_the_body_frame_is_the_child_of_a_chain_by_itself(known, tmp_path):
    file = write_chain(known, tmp_path / "run.mcap", every=1)
    truth = only("ros", file, RosOptions(truth_parent="map", body_frame="imu")).truth
    assert (rotation(truth.q_nb.copy()) * rotation(known.q_nb).inv()).magnitude().max() < 1e-9


@pytest.mark.slow
def test_frames_side_by_side_are_connected_by_the_one_above(known, tmp_path):
    """table and phone both stand on odom: the truth is that of the phone against the table."""
    table = Rotation.from_euler("ZYX", [10, 20, 30], degrees=True)
    file = write_chain(known, tmp_path / "run.mcap", more=[("odom", "table", table.as_quat(scalar_first=True))])
    truth = only("ros", file, RosOptions(truth_parent="table", truth_child="imu")).truth
    expected = table.inv() * CORRECTION.inv() * rotation(known.q_nb)
    assert (rotation(truth.q_nb.copy()) * expected.inv()).magnitude().max() < 1e-9


@pytest.mark.slow
def test_a_gap_of_a_slow_link_is_not_bridged(known, tmp_path):
    """Samples 200-259 lack the slow link: 7 of its steps without one, where 5 are a gap."""
    file = write_chain(known, tmp_path / "run.mcap", hole=(200, 260))
    recording = only("ros", file, RosOptions(truth_parent="map", truth_child="imu"))
    kept = np.flatnonzero(np.isin(known.t_ns + START_NS, recording.truth.t_ns))
    assert kept.tolist() == [*range(191), *range(260, 591)]
    assert any("78 of 600 stamps dropped" in note for note in recording.info.notes)


@pytest.mark.slow
def test_a_chain_that_is_not_clear_or_not_there_is_refused_by_name(known, tmp_path):
    two = write_chain(known, tmp_path / "two.mcap", more=[("world", "odom", (1.0, 0, 0, 0))])
    options = RosOptions(truth_parent="map", truth_child="imu")
    refuse(two, options, BadParameter, "odom has 2 parents", "world (600)", "map (60)")
    file = write_chain(known, tmp_path / "run.mcap")
    refuse(
        file, RosOptions(truth_parent="mars", truth_child="imu"), BadParameter, "--truth-parent mars", "imu, map, odom"
    )
    refuse(file, RosOptions(truth_parent="phone", truth_child="imu"), BadParameter, "every link to imu is fixed")


def test_an_inverted_truth_in_north_east_down_is_converted(known, tmp_path):
    ros = Ros()
    for t, gyro, accel, q in samples(known):
        ros.imu("/imu", t, gyro, accel)
        inverse_ned = quaternion((local_from_enu("ned") * rotation(q)).inv())
        ros.tf("/tf", t, ("world_ned", "phone", inverse_ned))
    options = RosOptions(truth_child="phone", truth_frame="ned", truth_inverse=True)
    truth = only("ros", ros.write(tmp_path / "run.mcap"), options).truth
    assert (rotation(truth.q_nb.copy()) * rotation(known.q_nb).inv()).magnitude().max() < 1e-9


def test_static_transforms_turn_the_sensors_into_the_body(known, tmp_path):
    """base_link <- mast <- imu: two turns that do not commute."""
    mast_from_imu = Rotation.from_euler("ZYX", [30, -20, 10], degrees=True)
    base_from_mast = Rotation.from_euler("ZYX", [-70, 40, 5], degrees=True)
    imu_from_base = (base_from_mast * mast_from_imu).inv()
    ros = Ros()
    ros.tf("/tf_static", START_NS, ("base_link", "mast", base_from_mast.as_quat(scalar_first=True)))
    ros.tf("/tf_static", START_NS + 1, ("/mast", "/imu", mast_from_imu.as_quat(scalar_first=True)))
    for t, gyro, accel, q in samples(known):
        device = (rotation(q) * imu_from_base.inv()).as_quat(scalar_first=True)
        ros.imu("/imu", t, imu_from_base.apply(gyro), imu_from_base.apply(accel), q=device)
    file = ros.write(tmp_path / "run.mcap")
    (imported,) = IMPORTERS["ros"].read_all(file, RosOptions(body_frame="base_link"))
    np.testing.assert_allclose(imported.recording.imu.gyro_b_radps, known.gyro_b_radps, atol=1e-12)
    np.testing.assert_allclose(imported.recording.imu.accel_b_mps2, known.accel_b_mps2, atol=1e-11)
    (device,) = imported.estimates
    assert (rotation(device.q_nb.copy()) * rotation(known.q_nb).inv()).magnitude().max() < 1e-9
    refuse(file, RosOptions(body_frame="camera"), BadParameter, "--body-frame camera", "base_link, imu, mast")


# --- what a message does not give


def test_gyro_and_accelerometer_may_alternate_on_one_topic(known, tmp_path):
    ros = Ros()
    for t, gyro, accel, _ in samples(known):
        ros.imu("/imu", t, gyro, (0, 0, 0), given=(NOT_GIVEN, NINE, NOT_GIVEN))
        ros.imu("/imu", t + 1_000_000, (0, 0, 0), accel, given=(NOT_GIVEN, NOT_GIVEN, NINE))
    (imported,) = IMPORTERS["ros"].read_all(ros.write(tmp_path / "run.mcap"))
    imu = imported.recording.imu
    np.testing.assert_array_equal(imu.gyro_b_radps, known.gyro_b_radps[1:])
    assert np.abs(imu.accel_b_mps2 - known.accel_b_mps2[1:]).max() < 0.05  # interpolated over 10 ms
    assert imported.estimates == ()


def test_gyro_and_accelerometer_on_two_topics_are_united(known, tmp_path):
    ros = Ros()
    for k, (t, gyro, accel, _) in enumerate(samples(known)):
        ros.imu("/camera/gyro/sample", t, gyro, (0, 0, 0), frame="gyro_frame")
        if k % 2 == 0:
            ros.imu("/camera/accel/sample", t, (0, 0, 0), accel, frame="accel_frame")
    file = ros.write(tmp_path / "run.mcap")
    given = RosOptions(gyro_topic="/camera/gyro/sample", accel_topic="/camera/accel/sample")
    for options in (None, given):
        recording = only("ros", file, options)
        np.testing.assert_array_equal(recording.imu.gyro_b_radps, known.gyro_b_radps[:-1])
        np.testing.assert_array_equal(recording.imu.accel_b_mps2[::2], known.accel_b_mps2[::2])
    refuse(file, RosOptions(imu_topic="/camera/gyro/sample"), BadSource, "no linear acceleration")
    refuse(file, RosOptions(gyro_topic="/camera/gyro/sample"), BadParameter, "belong together")


def test_two_whole_imus_are_not_united(known, tmp_path):
    ros = Ros()
    for t, gyro, accel, _ in samples(known):
        ros.imu("/left", t, gyro, accel)
        ros.imu("/right", t, -gyro, accel)
    refuse(ros.write(tmp_path / "run.mcap"), None, BadParameter, "/left, /right", "--imu-topic")


def test_the_attitude_of_a_device_becomes_an_estimate(known, tmp_path):
    ros = Ros()
    for k, (t, gyro, accel, q) in enumerate(samples(known)):
        ros.imu("/imu", t, gyro, accel, q=(0, 0, 0, 0) if k < 5 else 0.5 * q * (2 if k % 2 else -2))
    (imported,) = IMPORTERS["ros"].read_all(ros.write(tmp_path / "run.mcap"))
    (device,) = imported.estimates
    assert (device.name, device.recording) == ("device", "run")
    assert (device.t_ns == known.t_ns[5:] + START_NS).all()
    assert (rotation(device.q_nb.copy()) * rotation(known.q_nb[5:]).inv()).magnitude().max() < 1e-9
    assert any("5 of 600 samples without an attitude" in note for note in imported.recording.info.notes)


def test_odometry_is_the_truth_only_when_asked_for(known, tmp_path):
    ros = Ros()
    for t, gyro, accel, q in samples(known):
        ros.imu("/imu", t, gyro, accel)
        ros.odometry("/odom", t, q)
    file = ros.write(tmp_path / "run.mcap")
    recording = only("ros", file)
    assert recording.truth is None
    assert any("/odom is odometry" in note for note in recording.info.notes)
    asked = only("ros", file, RosOptions(truth_topic="/odom"))
    assert len(asked.truth.t_ns) == 600
    assert any("odometry, which drifts" in note for note in asked.info.notes)
    assert asked.info.extra["truth_type"] == "nav_msgs/Odometry"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("factor", "says"),
    [
        (1e-2, "looks like gauss that was read as tesla"),
        (1.0, "looks like microtesla that was read as tesla"),
        (0.0, "left out"),
    ],
)
def test_a_bad_magnetometer_does_not_stop_the_rest(known, tmp_path, factor, says):
    ros = Ros()
    for k, (t, gyro, accel, _) in enumerate(samples(known)):
        ros.imu("/imu", t, gyro, accel)
        ros.mag("/mag", t, factor * known.mag_b_ut[k])
    recording = only("ros", ros.write(tmp_path / "run.mcap"))
    assert len(recording.imu.t_ns) == 600
    assert any(says in note for note in recording.info.notes)
    assert (recording.mag is None) == (factor == 0)
    assert recording.info.mag_uncalibrated == (factor > 0)


# --- stamps


@pytest.mark.parametrize("wild_ns", [0, 12_345, 2_000_000_000 * 10**9])
def test_a_single_absurd_stamp_does_not_decide_the_clock(known, tmp_path, wild_ns):
    ros = Ros()
    for k, (t, gyro, accel, _) in enumerate(samples(known)):
        ros.imu("/imu", wild_ns if k == 300 else t, gyro, accel, logged=t + 1_000_000)
    recording = only("ros", ros.write(tmp_path / "run.mcap"))
    assert recording.duration_s == pytest.approx(5.99)
    assert len(recording.imu.t_ns) == 599
    assert any("1 of 600 messages" in note for note in recording.info.notes)


def test_without_any_stamp_the_times_of_receipt_are_used(known, tmp_path):
    ros = Ros()
    for t, gyro, accel, _ in samples(known):
        ros.imu("/imu", 0, gyro, accel, logged=t)
    recording = only("ros", ros.write(tmp_path / "run.mcap"))
    assert (recording.imu.t_ns == known.t_ns + START_NS).all()
    assert any("times of receipt" in note for note in recording.info.notes)


# --- containers


def test_an_mcap_file_of_ros1_messages_is_read(known, tmp_path):
    ros = Ros(ROS1, ros1=True)
    for t, gyro, accel, q in samples(known):
        ros.imu("/imu", t, gyro, accel)
        ros.tf("/tf", t, ("map", "phone", q))
    recording = only("ros", ros.write(tmp_path / "run.mcap"), RosOptions(truth_child="phone"))
    np.testing.assert_array_equal(recording.imu.gyro_b_radps, known.gyro_b_radps)
    assert (rotation(recording.truth.q_nb.copy()) * rotation(known.q_nb).inv()).magnitude().max() < 1e-9


def test_a_common_type_needs_no_definition(known, tmp_path):
    ros = Ros()
    for t, gyro, accel, _ in samples(known):
        ros.imu("/imu", t, gyro, accel)
    recording = only("ros", ros.write(tmp_path / "run.mcap", empty_schema=True))
    np.testing.assert_array_equal(recording.imu.gyro_b_radps, known.gyro_b_radps)


def test_a_cut_mcap_file_gives_its_whole_chunks_with_the_truth_of_tf(known, tmp_path):
    ros = Ros()
    for t, gyro, accel, q in samples(known):
        ros.imu("/imu", t, gyro, accel)
        ros.tf("/tf", t, ("map", "phone", q), ("map", "table", q)) if t % 2 else ros.tf("/tf", t, ("map", "phone", q))
    file = ros.write(tmp_path / "run.mcap", chunk_size=20_000)
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    recording = only("ros", file, RosOptions(truth_child="phone"))
    assert 100 < len(recording.truth.t_ns) < 500
    n = len(recording.imu.t_ns)
    np.testing.assert_array_equal(recording.imu.gyro_b_radps, known.gyro_b_radps[:n])
    assert any("cut short" in note for note in recording.info.notes)
    file.write_bytes(file.read_bytes()[:400])
    refuse(file, None, BadSource, "cut short", "no chunk of it is whole")


def test_a_cut_bag_gives_its_whole_chunks(known, tmp_path):
    from rosbags.rosbag1 import Writer as Writer1

    with Writer1(tmp_path / "run.bag") as writer:
        writer.chunk_threshold = 20_000
        write_bag(ROS1, writer, known, ros1=True)
    data = (tmp_path / "run.bag").read_bytes()
    (tmp_path / "cut.bag").write_bytes(data[: len(data) // 2])
    recording = only("ros", tmp_path / "cut.bag")
    n = len(recording.imu.t_ns)
    assert 100 < n < 500
    np.testing.assert_array_equal(recording.imu.gyro_b_radps, known.gyro_b_radps[:n])
    assert any("cut short" in note for note in recording.info.notes)


def test_a_folder_without_metadata_is_read(known, tmp_path):
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2

    with Writer2(tmp_path / "run", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        write_bag(ROS2, writer, known, ros1=False)
    (tmp_path / "run" / "metadata.yaml").unlink()
    recording = only("ros", tmp_path / "run")
    np.testing.assert_array_equal(recording.imu.gyro_b_radps, known.gyro_b_radps)
    assert any("no metadata.yaml" in note for note in recording.info.notes)


def test_two_drivers_with_different_units_on_one_topic_are_refused(known, tmp_path):
    ros = Ros()
    for k, (t, gyro, accel, _) in enumerate(samples(known)):
        ros.imu("/imu", t, gyro, accel / 9.80665 if k % 2 else accel)
    refuse(
        ros.write(tmp_path / "run.mcap"),
        None,
        BadSource,
        "50% of the accelerations are of about 9.8",
        "one of them in g",
    )
