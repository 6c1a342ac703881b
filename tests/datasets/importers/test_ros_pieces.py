"""A long bag that is imported in pieces gives the bytes of one that is read whole."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from stillpoint.datasets.errors import BadSource
from stillpoint.datasets.importers import ros_files, ros_pieces
from stillpoint.datasets.importers.ros import RosOptions
from stillpoint.datasets.importers.ros_pieces import read_ros_pieces
from stillpoint.datasets.importers.table import IMPORTERS
from stillpoint.datasets.mcap.store import write, write_pieces, write_trajectory_pieces

RATE_HZ = 100
OPTIONS = RosOptions(place="48,11")


@pytest.fixture(autouse=True)
def _small_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ros_pieces, "BATCH_MESSAGES", 100)
    monkeypatch.setattr(ros_files, "_BLOCK_BYTES", 20_000)


def _write_bag(path: Path, kind: str, n: int = 1200, orientation: str = "turning", **spoil: Any) -> Path:
    """Write an IMU at 100 Hz and a magnetometer at half that rate; ``spoil`` changes the messages of one kind."""
    ros1 = kind == "bag"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    types, rng = store.types, np.random.default_rng(4)
    storage = {"db3": StoragePlugin.SQLITE3, "mcap": StoragePlugin.MCAP}
    writer: Any = Writer1(path) if ros1 else Writer2(path, version=9, storage_plugin=storage[kind])
    if ros1:
        writer.chunk_threshold = 20_000
    vector, turn = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    nine = np.zeros(9)

    def header(t_ns: int, frame: str) -> Any:
        stamp = types["builtin_interfaces/msg/Time"](sec=t_ns // 10**9, nanosec=t_ns % 10**9)
        return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame, **({"seq": 0} if ros1 else {}))

    with writer:
        imu_to = writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=store)
        mag_to = writer.add_connection("/mag", "sensor_msgs/msg/MagneticField", typestore=store)
        for k in range(n):
            t_ns = 1_700_000_000_000_000_000 + k * 10**9 // RATE_HZ
            angle = 0.001 * k if orientation == "turning" else 0.0
            q = turn(0.0, 0.0, float(np.sin(angle)), float(np.cos(angle)))
            covariance = nine.copy()
            covariance[0] = -1 if orientation == "none" else 0
            stamp_ns = spoil.get("stamps_ns", {}).get(k, t_ns)
            frame = "other" if k >= spoil.get("frame_from", n) else "imu"
            gyro, accel = rng.normal(scale=0.01, size=3), rng.normal([0, 0, 9.81], 0.02)
            accel = accel / 9.81 if k >= spoil.get("in_g_from", n) else accel
            message = types["sensor_msgs/msg/Imu"](
                header(stamp_ns, frame), q, covariance, vector(*gyro), nine, vector(*accel), nine
            )
            writer.write(imu_to, t_ns + 5_000_000, serialize(message, "sensor_msgs/msg/Imu"))
            if k % 2:
                field = types["sensor_msgs/msg/MagneticField"](
                    header(t_ns + 1_000_000, "imu"), vector(*rng.normal([0.0, 20e-6, -44e-6], 3e-7)), nine
                )
                writer.write(mag_to, t_ns + 6_000_000, serialize(field, "sensor_msgs/msg/MagneticField"))
    return path


@pytest.mark.parametrize("kind", ["bag", "db3", "mcap"])
@pytest.mark.parametrize("orientation", ["turning", "still", "none"])
def test_a_bag_in_pieces_has_the_bytes_of_the_whole(tmp_path: Path, kind: str, orientation: str) -> None:
    source = _write_bag(tmp_path / f"run.{kind}" if kind == "bag" else tmp_path / "run", kind, orientation=orientation)
    long = read_ros_pieces(source, OPTIONS)
    assert long is not None
    whole = IMPORTERS["ros"].read_one(source, OPTIONS)
    write(tmp_path / "whole.mcap", whole.recording)
    write_pieces(tmp_path / "pieces.mcap", long.head, long.pieces)
    if kind != "mcap":  # its writer makes one chunk of so little
        assert len(list(long.pieces())) > 5
    assert (tmp_path / "pieces.mcap").read_bytes() == (tmp_path / "whole.mcap").read_bytes()
    assert (long.estimates is not None) == (len(whole.estimates) == 1) == (orientation == "turning")
    if long.estimates is not None:
        write(tmp_path / "whole.estimate.mcap", whole.estimates[0])
        samples = len(whole.estimates[0].t_ns)
        write_trajectory_pieces(tmp_path / "pieces.estimate.mcap", long.estimates(), samples)
        assert (tmp_path / "pieces.estimate.mcap").read_bytes() == (tmp_path / "whole.estimate.mcap").read_bytes()


START_NS = 1_700_000_000_000_000_000


@pytest.mark.parametrize("spoil", [
    {"stamps_ns": {700: START_NS}}, {"stamps_ns": {5: 0}}, {"stamps_ns": {900: 2 * START_NS // 3}},
    {"frame_from": 600}, {"in_g_from": 800},
], ids=["back", "unset", "wild", "two frames", "two units"])  # fmt: skip
def test_what_only_the_whole_can_tell_is_left_to_it(tmp_path: Path, spoil: dict[str, Any]) -> None:
    assert read_ros_pieces(_write_bag(tmp_path / "run", "db3", **spoil), OPTIONS) is None


@pytest.mark.parametrize("given", [{"truth_topic": "/imu"}, {"body_frame": "imu"}, {"frame": "imu"}])
def test_truths_and_frames_need_the_whole(tmp_path: Path, given: dict[str, str]) -> None:
    assert read_ros_pieces(_write_bag(tmp_path / "run", "db3", n=300), RosOptions(**given)) is None  # type: ignore[arg-type]


def test_wrong_units_are_refused_as_of_the_whole(tmp_path: Path) -> None:
    source = _write_bag(tmp_path / "run", "db3", in_g_from=0)
    with pytest.raises(BadSource) as pieces:
        read_ros_pieces(source, OPTIONS)
    with pytest.raises(BadSource) as whole:
        IMPORTERS["ros"].read_one(source, OPTIONS)
    assert str(pieces.value) == str(whole.value)
