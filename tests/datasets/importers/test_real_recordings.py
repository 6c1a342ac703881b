"""The real recordings: their known facts, and physics through the truth (signs, axes, frames, clocks)."""

from pathlib import Path

import numpy as np
import pytest

from stillpoint.datasets import Recording
from stillpoint.datasets.frames import rotation
from stillpoint.datasets.importers.csv_log import CsvOptions
from stillpoint.datasets.importers.options import TyrexOptions
from stillpoint.datasets.importers.table import IMPORTERS
from stillpoint.datasets.recording import rate_hz
from stillpoint.smoother.rest import find_rests

pytestmark = pytest.mark.real_data

# How late the gyro's stamps are against the truth, s (measured, see the dataset's notes).
TYREX_LATE_S = {
    "Guillaume_Nexus5_NoDist_AR": 0.017,
    "Guillaume_Nexus5_NoDist_Texting": 0.0205,
    "Guillaume_Nexus5_NoDist_Swinging": 0.0237,
    "Guillaume_Nexus5_Dist_Phoning": 0.0192,
    "Guillaume_Nexus5_NoDist_RunningHand": 0.0218,
    "Guillaume_iPhone5_NoDist_Texting": 0.030,
    "Guillaume_iPhone5_Dist_AR": 0.0129,
    "Guillaume_iPhone5_NoDist_Phoning": 0.0169,
    "Guillaume_iPhone4S_NoDist_AR": 0.0091,
    "Guillaume_iPhone4S_Dist_FrontPocket": 0.0096,
}
GYRO_BIAS_DPS = {"Nexus5": (2, 3.8, 4.7), "iPhone5": (0, 5.4, 5.8)}  # axis, from, to
MAG_HZ = {"Nexus5": 49.65, "iPhone4S": 38.3, "iPhone5": 24.7}


@pytest.fixture(scope="module")
def broad(data_dir: Path) -> list[Recording]:
    return list(IMPORTERS["broad"](data_dir / "broad"))


@pytest.fixture(scope="module")
def tyrex(data_dir: Path) -> list[Recording]:
    return list(IMPORTERS["tyrex"](data_dir / "tyrex"))


