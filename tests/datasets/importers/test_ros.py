"""The known recording through the bags of ROS 1 and ROS 2."""

from pathlib import Path

import pytest
from bags import write_bag
from known import START_NS, Known, assert_known, only
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from stillpoint.datasets.importers.ros import GPS, GPS_LEAVES, IMU, IMU_LEAVES, MAG, MAG_LEAVES, RosOptions
from stillpoint.datasets.importers.ros_truth import POSES, TF


def ros_source(tmp_path: Path, variant: str, known: Known, truth: str) -> Path:
    if variant == "ros1":
        store = get_typestore(Stores.ROS1_NOETIC)
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF[0]))
        with Writer1(tmp_path / "run.bag") as writer:
            write_bag(store, writer, known, ros1=True, truth=truth)
        return tmp_path / "run.bag"
    store = get_typestore(Stores.ROS2_HUMBLE)
    plugin = StoragePlugin.SQLITE3 if variant == "sqlite" else StoragePlugin.MCAP
    with Writer2(tmp_path / "run", version=9, storage_plugin=plugin) as writer:
        write_bag(store, writer, known, ros1=False, truth=truth)
    if variant != "mcap":
        return tmp_path / "run"
    (tmp_path / "run" / "run.mcap").rename(tmp_path / "run.mcap")
    return tmp_path / "run.mcap"


@pytest.mark.parametrize("variant", ["ros1", "sqlite", "mcap bag", "mcap"])
def test_ros_is_read_in_each_of_its_containers(known, tmp_path, variant):
    source = ros_source(tmp_path, variant, known, "geometry_msgs/msg/PoseStamped")
    recording = only("ros", source)
    assert_known(recording, known, start_ns=START_NS, near=1e-12)
    assert recording.name == "run"
    assert recording.gps.valid.tolist() == [True, False, True, True, True, True]
    assert (recording.truth.position_n_m == [1, 2, 3]).all()


@pytest.mark.parametrize("variant", ["ros1", "sqlite", "mcap"])
def test_ros_truth_comes_from_one_child_of_tf(known, tmp_path, variant):
    source = ros_source(tmp_path, variant, known, TF[0])
    recording = only("ros", source, RosOptions(truth_child="phone"))
    assert_known(recording, known, start_ns=START_NS, near=1e-12)


def test_the_leaves_of_the_ros_table_are_numbers_of_the_messages_they_stand_for():
    fields = get_typestore(Stores.ROS2_HUMBLE).fielddefs
    tables = {IMU: IMU_LEAVES, MAG: MAG_LEAVES, GPS: GPS_LEAVES, **POSES}
    for kind, leaves in tables.items():
        for leaf in (leaf for parts in leaves.values() for leaf in parts):
            at = "geometry_msgs/msg/TransformStamped" if kind in TF else kind
            for part in leaf.partition("[")[0].split("."):
                _, at = dict(fields[at][1])[part]
            base = at[0][1][0] if "[" in leaf else at[0]
            assert base in ("float64", "int8"), f"{kind}: {leaf}"
