"""The known recording through the logging apps of phones."""

import zipfile

import numpy as np
import pytest
from known import START_NS, G, Known, assert_known, only

from stillpoint.datasets import BadParameter, BadSource
from stillpoint.datasets.frames import quaternion, rotation
from stillpoint.datasets.importers.options import PhoneOptions
from stillpoint.datasets.importers.table import IMPORTERS

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
def test_sensorlogger_is_read_from_each_platform(known, tmp_path, platform, standardised, logged):
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


@pytest.mark.parametrize("inverse", [False, True])
def test_the_attitude_of_the_phone_becomes_an_estimate_whichever_way_it_turns(known, tmp_path, inverse):
    (tmp_path / "Gyroscope.csv").write_text(axis_csv(known, known.gyro_b_radps))
    (tmp_path / "TotalAcceleration.csv").write_text(axis_csv(known, known.accel_b_mps2))
    q = quaternion(rotation(known.q_nb).inv()) if inverse else known.q_nb
    lines = [
        f"{START_NS + t},{','.join(map(repr, row))}" for t, row in zip(known.t_ns.tolist(), q.tolist(), strict=True)
    ]
    (tmp_path / "Orientation.csv").write_text("\n".join(["time,qw,qx,qy,qz", *lines]))
    (imported,) = IMPORTERS["sensorlogger"].read_all(tmp_path, PhoneOptions(platform="android"))
    (device,) = imported.estimates
    assert (rotation(device.q_nb.copy()) * rotation(known.q_nb).inv()).magnitude().max() < 1e-6
    assert any("other way" in note for note in imported.recording.info.notes) == inverse


def test_an_empty_file_is_not_taken_and_a_wrong_platform_says_so(known, tmp_path):
    (tmp_path / "Gyroscope.csv").write_text(axis_csv(known, known.gyro_b_radps))
    (tmp_path / "AccelerometerUncalibrated.csv").write_text(axis_csv(known, -known.accel_b_mps2 / G))
    (tmp_path / "GyroscopeUncalibrated.csv").write_text("")
    (tmp_path / "MagnetometerUncalibrated.csv").write_text("time,seconds_elapsed,z,y,x\n")
    recording = only("sensorlogger", tmp_path, PhoneOptions(platform="ios"))
    assert any("GyroscopeUncalibrated.csv" in note and "empty" in note for note in recording.info.notes)
    with pytest.raises(BadSource, match="this looks like ios: check --platform"):
        only("sensorlogger", tmp_path, PhoneOptions(platform="android"))
    (tmp_path / "Metadata.csv").write_text(metadata_csv("ios", False))
    with pytest.raises(BadParameter, match=r"Metadata.csv of .* says ios"):
        only("sensorlogger", tmp_path, PhoneOptions(platform="android"))


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
def test_phyphox_is_read_with_each_separator_and_decimal_sign(known, tmp_path, delimiter, comma):
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


def test_phyphox_locations_are_read(known, tmp_path):
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
