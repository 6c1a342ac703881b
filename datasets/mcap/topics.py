"""The table of topics: the place, unit and order of every quantity in a file.

The only place that knows that ROS writes quaternions xyzw and magnetic fields in tesla. ``docs/topics.md`` is made
from it by :mod:`stillpoint.scripts.pages.topics_page`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

BODY_FRAME = "imu_link"
LOCAL_FRAME = "map"  # East-North-Up by ROS's REP 103 and 105
UT_PER_TESLA = 1e6

Array = NDArray[Any]


@dataclass(frozen=True)
class Column:
    """A field of a stream and the leaves of the message that hold it, in the order of the field's columns."""

    field: str
    leaves: tuple[str, ...]
    unit: str
    shape: tuple[int, ...] = ()  # of one row in memory; -1 for as many as the file has
    to_file: Callable[[Array], Array] | None = None
    from_file: Callable[[Array], Array] | None = None
    derived: bool = False  # True: computed from other columns for viewers, not read back


@dataclass(frozen=True)
class Topic:
    """One row of the table."""

    kind: str  # of file: recording, reference, roll reference, estimate
    stream: str  # attribute of the object that holds the columns, "" for the object itself
    name: str
    type_name: str
    holds: str
    columns: tuple[Column, ...]
    frame: str = ""  # header.frame_id
    constants: Mapping[str, Any] = field(default_factory=dict)
    drawn: bool = False  # True: a copy for 3D viewers, not read back


def _list_xyz(path: str) -> tuple[str, ...]:
    return tuple(f"{path}.{axis}" for axis in "xyz")


def _list_wxyz(path: str) -> tuple[str, ...]:
    return tuple(f"{path}.{axis}" for axis in "wxyz")


def _make_flag(name: str, leaf: str = "data") -> Column:
    return Column(name, (leaf,), "", to_file=lambda a: a.astype(np.uint8), from_file=lambda a: a.astype(np.bool_))


def _make_block_of_36(name: str, leaf: str, unit: str, derived: bool = False) -> Column:
    """Return a covariance (N, 3, 3) as the upper left block of ROS's 6 x 6, row-major; the rest is 0, not stated."""

    def to_file(cov: Array) -> Array:
        whole = np.zeros((len(cov), 6, 6))
        whole[:, :3, :3] = cov
        return whole.reshape(-1, 36)

    def from_file(whole: Array) -> Array:
        return np.ascontiguousarray(whole.reshape(-1, 6, 6)[:, :3, :3])

    return Column(name, (leaf,), unit, (3, 3), to_file, from_file, derived)


_NO_ESTIMATE = np.array([-1.0] + 8 * [0.0])  # covariance of a part of sensor_msgs/Imu that is not there
IMU, MAG = "sensor_msgs/msg/Imu", "sensor_msgs/msg/MagneticField"
POSE, VECTOR = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/Vector3Stamped"
_JOINTS, _ARRAY, _BOOL = "sensor_msgs/msg/JointState", "std_msgs/msg/Float64MultiArray", "std_msgs/msg/Bool"
_ATTITUDE_ONLY = {"angular_velocity_covariance": _NO_ESTIMATE, "linear_acceleration_covariance": _NO_ESTIMATE}
MAG_FIELD, MAG_REMAINDER = "/imu/mag", "/imu/mag_remainder"
EXTRA = "/extra/"  # before the name of a series of Recording.extra; their columns are in the facts


def make_extra_topic(name: str, labels: Sequence[str]) -> Topic:
    """Return the topic of one series of ``Recording.extra``."""
    return Topic(
        "recording", f"extra {name}", f"{EXTRA}{name}", _ARRAY, f"one number each: {', '.join(labels)}",
        (Column("values", ("data",), "", (-1,)),),
        constants={"layout.dim": 1, "layout.dim[0].label": ", ".join(labels)},
    )  # fmt: skip


