"""Wrong input gives one line that names the file, the place and the remedy."""

import zipfile
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io

from stillpoint.datasets import BadParameter, BadSource, StillpointError
from stillpoint.datasets.importers.csv_log import CsvOptions
from stillpoint.datasets.importers.options import Options, PhoneOptions
from stillpoint.datasets.importers.ros import RosOptions
from stillpoint.datasets.importers.table import IMPORTERS

GOOD = CsvOptions(time="t:s", gyro="gx,gy,gz:rad/s", accel="ax,ay,az:m/s^2")
ROWS = [f"{k / 100},0,0,0,0,0,9.81" for k in range(300)]
HEADER = "t,gx,gy,gz,ax,ay,az"


def log(tmp_path: Path, *lines: str) -> Path:
    file = tmp_path / "log.csv"
    file.write_text("\n".join(lines))
    return file


def refused(kind: str, source: Path, options: Options | None, *said: str) -> StillpointError:
    """The error of an import: one line that says all of ``said`` and names the source."""
    with pytest.raises((BadSource, BadParameter)) as caught:
        list(IMPORTERS[kind](source, options))
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 500
    for word in said:
        assert word in message, message
    return caught.value


@pytest.mark.parametrize("kind", IMPORTERS)
def test_a_source_that_is_not_there_or_is_empty(kind, tmp_path):
    refused(kind, tmp_path / "nothing.zip", None, "nothing.zip", "no such file")
    (tmp_path / "empty").mkdir()
    options = GOOD if kind == "csv" else None
    assert isinstance(refused(kind, tmp_path / "empty", options, "empty"), BadSource)


# --- delimited logs


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ([], ("is empty",)),
        ([HEADER], ("no rows",)),
        ([HEADER.replace("gz", "gw"), *ROWS], ("no column 'gz'", "gw")),
        ([HEADER.replace("gz", "gx"), *ROWS], ("two columns are called 'gx'", "2 and 4")),
        ([HEADER, *ROWS[:5], "0.05,0,oops,0,0,0,9.81", *ROWS[6:]], ("line 7", "'gy'", "'oops'")),
        ([HEADER, *ROWS[:5], "0.05,0,0"], ("line 7", "3 cells", "'gz'")),
        ([HEADER, *ROWS[:5], "noon,0,0,0,0,0,9.81"], ("line 7", "'noon'", "no")),
        ([HEADER, *ROWS[:5], *ROWS[3:]], ("line 7", "does not rise", "--drop-disordered")),
        ([HEADER, *(row.replace("9.81", "") for row in ROWS)], ("no row has numbers", "--accel")),
    ],
)
def test_a_broken_log_names_line_and_column(tmp_path, lines, said):
    error = refused("csv", log(tmp_path, *lines), GOOD, "log.csv", *said)
    assert isinstance(error, BadSource)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (CsvOptions(gyro=GOOD.gyro, accel=GOOD.accel), ("time column", "t looks like it", "--time")),
        (CsvOptions(time="t:s", rate=100.0, gyro=GOOD.gyro, accel=GOOD.accel), ("two clocks", "--rate")),
        (CsvOptions(rate=-1.0, gyro=GOOD.gyro, accel=GOOD.accel), ("--rate -1", "positive")),
        (CsvOptions(time="t:min", gyro=GOOD.gyro, accel=GOOD.accel), ("no unit 'min'", "ms")),
        (CsvOptions(time="t:s", gyro="gx,gy,gz:deg", accel=GOOD.accel), ("--gyro", "no unit 'deg'", "deg/s")),
        (CsvOptions(time="t:s", gyro="gx,gy,gz", accel=GOOD.accel), ("--gyro", "no unit", "rad/s")),
        (CsvOptions(time="t:s", gyro="gx,gy:rad/s", accel=GOOD.accel), ("--gyro", "2 columns", "not 3")),
        (CsvOptions(time="t:s", gyro="gx,gx,gz:rad/s", accel=GOOD.accel), ("--gyro", "'gx' twice")),
        (CsvOptions(time="t:s", gyro="gx,gy,gz:x*rad/s", accel=GOOD.accel), ("--gyro", "no unit")),
        (CsvOptions(time="t:s", gyro=GOOD.gyro), ("--accel", "gx, gy, gz")),
    ],
)
def test_a_wrong_option_names_the_flag_and_what_there_is(tmp_path, options, said):
    assert isinstance(refused("csv", log(tmp_path, HEADER, *ROWS), options, *said), BadParameter)


def test_the_wrong_unit_is_seen_in_the_sizes_and_named(tmp_path):
    in_g = CsvOptions(time="t:s", gyro=GOOD.gyro, accel="ax,ay,az:g")
    refused("csv", log(tmp_path, HEADER, *ROWS), in_g, "log.csv", "96.2", "at rest", "9.8")
    kept = next(IMPORTERS["csv"](tmp_path / "log.csv", CsvOptions(**{**vars(in_g), "units_unchecked": True})))
    assert kept.info.units_unchecked


