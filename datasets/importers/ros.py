"""ROS 1 bags, ROS 2 bags and MCAP files of others: Imu, MagneticField, NavSatFix, and an attitude as truth.

Stamps are those of the headers. Vectors are as ROS defines them (REP 103, REP 145): rad/s, m/s^2 with +g up at rest,
tesla; an attitude takes the body to a local East-North-Up frame. A first covariance of -1 means that the driver does
not give that part of the message.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.errors import BadParameter, BadSource
from stillpoint.datasets.frames import quaternion, rotation
from stillpoint.datasets.importers.columns import FIELD, STANDARD_GRAVITY_MPS2
from stillpoint.datasets.importers.files import hash_files, require_existing
from stillpoint.datasets.importers.imported import Imported, make_device_estimate, make_mag, turn_truth
from stillpoint.datasets.importers.options import OwnOptions, make_info
from stillpoint.datasets.importers.ros_files import (
    Leaves,
    Messages,
    RosFiles,
    collect_messages,
    open_ros,
    settle_stamps,
)
from stillpoint.datasets.importers.ros_frames import StaticFrames, keep_frame
from stillpoint.datasets.importers.ros_truth import (
    ODOMETRY,
    POSES,
    STATIC,
    TF,
    TF_LIST,
    TRANSFORM,
    list_leaves,
    list_pose_topics,
    read_pose_topic,
)
from stillpoint.datasets.importers.series import (
    Log,
    Series,
    drop_incomplete_rows,
    make_gps,
    merge_imu,
    sort_by_time,
)
from stillpoint.datasets.recording import Imu, Mag, Recording
from stillpoint.datasets.trajectory import Estimate

IMU, MAG, GPS = "sensor_msgs/msg/Imu", "sensor_msgs/msg/MagneticField", "sensor_msgs/msg/NavSatFix"


_COVARIANCES = ("orientation_covariance[0]", "angular_velocity_covariance[0]", "linear_acceleration_covariance[0]")
IMU_LEAVES: Leaves = {
    "gyro": list_leaves("angular_velocity", "xyz"),
    "accel": list_leaves("linear_acceleration", "xyz"),
    "q": list_leaves("orientation", "wxyz"),
    "covariances": _COVARIANCES,
}
MAG_LEAVES: Leaves = {"mag": list_leaves("magnetic_field", "xyz")}
GPS_LEAVES: Leaves = {"fix": ("latitude", "longitude", "altitude", "status.status")}


@dataclass(frozen=True)
class RosOptions(OwnOptions):
    """Which topics and frames to take, where there is more than one."""

    imu_topic: str | None = None
    gyro_topic: str | None = None  # where gyro and accelerometer have a topic each
    accel_topic: str | None = None
    mag_topic: str | None = None
    gps_topic: str | None = None
    truth_topic: str | None = None
    truth_parent: str | None = None  # the fixed frame of the truth
    truth_child: str | None = None  # the moving frame to take from a TF topic
    truth_frame: Literal["enu", "nwu", "ned"] = "enu"  # the axes of the fixed frame
    truth_inverse: bool = False  # the poses take the fixed frame to the moving one
    frame: str | None = None  # the frame_id to take from a topic that holds several sensors
    imu_frame: str | None = None  # the sensors' frame in /tf_static, where the headers say another
    body_frame: str | None = None  # turn the sensors into this frame by /tf_static


def read_ros(source: Path, options: RosOptions) -> Imported:
    """Return the one recording of a ``.bag``, a ROS 2 bag (folder), or an ``.mcap``. Raises :class:`BadSource`."""
    require_existing(source)
    bag = open_ros(source)
    log = Log(notes=list(bag.notes))
    chosen = choose_topics(bag, options, log)
    imu_topics, mag_topic, gps_topic, truth_topic = chosen.imu, chosen.mag, chosen.gps, chosen.truth
    static = STATIC if options.body_frame is not None else None
    poses = list_pose_topics(bag, truth_topic) if truth_topic is not None else []
    logs = bag.read([topic for topic in (*imu_topics, mag_topic, gps_topic, *poses, static) if topic])

    mounting = StaticFrames.none()
    if static is not None:
        mounting = StaticFrames.read(bag, collect_messages(static, _get_kind(bag, static), logs, TRANSFORM, TF_LIST))
    parts = [collect_messages(topic, IMU, logs, IMU_LEAVES) for topic in imu_topics]
    imu, device = read_imu(source, parts, options, mounting, log)
    mag, uncalibrated = None, options.mag_uncalibrated
    if mag_topic is not None:
        messages = collect_messages(mag_topic, MAG, logs, MAG_LEAVES)
        mag, uncalibrated = read_mag(messages, options, mounting, log)
    gps = None
    if gps_topic is not None:
        gps = make_gps(_read_fixes(collect_messages(gps_topic, GPS, logs, GPS_LEAVES), log), log)
    truth = None
    if truth_topic is not None:
        child = options.truth_child or (options.body_frame if options.truth_parent is not None else None)
        truth = read_pose_topic(bag, truth_topic, logs, options.truth_parent, child, log)
        truth = turn_truth(truth, options.truth_frame, options.truth_inverse)
        if options.truth_frame != "enu" or options.truth_inverse:
            way = ", inverted" if options.truth_inverse else ""
            log.add_conversion(f"truth {options.truth_frame.upper()} -> East-North-Up{way}")

    sha256 = hash_files(bag.files, source.parent if source.is_file() else source)
    estimates: tuple[Estimate, ...] = ()
    if device is not None:
        source_name = f"orientation of {imu_topics[0]}"
        estimates = make_device_estimate(device.t_ns, device.values, source.stem, source_name, sha256, log)
    known = {"extra": {"truth_type": bag.types[truth_topic].replace("/msg/", "/")}} if truth_topic is not None else {}
    info = make_info(
        f"ROS bag {source.name}", options, imu.t_ns, sha256, log, **{"mag_uncalibrated": uncalibrated, **known}
    )
    return Imported(Recording(source.stem, imu=imu, mag=mag, gps=gps, truth=truth, info=info), estimates)


@dataclass(frozen=True)
class Topics:
    """The topics of a bag that are imported."""

    imu: list[str]  # one, or one of the gyro and one of the accelerometer
    mag: str | None
    gps: str | None
    truth: str | None


def choose_topics(bag: RosFiles, options: RosOptions, log: Log) -> Topics:
    """Return the topics that were named, or the only ones of their types; raises :class:`BadParameter`."""
    return Topics(
        _choose_imu_topics(bag, options),
        _choose_topic(bag, "mag", (MAG,), options.mag_topic),
        _choose_topic(bag, "gps", (GPS,), options.gps_topic),
        _choose_truth_topic(bag, options, log),
    )


def _get_kind(bag: RosFiles, topic: str) -> str:
    """Return the type of a topic; raises :class:`BadParameter` where the bag does not have it."""
    if topic not in bag.types:
        raise BadParameter(f"--body-frame: {bag.source} has no topic {topic}; leave the frame out")
    return bag.types[topic]


def _list_topics(bag: RosFiles) -> str:
    return ", ".join(f"{topic} ({kind.replace('/msg/', '/')})" for topic, kind in bag.types.items()) or "no topic"


def _find_topics(bag: RosFiles, kinds: tuple[str, ...]) -> list[str]:
    """Return the topics of these types that have messages, sorted."""
    return sorted(topic for topic, kind in bag.types.items() if kind in kinds and bag.counts.get(topic, 0))


def _choose_topic(bag: RosFiles, what: str, kinds: tuple[str, ...], named: str | None) -> str | None:
    """Return the topic that was named, or the only one of these types; raises :class:`BadParameter`."""
    found = _find_topics(bag, kinds)
    if named is not None:
        if bag.types.get(named) not in kinds:
            raise BadParameter(
                f"--{what}-topic {named}: {bag.source} has no such topic for {what}; it has {_list_topics(bag)}"
            )
        return named
    if len(found) > 1:
        raise BadParameter(
            f"{bag.source}: has {len(found)} {what} topics, {', '.join(found)}; name one: --{what}-topic"
        )
    return found[0] if found else None


def _choose_imu_topics(bag: RosFiles, options: RosOptions) -> list[str]:
    """Return the topic of the IMU, or one of the gyro and one of the accelerometer, or two that may be these."""
    if options.gyro_topic is not None or options.accel_topic is not None:
        if options.gyro_topic is None or options.accel_topic is None:
            raise BadParameter("--gyro-topic, --accel-topic: belong together; give both")
        for what, topic in (("gyro", options.gyro_topic), ("accel", options.accel_topic)):
            _choose_topic(bag, what, (IMU,), topic)
        return [options.gyro_topic, options.accel_topic]
    found = _find_topics(bag, (IMU,))
    if options.imu_topic is None and len(found) == 2:
        return found  # united if one is a gyro and the other an accelerometer
    if options.imu_topic is None and not found:
        raise BadSource(f"{bag.source}: has no topic of sensor_msgs/Imu; it has {_list_topics(bag)}")
    chosen = _choose_topic(bag, "imu", (IMU,), options.imu_topic)
    return [chosen] if chosen is not None else []


def _choose_truth_topic(bag: RosFiles, options: RosOptions, log: Log) -> str | None:
    """Return the topic that was named, or the only pose topic; odometry and TF are the truth only when asked for."""
    if options.truth_topic is not None:
        topic = _choose_topic(bag, "truth", tuple(POSES), options.truth_topic)
        if bag.types[options.truth_topic] == ODOMETRY:
            log.add_note(f"truth: {topic} is odometry, which drifts; its errors count as errors of what is scored")
        return topic
    poses = tuple(kind for kind in POSES if kind != ODOMETRY and kind not in TF)
    topic = _choose_topic(bag, "truth", poses, None)
    if topic is not None:
        return topic
    for name in _find_topics(bag, (ODOMETRY,)):
        log.add_note(f"{name} is odometry and is not taken for the truth; --truth-topic {name} takes it")
    transforms = [topic for topic in _find_topics(bag, TF) if topic != STATIC]
    if transforms and (options.truth_child is not None or options.truth_parent is not None):
        return _choose_topic(bag, "truth", TF, transforms[0] if len(transforms) == 1 else None)
    for name in transforms:
        log.add_note(f"{name} is not taken for the truth; --truth-topic {name} --truth-child FRAME takes a frame of it")
    return None


def read_imu(
    source: Path, parts: list[Messages], options: RosOptions, mounting: StaticFrames, log: Log
) -> tuple[Imu, Series | None]:
    """Return gyro and accelerometer on one clock, and the device's own attitude (N, 4) wxyz where it gives one."""
    given = [_find_given(part, zero_gyro_counts=len(parts) == 1) for part in parts]
    gyro_at = [k for k, one in enumerate(given) if one["gyro"].any()]
    accel_at = [k for k, one in enumerate(given) if one["accel"].any()]
    if options.gyro_topic is not None:
        gyro_at, accel_at = [0], [len(parts) - 1]
    if len(parts) == 2 and options.gyro_topic is None and not (len(gyro_at) == len(accel_at) == 1):
        names = ", ".join(part.topic for part in parts)
        raise BadParameter(f"{source}: has {len(parts)} imu topics, {names}; name one: --imu-topic")
    for what, at in (("angular velocity", gyro_at), ("linear acceleration", accel_at)):
        if not at:
            names = " and ".join(part.topic for part in parts)
            raise BadSource(f"{source}: {names} gives no {what} (zeros, or covariance -1); name another --imu-topic")
    k, j = gyro_at[0], accel_at[0]
    if options.imu_topic is None and k != j:
        log.add_note(f"gyro of {parts[k].topic} and accelerometer of {parts[j].topic} united")
    gyro = _read_vectors(parts[k], "gyro", given[k]["gyro"], options, mounting, log)
    accel = _read_vectors(parts[j], "accel", given[j]["accel"], options, mounting, log)
    device = None
    if given[k]["q"].any():
        messages = keep_frame(parts[k].where(given[k]["q"]), options.frame, "--frame")
        series = sort_by_time(settle_stamps(messages, messages.numbers["q"], Log()), "device", Log())
        turn = mounting.find_rotation(options.body_frame, options.imu_frame or str(messages.frames[0]))
        norm = np.linalg.norm(series.values, axis=1)
        rotations = rotation(np.where(norm[:, None] > 0.5, series.values, [1.0, 0.0, 0.0, 0.0])) * turn.inv()
        device = Series(series.t_ns, np.where(norm[:, None] > 0.5, quaternion(rotations), 0.0))
    return merge_imu(gyro, accel, str(source), log), device


