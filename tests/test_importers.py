"""One known recording, with an attitude that no axis swap or sign leaves unchanged, goes through every importer."""

import json
import zipfile
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from stillpoint.datasets import Recording
from stillpoint.datasets.frames import quaternion, rotation, to_xyzw
from stillpoint.datasets.importers.csv_log import CsvOptions
from stillpoint.datasets.importers.options import PhoneOptions, TyrexOptions
from stillpoint.datasets.importers.ros import RosOptions
from stillpoint.datasets.importers.ros_messages import LEAVES, TF
from stillpoint.datasets.importers.table import IMPORTERS

G = 9.80665
START_NS = 1_700_000_000_123_456_789
FIELD_N_UT = np.array([1.5, 20.0, -40.0])


@dataclass(frozen=True)
class Known:
    """Turns about changing axes from a tilted start, sampled at 100 Hz."""

    t_ns: np.ndarray
    q_nb: np.ndarray
    gyro_b_radps: np.ndarray
    accel_b_mps2: np.ndarray
    mag_b_ut: np.ndarray

    @property
    def t_s(self) -> np.ndarray:
        return self.t_ns / 1e9


@pytest.fixture(scope="module")
def known() -> Known:
    t_ns = np.arange(600, dtype=np.int64) * 10_000_000
    t_s = t_ns / 1e9
    turn = Rotation.from_rotvec(np.stack([0.9 * np.sin(t_s), 0.5 * t_s, 0.3 * np.cos(2 * t_s)], axis=1))
    attitude = Rotation.from_euler("ZYX", [70, -35, 20], degrees=True) * turn
    step = (attitude[:-1].inv() * attitude[1:]).as_rotvec() / 0.01
    gyro = np.concatenate([step[:1], step])
    accel = attitude.inv().apply([0, 0, G])
    return Known(t_ns, quaternion(attitude), gyro, accel, attitude.inv().apply(FIELD_N_UT))


def assert_known(recording: Recording, known: Known, start_ns: int = 0, near: float = 1e-9, truth: bool = True) -> None:
    """Times exact, vectors and attitude equal, and the body's vectors lead to up and north through the truth."""
    assert (recording.imu.t_ns == known.t_ns + start_ns).all()
    np.testing.assert_allclose(recording.imu.gyro_b_radps, known.gyro_b_radps, atol=near)
    np.testing.assert_allclose(recording.imu.accel_b_mps2, known.accel_b_mps2, atol=10 * near)
    np.testing.assert_allclose(recording.mag.mag_b_ut, known.mag_b_ut, atol=100 * near)
    assert recording.info.sha256
    assert recording.info.conversions
    if truth:
        here = np.isin(known.t_ns + start_ns, recording.truth.t_ns)
        assert len(recording.truth.t_ns) == here.sum() > 500
        error = rotation(recording.truth.q_nb) * rotation(known.q_nb[here]).inv()
        assert error.magnitude().max() < 1e-6
        imu = np.isin(recording.imu.t_ns, recording.truth.t_ns)
        up = rotation(recording.truth.q_nb).apply(recording.imu.accel_b_mps2[imu])
        np.testing.assert_allclose(up, np.tile([0, 0, G], (len(up), 1)), atol=1e-5)


def only(kind: str, source: Path, options=None) -> Recording:
    recordings = list(IMPORTERS[kind](source, options))
    assert len(recordings) == 1
    return recordings[0]


# --- BROAD


def broad_fields(known: Known) -> dict:
    opt_quat, opt_pos = known.q_nb.copy(), np.tile([1.0, 2.0, 3.0], (600, 1))
    opt_quat[100:120] = np.nan
    movement = np.arange(600) >= 300
    return {
        "imu_gyr": known.gyro_b_radps,
        "imu_acc": known.accel_b_mps2,
        "imu_mag": known.mag_b_ut,
        "opt_quat": opt_quat,
        "opt_pos": opt_pos,
        "movement": movement.astype(np.uint8)[:, None],
    }


