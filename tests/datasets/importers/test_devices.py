"""The known recording through the logs of devices: its attitude distinguishes every axis, sign and order."""

import numpy as np
import pytest
from devices import table, write_euroc, write_ulog
from known import START_NS, G, Known, assert_known

from stillpoint.datasets import BadSource
from stillpoint.datasets.frames import quaternion, rotation, to_xyzw
from stillpoint.datasets.importers.imported import Imported
from stillpoint.datasets.importers.movella import MovellaOptions
from stillpoint.datasets.importers.table import IMPORTERS


def read_one(kind: str, source, options=None) -> Imported:
    (imported,) = IMPORTERS[kind].read_all(source, options)
    return imported


def assert_device(imported: Imported, known: Known, start_ns: int = 0, near: float = 1e-6) -> None:
    """The device's attitude is the known one, body to East-North-Up up to a heading."""
    (estimate,) = imported.estimates
    assert estimate.name == "device"
    assert estimate.recording == imported.recording.name
    at = np.searchsorted(known.t_ns + start_ns, estimate.t_ns)
    error = rotation(estimate.q_nb) * rotation(known.q_nb[at]).inv()
    heading = error[0]
    assert abs(heading.as_rotvec()[:2]).max() < near
    assert (heading.inv() * error).magnitude().max() < near


# --- ASL folders


@pytest.mark.parametrize("turned", [False, True])
def test_a_folder_in_the_asl_format_is_read(known, tmp_path, turned):
    turn = rotation([0.5, 0.5, 0.1, np.sqrt(0.49)]) if turned else None
    write_euroc(tmp_path / "MH_01" / "mav0", known, turn)
    recording = read_one("euroc", tmp_path / "MH_01").recording
    assert_known(recording, known, start_ns=START_NS, near=1e-8)
    assert recording.name == "MH_01"
    assert (recording.truth.position_n_m == [1, 2, 3]).all()
    assert any("T_BS" in line for line in recording.info.conversions) == turned


def test_a_magnetometer_in_an_unknown_unit_does_not_stop_the_rest(known, tmp_path):
    write_euroc(tmp_path / "mav0", known)
    file = tmp_path / "mav0" / "mag0" / "data.csv"
    file.write_text(file.read_text().replace("[uT]", "[furlong]"))
    recording = read_one("euroc", tmp_path).recording
    assert recording.mag is None
    assert any("furlong" in note for note in recording.info.notes)
    assert recording.truth is not None


# --- x-io


def test_ngimu_whose_quaternion_takes_the_earth_to_the_sensor(known, tmp_path):
    axes = [f"{what} {a} ({unit})" for what, unit in (("Gyroscope", "deg/s"), ("Accelerometer", "g")) for a in "XYZ"]
    axes += [f"Magnetometer {a} (uT)" for a in "XYZ"]
    values = np.column_stack([np.rad2deg(known.gyro_b_radps), known.accel_b_mps2 / G, known.mag_b_ut])
    (tmp_path / "sensors.csv").write_text(table(",".join(["Time (s)", *axes]), known.t_s, values))
    to_sensor = quaternion(rotation(known.q_nb).inv())
    (tmp_path / "quaternion.csv").write_text(table("Time (s),W,X,Y,Z", known.t_s, to_sensor))
    imported = read_one("ngimu", tmp_path)
    assert_known(imported.recording, known, near=1e-8, truth=False)
    assert_device(imported, known)
    assert not any("other way" in note for note in imported.recording.info.notes)