def read_mag(messages: Messages, options: RosOptions, mounting: StaticFrames, log: Log) -> tuple[Mag | None, bool]:
    """Return the magnetometer, and whether its size says nothing; see :func:`make_mag`."""
    series = _read_vectors(messages, "mag", np.ones(len(messages.stamps_ns), np.bool_), options, mounting, log)
    log.add_conversion("mag T -> uT")
    return make_mag(Series(series.t_ns, FIELD["T"] * series.values), options.mag_uncalibrated, log)


def _find_given(messages: Messages, zero_gyro_counts: bool) -> dict[str, NDArray[np.bool_]]:
    """Return which messages give gyro, accelerometer and attitude: no covariance of -1, and not zeros throughout.

    A gyro of zeros is possible where it is the only one: a simulated rest.
    """
    covariances = messages.numbers["covariances"]
    given = {}
    for k, name in enumerate(("q", "gyro", "accel")):
        mask = covariances[:, k] != -1
        some = (name == "gyro" and zero_gyro_counts) or messages.numbers[name][mask].any()
        given[name] = mask if some else np.zeros_like(mask)
    return given


def _read_vectors(
    messages: Messages, what: str, given: NDArray[np.bool_], options: RosOptions, mounting: StaticFrames, log: Log
) -> Series:
    """Return the vectors (N, 3) of one sensor, in the body frame where one was asked for."""
    absent = int((~given).sum())
    if absent:
        log.add_note(f"{what}: {absent} of {len(given)} messages of {messages.topic} do not give it (covariance -1)")
    messages = messages.where(given)
    chosen = options.frame
    if what == "mag" and len(set(messages.frames)) == 1:
        chosen = (
            None  # --frame tells sensors on one topic apart; a magnetometer alone on its topic has a frame of its own
        )
    messages = keep_frame(messages, chosen, "--frame")
    log.add_conversion(f"{what} from {messages.topic} ({messages.kind.replace('/msg/', '/')}), stamps of its headers")
    series = settle_stamps(messages, messages.numbers[what], log)
    series = sort_by_time(drop_incomplete_rows(series, what, log), what, log)
    if what == "accel":
        _check_one_unit(series, messages.topic)
    if options.body_frame is None:
        return series
    frame = options.imu_frame if what != "mag" and options.imu_frame is not None else str(messages.frames[0])
    turn = mounting.find_rotation(options.body_frame, frame)
    log.add_conversion(f"{what} turned from {frame} to {options.body_frame} by /tf_static; its lever arm is left out")
    return Series(series.t_ns, turn.apply(series.values.copy()))


def _check_one_unit(series: Series, topic: str) -> None:
    """Raise :class:`BadSource` where some messages are in m/s^2 and others in g: two drivers on one topic."""
    size = np.linalg.norm(series.values, axis=1)
    shares = [float(np.mean(np.abs(size / gravity - 1) < 0.15)) for gravity in (STANDARD_GRAVITY_MPS2, 1.0)]
    if min(shares, default=0.0) > 0.15:
        raise BadSource(
            f"{topic}: {shares[0]:.0%} of the accelerations are of about 9.8 and {shares[1]:.0%} of about 1: "
            "two drivers publish on it, one of them in g; record them on topics of their own"
        )


def _read_fixes(messages: Messages, log: Log) -> Series:
    """Return fixes without course and speed, which NavSatFix does not have; a status below 0 is no fix."""
    values = np.full((len(messages.stamps_ns), 5), np.nan)
    fix = messages.numbers["fix"]
    values[:, :3] = fix[:, :3]
    values[fix[:, 3] < 0, :2] = np.nan
    log.add_conversion(f"gps from {messages.topic} (sensor_msgs/NavSatFix), stamps of its headers")
    return settle_stamps(messages, values, log)
