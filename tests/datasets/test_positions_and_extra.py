"""Positions and velocities of a reference, and free named series of a recording, come back from a file bit for bit."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation
from swings import as_reference, swing

from stillpoint.datasets import BadRecording, Imu, Recording, Series, read, write
from stillpoint.datasets.exporters.tables import make_tables

COLUMNS = ("position_n_m", "velocity_n_mps", "position_cov_n_m2", "velocity_cov_n_m2ps2")


def covariances(n, seed):
    roots = np.random.default_rng(seed).normal(size=(n, 3, 3))
    return roots @ roots.transpose(0, 2, 1) + 0.1 * np.eye(3)


@pytest.fixture
def placed():
    t_ns, q_nb = swing(50)
    draw = np.random.default_rng(4)
    return replace(
        as_reference(t_ns, q_nb),
        position_n_m=draw.normal(size=(50, 3)) * 1e3,
        velocity_n_mps=draw.normal(size=(50, 3)) * 30,
        position_cov_n_m2=covariances(50, 1),
        velocity_cov_n_m2ps2=covariances(50, 2),
        origin_lat_lon_alt=(48.1, 11.5, 519.0),
    )


def test_positions_come_back_bit_for_bit(tmp_path, placed):
    write(tmp_path / "run.mcap", placed)
    back = read(tmp_path / "run.mcap")
    for name in COLUMNS:
        assert np.array_equal(getattr(back, name), getattr(placed, name))
    assert back.origin_lat_lon_alt == placed.origin_lat_lon_alt


def test_a_reference_without_positions_has_none_in_its_file(tmp_path):
    t_ns, q_nb = swing(50)
    write(tmp_path / "run.mcap", as_reference(t_ns, q_nb))
    back = read(tmp_path / "run.mcap")
    assert all(getattr(back, name) is None for name in (*COLUMNS, "origin_lat_lon_alt", "velocity_b_mps"))
    assert b"nav_msgs" not in (tmp_path / "run.mcap").read_bytes()


@pytest.mark.parametrize("name", COLUMNS)
def test_a_part_of_the_columns_is_refused(placed, name):
    with pytest.raises(BadRecording, match="position, velocity, both covariances and the origin, or none"):
        replace(placed, **{name: None})


def test_odometry_states_the_twist_in_body_axes(tmp_path, placed):
    """By ROS's definition of nav_msgs/Odometry the twist is in the child frame."""
    write(tmp_path / "run.mcap", placed)
    with open(tmp_path / "run.mcap", "rb") as file:
        schema, _, message = next(make_reader(file).iter_messages(["/reference/odometry"]))
    assert schema.name == "nav_msgs/msg/Odometry"
    odometry = get_typestore(Stores.ROS2_HUMBLE).deserialize_cdr(message.data, schema.name)
    turn = Rotation.from_quat(placed.q_nb[0], scalar_first=True)
    twist, pose = odometry.twist, odometry.pose
    along = [twist.twist.linear.x, twist.twist.linear.y, twist.twist.linear.z]
    assert turn.apply(along) == pytest.approx(placed.velocity_n_mps[0])
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("map", "imu_link")
    assert pose.covariance.reshape(6, 6)[:3, :3] == pytest.approx(placed.position_cov_n_m2[0])
    turned = turn.as_matrix() @ twist.covariance.reshape(6, 6)[:3, :3] @ turn.as_matrix().T
    assert turned == pytest.approx(placed.velocity_cov_n_m2ps2[0])


def recording_with(**extra):
    t_ns = np.arange(0, 10**9, 10**7)
    still = np.zeros((100, 3))
    return Recording("run", Imu(t_ns, still, still + np.array([0.0, 0.0, 9.81])), extra=extra)


@pytest.mark.slow
@given(
    values=st.lists(st.tuples(st.floats(), st.floats(allow_nan=False)), min_size=1, max_size=20),
    labels=st.just(("speed_mps", "steering wheel, rad")),
)
def test_series_come_back_bit_for_bit(tmp_path_factory, values, labels):
    path = tmp_path_factory.mktemp("extra") / "run.mcap"
    series = Series(np.arange(len(values)) * 10**8 + 5, np.array(values), labels)
    write(path, recording_with(wheel=series, baro=series))
    back = read(path)
    assert list(back.extra) == ["wheel", "baro"]
    assert back.extra["wheel"].labels == labels
    assert np.array_equal(back.extra["wheel"].t_ns, series.t_ns)
    assert back.extra["wheel"].values.tobytes() == series.values.tobytes()


def test_a_series_is_a_stream_with_its_own_clock():
    recording = recording_with(wheel=Series(np.array([3, 7]), np.array([1.0, 2.0]), ("speed_mps",)))
    assert dict(recording.streams())["extra wheel"].tolist() == [3, 7]
    assert recording.extra["wheel"].column("speed_mps").tolist() == [1.0, 2.0]
    assert make_tables(recording)["extra.wheel"]["speed_mps"].tolist() == [1.0, 2.0]
    with pytest.raises(BadRecording, match="has no column 'speed'; it has speed_mps"):
        recording.extra["wheel"].column("speed")


@pytest.mark.parametrize("name", ["", "a/b", "1st", "wheel speed"])
def test_a_name_that_is_no_topic_is_refused(name):
    with pytest.raises(BadRecording, match="give a name of letters, digits and _"):
        recording_with(**{name: Series(np.array([1]), np.array([1.0]), ("x",))})
