"""Small valid inputs of every kind, from which the fuzzer makes damaged ones."""

import json
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np
import scipy.io
from devices import write_euroc, write_ulog
from known import START_NS, known_recording
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from stillpoint.datasets import Imu, Mag, Recording, Truth, write
from stillpoint.datasets.frames import rotation, to_xyzw
from stillpoint.datasets.importers.csv_log import CsvOptions
from stillpoint.datasets.importers.options import Options
from stillpoint.datasets.importers.ros import RosOptions
from stillpoint.datasets.importers.spin_csv import SpinOptions
from stillpoint.datasets.mcap import cdr

N = 200  # samples: enough for every check, and quick
KNOWN = known_recording()
T_NS = KNOWN.t_ns[:N]
GYRO, ACCEL, MAG, Q = KNOWN.gyro_b_radps[:N], KNOWN.accel_b_mps2[:N], KNOWN.mag_b_ut[:N], KNOWN.q_nb[:N]


@dataclass(frozen=True)
class Seed:
    """One valid input: the file to damage, what to import, and how."""

    name: str
    kind: str  # an importer, "mcap" for stillpoint's own files, or "poses" for trajectories
    make: Callable[[Path], tuple[Path, Path]]  # folder -> (the source to import, the file in it to damage)
    options: Options | None = None
    poses: dict[str, object] = field(default_factory=dict)
    text: bool = False  # the file is text


def _broad(suffix: str) -> Callable[[Path], tuple[Path, Path]]:
    def make(folder: Path) -> tuple[Path, Path]:
        fields = {"imu_gyr": GYRO, "imu_acc": ACCEL, "imu_mag": MAG, "opt_quat": Q, "opt_pos": Q[:, :3]}
        fields |= {"movement": np.ones((N, 1), np.uint8)}
        file = folder / f"trial{suffix}"
        if suffix == ".mat":
            scipy.io.savemat(file, {**fields, "sampling_rate": 100.0}, do_compression=False)
        else:
            with h5py.File(file, "w") as out:
                for name, values in fields.items():
                    out[name] = values
                out.attrs["sampling_rate"] = 100.0
        return file, file

    return make


def _trials(folder: Path) -> tuple[Path, Path]:
    source, _ = _broad(".mat")(folder)
    file = folder / "trials.json"
    file.write_text(json.dumps({"trials": {"trial": {"description": "turns", "groups": ["a", "b"]}}}))
    return source, file


def _bench(folder: Path) -> tuple[Path, Path]:
    names = ("mpu6050_gyroscope.mat", "mpu6050_accelerometer.mat", "hmc5883l_compass.mat")
    for name, values in zip(names, (np.rad2deg(GYRO), ACCEL / 9.80665, MAG / 100), strict=True):
        with h5py.File(folder / name, "w") as out:
            out["buffer"] = np.vstack([T_NS / 1e9, values.T])
    return folder, folder / names[0]


def _tyrex(damage_truth: bool) -> Callable[[Path], tuple[Path, Path]]:
    def make(folder: Path) -> tuple[Path, Path]:
        trial = folder / "android" / "Ann_X_AR"
        trial.mkdir(parents=True)
        for name, values in (("gyroscope.txt", GYRO), ("accelerometer.txt", ACCEL), ("magnetometer.txt", MAG)):
            np.savetxt(trial / name, np.column_stack([T_NS / 1e9, values]))
        (trial / "timeAlignment.txt").write_text("0.0\n")
        (folder / "qualisys").mkdir()
        columns = rotation(Q).as_matrix().transpose(0, 2, 1).reshape(-1, 9).T.copy()
        bodies = {"Rotations": columns[None], "Positions": np.ones((1, 3, N)), "Residual": np.ones((1, N))}
        motion = {"FrameRate": 100.0, "Timestamp": "2016-06-03, 11:23:29", "RigidBodies": bodies}
        truth = folder / "qualisys" / "Ann_X_AR.mat"
        scipy.io.savemat(truth, {"Ann_X_AR": motion})
        return trial, truth if damage_truth else trial / "gyroscope.txt"

    return make


def _table(header: str, *columns: np.ndarray, delimiter: str = ",") -> str:
    rows = np.column_stack(columns).tolist()
    lines = [delimiter.join(repr(cell) for cell in row) for row in rows]
    return "\n".join([header.replace(",", delimiter), *lines])


