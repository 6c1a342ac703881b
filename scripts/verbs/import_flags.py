"""The flags of ``stillpoint import``, by the kinds that take them."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Group, Parameter

ALL = Group("All kinds", sort_key=1)
OWN = Group("Own recordings: all kinds but broad, tyrex, bench, flatball", sort_key=2)
PHONES = Group("Phones: tyrex, sensorlogger, sensorlog", sort_key=3)
LOG = Group("Delimited logs: csv, spin; --rate also movella", sort_key=4)
CSV = Group("Logs of an IMU: csv", sort_key=5)
SPIN = Group("Logs of a spinning body: spin", sort_key=6)
ROS = Group("Bags: ros", sort_key=7)

AnyKind = Annotated[bool, Parameter(group=ALL, negative="")]
Own = Annotated[str | None, Parameter(group=OWN)]
Phone = Annotated[str | None, Parameter(group=PHONES)]
LogSetting = Annotated[str | None, Parameter(group=LOG)]
Setting = Annotated[str | None, Parameter(group=CSV)]
Columns = Annotated[str | None, Parameter(group=CSV, allow_leading_hyphen=True)]
SpinSetting = Annotated[str | None, Parameter(group=SPIN)]
SpinColumns = Annotated[str | None, Parameter(group=SPIN, allow_leading_hyphen=True)]
SpinSize = Annotated[float | None, Parameter(group=SPIN)]
TopicName = Annotated[str | None, Parameter(group=ROS)]


@dataclass(frozen=True, kw_only=True)
class Flags:
    """The flags of an import; each name is that of a field of some kind's options.

    Parameters
    ----------
    units_unchecked
        Keep a recording whose sizes or rates are implausible, for the doctor to look at.
    place
        Where it was recorded, LAT,LON or LAT,LON,ALT in deg and m; south and west are negative.
    date
        When it was recorded, as 2025-08-31.
    licence
        Licence of the recording, kept in the file.
    citation
        How to cite it.
    sensor
        Model of the sensor.
    mag_uncalibrated
        The size of the field says nothing (hard iron, raw counts).
    mag
        tyrex, sensorlogger, sensorlog: raw (the default) or calibrated by the phone. csv: columns and unit,
        mx,my,mz:uT.
    platform
        sensorlogger: ios or android, where no Metadata.csv says it.
    config
        A TOML file with the settings of the kind, as gyro = "gx,gy,gz:deg/s".
    time
        The column of time and its unit, t:ms (s, ms, us, ns, or iso for dates).
    rate
        Samples per second, where the log has no time.
    gyro
        Columns and unit of the gyro, gx,gy,gz:deg/s; a leading - turns a sign, 0.061*deg/s is a unit per count.
    accel
        Columns and unit of the accelerometer, ax,ay,az:g.
    gyro_time
        The gyro's own time column and its unit, where each sensor has one.
    accel_time
        The accelerometer's own time column.
    mag_time
        The magnetometer's own time column.
    gps
        Columns of satellite fixes, lat,lon[,alt[,speed[,course]]] in deg, m, m/s and deg.
    gps_time
        Their own time column.
    truth
        Columns of a quaternion that takes the body to the local frame, qw,qx,qy,qz; or a file of its own
        (TUM, EuRoC, CSV, KITTI, a bag), {name} in it standing for the log's name.
    truth_time
        The truth's own time column and its unit.
    truth_columns
        Columns of the quaternion in the truth's own file, where its header does not tell.
    truth_euler
        Columns and unit of Euler angles instead, in the order of the turns, yaw,pitch,roll:deg.
    truth_order
        Axes of these turns: ZYX (the default) about moving axes, small letters about fixed ones.
    truth_frame
        The local frame of the truth: enu (the default), nwu or ned.
    truth_inverse
        The truth takes the local frame to the body.
    position
        Columns and unit of the truth's position, x,y,z:m.
    moving
        A column that is 0 where the truth is not to be scored.
    delimiter
        What separates the columns, where it is not found by itself.
    drop_disordered
        Sort disorder of up to a second by time and drop equal stamps, counted.
    geometry
        Where the accelerometers sit: bench (the default: F4, F5), five (F1 to F5, g1, g2), or a .toml file.
    d1_m
        Lever arm of F4 in m, 0.10 unless given.
    d2_m
        Lever arm of F5 in m, 0.50 unless given.
    range_g
        Range of the accelerometers, 16 unless given.
    accels
        Columns and unit of the accelerometers in the order of the geometry, F4,F5:g.
    gyros
        Columns and unit of the gyros, g1,g2:deg/s.
    encoder_angle
        Column and unit of the shaft's angle (rad, deg, rev), angle:deg.
    encoder_rate
        Column and unit of its rate, speed:deg/s.
    imu_topic
        The topic of gyro and accelerometer, where there are several.
    mag_topic
        The topic of the magnetometer.
    gps_topic
        The topic of the satellite fixes.
    truth_topic
        The topic of the true pose (PoseStamped, Odometry, TransformStamped, QuaternionStamped or TF).
    gyro_topic
        The topic of the gyro, where it is not that of the accelerometer.
    accel_topic
        The topic of the accelerometer.
    truth_parent
        The fixed frame of the truth, where the topic holds several.
    truth_child
        The child frame to take from a TF topic.
    frame
        The frame_id to take, where one topic holds several sensors.
    imu_frame
        The frame of gyro and accelerometer in /tf_static, where the headers name another.
    body_frame
        Turn the sensors into this frame by /tf_static.
    """

    units_unchecked: AnyKind = False
    place: Annotated[str | None, Parameter(group=ALL, allow_leading_hyphen=True)] = None
    date: Annotated[str | None, Parameter(group=ALL)] = None
    licence: Own = None
    citation: Own = None
    sensor: Own = None
    mag_uncalibrated: Annotated[bool, Parameter(group=OWN, negative="")] = False
    mag: Annotated[str | None, Parameter(group=[PHONES, CSV], allow_leading_hyphen=True)] = None
    platform: Phone = None
    config: Annotated[Path | None, Parameter(group=LOG)] = None
    time: LogSetting = None
    rate: Annotated[float | None, Parameter(group=LOG)] = None
    gyro: Columns = None
    accel: Columns = None
    gyro_time: Setting = None
    accel_time: Setting = None
    mag_time: Setting = None
    gps: Setting = None
    gps_time: Setting = None
    truth: Columns = None
    truth_time: Setting = None
    truth_columns: Columns = None
    truth_euler: Columns = None
    truth_order: Setting = None
    truth_frame: Setting = None
    truth_inverse: Annotated[bool, Parameter(group=CSV, negative="")] = False
    position: Columns = None
    moving: Setting = None
    delimiter: LogSetting = None
    drop_disordered: Annotated[bool, Parameter(group=LOG, negative="")] = False
    geometry: SpinSetting = None
    d1_m: SpinSize = None
    d2_m: SpinSize = None
    range_g: SpinSize = None
    accels: SpinColumns = None
    gyros: SpinColumns = None
    encoder_angle: SpinColumns = None
    encoder_rate: SpinColumns = None
    imu_topic: TopicName = None
    mag_topic: TopicName = None
    gps_topic: TopicName = None
    truth_topic: TopicName = None
    gyro_topic: TopicName = None
    accel_topic: TopicName = None
    truth_parent: TopicName = None
    truth_child: TopicName = None
    frame: TopicName = None
    imu_frame: TopicName = None
    body_frame: TopicName = None
