"""The known recording through the importers of public data: BROAD, Tyrex, the bench."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
from known import G, Known, assert_known, only

from stillpoint.datasets.frames import rotation
from stillpoint.datasets.importers.options import TyrexOptions

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
def test_broad_is_read_in_each_of_its_formats(known, tmp_path, variant):
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
def test_tyrex_is_read_from_each_system(known, tmp_path, ios):
    # The phone's clock starts 3 s before the motion, Qualisys' with it: aligned by -3 s.
    folder = write_tyrex(tmp_path, known, ios, late_s=-3.0)
    recording = only("tyrex", folder)
    assert_known(recording, known, start_ns=3_000_000_000, near=1e-8)
    assert recording.name == folder.name
    assert recording.info.date == ("2016-06-03" if ios else "2016-06-02")
    assert recording.info.mag_uncalibrated
    assert len(recording.truth.t_ns) == 595
    assert (recording.truth.position_n_m == 1.5).all()


def test_tyrex_is_read_with_the_field_that_the_phone_calibrated(known, tmp_path):
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
