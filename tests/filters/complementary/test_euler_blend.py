"""``cf-literal`` against Elmi Aziz and Mohseni Araste's equations (4)-(11), written out per Euler angle with scipy."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from stillpoint.datasets import Imu, Info, Mag, Recording
from stillpoint.datasets.frames import euler, rotation, wrap
from stillpoint.datasets.simulate import PERFECT, simulate
from stillpoint.filters import estimate

STEP_S, W0, ZETA = 0.01, 0.25, 3.0


def integrate_euler_rates(gyro: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Eq (10): roll, pitch and yaw (N, 3) by adding up the Euler rates, from a first triple."""
    angles = [first]
    for p, q, r in gyro[1:]:
        roll, pitch, _ = angles[-1]
        turning = q * np.sin(roll) + r * np.cos(roll)
        rates = [p + turning * np.tan(pitch), q * np.cos(roll) - r * np.sin(roll), turning / np.cos(pitch)]
        angles.append(angles[-1] + STEP_S * np.array(rates))
    return np.array(angles)


def compute_acc_angles(accel: np.ndarray, mag: np.ndarray) -> np.ndarray:
    """Eqs (4)-(6) as z-y-x angles of a forward-left-up body, yaw counter-clockwise from north, (N, 3)."""
    roll = np.arctan2(accel[:, 1], accel[:, 2])
    pitch = np.arctan2(-accel[:, 0], np.hypot(accel[:, 1], accel[:, 2]))
    north = mag[:, 0] * np.cos(pitch) + np.sin(pitch) * (mag[:, 1] * np.sin(roll) + mag[:, 2] * np.cos(roll))
    west = mag[:, 1] * np.cos(roll) - mag[:, 2] * np.sin(roll)
    return np.column_stack([roll, pitch, np.arctan2(-west, north)])


@pytest.fixture(scope="module")
def tripod():
    """Slow turns within 40 deg of level at 100 Hz exactly, a field with every sample of the IMU, n magnetic."""
    made = simulate("phone-2", seed=1, minutes=2.0, sensor=PERFECT)
    t_ns = np.arange(len(made.imu.t_ns), dtype=np.int64) * 10_000_000
    field = rotation(made.truth.q_nb).inv().apply([0.0, 30.0, -38.0])
    imu = Imu(t_ns, made.imu.gyro_b_radps, made.imu.accel_b_mps2)
    return Recording("tripod", imu, Mag(t_ns, field), info=Info(units_unchecked=True)), rotation(made.truth.q_nb)


@pytest.mark.slow
def test_it_is_eq_11_of_each_angle_open_loop(tripod):
    recording, _ = tripod
    found = estimate(recording, "cf-literal", {"kappa": 1.0, "omega0_radps": W0, "zeta": ZETA})
    acc = np.unwrap(compute_acc_angles(recording.imu.accel_b_mps2, recording.mag.mag_b_ut), axis=0)
    gyro = integrate_euler_rates(recording.imu.gyro_b_radps, acc[0])
    ones = [2 * ZETA * W0, W0**2], [1, 2 * ZETA * W0, W0**2]
    b, a, _ = signal.cont2discrete(ones, STEP_S, method="zoh")
    held = np.concatenate([(acc - gyro)[1:], np.zeros((1, 3))])
    expected = gyro + signal.lfilter(b.ravel(), a, held, axis=0)
    assert np.abs(wrap(euler(found.q_nb, "enu") - [0, 0, np.pi / 2] - expected)).max() < 1e-6


def test_a_bias_turns_the_angles_of_an_open_loop_and_not_those_of_cf(tripod):
    """Half a degree a second on each axis tilts the angles of (10) by a minute of degrees; cf feeds the tilt back."""
    recording, true = tripod
    imu = recording.imu
    biased = replace(recording, imu=Imu(imu.t_ns, imu.gyro_b_radps + np.deg2rad(0.5), imu.accel_b_mps2))
    off = {name: (rotation(estimate(biased, name).q_nb) * true.inv()).magnitude() for name in ("cf", "cf-literal")}
    assert np.sqrt(np.mean(off["cf-literal"] ** 2)) > 3 * np.sqrt(np.mean(off["cf"] ** 2))
