"""The bench of Byambajav et al.: exact motion, data-sheet sensors, the paper's drift."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stillpoint.datasets import BadParameter, Recording
from stillpoint.datasets.earth import normal_gravity_mps2
from stillpoint.datasets.frames import rotation
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.simulate.servo import BENCH, MPU6050, plan_swings
from stillpoint.filters import estimate

MINUTES = 5.0
G = normal_gravity_mps2(47.92, 1350.0)


@pytest.fixture(scope="module")
def bench() -> Recording:
    return simulate("servo-bench", minutes=MINUTES)


@pytest.fixture(scope="module")
def perfect() -> Recording:
    return simulate("servo-bench", minutes=MINUTES, sensor="perfect")


def during(recording: Recording, rate_hz: float) -> np.ndarray:
    """The IMU samples within the swings at this rate."""
    t_s = (recording.truth.t_ns - 1_398_916_800_000_000_000) / 1e9
    rests, rates = json.loads(recording.info.extra["rests_s"]), json.loads(recording.info.extra["swings_hz"])
    inside = np.zeros(len(t_s), dtype=bool)
    for k, rate in enumerate(rates):
        if rate == rate_hz:
            inside |= (t_s > rests[k][1]) & (t_s < rests[k + 1][0])
    return inside


@pytest.mark.slow
def test_rate_and_acceleration_are_the_derivatives_of_the_motion() -> None:
    path = plan_swings(BENCH, 300.0, 0, "servo-bench")
    t_s, h = np.linspace(55.0, 215.0, 40_001), 1e-5
    angle, rate, accel = path.angle(t_s)
    before, after = path.angle(t_s - h), path.angle(t_s + h)
    assert rate == pytest.approx((after[0] - before[0]) / (2 * h), abs=1e-5)
    assert accel == pytest.approx((after[1] - before[1]) / (2 * h), abs=2e-3)  # the third derivative jumps at the ends
    second = (path.position(t_s + h) - 2 * path.position(t_s) + path.position(t_s - h)) / h**2
    assert path.acceleration_n_mps2(t_s) == pytest.approx(second, abs=0.05)
    assert np.rad2deg([angle.min(), angle.max()]) == pytest.approx([-90, 90], abs=0.3)


@pytest.mark.slow
def test_a_perfect_gyro_integrates_to_the_truth_and_rests_are_still(perfect: Recording) -> None:
    imu, truth = perfect.require_imu(), perfect.truth
    dt_s = np.diff(imu.t_ns)[:, None] / 1e9
    steps = Rotation.from_rotvec(imu.gyro_b_radps[1:] * dt_s)
    q_nb = rotation(truth.q_nb)
    assert (steps.inv() * (q_nb[:-1].inv() * q_nb[1:])).magnitude().max() < 1e-9
    still = ~truth.moving
    assert np.linalg.norm(imu.accel_b_mps2[still], axis=1) == pytest.approx(G, abs=1e-9)
    assert np.abs(q_nb[still].inv().apply([0, 0, G]) - imu.accel_b_mps2[still]).max() < 1e-9
    assert (rotation(perfect.base_pose).inv() * q_nb[0]).magnitude() < 1e-9


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes_and_a_longer_run_begins_alike() -> None:
    one, again, other = (simulate("servo-bench", seed=s, minutes=2.5) for s in (3, 3, 4))
    longer = simulate("servo-bench", seed=3, minutes=6.0)
    assert one.imu.accel_b_mps2.tobytes() == again.imu.accel_b_mps2.tobytes()
    assert (one.imu.accel_b_mps2[:100] != other.imu.accel_b_mps2[:100]).any()
    n = 120 * 100  # the first rest and swing
    assert (one.imu.gyro_b_radps[:n] == longer.imu.gyro_b_radps[:n]).all()
    assert (one.imu.accel_b_mps2[:n] == longer.imu.accel_b_mps2[:n]).all()


@pytest.mark.slow
def test_the_converters_have_the_steps_of_the_data_sheets(bench: Recording) -> None:
    imu, mag = bench.require_imu(), bench.mag
    gyro_lsb = np.rad2deg(imu.gyro_b_radps) * 131.072  # the sheets round to 131 and 16384 per deg/s and g
    accel_lsb = imu.accel_b_mps2 / 9.80665 * 16384
    mag_lsb = mag.mag_b_ut / 100 * 1090
    assert np.abs(gyro_lsb - np.round(gyro_lsb)).max() < 1e-6
    assert np.abs(accel_lsb - np.round(accel_lsb)).max() < 1e-6
    assert np.abs(mag_lsb - np.round(mag_lsb)).max() < 0.01 * np.abs(mag_lsb).max()
    assert np.abs(mag_lsb).max() < 2048
    assert len(mag.t_ns) / len(imu.t_ns) == pytest.approx(0.75, abs=1e-3)


def test_noise_at_rest_is_that_of_the_data_sheets(bench: Recording) -> None:
    rest = slice(0, 5900)
    gyro = np.rad2deg(np.diff(bench.imu.gyro_b_radps[rest], axis=0)).std() / np.sqrt(2)
    accel = np.diff(bench.imu.accel_b_mps2[rest], axis=0).std() / np.sqrt(2) / 9.80665
    assert gyro == pytest.approx(0.005 * 10, rel=0.03)  # per root Hz, at 100 Hz
    assert accel == pytest.approx(400e-6 * 10, rel=0.03)
    assert np.diff(bench.mag.mag_b_ut[: 60 * 75], axis=0).std() / np.sqrt(2) == pytest.approx(0.2, rel=0.05)


@pytest.mark.slow
def test_the_gyro_alone_drifts_by_50_deg_a_minute_in_the_median() -> None:
    """Fig 5. A normal bias of this sd is below 0.84 deg/s half of the time."""
    drawn = [json.loads(simulate("servo-bench", seed=s, minutes=2.2).info.extra["sensor_drawn"]) for s in range(60)]
    bias_degps = np.rad2deg([facts["gyro"]["bias"] for facts in drawn])
    assert 60 * np.median(np.abs(bias_degps)) == pytest.approx(50, abs=8)  # 180 draws: 9 % of sampling error
    assert np.abs(bias_degps).max() < 20  # what the sheet allows


def test_the_drift_of_a_recording_is_its_bias_times_the_time() -> None:
    recording = simulate("servo-bench", seed=1, minutes=2.2)
    found = estimate(recording, "gyro", {"rule": "trapezoidal"})
    minute = slice(None, 6000)  # the rest
    turned = rotation(found.q_nb[minute]).inv()[0] * rotation(found.q_nb[minute])[-1]
    bias = np.array(json.loads(recording.info.extra["sensor_drawn"])["gyro"]["bias"])
    assert np.rad2deg(turned.magnitude()) == pytest.approx(np.rad2deg(np.linalg.norm(bias)) * 59.99, rel=0.05)


@pytest.mark.slow
def test_the_bias_changes_while_the_device_warms_up() -> None:
    recording = simulate("servo-bench", seed=2, minutes=30)
    drawn = json.loads(recording.info.extra["sensor_drawn"])["gyro"]
    truth_rate = simulate("servo-bench", seed=2, minutes=30, sensor="perfect").imu.gyro_b_radps
    still = ~recording.truth.moving
    n = min(len(truth_rate), len(still))
    off = recording.imu.gyro_b_radps[:n][still[:n]] - 0.0
    changed = off[-3000:].mean(axis=0) - off[:3000].mean(axis=0)
    # Over 30 min e^-6 is left of it; the wandering bias (20 deg/h) is on top, and the first half minute is 5 % warm.
    assert np.rad2deg(changed - 0.95 * np.array(drawn["warming"])) == pytest.approx([0, 0, 0], abs=0.04)


def test_the_accelerometer_s_angle_is_worse_at_the_high_rate(bench: Recording) -> None:
    """Byambajav et al., fig 6."""
    imu, up_b = bench.require_imu(), rotation(bench.truth.q_nb).inv().apply([0, 0, 1])
    seen = imu.accel_b_mps2 / np.linalg.norm(imu.accel_b_mps2, axis=1, keepdims=True)
    off_deg = np.rad2deg(np.arccos(np.clip((seen * up_b).sum(axis=1), -1, 1)))
    rms = [
        np.sqrt(np.mean(off_deg[rows] ** 2)) for rows in (~bench.truth.moving, during(bench, 0.1), during(bench, 0.4))
    ]
    assert rms[0] < rms[1] < 0.7 * rms[2]
    assert np.abs(imu.gyro_b_radps[:, 0]).max() < np.deg2rad(MPU6050.gyro.range_degps)
    assert bench.info.notes == ()


def test_too_short_a_run_says_what_it_needs() -> None:
    with pytest.raises(BadParameter, match=r"servo-bench needs at least 2\.17"):
        simulate("servo-bench", minutes=2.0)