@pytest.mark.parametrize("variant", ["mat", "attribute", "dataset"])
def test_broad_in_each_of_its_formats(known, tmp_path, variant):
    fields = broad_fields(known)
    if variant == "mat":
        file = tmp_path / "07_trial_B.mat"
        scipy.io.savemat(file, {**fields, "sampling_rate": 100.0})
    else:
        file = tmp_path / "07_trial_B.hdf5"
        with h5py.File(file, "w") as out:
            for name, values in fields.items():
                out[name] = values.squeeze()
            if variant == "attribute":
                out.attrs["sampling_rate"] = 100.0
            else:
                out["sampling_rate"] = 100.0
    trials = {"trials": {"07_trial_B": {"description": "turns", "groups": ["a", "b"]}}}
    (tmp_path / "trials.json").write_text(json.dumps(trials))
    recording = only("broad", file)
    assert_known(recording, known)
    assert recording.name == "07_trial_B"
    assert len(recording.truth.t_ns) == 580
    assert any("20 of 600" in note for note in recording.info.notes)
    assert (recording.truth.moving == (recording.truth.t_ns >= known.t_ns[300])).all()
    assert (recording.truth.position_n_m == [1, 2, 3]).all()
    assert recording.info.extra["description"] == "turns"
    assert set(recording.info.sha256) == {file.name, "trials.json"}


def test_the_rate_of_broad_is_a_period_of_whole_nanoseconds(known, tmp_path):
    # 285.71428571 Hz, as the files say, is 2000/7 Hz rounded: sample 50 000 would be 2.6 ns late.
    scipy.io.savemat(tmp_path / "x.mat", {**broad_fields(known), "sampling_rate": 285.71428571})
    assert (np.diff(only("broad", tmp_path / "x.mat").imu.t_ns) == 3_500_000).all()


# --- Tyrex


def write_tyrex(root: Path, known: Known, ios: bool, late_s: float = -2.0) -> Path:
    folder = root / ("ios" if ios else "android") / "Ann_PhoneX_NoDist_AR"
    folder.mkdir(parents=True)
    boot = 1234.5 if ios else 0.0
    accel = -known.accel_b_mps2 / G if ios else known.accel_b_mps2
    bias = np.tile([0.1, 0.2, 0.3], (600, 1))

    def save(name: str, *columns: np.ndarray) -> None:
        np.savetxt(folder / name, np.column_stack([known.t_s + 3.0 + boot, *columns]), fmt="%.12f")

    save("gyroscope.txt", known.gyro_b_radps, *([] if ios else [bias]))
    save("accelerometer.txt", accel)
    save("magnetometer.txt", known.mag_b_ut, *([] if ios else [bias]))
    save("magnetometer-calibrated.txt", -known.mag_b_ut)
    if ios:
        (folder / "description.txt").write_text("[Time]\nBootTime = 1234.5")
    else:
        (folder / "record.properties").write_text("[Time]\nStartTime = 1464871211\n")
    (folder / "timeAlignment.txt").write_text(f"  {late_s:.7e}\n")
    columns = rotation(known.q_nb).as_matrix().transpose(0, 2, 1).reshape(-1, 9).T.copy()
    columns[:, 50:55] = np.nan
    bodies = {"Rotations": columns[None], "Positions": np.full((1, 3, 600), 1500.0), "Residual": np.ones((1, 600))}
    motion = {"Frames": 600.0, "FrameRate": 100.0, "Timestamp": "2016-06-03, 11:23:29", "RigidBodies": bodies}
    (root / "qualisys").mkdir()
    scipy.io.savemat(root / "qualisys" / f"{folder.name}.mat", {folder.name: motion})
    return folder


@pytest.mark.parametrize("ios", [False, True])
def test_tyrex(known, tmp_path, ios):
    # The phone's clock starts 3 s before the motion, Qualisys' with it: aligned by -3 s.
    folder = write_tyrex(tmp_path, known, ios, late_s=-3.0)
    recording = only("tyrex", folder)
    assert_known(recording, known, start_ns=3_000_000_000, near=1e-8)
    assert recording.name == folder.name
    assert recording.info.date == ("2016-06-03" if ios else "2016-06-02")
    assert recording.info.mag_uncalibrated
    assert len(recording.truth.t_ns) == 595
    assert (recording.truth.position_n_m == 1.5).all()


def test_tyrex_with_the_field_that_the_phone_calibrated(known, tmp_path):
    folder = write_tyrex(tmp_path, known, ios=False)
    recording = only("tyrex", folder, TyrexOptions(mag="calibrated"))
    np.testing.assert_allclose(recording.mag.mag_b_ut, -known.mag_b_ut, atol=1e-9)
    assert not recording.info.mag_uncalibrated