TOPICS: tuple[Topic, ...] = (
    Topic(
        "recording", "imu", "/imu/data_raw", IMU,
        "angular rate over the interval that ends at the stamp, specific force (+g up at rest)",
        (
            Column("gyro_b_radps", _list_xyz("angular_velocity"), "rad/s", (3,)),
            Column("accel_b_mps2", _list_xyz("linear_acceleration"), "m/s²", (3,)),
        ),
        BODY_FRAME, {"orientation.w": 1.0, "orientation_covariance": _NO_ESTIMATE},
    ),
    Topic(
        "recording", "mag_remainder", MAG_REMAINDER, VECTOR,
        "what field × 10⁶ lacks to the microtesla in memory, where that product rounds; rows that need it only",
        (Column("remainder_b_ut", _list_xyz("vector"), "µT", (3,)),),
        BODY_FRAME,
    ),
    Topic(
        "recording", "mag", MAG_FIELD, MAG, "magnetic field",
        (Column("mag_b_ut", _list_xyz("magnetic_field"), "T", (3,)),), BODY_FRAME,
    ),
    Topic(
        "recording", "gps", "/gps/fix", "sensor_msgs/msg/NavSatFix", "satellite fix, WGS 84",
        (
            Column("lat_deg", ("latitude",), "deg"),
            Column("lon_deg", ("longitude",), "deg"),
            Column("alt_m", ("altitude",), "m"),
            Column(
                "valid", ("status.status",), "0 fix, -1 none",
                to_file=lambda valid: np.where(valid, 0, -1), from_file=lambda status: status >= 0,
            ),
        ),
        BODY_FRAME, {"status.service": 1},
    ),
    Topic(
        "recording", "gps", "/gps/course", VECTOR,
        "x: course clockwise from true north, y: speed over ground, z: accuracy as the receiver states it (0: not)",
        (
            Column("course_rad", ("vector.x",), "rad"),
            Column("speed_mps", ("vector.y",), "m/s"),
            Column("position_sd_m", ("vector.z",), "m"),
        ),
        BODY_FRAME,
    ),
    Topic(
        "recording", "spin", "/spin/accel", _ARRAY, "one number per accelerometer; their places are in the facts",
        (Column("accel_mps2", ("data",), "m/s²", (-1,)),),
        constants={"layout.dim": 1, "layout.dim[0].label": "accelerometer"},
    ),
    Topic(
        "recording", "spin", "/spin/gyro", _ARRAY, "one number per gyro; their axes are in the facts",
        (Column("gyro_radps", ("data",), "rad/s", (-1,)),),
        constants={"layout.dim": 1, "layout.dim[0].label": "gyro"},
    ),
    Topic(
        "recording", "encoder", "/encoder", _JOINTS, "shaft encoder, angle unwrapped",
        (Column("angle_rad", ("position",), "rad"), Column("rate_radps", ("velocity",), "rad/s")),
        BODY_FRAME, {"name": 1, "name[0]": "shaft"},
    ),
    Topic(
        "recording", "truth", "/truth/pose", POSE, "independent truth; a position may be NaN",
        (
            Column("q_nb", _list_wxyz("pose.orientation"), "", (4,)),
            Column("position_n_m", _list_xyz("pose.position"), "m", (3,)),
        ),
        LOCAL_FRAME,
    ),
    Topic("recording", "truth", "/truth/moving", _BOOL, "the samples of the truth that count", (_make_flag("moving"),)),
    Topic(
        "recording", "roll_truth", "/truth/roll", _JOINTS, "true angle (unwrapped) and rate about the spin axis",
        (Column("angle_rad", ("position",), "rad"), Column("rate_radps", ("velocity",), "rad/s")),
        BODY_FRAME, {"name": 1, "name[0]": "roll"},
    ),
    Topic(
        "reference", "", "/reference/attitude", IMU,
        "attitude; orientation_covariance is that of the small rotation d in q · exp(d), d in body axes, row-major",
        (
            Column("q_nb", _list_wxyz("orientation"), "", (4,)),
            Column("cov_b_rad2", ("orientation_covariance",), "rad²", (3, 3)),
        ),
        LOCAL_FRAME, _ATTITUDE_ONLY,
    ),
    Topic(
        "reference", "", "/reference/gyro_bias", VECTOR, "bias of the gyro",
        (Column("gyro_bias_b_radps", _list_xyz("vector"), "rad/s", (3,)),),
        BODY_FRAME,
    ),
    Topic(
        "reference", "", "/reference/odometry", "nav_msgs/msg/Odometry",
        "where there are satellites: position in East-North-Up of the origin in the facts, with covariance; the twist "
        "is the velocity in body axes, for viewers",
        (
            Column("position_n_m", _list_xyz("pose.pose.position"), "m", (3,)),
            _make_block_of_36("position_cov_n_m2", "pose.covariance", "m²"),
            Column("q_nb", _list_wxyz("pose.pose.orientation"), "", (4,), derived=True),
            Column("velocity_b_mps", _list_xyz("twist.twist.linear"), "m/s", (3,), derived=True),
            _make_block_of_36("velocity_cov_b_m2ps2", "twist.covariance", "m²/s²", derived=True),
        ),
        LOCAL_FRAME, {"child_frame_id": BODY_FRAME},
    ),
    Topic(
        "reference", "", "/reference/velocity", "geometry_msgs/msg/TwistWithCovarianceStamped",
        "where there are satellites: velocity in East-North-Up, with covariance",
        (
            Column("velocity_n_mps", _list_xyz("twist.twist.linear"), "m/s", (3,)),
            _make_block_of_36("velocity_cov_n_m2ps2", "twist.covariance", "m²/s²"),
        ),
        LOCAL_FRAME,
    ),
    Topic(
        "reference", "", "/reference/pose", POSE, "the attitude once more, for 3D viewers; not read back",
        (Column("q_nb", _list_wxyz("pose.orientation"), "", (4,)),),
        LOCAL_FRAME, drawn=True,
    ),
    Topic(
        "roll reference", "", "/reference/roll", _JOINTS, "angle (unwrapped) and rate about the spin axis",
        (Column("angle_rad", ("position",), "rad"), Column("rate_radps", ("velocity",), "rad/s")),
        BODY_FRAME, {"name": 1, "name[0]": "roll"},
    ),
    Topic(
        "roll reference", "", "/reference/roll_sd", VECTOR, "standard deviations, x: of the angle, y: of the rate",
        (Column("angle_sd_rad", ("vector.x",), "rad"), Column("rate_sd_radps", ("vector.y",), "rad/s")),
        BODY_FRAME,
    ),
    Topic(
        "estimate", "", "/estimate/attitude", IMU,
        "attitude; covariance as in /reference/attitude, all zero where the estimator states none",
        (
            Column("q_nb", _list_wxyz("orientation"), "", (4,)),
            Column("cov_b_rad2", ("orientation_covariance",), "rad²", (3, 3)),
        ),
        LOCAL_FRAME, _ATTITUDE_ONLY,
    ),
    Topic(
        "estimate", "", "/estimate/roll", _JOINTS, "angle and rate about one axis; empty where not estimated",
        (Column("angle_rad", ("position",), "rad"), Column("rate_radps", ("velocity",), "rad/s")),
        BODY_FRAME, {"name": 1, "name[0]": "roll"},
    ),
    Topic(
        "estimate", "", "/estimate/roll_sd", VECTOR, "standard deviations, x: of the angle, y: of the rate",
        (Column("angle_sd_rad", ("vector.x",), "rad"), Column("rate_sd_radps", ("vector.y",), "rad/s")),
        BODY_FRAME,
    ),
    Topic(
        "estimate", "", "/estimate/gyro_bias", VECTOR, "bias of the gyro",
        (Column("gyro_bias_b_radps", _list_xyz("vector"), "rad/s", (3,)),),
        BODY_FRAME,
    ),
    Topic(
        "estimate", "", "/estimate/innovation", _ARRAY, "normalised innovation; NaN where there was no update",
        (Column("innovation", ("data",), "1", (-1,)),),
        constants={"layout.dim": 1, "layout.dim[0].label": "innovation"},
    ),
    Topic(
        "estimate", "", "/estimate/ready", _BOOL, "0 while the estimator says that it is starting",
        (_make_flag("ready"),),
    ),
    Topic(
        "estimate", "", "/estimate/pose", POSE, "the attitude once more, for 3D viewers; not read back",
        (Column("q_nb", _list_wxyz("pose.orientation"), "", (4,)),),
        LOCAL_FRAME, drawn=True,
    ),
)  # fmt: skip


def to_tesla(mag_b_ut: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return microtesla (N, 3) as tesla, and the microtesla minus tesla × 10⁶ (N, 3).

    Doubles are spaced more widely on one side of a power of two than on the other, so about one value in thirty has
    no double in tesla that multiplies back to it. The remainder is exact, and -0.0 (which changes no bit) elsewhere.
    """
    best = mag_b_ut / UT_PER_TESLA
    with np.errstate(over="ignore"):
        for toward in (0.0, np.copysign(np.inf, mag_b_ut)):
            other = np.nextafter(mag_b_ut / UT_PER_TESLA, toward)
            nearer = np.abs(other * UT_PER_TESLA - mag_b_ut) < np.abs(best * UT_PER_TESLA - mag_b_ut)
            best = np.where(nearer, other, best)
    back = best * UT_PER_TESLA
    return best, np.where(back == mag_b_ut, -0.0, mag_b_ut - back)


def to_microtesla(
    field_t: NDArray[np.float64], remainder_ut: NDArray[np.float64] | float = -0.0
) -> NDArray[np.float64]:
    """Return the inverse of :func:`to_tesla`, bit for bit."""
    return field_t * UT_PER_TESLA + remainder_ut