def test_disordered_rows_are_sorted_and_counted_when_asked(tmp_path):
    lines = [HEADER, *ROWS[:5], *ROWS[3:]]
    options = CsvOptions(**{**vars(GOOD), "drop_disordered": True})
    recording = next(IMPORTERS["csv"](log(tmp_path, *lines), options))
    assert (recording.imu.t_ns == np.arange(300) * 10_000_000).all()
    assert "gyro: 2 samples with the stamp of the one before dropped" in recording.info.notes


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("gyro = ", "is not TOML"),
        ("gyros = 'gx,gy,gz:rad/s'", "no setting 'gyros'"),
        ("rate = '100'", "rate = '100'"),
        ("rate = true", "rate = True"),
        ("gyro = 3", "gyro = 3"),
    ],
)
def test_a_wrong_config_file_gives_one_line_error(tmp_path, text, said):
    config = tmp_path / "log.toml"
    config.write_text(text)
    refused("csv", log(tmp_path, HEADER, *ROWS), CsvOptions(config=config), "log.toml", said)


@pytest.mark.parametrize(("truth", "said"), [("gx,gy,gz,ax", "no row has a quaternion"), ("gx,gy,gz,az", "not a unit")])
def test_columns_without_quaternions_are_refused(tmp_path, truth, said):
    refused("csv", log(tmp_path, HEADER, *ROWS), CsvOptions(**{**vars(GOOD), "truth": truth}), "log.csv", said)


# --- datasets


def test_broad_refuses_what_is_no_trial(tmp_path):
    (tmp_path / "a.mat").write_bytes(b"not a mat file, but long enough to be read as one" * 10)
    refused("broad", tmp_path / "a.mat", None, "a.mat", "cannot be read")
    (tmp_path / "a.hdf5").write_bytes(b"nor an hdf5 file")
    refused("broad", tmp_path / "a.hdf5", None, "a.hdf5", "cannot be read")
    scipy.io.savemat(tmp_path / "b.mat", {"imu_gyr": np.zeros((5, 3)), "imu_acc": np.zeros((5, 3))})
    refused("broad", tmp_path / "b.mat", None, "b.mat", "has no imu_mag, opt_quat")
    fields = {"imu_gyr": (5, 3), "imu_acc": (4, 3), "imu_mag": (5, 3), "opt_quat": (5, 4), "opt_pos": (5, 3)}
    arrays = {name: np.zeros(shape) for name, shape in fields.items()}
    scipy.io.savemat(tmp_path / "c.mat", {**arrays, "movement": np.zeros(5), "sampling_rate": 100.0})
    refused("broad", tmp_path / "c.mat", None, "c.mat", "imu_acc has 12 values, not 15")


def tyrex_trial(tmp_path: Path) -> Path:
    folder = tmp_path / "android" / "Ann_X_AR"
    folder.mkdir(parents=True)
    for name in ("gyroscope.txt", "accelerometer.txt", "magnetometer.txt"):
        np.savetxt(folder / name, np.column_stack([np.arange(100) / 100, np.full((100, 3), 5.66)]))
    return folder


def test_tyrex_refuses_half_a_trial(tmp_path):
    folder = tyrex_trial(tmp_path)
    assert len(list(IMPORTERS["tyrex"](folder))) == 1
    (folder / "magnetometer.txt").unlink()
    refused("tyrex", folder, None, "has no magnetometer.txt")
    (folder / "accelerometer.txt").write_text("0.1 2 3\n0.2 3 4\n")
    refused("tyrex", folder, None, "accelerometer.txt", "t x y z")
    (folder / "description.txt").write_text("[Time]\nStart = 3")
    refused("tyrex", folder, None, "description.txt", "BootTime")


def test_tyrex_truth_needs_its_alignment(tmp_path):
    folder = tyrex_trial(tmp_path)
    (tmp_path / "qualisys").mkdir()
    bodies = {"Rotations": np.eye(3).reshape(1, 9, 1), "Positions": np.zeros((1, 3, 1)), "Residual": np.zeros((1, 1))}
    motion = {"FrameRate": 60.0, "Timestamp": "2016-06-03", "RigidBodies": bodies}
    scipy.io.savemat(tmp_path / "qualisys" / "Ann_X_AR.mat", {"Ann_X_AR": motion})
    refused("tyrex", folder, None, "timeAlignment.txt", "is missing")
    (folder / "timeAlignment.txt").write_text("soon")
    refused("tyrex", folder, None, "timeAlignment.txt", "no number")
    scipy.io.savemat(tmp_path / "qualisys" / "Ann_X_AR.mat", {"Ann_X_AR": {"FrameRate": 60.0}})
    refused("tyrex", folder, None, "Ann_X_AR.mat", "Qualisys")


def test_bench_refuses_a_log_that_is_not_whole(tmp_path):
    folder = tmp_path / "still"
    folder.mkdir()
    for name in ("mpu6050_gyroscope.mat", "mpu6050_accelerometer.mat"):
        with h5py.File(folder / name, "w") as out:
            out["buffer"] = np.vstack([np.arange(100) / 100, np.ones((3, 100))])
    refused("bench", folder, None, "has no hmc5883l_compass.mat")
    with h5py.File(folder / "hmc5883l_compass.mat", "w") as out:
        out["buffer"] = np.ones((3, 100))
    refused("bench", folder, None, "hmc5883l_compass.mat", "(3, 100)", "4 rows")
    (folder / "hmc5883l_compass.mat").write_bytes(b"?")
    refused("bench", folder, None, "hmc5883l_compass.mat", "cannot be read")