def test_tyrex_truth_before_the_phone_started_is_dropped_and_counted(known, tmp_path):
    recording = only("tyrex", write_tyrex(tmp_path, known, ios=False, late_s=0.995))
    assert recording.truth.t_ns[0] == 5_000_000
    assert any(note.startswith("truth: 100 frames before") for note in recording.info.notes)


# --- bench


def test_bench_changes_units_and_clocks_but_no_sign(known, tmp_path):
    folder = tmp_path / "slow-turn"
    folder.mkdir()
    rows = {
        "mpu6050_gyroscope": ("gyroBuffer", np.rad2deg(known.gyro_b_radps)),
        "mpu6050_accelerometer": ("accelBuffer", -known.accel_b_mps2 / G),
        "hmc5883l_compass": ("compassBuffer", known.mag_b_ut / 100),
    }
    for name, (key, values) in rows.items():
        with h5py.File(folder / f"{name}.mat", "w") as out:
            out[key] = np.vstack([known.t_s, values.T])
    recording = only("bench", folder)
    np.testing.assert_allclose(recording.imu.accel_b_mps2, -known.accel_b_mps2, atol=1e-9)
    np.testing.assert_allclose(recording.imu.gyro_b_radps, known.gyro_b_radps, atol=1e-12)
    np.testing.assert_allclose(recording.mag.mag_b_ut, known.mag_b_ut, atol=1e-9)
    np.testing.assert_allclose(recording.imu.t_ns, known.t_ns, atol=2)
    assert recording.info.mag_uncalibrated


# --- delimited logs

HEADER = ["t", "gy", "gx", "gz", "ax", "ay", "az", "m0", "m1", "m2", "qw", "qx", "qy", "qz", "go"]


def csv_rows(known: Known, q: np.ndarray) -> list[list[str]]:
    """Milliseconds, deg/s with x and y swapped, g with y turned, counts of 0.25 uT with z turned."""
    w = np.rad2deg(known.gyro_b_radps)
    f = known.accel_b_mps2 / G
    m = known.mag_b_ut / 0.25
    moving = np.arange(600) % 2
    columns = [w[:, 1], w[:, 0], w[:, 2], f[:, 0], -f[:, 1], f[:, 2], m[:, 0], m[:, 1], -m[:, 2], *q.T, moving]
    table = np.column_stack([known.t_s * 1e3, *columns])
    rows = [[repr(float(cell)) for cell in row] for row in table]
    for row in rows[40:45]:
        row[10:14] = [""] * 4
    return rows


SETTINGS = {
    "time": "t:ms",
    "gyro": "gx,gy,gz:dps",
    "accel": "ax,-ay,az:g",
    "mag": "m0,m1,-m2:0.25*uT",
    "truth": "qw,qx,qy,qz",
    "moving": "go",
}