def _csv(folder: Path) -> tuple[Path, Path]:
    file = folder / "log.csv"
    header = "t,gx,gy,gz,ax,ay,az,mx,my,mz,qw,qx,qy,qz,lat,lon"
    file.write_text(_table(header, T_NS / 1e6, GYRO, ACCEL, MAG, Q, 52.5 + T_NS / 1e15, 13.3 + T_NS / 1e15))
    return file, file


CSV = CsvOptions(
    time="t:ms", gyro="gx,gy,gz:rad/s", accel="ax,ay,az:m/s^2", mag="mx,my,mz:uT", truth="qw,qx,qy,qz", gps="lat,lon"
)


def _spin(folder: Path) -> tuple[Path, Path]:
    file = folder / "spin.csv"
    speed = np.full(N, 60.0)
    file.write_text(_table("t_s,F4_mps2,F5_mps2,angle_deg,rate_degps", T_NS / 1e9, -speed, speed, speed, speed))
    return file, file


def _phone_zip(texts: dict[str, str]) -> Callable[[Path], tuple[Path, Path]]:
    def make(folder: Path) -> tuple[Path, Path]:
        file = folder / "a.zip"
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, text in texts.items():
                archive.writestr(name, text)
        return file, file

    return make


def _sensorlogger_texts() -> dict[str, str]:
    t = START_NS + T_NS
    lines = {}
    for name, values in (("Gyroscope.csv", GYRO), ("TotalAcceleration.csv", ACCEL), ("Magnetometer.csv", MAG)):
        rows = [f"{at},0,{z!r},{y!r},{x!r}" for at, (x, y, z) in zip(t.tolist(), values.tolist(), strict=True)]
        lines[name] = "\n".join(["time,seconds_elapsed,z,y,x", *rows])
    return lines | {"Metadata.csv": "device name,platform,standardisation\nX,android,false\n"}


def _phyphox_texts() -> dict[str, str]:
    def one(what: str, unit: str, values: np.ndarray) -> str:
        names = ",".join(f"{what} {axis} ({unit})" for axis in "xyz")
        return _table(f"Time (s),{names}", T_NS / 1e9, values)

    return {
        "Gyroscope.csv": one("Gyroscope", "rad/s", GYRO),
        "Accelerometer.csv": one("Acceleration", "m/s^2", ACCEL),
        "Magnetometer.csv": one("Magnetic field", "uT", MAG),
        "meta/time.csv": '"event","experiment time","system time","text"\n"START",0,1700000000.123,"x"\n',
    }


def _folder(texts: dict[str, str], damaged: str) -> Callable[[Path], tuple[Path, Path]]:
    def make(folder: Path) -> tuple[Path, Path]:
        for name, text in texts.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(text)
        return folder, folder / damaged

    return make