# --- phones and bags


@pytest.mark.parametrize("kind", ["sensorlogger", "phyphox"])
def test_a_file_that_is_no_zip_and_a_zip_without_csv(kind, tmp_path):
    (tmp_path / "x.zip").write_bytes(b"PK but not really")
    refused(kind, tmp_path / "x.zip", None, "x.zip", "cannot be read as a zip")
    with zipfile.ZipFile(tmp_path / "y.zip", "w") as archive:
        archive.writestr("readme.txt", "nothing")
    refused(kind, tmp_path / "y.zip", None, "y.zip", "holds no CSV")


AXES = "time,seconds_elapsed,z,y,x\n1700000000000000000,0,9.8,0,0\n1700000000010000000,0.01,9.8,0,0\n"


def test_sensorlogger_says_what_to_log(tmp_path):
    (tmp_path / "Accelerometer.csv").write_text(AXES)
    refused("sensorlogger", tmp_path, None, "no Gyroscope.csv")
    (tmp_path / "Gyroscope.csv").write_text(AXES)
    refused("sensorlogger", tmp_path, None, "--platform ios or --platform android")
    android = PhoneOptions(platform="android")
    refused("sensorlogger", tmp_path, android, "without gravity", "Gravity.csv")
    (tmp_path / "Gravity.csv").write_text(
        AXES.replace("0000000000000,", "0000000000007,").replace("10000000,", "10000007,")
    )
    refused("sensorlogger", tmp_path, android, "share 0 of 2 stamps")
    (tmp_path / "TotalAcceleration.csv").write_text(AXES.replace("z,y,x", "z,y,w"))
    refused("sensorlogger", tmp_path, android, "TotalAcceleration.csv", "no column 'x'")


def test_phyphox_says_what_to_record(tmp_path):
    gyro = '"Time (s)","Gyroscope x (rad/s)","Gyroscope y (rad/s)","Gyroscope z (rad/s)"\n0,0,0,0\n0.01,0,0,0\n'
    (tmp_path / "Gyroscope.csv").write_text(gyro)
    refused("phyphox", tmp_path, None, "acceleration with gravity (m/s^2)")
    (tmp_path / "Linear Accelerometer.csv").write_text(
        gyro.replace("Gyroscope", "Acceleration").replace("rad/s", "m/s^2")
    )
    refused("phyphox", tmp_path, None, "acceleration with gravity (m/s^2)")
    (tmp_path / "Gyroscope 2.csv").write_text(gyro)
    refused("phyphox", tmp_path, None, "gyro is there twice", "Gyroscope 2.csv")
    (tmp_path / "Gyroscope 2.csv").unlink()
    (tmp_path / "Gyroscope.csv").write_text(gyro.replace("Gyroscope x (rad/s)", "Zeit (s)"))
    refused("phyphox", tmp_path, None, "gyroscope (rad/s)")
    both = gyro.replace('"Time (s)"', '"Time (s)","Zeit (s)"').replace(",0,0,0\n", ",0,0,0,0\n")
    (tmp_path / "Gyroscope.csv").write_text(both)
    refused("phyphox", tmp_path, None, "Gyroscope.csv", "2 time columns")


def test_ros_refuses_what_is_no_bag_and_lists_topics(tmp_path):
    (tmp_path / "x.txt").write_text("hello")
    refused("ros", tmp_path / "x.txt", None, "x.txt", "is not a bag")
    (tmp_path / "x.bag").write_bytes(b"#ROSBAG V2.0\nbut cut off")
    refused("ros", tmp_path / "x.bag", None, "x.bag", "cut short")
    (tmp_path / "x.mcap").write_bytes(b"\x89MCAP?")
    refused("ros", tmp_path / "x.mcap", None, "x.mcap")


def test_ros_asks_which_of_several_topics(tmp_path):
    from stillpoint.datasets.mcap.writer import Stream, write_mcap

    t_ns = np.arange(100, dtype=np.int64) * 10_000_000
    columns = {"angular_velocity.x": np.zeros(100), "linear_acceleration.z": np.full(100, 9.81)}
    streams = [Stream(topic, "sensor_msgs/msg/Imu", t_ns, columns, {}, {}) for topic in ("/hand", "/head")]
    file = tmp_path / "two.mcap"
    write_mcap(file, streams, {}, {}, library="test")
    assert isinstance(refused("ros", file, None, "two.mcap", "/hand, /head", "--imu-topic"), BadParameter)
    assert len(next(IMPORTERS["ros"](file, RosOptions(imu_topic="/head"))).imu.t_ns) == 100
    refused("ros", file, RosOptions(imu_topic="/foot"), "/foot", "/hand (sensor_msgs/Imu)")
    refused("ros", file, RosOptions(imu_topic="/head", mag_topic="/head"), "no such topic for mag")