def rates_of_truth(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Mid times in s and body rates of the truth between neighbouring scored samples."""
    truth = recording.truth
    q = rotation(truth.q_nb)
    step_s = np.diff(truth.t_ns) / 1e9
    whole = (step_s < 1.5 * np.median(step_s)) & truth.moving[1:] & truth.moving[:-1]
    turned = (q[:-1].inv() * q[1:]).as_rotvec() / step_s[:, None]
    return (truth.t_ns[1:] / 1e9 - step_s / 2)[whole], turned[whole]


def gyro_against_truth(recording: Recording, late_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Correlation per axis, and the median difference (bias) in deg/s."""
    mid_s, truth = rates_of_truth(recording)
    t_s = recording.imu.t_ns / 1e9
    near = np.abs(t_s[np.clip(np.searchsorted(t_s, mid_s + late_s), 0, len(t_s) - 1)] - mid_s - late_s) < 0.02
    gyro = np.stack([np.interp(mid_s + late_s, t_s, axis) for axis in recording.imu.gyro_b_radps.T], axis=1)
    same = [np.corrcoef(gyro[near, k], truth[near, k])[0, 1] for k in range(3)]
    return np.array(same), np.rad2deg(np.median(gyro[near] - truth[near], axis=0))


def field_and_hard_iron(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Least squares of m_b = R_nb^T h_n + o_b over the truth's samples."""
    mag, truth = recording.mag, recording.truth
    at = np.clip(np.searchsorted(mag.t_ns, truth.t_ns), 0, len(mag.t_ns) - 1)
    turns = rotation(truth.q_nb).as_matrix().transpose(0, 2, 1)
    design = np.concatenate([turns, np.broadcast_to(np.eye(3), turns.shape)], axis=2).reshape(-1, 6)
    found = np.linalg.lstsq(design, mag.mag_b_ut[at].reshape(-1), rcond=None)[0]
    return found[:3], found[3:]


def mean_force_n(recording: Recording) -> np.ndarray:
    """Mean specific force in n over the scored samples of the truth that have an IMU sample within 20 ms."""
    imu, truth = recording.imu, recording.truth
    at = np.clip(np.searchsorted(imu.t_ns, truth.t_ns), 0, len(imu.t_ns) - 1)
    near = truth.moving & (np.abs(imu.t_ns[at] - truth.t_ns) < 20_000_000)
    return rotation(truth.q_nb[near]).apply(imu.accel_b_mps2[at[near]]).mean(axis=0)


def test_all_broad_trials_are_read(broad):
    assert len(broad) == 12
    for recording in broad:
        assert rate_hz(recording.imu.t_ns) == pytest.approx(2000 / 7, rel=1e-12)
        missing = 1 - len(recording.truth.t_ns) / len(recording.imu.t_ns)
        assert 0.0005 < missing < 0.09, recording.name
        assert recording.info.licence == "CC BY 4.0"
        assert recording.info.extra["description"]


def test_broad_rests_at_both_ends_and_the_size_of_gravity_there(broad):
    for recording in broad:
        rests = find_rests(recording.imu)
        t_ns = recording.imu.t_ns
        assert len(rests) >= 2
        first, last = rests[0], rests[-1]
        assert first[0] - t_ns[0] < 2e9, recording.name
        assert 18 < (first[1] - first[0]) / 1e9 < 48, recording.name
        assert t_ns[-1] - last[1] < 2e9, recording.name
        assert 18 < (last[1] - last[0]) / 1e9 < 42, recording.name
        still = (t_ns >= first[0]) & (t_ns <= first[1])
        size = np.linalg.norm(recording.imu.accel_b_mps2[still].mean(axis=0))
        assert 9.80 < size < 9.91, recording.name
        assert np.rad2deg(np.abs(recording.imu.gyro_b_radps[still].mean(axis=0))).max() < 0.6, recording.name


def test_broad_sensors_agree_with_the_truth(broad):
    """Gyro turns as the truth does, gravity leads up, the field leads to magnetic north and down."""
    for recording in broad:
        same, _ = gyro_against_truth(recording, late_s=0.0042)
        assert (same > 0.97).all(), recording.name
        force = mean_force_n(recording)
        assert np.abs(force[:2]).max() < 0.1, recording.name
        assert 9.75 < force[2] < 9.95, recording.name
        field, _ = field_and_hard_iron(recording)
        assert abs(np.rad2deg(np.arctan2(field[0], field[1]))) < 7, recording.name
        assert field[2] < -30, recording.name


def test_all_tyrex_trials_are_read(tyrex):
    assert [r.name for r in tyrex] == sorted(TYREX_LATE_S)
    for recording in tyrex:
        model = recording.info.sensor
        assert rate_hz(recording.mag.t_ns) == pytest.approx(MAG_HZ[model], rel=0.005)
        assert rate_hz(recording.truth.t_ns) == pytest.approx(60, rel=1e-5)
        assert recording.info.mag_uncalibrated
        assert recording.info.date.startswith("2016-06-")
        assert not any("calibrated" in name for name in recording.info.sha256)


def test_tyrex_sensors_agree_with_the_truth(tyrex):
    """On both systems, with the measured lag: gyro, gravity, and the field after its hard iron, 0-7 deg from true north
    (Grenoble's declination is 2 deg; trials with magnets are left out of that)."""
    for recording in tyrex:
        same, bias_dps = gyro_against_truth(recording, TYREX_LATE_S[recording.name])
        assert (same > 0.87).all(), recording.name
        if recording.info.sensor in GYRO_BIAS_DPS:
            axis, low, high = GYRO_BIAS_DPS[recording.info.sensor]
            assert low < bias_dps[axis] < high, recording.name
        force = mean_force_n(recording)
        assert np.abs(force[:2]).max() < 0.1, recording.name
        assert force[2] > 7, recording.name
        field, hard_iron = field_and_hard_iron(recording)
        assert np.linalg.norm(hard_iron) > 300, recording.name
        if "NoDist" in recording.name:
            assert -2 < np.rad2deg(np.arctan2(field[0], field[1])) < 7, recording.name
            assert 36 < np.linalg.norm(field) < 52, recording.name


def test_tyrex_lag_against_the_truth_is_left_as_it_is(tyrex):
    """The best lag is the measured one, not zero: the importer moves no clock beyond timeAlignment.txt."""
    for recording in tyrex:
        lags = np.arange(-0.01, 0.05, 0.004)
        same = [gyro_against_truth(recording, lag)[0].mean() for lag in lags]
        assert abs(lags[int(np.argmax(same))] - TYREX_LATE_S[recording.name]) < 0.005, recording.name


def test_tyrex_gyro_gap_stays_a_gap_and_the_authors_exclusions_are_not_scored(tyrex):
    recording = next(r for r in tyrex if r.name == "Guillaume_Nexus5_NoDist_AR")
    assert np.diff(recording.imu.t_ns).max() / 1e9 == pytest.approx(23.7, abs=0.1)
    assert (~recording.truth.moving).sum() == 3360
    assert recording.truth.moving.sum() > 3500


def test_tyrex_calibrated_field_has_no_hard_iron(data_dir):
    folder = data_dir / "tyrex" / "android" / "Guillaume_Nexus5_NoDist_Swinging"
    recording = next(IMPORTERS["tyrex"](folder, TyrexOptions(mag="calibrated")))
    assert np.linalg.norm(field_and_hard_iron(recording)[1]) < 8
    assert not recording.info.mag_uncalibrated


def test_bench_keeps_the_flaws_of_the_log(data_dir):
    logs = {recording.name: recording for recording in IMPORTERS["bench"](data_dir / "bench")}
    assert len(logs) == 5
    still = logs["unmoved-with-z-pointing-front-and-y-down"]
    assert rate_hz(still.imu.t_ns) == pytest.approx(99.4, abs=0.5)
    assert rate_hz(still.mag.t_ns) == pytest.approx(76.9, abs=0.1)
    bias_dps = np.rad2deg(still.imu.gyro_b_radps.mean(axis=0))
    np.testing.assert_allclose(bias_dps, [4.5, 0.05, 1.1], atol=0.1)
    # y points down, and a right accelerometer would read -g on it.
    np.testing.assert_allclose(still.imu.accel_b_mps2.mean(axis=0) / 9.80665, [0.03, 1.01, 0.05], atol=0.02)
    assert np.ptp(np.diff(still.imu.t_ns)) <= 1


def test_flags_describe_the_log_of_a_disc(data_dir):
    file = next((data_dir / "disc").glob("*.csv"))
    options = CsvOptions(
        rate=100.0,
        gyro="gx,gy,gz:deg/s",
        accel="acc-x,acc-y,acc-z:g",
        mag="mag-x,mag-y,mag-z:uT",
        mag_uncalibrated=True,
    )
    recording = next(IMPORTERS["csv"](file, options))
    assert len(recording.imu.t_ns) == 3558
    assert np.rad2deg(np.abs(recording.imu.gyro_b_radps).max()) == pytest.approx(3391, abs=1)
    throw = slice(1584, 1874)
    spin_dps = np.rad2deg(np.abs(recording.imu.gyro_b_radps[throw, 2]))
    assert np.median(spin_dps) > 2000
    assert np.linalg.norm(recording.imu.accel_b_mps2[:100].mean(axis=0)) / 9.80665 == pytest.approx(1.03, abs=0.02)
