"""The start value: coarse, but never at a wrong minimum."""

from dataclasses import replace

import numpy as np
import pytest
from known_motion import between, rotated_body
from scipy.spatial.transform import Rotation

from stillpoint.datasets import Imu, Mag
from stillpoint.datasets.frames import rotation
from stillpoint.datasets.simulate import simulate
from stillpoint.smoother.attitude.keys import prepare_motion
from stillpoint.smoother.attitude.start import find_start

NO_RESTS = np.empty((0, 2), dtype=np.int64)


@pytest.fixture(scope="module")
def swing(hand):
    return between(hand, 62.0, 86.0)


def start_of(recording):
    imu = recording.imu
    return find_start(prepare_motion(imu, NO_RESTS), recording.mag, int(imu.t_ns[0]), None)


def error_deg(recording, start):
    """Against the truth after the heading's mean is taken off: n's north is magnetic here."""
    off = (rotation(recording.truth.q_nb) * rotation(start.q_nb).inv()).as_quat(scalar_first=True)
    heading = 2 * np.arctan2(off[:, 3], off[:, 0])
    mean = np.angle(np.exp(1j * heading).mean())
    turned = Rotation.from_euler("z", mean) * rotation(start.q_nb)
    return np.rad2deg((rotation(recording.truth.q_nb) * turned.inv()).magnitude())


@pytest.mark.parametrize("bias_degps", [[0, 0, 0], [5.7, 0, 0], [0, -5.7, 3.0], [3, 3, -5]])
def test_a_gyro_bias_of_a_phone_is_found_without_rest(swing, bias_degps):
    """Up to 5.7 deg/s in the hand: what is left is within the graph's prior of 1 deg/s."""
    bias = np.deg2rad(bias_degps)
    loud = replace(swing, imu=Imu(swing.imu.t_ns, swing.imu.gyro_b_radps + bias, swing.imu.accel_b_mps2))
    start = start_of(loud)
    assert np.rad2deg(np.abs(start.gyro_bias_b_radps - bias).max()) < 1.0
    assert np.percentile(error_deg(loud, start), 95) < 15.0


@pytest.mark.parametrize("turn_deg", [[180, 0, 0], [0, 180, 0], [0, 90, 0], [0, 0, 135]])
def test_the_start_is_found_upside_down_and_on_its_side(swing, turn_deg):
    turned = rotated_body(swing, Rotation.from_rotvec(turn_deg, degrees=True))
    assert np.percentile(error_deg(turned, start_of(turned)), 95) < 15.0


def test_a_hard_iron_of_hundreds_of_ut_is_found(swing):
    iron = np.array([300.0, -200.0, 150.0])
    info = replace(swing.info, mag_uncalibrated=True)
    raw = replace(swing, mag=Mag(swing.mag.t_ns, swing.mag.mag_b_ut + iron), info=info)
    np.testing.assert_allclose(start_of(raw).hard_iron_b_ut, iron, atol=8.0)


def test_the_earths_vertical_field_is_not_taken_for_hard_iron():
    """Turning about the vertical only: 126 uT of iron fitted as well as none."""
    table = simulate("phone-1", seed=1, minutes=1.2)
    assert np.linalg.norm(start_of(table).hard_iron_b_ut) < 15.0


def test_without_magnetometer_the_tilt_is_still_right(swing):
    blind = replace(swing, mag=None)
    up = rotation(start_of(blind).q_nb).inv().apply([0.0, 0.0, 1.0])
    true = rotation(swing.truth.q_nb).inv().apply([0.0, 0.0, 1.0])
    tilt_deg = np.rad2deg(np.arccos(np.clip((up * true).sum(axis=1), -1, 1)))
    assert np.percentile(tilt_deg, 95) < 12.0