@pytest.mark.parametrize(("delimiter", "comma"), [(",", False), (";", True), ("\t", True), (";", False), (" ", False)])
def test_a_delimited_log_by_flags(known, tmp_path, delimiter, comma):
    file = tmp_path / "log.csv"
    rows = csv_rows(known, known.q_nb)
    if delimiter == " ":  # no empty cells in a log that is parted by blanks
        rows = [[cell or "nan" for cell in row] for row in rows]
    text = "\n".join(delimiter.join(row) for row in [HEADER, *rows])
    file.write_text("# a comment\n" + (text.replace(".", ",") if comma else text))
    recording = only("csv", file, CsvOptions(**SETTINGS))
    assert_known(recording, known)
    assert len(recording.truth.t_ns) == 595
    assert (recording.truth.moving == (recording.truth.t_ns // 10_000_000 % 2 == 1)).all()
    assert any("sign of y flipped" in line for line in recording.info.conversions)


def test_a_delimited_log_by_a_toml_file_and_by_column_numbers(known, tmp_path):
    file, config = tmp_path / "log.txt", tmp_path / "log.toml"
    file.write_text("\n".join(",".join(row) for row in csv_rows(known, known.q_nb)))
    numbered = {name: str(place + 1) for place, name in enumerate(HEADER)}
    lines = ['licence = "CC0"', 'time = "1:ms"', "drop-disordered = true"]
    for key in ("gyro", "accel", "mag", "truth", "moving"):
        columns, colon, unit = SETTINGS[key].partition(":")
        said = ",".join("-" * name.startswith("-") + numbered[name.lstrip("-")] for name in columns.split(","))
        lines.append(f'{key} = "{said}{colon}{unit}"')
    config.write_text("\n".join(lines))
    recording = only("csv", file, CsvOptions(config=config, sensor="IMU"))
    assert_known(recording, known)
    assert (recording.info.licence, recording.info.sensor) == ("CC0", "IMU")


@pytest.mark.parametrize("frame", ["nwu", "ned"])
def test_a_delimited_log_with_truth_in_another_local_frame(known, tmp_path, frame):
    # The rows of these matrices are the axes of the frame in East-North-Up.
    axes = {"nwu": [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], "ned": [[0, 1, 0], [1, 0, 0], [0, 0, -1]]}[frame]
    q = quaternion(Rotation.from_matrix(axes) * rotation(known.q_nb))
    file = tmp_path / "log.csv"
    file.write_text("\n".join(",".join(row) for row in [HEADER, *csv_rows(known, q)]))
    assert_known(only("csv", file, CsvOptions(**SETTINGS, truth_frame=frame)), known)


def test_stamps_of_the_epoch_are_kept_to_the_nanosecond(known, tmp_path):
    # A double would round 1.7e9 s to 0.24 us.
    file = tmp_path / "log.csv"
    stamps = [f"{(START_NS + t) // 10**9}.{(START_NS + t) % 10**9:09d}" for t in known.t_ns.tolist()]
    rows = [[stamp, *row[1:]] for stamp, row in zip(stamps, csv_rows(known, known.q_nb), strict=True)]
    file.write_text("\n".join(",".join(row) for row in [HEADER, *rows]))
    recording = only("csv", file, CsvOptions(**{**SETTINGS, "time": "t"}))
    assert_known(recording, known, start_ns=START_NS)
    assert (recording.info.epoch, recording.info.date) == ("unix", "2023-11-14")


def test_sensors_on_rows_of_their_own_keep_their_own_clocks(known, tmp_path):
    """Every second row has the field only; the accelerometer stands between the gyro's rows."""
    lines = ["t,gx,gy,gz,ax,ay,az,mx,my,mz"]
    for k in range(400):
        gyro = ["1.5", "0", "0"] if k % 2 == 0 else [""] * 3
        accel = ["0", f"{0.001 * k!r}", "9.8"] if k % 2 else [""] * 3
        mag = ["20", "0", "-40"] if k % 4 == 1 else [""] * 3
        lines.append(",".join([str(k), *gyro, *accel, *mag]))
    file = tmp_path / "rows.csv"
    file.write_text("\n".join(lines))
    options = CsvOptions(time="t:ms", gyro="gx,gy,gz:rad/s", accel="ax,ay,az:m/s^2", mag="mx,my,mz:uT")
    recording = only("csv", file, options)
    assert (recording.imu.t_ns == np.arange(2, 400, 2) * 1_000_000).all()
    np.testing.assert_allclose(recording.imu.accel_b_mps2[:, 1], 0.001 * np.arange(2, 400, 2), atol=1e-12)
    assert (recording.mag.t_ns == np.arange(1, 400, 4) * 1_000_000).all()
    assert "gyro: 1 samples without accelerometer samples around them dropped" in recording.info.notes


# --- Sensor Logger


def axis_csv(known: Known, values: np.ndarray) -> str:
    lines = ["time,seconds_elapsed,z,y,x"]
    for t, (x, y, z) in zip(known.t_ns.tolist(), values.tolist(), strict=True):
        lines.append(f"{START_NS + t},{t / 1e9},{z!r},{y!r},{x!r}")
    return "\n".join(lines)


def metadata_csv(platform: str, standardised: bool) -> str:
    return (
        "version,device name,recording epoch time,recording time,recording timezone,platform,appVersion,device id,"
        "sensors,sampleRateMs,standardisation,platform version\n"
        f"3,Phone X,1700000000123,2023-11-14_22-13-20,Europe/Berlin,{platform},1.64,abc,"
        f"Accelerometer|Gyroscope,10|10,{str(standardised).lower()},17"
    )


LOCATION = (
    "time,seconds_elapsed,bearingAccuracy,speedAccuracy,verticalAccuracy,horizontalAccuracy,speed,bearing,altitude,"
    "longitude,latitude\n"
    f"{START_NS},0,-1,-1,3,5,-1,-1,214.2,13.3,52.5\n{START_NS + 10**9},1,10,1,3,5,1.5,90,214.3,13.31,52.5\n"
)


@pytest.mark.parametrize("logged", ["raw", "total", "parts"])
@pytest.mark.parametrize(("platform", "standardised"), [("android", False), ("ios", False), ("ios", True)])
def test_sensorlogger(known, tmp_path, platform, standardised, logged):
    sign = -1.0 if platform == "ios" and not standardised else 1.0
    force = sign * known.accel_b_mps2
    gravity = sign * np.tile([0.1, -0.2, 9.7], (600, 1))
    files = {
        "Metadata.csv": metadata_csv(platform, standardised),
        "Gyroscope.csv": axis_csv(known, known.gyro_b_radps),
        "Magnetometer.csv": axis_csv(known, known.mag_b_ut),
        "Location.csv": LOCATION,
        "Accelerometer.csv": axis_csv(known, force - gravity),
        "Gravity.csv": axis_csv(known, gravity),
    }
    if logged == "total":
        files["TotalAcceleration.csv"] = axis_csv(known, force)
    if logged == "raw":
        files["AccelerometerUncalibrated.csv"] = axis_csv(known, force / G if sign < 0 else force)
    source = tmp_path / "2023-11-14_22-13-20.zip"
    with zipfile.ZipFile(source, "w") as archive:
        for name, text in files.items():
            archive.writestr(name, text)
    recording = only("sensorlogger", source)
    assert_known(recording, known, start_ns=START_NS, truth=False)
    assert (recording.info.epoch, recording.info.sensor) == ("unix", "Phone X")
    assert recording.name == "2023-11-14_22-13-20"
    np.testing.assert_allclose(recording.gps.course_rad, [np.nan, np.pi / 2])
    np.testing.assert_allclose(recording.gps.speed_mps, [np.nan, 1.5])
    assert recording.gps.lat_deg[1] == 52.5


def test_sensorlogger_takes_the_raw_field_where_it_was_logged_unless_asked(known, tmp_path):
    (tmp_path / "Gyroscope.csv").write_text(axis_csv(known, known.gyro_b_radps))
    (tmp_path / "TotalAcceleration.csv").write_text(axis_csv(known, known.accel_b_mps2))
    (tmp_path / "Magnetometer.csv").write_text(axis_csv(known, known.mag_b_ut))
    (tmp_path / "MagnetometerUncalibrated.csv").write_text(axis_csv(known, known.mag_b_ut + 300))
    raw = only("sensorlogger", tmp_path, PhoneOptions(platform="android"))
    assert raw.info.mag_uncalibrated
    np.testing.assert_allclose(raw.mag.mag_b_ut, known.mag_b_ut + 300)
    calibrated = only("sensorlogger", tmp_path, PhoneOptions(platform="android", mag="calibrated"))
    assert not calibrated.info.mag_uncalibrated
    np.testing.assert_allclose(calibrated.mag.mag_b_ut, known.mag_b_ut)


# --- phyphox


def phyphox_csv(known: Known, names: tuple[str, str, str], values: np.ndarray, delimiter: str, comma: bool) -> str:
    lines = [delimiter.join(f'"{name}"' for name in ("Time (s)", *names))]
    for t, row in zip(known.t_s.tolist(), values.tolist(), strict=True):
        cells = [f"{cell:.12E}" for cell in (t, *row)]
        lines.append(delimiter.join(cell.replace(".", ",") if comma else cell for cell in cells))
    return "\n".join(lines) + "\n"


def axes(what: str, unit: str) -> tuple[str, str, str]:
    return (f"{what} x ({unit})", f"{what} y ({unit})", f"{what} z ({unit})")


@pytest.mark.parametrize(("delimiter", "comma"), [(",", False), ("\t", False), (";", True), ("\t", True)])
def test_phyphox_with_each_separator_and_decimal_sign(known, tmp_path, delimiter, comma):
    start = f'"event"{delimiter}"experiment time"{delimiter}"system time"{delimiter}"system time text"\n'
    stamp = "1700000000.123".replace(".", "," if comma else ".")
    start += delimiter.join(['"START"', "0", stamp, '"2023-11-14 22:13:20.123 UTC+00:00"'])
    device = f'"property"{delimiter}"value"\n"version"{delimiter}"1.2.0"\n"deviceModel"{delimiter}"Pixel 6a"\n'
    files = {
        "Gyroskop.csv": (axes("Gyroskop", "rad/s"), known.gyro_b_radps),
        "Accelerometer.csv": (axes("Acceleration", "m/s^2"), known.accel_b_mps2),
        "Linear Accelerometer.csv": (axes("Linear Acceleration", "m/s^2"), known.accel_b_mps2 * 0),
        "Magnetometer.csv": (axes("Magnetic field", "µT"), known.mag_b_ut),
    }
    source = tmp_path / "run 2023-11-14.zip"
    with zipfile.ZipFile(source, "w") as archive:
        for name, (columns, values) in files.items():
            archive.writestr(name, phyphox_csv(known, columns, values, delimiter, comma))
        archive.writestr("meta/device.csv", device)
        archive.writestr("meta/time.csv", start)
    recording = only("phyphox", source)
    assert_known(recording, known, start_ns=1_700_000_000_123_000_000, truth=False)
    assert recording.info.sensor == "Pixel 6a"
    assert any("without gravity" in note for note in recording.info.notes)


def test_phyphox_puts_the_pauses_back_into_the_time(known, tmp_path):
    """Experiment time leaves pauses out: what comes after 2 s was taken 10 s later than it says."""
    names = (*axes("Gyroscope", "rad/s"), *axes("Acceleration", "m/s^2"))
    values = np.column_stack([known.gyro_b_radps, known.accel_b_mps2])
    (tmp_path / "Raw Data.csv").write_text(phyphox_csv(known, names, values, ",", False))
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta" / "time.csv").write_text(
        '"event","experiment time","system time","system time text"\n"START",0,100.5,""\n"PAUSE",2,102.5,""\n'
        '"START",2,112.5,""\n"PAUSE",6,116.5,""\n'
    )
    t_ns = only("phyphox", tmp_path).imu.t_ns
    assert t_ns[0] == 100_500_000_000
    assert t_ns[199] == 102_490_000_000
    assert t_ns[200] == 112_500_000_000


def test_phyphox_location(known, tmp_path):
    names = (*axes("Gyroscope", "rad/s"), *axes("Acceleration", "m/s^2"))
    values = np.column_stack([known.gyro_b_radps, known.accel_b_mps2])
    (tmp_path / "Raw Data.csv").write_text(phyphox_csv(known, names, values, ",", False))
    (tmp_path / "Location.csv").write_text(
        '"Time (s)","Latitude (°)","Longitude (°)","Height (m)","Velocity (m/s)","Direction (°)",'
        '"Horizontal Accuracy (m)","Vertical Accuracy (m)"\n0.5,NaN,NaN,NaN,NaN,NaN,NaN,NaN\n'
        "1.5,52.5,13.3,80,2,45,4,6\n"
    )
    gps = only("phyphox", tmp_path).gps
    assert gps.t_ns.tolist() == [1_500_000_000]
    assert (gps.lat_deg[0], gps.lon_deg[0], gps.alt_m[0], gps.speed_mps[0]) == (52.5, 13.3, 80, 2)
    assert gps.course_rad[0] == pytest.approx(np.pi / 4)


# --- ROS


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
def test_ros_in_each_of_its_containers(known, tmp_path, variant):
    source = ros_source(tmp_path, variant, known, "geometry_msgs/msg/PoseStamped")
    recording = only("ros", source)
    assert_known(recording, known, start_ns=START_NS, near=1e-12)
    assert recording.name == "run"
    assert recording.gps.valid.tolist() == [True, False, True, True, True, True]
    assert (recording.truth.position_n_m == [1, 2, 3]).all()


@pytest.mark.parametrize("variant", ["ros1", "sqlite", "mcap"])
def test_ros_truth_from_one_child_of_tf(known, tmp_path, variant):
    source = ros_source(tmp_path, variant, known, TF[0])
    recording = only("ros", source, RosOptions(truth_child="phone"))
    assert_known(recording, known, start_ns=START_NS, near=1e-12)


def test_the_leaves_of_the_ros_table_are_numbers_of_the_messages_they_stand_for():
    fields = get_typestore(Stores.ROS2_HUMBLE).fielddefs
    for kinds in LEAVES.values():
        for kind, leaves in kinds.items():
            for leaf in leaves:
                at = "geometry_msgs/msg/TransformStamped" if kind in TF else kind
                for part in leaf.split("."):
                    _, at = dict(fields[at][1])[part]
                assert at[0] in ("float64", "int8"), f"{kind}: {leaf}"