def _write_ros(store, writer, ros1: bool) -> None:
    types = store.types
    stamp, vector = types["builtin_interfaces/msg/Time"], types["geometry_msgs/msg/Vector3"]
    turn, point, nine = types["geometry_msgs/msg/Quaternion"], types["geometry_msgs/msg/Point"], np.zeros(9)
    kinds = {"/imu": "sensor_msgs/msg/Imu", "/pose": "geometry_msgs/msg/PoseStamped"}
    kinds |= {"/mag": "sensor_msgs/msg/MagneticField", "/tf": "tf2_msgs/msg/TFMessage"}
    to = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in kinds.items()}
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    for k, t in enumerate((T_NS + START_NS).tolist()):
        extra = {"seq": 0} if ros1 else {}
        at = types["std_msgs/msg/Header"](stamp=stamp(sec=t // 10**9, nanosec=t % 10**9), frame_id="imu", **extra)
        q = turn(*to_xyzw(Q[k]).tolist())
        moved = types["geometry_msgs/msg/Transform"](vector(1.0, 2.0, 3.0), q)
        messages = {
            "/imu": types[kinds["/imu"]](at, q, nine, vector(*GYRO[k]), nine, vector(*ACCEL[k]), nine),
            "/mag": types[kinds["/mag"]](at, vector(*(MAG[k] * 1e-6)), nine),
            "/pose": types[kinds["/pose"]](at, types["geometry_msgs/msg/Pose"](point(1.0, 2.0, 3.0), q)),
            "/tf": types[kinds["/tf"]]([types["geometry_msgs/msg/TransformStamped"](at, "phone", moved)]),
        }
        for topic, message in messages.items():
            writer.write(to[topic], t, serialize(message, kinds[topic]))


def _bag(folder: Path) -> tuple[Path, Path]:
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    with Writer1(folder / "run.bag") as writer:
        _write_ros(store, writer, ros1=True)
    return folder / "run.bag", folder / "run.bag"


def _db3(folder: Path) -> tuple[Path, Path]:
    with Writer2(folder / "run", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        _write_ros(get_typestore(Stores.ROS2_HUMBLE), writer, ros1=False)
    return folder / "run", next((folder / "run").glob("*.db3"))


def _foreign_mcap(checked: bool) -> Callable[[Path], tuple[Path, Path]]:
    """Without checksums and compression, so that damage reaches what is behind them."""

    def make(folder: Path) -> tuple[Path, Path]:
        store, file = get_typestore(Stores.ROS2_HUMBLE), folder / "run.mcap"
        types, nine = store.types, np.zeros(9)
        with file.open("wb") as out:
            options = {} if checked else {"compression": CompressionType.NONE, "enable_crcs": False}
            writer = McapWriter(out, **options)
            writer.start(profile="ros2")
            kind = "sensor_msgs/msg/Imu"
            schema = writer.register_schema(kind, "ros2msg", cdr.get_definition(kind).encode())
            channel = writer.register_channel("/imu", "cdr", schema)
            vector = types["geometry_msgs/msg/Vector3"]
            for k, t in enumerate((T_NS + START_NS).tolist()):
                stamp = types["builtin_interfaces/msg/Time"](sec=t // 10**9, nanosec=t % 10**9)
                at = types["std_msgs/msg/Header"](stamp=stamp, frame_id="imu")
                q = types["geometry_msgs/msg/Quaternion"](*to_xyzw(Q[k]).tolist())
                message = types[kind](at, q, nine, vector(*GYRO[k]), nine, vector(*ACCEL[k]), nine)
                writer.add_message(channel, t, bytes(store.serialize_cdr(message, kind)), t)
            writer.finish()
        return file, file

    return make


def _own_mcap(folder: Path) -> tuple[Path, Path]:
    truth = Truth(T_NS, Q, np.ones(N, np.bool_))
    write(folder / "x.mcap", Recording("x", imu=Imu(T_NS, GYRO, ACCEL), mag=Mag(T_NS, MAG), truth=truth))
    return folder / "x.mcap", folder / "x.mcap"


def _ulog(folder: Path) -> tuple[Path, Path]:
    write_ulog(folder / "x.ulg", KNOWN, count=N)
    return folder / "x.ulg", folder / "x.ulg"


def _euroc(folder: Path) -> tuple[Path, Path]:
    write_euroc(folder / "mav0", KNOWN)
    return folder, folder / "mav0" / "imu0" / "data.csv"


def _movella(folder: Path) -> tuple[Path, Path]:
    names = ",".join(f"{what}_{axis}" for what in ("Acc", "Gyr", "Mag") for axis in "XYZ")
    text = _table(f"SampleTimeFine,Quat_W,Quat_X,Quat_Y,Quat_Z,{names}", T_NS / 1e3, Q, ACCEL, np.rad2deg(GYRO), MAG)
    (folder / "dot.csv").write_text("DeviceTag: ,Left\n" + text)
    return folder / "dot.csv", folder / "dot.csv"


def _xio(folder: Path) -> tuple[Path, Path]:
    names = [
        f"{what} {axis} ({unit})" for what, unit in (("Gyroscope", "deg/s"), ("Accelerometer", "g")) for axis in "XYZ"
    ]
    header = ",".join(["Timestamp (us)", *names])
    (folder / "Inertial.csv").write_text(_table(header, T_NS / 1e3, np.rad2deg(GYRO), ACCEL / 9.80665))
    (folder / "Quaternion.csv").write_text(_table("Timestamp (us),W,X,Y,Z", T_NS / 1e3, Q))
    return folder, folder / "Inertial.csv"


def _sensorlog(folder: Path) -> tuple[Path, Path]:
    gyro = ["gyroTimestamp_sinceReboot(s)", *(f"gyroRotation{axis}(rad/s)" for axis in "XYZ")]
    accel = ["accelerometerTimestamp_sinceReboot(s)", *(f"accelerometerAcceleration{axis}(G)" for axis in "XYZ")]
    file = folder / "log.csv"
    file.write_text(_table(",".join([*gyro, *accel]), T_NS / 1e9, GYRO, T_NS / 1e9, -ACCEL / 9.80665))
    return file, file


def _kitti(folder: Path) -> tuple[Path, Path]:
    (folder / "oxts" / "data").mkdir(parents=True)
    numbers = np.zeros((20, 30))
    numbers[:, 11:14], numbers[:, 17:20] = ACCEL[:20], GYRO[:20]
    for k, row in enumerate(numbers):
        (folder / "oxts" / "data" / f"{k:010d}.txt").write_text(" ".join(map(repr, row.tolist())))
    stamps = [f"2011-09-26 13:02:25.{k * 10_000_000:09d}" for k in range(20)]
    (folder / "oxts" / "timestamps.txt").write_text("\n".join(stamps))
    return folder, folder / "oxts" / "timestamps.txt"


def _poses(name: str, text: str) -> Callable[[Path], tuple[Path, Path]]:
    def make(folder: Path) -> tuple[Path, Path]:
        (folder / name).write_text(text)
        return folder / name, folder / name

    return make


def list_seeds() -> list[Seed]:
    """Return a seed for every kind of input."""
    tum = _table("# t,x,y,z,qx,qy,qz,qw", T_NS / 1e9, Q[:, :3], to_xyzw(Q), delimiter=" ")
    euroc = "#timestamp [ns],x,y,z,qw,qx,qy,qz\n" + "\n".join(
        f"{START_NS + t},1,2,3,{','.join(map(repr, q))}" for t, q in zip(T_NS.tolist(), Q.tolist(), strict=True)
    )
    return [
        Seed("broad .mat", "broad", _broad(".mat")),
        Seed("broad .hdf5", "broad", _broad(".hdf5")),
        Seed("broad trials.json", "broad", _trials, text=True),
        Seed("bench .mat (HDF5)", "bench", _bench),
        Seed("tyrex truth .mat", "tyrex", _tyrex(True)),
        Seed("tyrex text", "tyrex", _tyrex(False), text=True),
        Seed("csv", "csv", _csv, CSV, text=True),
        Seed("spin csv", "spin", _spin, SpinOptions(units_unchecked=True), text=True),
        Seed("sensorlogger zip", "sensorlogger", _phone_zip(_sensorlogger_texts())),
        Seed("sensorlogger text", "sensorlogger", _folder(_sensorlogger_texts(), "Gyroscope.csv"), text=True),
        Seed("sensorlogger metadata", "sensorlogger", _folder(_sensorlogger_texts(), "Metadata.csv"), text=True),
        Seed("phyphox zip", "phyphox", _phone_zip(_phyphox_texts())),
        Seed("phyphox text", "phyphox", _folder(_phyphox_texts(), "Accelerometer.csv"), text=True),
        Seed("phyphox times", "phyphox", _folder(_phyphox_texts(), "meta/time.csv"), text=True),
        Seed("ROS 1 bag", "ros", _bag, RosOptions(truth_topic="/tf", truth_child="phone")),
        Seed("ROS 2 SQLite", "ros", _db3, RosOptions()),
        Seed("foreign MCAP", "ros", _foreign_mcap(True), RosOptions()),
        Seed("foreign MCAP, unchecked", "ros", _foreign_mcap(False), RosOptions()),
        Seed("own MCAP", "mcap", _own_mcap),
        Seed("ulog", "ulog", _ulog),
        Seed("euroc", "euroc", _euroc, text=True),
        Seed("movella", "movella", _movella, text=True),
        Seed("ximu3", "ximu3", _xio, text=True),
        Seed("sensorlog", "sensorlog", _sensorlog, text=True),
        Seed("kitti", "kitti", _kitti, text=True),
        Seed("TUM", "poses", _poses("a.tum", tum), text=True),
        Seed("EuRoC", "poses", _poses("data.csv", euroc), text=True),
        Seed("bag poses", "poses", _bag, poses={"topic": "/pose"}),
    ]
