"""The known recording as messages of a bag."""

from pathlib import Path

import numpy as np
from known import START_NS, Known
from rosbags.rosbag1 import Writer as Writer1
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from stillpoint.datasets.frames import to_xyzw


def write_bag(store, writer, known: Known, ros1: bool, truth: str = "geometry_msgs/msg/PoseStamped") -> None:
    types = store.types
    stamp, point = types["builtin_interfaces/msg/Time"], types["geometry_msgs/msg/Point"]
    vector, turn = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    nine = np.zeros(9)
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    kinds = {"/imu": "sensor_msgs/msg/Imu", "/mag": "sensor_msgs/msg/MagneticField", "/truth": truth}
    kinds |= {"/fix": "sensor_msgs/msg/NavSatFix"}
    to = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in kinds.items()}

    def header(t: int, frame: str):
        at = stamp(sec=t // 10**9, nanosec=t % 10**9)
        extra = {"seq": 0} if ros1 else {}
        return types["std_msgs/msg/Header"](stamp=at, frame_id=frame, **extra)

    for k, t in enumerate((known.t_ns + START_NS).tolist()):
        q = turn(*to_xyzw(known.q_nb[k]).tolist())
        messages = {
            "/imu": types["sensor_msgs/msg/Imu"](
                header(t, "imu"),
                turn(0.0, 0.0, 0.0, 1.0),
                nine,
                vector(*known.gyro_b_radps[k]),
                nine,
                vector(*known.accel_b_mps2[k]),
                nine,
            ),
            "/mag": types["sensor_msgs/msg/MagneticField"](header(t, "imu"), vector(*(known.mag_b_ut[k] * 1e-6)), nine),
        }
        if truth.startswith("geometry_msgs"):
            pose = types["geometry_msgs/msg/Pose"](point(1.0, 2.0, 3.0), q)
            messages["/truth"] = types[truth](header(t, "map"), pose)
        else:
            transform = types["geometry_msgs/msg/Transform"](vector(1.0, 2.0, 3.0), q)
            still = types["geometry_msgs/msg/Transform"](vector(0.0, 0.0, 0.0), turn(0.0, 0.0, 0.0, 1.0))
            stamped = types["geometry_msgs/msg/TransformStamped"]
            pair = [stamped(header(t, "map"), "table", still), stamped(header(t, "map"), "phone", transform)]
            messages["/truth"] = types[truth](pair[k % 2 :])
        if k % 100 == 0:
            status = types["sensor_msgs/msg/NavSatStatus"](status=-1 if k == 100 else 0, service=1)
            messages["/fix"] = types["sensor_msgs/msg/NavSatFix"](header(t, "gps"), status, 52.5, 13.3, 80.0, nine, 0)
        for topic, message in messages.items():
            # Logged 5 ms late: the stamps of the headers are what counts.
            writer.write(to[topic], t + 5_000_000, serialize(message, kinds[topic]))


def write_pose_bag(path: Path, known: Known, frames: tuple[str, ...] = ("map",)) -> None:
    """A ROS 1 bag with the attitude as a pose on /pose and as a transform on /tf."""
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    types = store.types
    with Writer1(path) as writer:
        pose, tf = "geometry_msgs/msg/PoseStamped", "tf2_msgs/msg/TFMessage"
        to_pose = writer.add_connection("/pose", pose, typestore=store)
        to_tf = writer.add_connection("/tf", tf, typestore=store)
        for k, t in enumerate((known.t_ns + START_NS).tolist()):
            stamp = types["builtin_interfaces/msg/Time"](sec=t // 10**9, nanosec=t % 10**9)
            at = types["std_msgs/msg/Header"](seq=0, stamp=stamp, frame_id=frames[k % len(frames)])
            q = types["geometry_msgs/msg/Quaternion"](*to_xyzw(known.q_nb[k]).tolist())
            body = types["geometry_msgs/msg/Pose"](types["geometry_msgs/msg/Point"](1.0, 2.0, 3.0), q)
            writer.write(to_pose, t, store.serialize_ros1(types[pose](at, body), pose))
            moved = types["geometry_msgs/msg/Transform"](types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0), q)
            part = types["geometry_msgs/msg/TransformStamped"](at, "phone", moved)
            writer.write(to_tf, t, store.serialize_ros1(types[tf]([part]), tf))