def test_ximu3_is_read_with_a_field_in_arbitrary_units(known, tmp_path):
    t_us = [str(t // 1000) for t in known.t_ns.tolist()]
    axes = [f"{what} {a} ({unit})" for what, unit in (("Gyroscope", "deg/s"), ("Accelerometer", "g")) for a in "XYZ"]
    values = np.column_stack([np.rad2deg(known.gyro_b_radps), known.accel_b_mps2 / G])
    (tmp_path / "Inertial.csv").write_text(table(",".join(["Timestamp (us)", *axes]), t_us, values))
    field = known.mag_b_ut / np.linalg.norm(known.mag_b_ut[0])
    (tmp_path / "Magnetometer.csv").write_text(table("Timestamp (us),X (a.u.),Y (a.u.),Z (a.u.)", t_us, field))
    (tmp_path / "Quaternion.csv").write_text(table("Timestamp (us),W,X,Y,Z", t_us, known.q_nb))
    imported = read_one("ximu3", tmp_path)
    recording = imported.recording
    np.testing.assert_allclose(recording.imu.gyro_b_radps, known.gyro_b_radps, atol=1e-9)
    np.testing.assert_allclose(recording.imu.accel_b_mps2, known.accel_b_mps2, atol=1e-9)
    np.testing.assert_allclose(recording.mag.mag_b_ut / 50, field, atol=1e-9)
    assert recording.info.mag_uncalibrated
    assert_device(imported, known)


def test_the_gyro_decides_which_way_a_quaternion_turns(known, tmp_path):
    """An x-IMU3 whose firmware writes the inverse: noted, and right."""
    t_us = [str(t // 1000) for t in known.t_ns.tolist()]
    axes = [f"{what} {a} ({unit})" for what, unit in (("Gyroscope", "deg/s"), ("Accelerometer", "g")) for a in "XYZ"]
    values = np.column_stack([np.rad2deg(known.gyro_b_radps), known.accel_b_mps2 / G])
    (tmp_path / "Inertial.csv").write_text(table(",".join(["Timestamp (us)", *axes]), t_us, values))
    inverse = quaternion(rotation(known.q_nb).inv())
    (tmp_path / "Quaternion.csv").write_text(table("Timestamp (us),W,X,Y,Z", t_us, inverse))
    imported = read_one("ximu3", tmp_path)
    assert_device(imported, known)
    assert any("other way than documented" in note for note in imported.recording.info.notes)


# --- Movella


def test_movella_dot_is_read_across_a_wrap_of_its_counter(known, tmp_path):
    t_us = (known.t_ns // 1000 + 2**32 - 3_000_000) % 2**32
    header = "PacketCounter,SampleTimeFine,Quat_W,Quat_X,Quat_Y,Quat_Z,"
    header += ",".join(f"{what}_{a}" for what in ("Acc", "Gyr", "Mag") for a in "XYZ") + ",Status"
    body = np.column_stack([known.q_nb, known.accel_b_mps2, np.rad2deg(known.gyro_b_radps), known.mag_b_ut / 40])
    counts = [str(k) for k in range(600)]
    text = table(header, counts, [str(t) for t in t_us.tolist()], body, ["0"] * 600)
    file = tmp_path / "dot.csv"
    file.write_text("DeviceTag: ,Left\nFirmwareVersion: ,3.0.0\nSyncStatus: ,Unsynced\n\n" + text)
    imported = read_one("movella", file)
    recording = imported.recording
    assert (np.diff(recording.imu.t_ns) == 10_000_000).all()
    np.testing.assert_allclose(recording.imu.gyro_b_radps, known.gyro_b_radps, atol=1e-9)
    np.testing.assert_allclose(recording.imu.accel_b_mps2, known.accel_b_mps2, atol=1e-9)
    assert any("wrapped" in note for note in recording.info.notes)
    assert_device(imported, known, start_ns=int(recording.imu.t_ns[0]))


def test_a_text_export_of_mt_manager_without_stamps_is_read(known, tmp_path):
    header = "PacketCounter\tSampleTimeFine\t" + "\t".join(f"{w}_{a}" for w in ("Acc", "Gyr") for a in "XYZ")
    header += "\t" + "\t".join(f"Quat_q{k}" for k in range(4))
    body = np.column_stack([known.accel_b_mps2, known.gyro_b_radps, known.q_nb])
    counts = [str(65_000 + k) if k < 536 else str(k - 536) for k in range(600)]
    text = table(header, counts, [""] * 600, body, delimiter="\t")
    file = tmp_path / "MT_0001.txt"
    file.write_text("// General information:\n//  MT Manager version:\t4.6\n// Update Rate: 100.0Hz\n" + text)
    imported = read_one("movella", file)
    assert (imported.recording.imu.t_ns == known.t_ns).all()
    np.testing.assert_allclose(imported.recording.imu.gyro_b_radps, known.gyro_b_radps, atol=1e-9)
    assert_device(imported, known)
    file.write_text(text)
    options = MovellaOptions(rate=100.0)
    assert (read_one("movella", file, options).recording.imu.t_ns == known.t_ns).all()


def test_movella_without_inertial_data_says_so(tmp_path):
    file = tmp_path / "dot.csv"
    file.write_text("PacketCounter,SampleTimeFine,Euler_X,FreeAcc_X\n1,100,0.1,0.0\n2,10100,0.1,0.0\n")
    with pytest.raises(BadSource, match=r"Gyr_X.*without gravity"):
        read_one("movella", file)


# --- SensorLog


def test_sensorlog_drops_repeated_rows_and_turns_apples_sign(known, tmp_path):
    boot_s = 5000.0
    stamps = [f"{boot_s + t:.6f}" for t in known.t_s.tolist()]
    late = [f"{boot_s + t + 0.001:.6f}" for t in known.t_s.tolist()]
    logged = [f"2021-05-06 18:31:{2 + t:09.6f} +0200" for t in known.t_s.tolist()]
    names = ["loggingTime(txt)", "gyroTimestamp_sinceReboot(s)", *(f"gyroRotation{a}(rad/s)" for a in "XYZ")]
    names += ["accelerometerTimestamp_sinceReboot(s)", *(f"accelerometerAcceleration{a}(G)" for a in "XYZ")]
    names += ["magnetometerTimestamp_sinceReboot(s)", *(f"magnetometer{a}(µT)" for a in "XYZ")]
    names += ["motionTimestamp_sinceReboot(s)", *(f"motionQuaternion{a}(R)" for a in "XYZW")]
    columns = [logged, stamps, known.gyro_b_radps, stamps, -known.accel_b_mps2 / G]
    columns += [late, known.mag_b_ut + 300.0, stamps, to_xyzw(known.q_nb)]
    lines = table(",".join(names), *columns).splitlines()
    doubled = [lines[0], *(line for row in lines[1:] for line in (row, row))]
    file = tmp_path / "log.csv"
    file.write_text("\n".join(doubled), encoding="utf-8")
    imported = read_one("sensorlog", file)
    recording = imported.recording
    assert (recording.imu.t_ns == known.t_ns + 5_000_000_000_000).all()
    np.testing.assert_allclose(recording.imu.gyro_b_radps, known.gyro_b_radps, atol=1e-9)
    np.testing.assert_allclose(recording.imu.accel_b_mps2, known.accel_b_mps2, atol=1e-9)
    np.testing.assert_allclose(recording.mag.mag_b_ut, known.mag_b_ut + 300, atol=1e-9)
    assert (recording.mag.t_ns == recording.imu.t_ns + 1_000_000).all()
    assert recording.info.mag_uncalibrated
    assert_device(imported, known, start_ns=5_000_000_000_000)


# --- KITTI


def test_kitti_oxts_is_read(known, tmp_path):
    folder = tmp_path / "drive_0001" / "oxts"
    (folder / "data").mkdir(parents=True)
    angles = rotation(known.q_nb).as_euler("ZYX")
    lines = []
    for k in range(600):
        numbers = np.zeros(30)
        numbers[:3] = 49.0, 8.4 + k * 1e-6, 112.0  # 0.0732 m eastwards a sample
        numbers[3:6] = angles[k, ::-1]
        numbers[6:8] = 0.0, 5.0  # towards east
        numbers[11:14], numbers[17:20] = known.accel_b_mps2[k], known.gyro_b_radps[k]
        (folder / "data" / f"{k:010d}.txt").write_text(" ".join(repr(float(number)) for number in numbers))
        lines.append(f"2011-09-26 13:02:{25 + k // 100:02d}.{k % 100 * 10_000_000:09d}")
    (folder / "timestamps.txt").write_text("\n".join(lines))
    recording = read_one("kitti", tmp_path).recording
    assert (recording.imu.t_ns - recording.imu.t_ns[0] == known.t_ns).all()
    assert recording.info.date == "2011-09-26"
    assert recording.name == "drive_0001"
    np.testing.assert_allclose(recording.imu.gyro_b_radps, known.gyro_b_radps, atol=1e-12)
    assert (rotation(recording.truth.q_nb.copy()) * rotation(known.q_nb).inv()).magnitude().max() < 1e-6
    up = rotation(recording.truth.q_nb.copy()).apply(recording.imu.accel_b_mps2.copy())
    np.testing.assert_allclose(up, np.tile([0, 0, G], (600, 1)), atol=1e-5)
    np.testing.assert_allclose(recording.gps.course_rad, np.pi / 2)
    np.testing.assert_allclose(recording.truth.position_n_m[:, 0], 0.0732 * np.arange(600), rtol=2e-3)
    np.testing.assert_allclose(recording.truth.position_n_m[:, 1:], 0.0, atol=1e-3)
    assert any("not independent" in note for note in recording.info.notes)


# --- PX4


def test_a_log_of_px4_is_read(known, tmp_path):
    pytest.importorskip("pyulog")
    write_ulog(tmp_path / "flight.ulg", known)
    imported = read_one("ulog", tmp_path / "flight.ulg")
    assert_known(imported.recording, known, start_ns=1_000_000_000, near=1e-6)
    assert_device(imported, known, start_ns=1_000_000_000, near=1e-5)
    assert any("North-East-Down" in line for line in imported.recording.info.conversions)


def test_other_bytes_are_refused_as_px4_log(tmp_path):
    pytest.importorskip("pyulog")
    (tmp_path / "x.ulg").write_bytes(b"nothing of the kind")
    with pytest.raises(BadSource, match=r"x\.ulg.*ULog"):
        read_one("ulog", tmp_path / "x.ulg")
