"""ROS messages with known numbers, and files of them made by the writer of the ``mcap`` package."""

from dataclasses import replace

import numpy as np
from mcap.writer import Writer as OfficialWriter
from rosbags.typesys import Stores, get_typestore

from stillpoint.datasets.mcap import cdr

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


def one_topic(path, type_name, bodies, times=None, **options):
    """A file of raw messages on /x."""
    with path.open("wb") as file:
        writer = OfficialWriter(file, **options)
        writer.start(profile="ros2")
        schema = writer.register_schema(type_name, "ros2msg", cdr.get_definition(type_name).encode())
        channel = writer.register_channel("/x", "cdr", schema)
        for k, body in enumerate(bodies):
            t = k if times is None else int(times[k])
            writer.add_message(channel, t, body, t)
        writer.finish()
    return path


def bag(path, writer, rows=N):
    """Imu and Vector3Stamped messages through any writer with the call of mcap's."""
    schemas = {
        name: writer.register_schema(name, "ros2msg", cdr.get_definition(name).encode()) for name in (IMU, VECTOR)
    }
    imu = writer.register_channel("/imu", "cdr", schemas[IMU])
    field = writer.register_channel("/field", "cdr", schemas[VECTOR])
    for k in range(rows):
        for channel, name, message in ((imu, IMU, imu_message(k)), (field, VECTOR, vector_message(k))):
            little = k % 2 == 0 or "big" not in path.name
            body = bytes(STORE.serialize_cdr(message, name, little_endian=little))
            writer.add_message(channel, int(T_NS[k]), body, int(T_NS[k]))
    writer.finish()
