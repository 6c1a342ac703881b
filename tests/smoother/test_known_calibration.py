"""A calibration known before: the sensor is as good as corrected, and what is found is said of its raw readings."""

from dataclasses import replace

import numpy as np
import pytest

from stillpoint.datasets import Imu, Mag, StillpointError, write
from stillpoint.datasets.mcap.store import read_reference
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.trajectory import Calibration
from stillpoint.scoring import score
from stillpoint.smoother import reference

GYRO = np.array([[0.75, 0.02, 0.0], [-0.03, 0.8, 0.01], [0.0, 0.02, 0.7]])
ACCEL = np.array([[1.1, 0.01, 0.0], [0.0, 0.92, -0.02], [0.03, 0.0, 1.05]])
MAG = np.array([[1.2, 0.0, 0.05], [0.05, 0.9, 0.0], [0.0, -0.05, 1.1]])
ACCEL_BIAS, IRON = np.array([0.5, -0.4, 0.3]), np.array([60.0, -80.0, 25.0])
KNOWN = Calibration(
    gyro_matrix=GYRO, accel_matrix=ACCEL, accel_bias_b_mps2=ACCEL_BIAS, mag_matrix=MAG, hard_iron_b_ut=IRON
)


@pytest.fixture(scope="module")
def hand():
    return simulate("phone-3", seed=2, minutes=1.6)


def raw(recording):
    """As a sensor reads that needs KNOWN: corrected = matrix (measured - bias)."""
    imu, mag = recording.imu, recording.mag
    gyro = np.linalg.solve(GYRO, imu.gyro_b_radps.T).T
    accel = np.linalg.solve(ACCEL, imu.accel_b_mps2.T).T + ACCEL_BIAS
    info = replace(recording.info, units_unchecked=True, mag_uncalibrated=True)
    field = np.linalg.solve(MAG, mag.mag_b_ut.T).T + IRON
    return replace(recording, imu=Imu(imu.t_ns, gyro, accel), mag=Mag(mag.t_ns, field), info=info)


@pytest.mark.slow
def test_a_wild_sensor_with_its_calibration_is_as_good_as_a_calibrated_one(hand):
    wild = raw(hand)
    with pytest.raises(StillpointError):
        reference(wild)
    made, tame = reference(wild, calibration=KNOWN), reference(hand)
    assert score(made, hand.truth).total_rmse_deg == pytest.approx(score(tame, hand.truth).total_rmse_deg, rel=1e-3)


def test_what_is_found_is_of_the_raw_readings(hand):
    """By what the reference states, the raw readings are corrected to what the good sensor's are corrected to."""
    wild = raw(hand)
    made, tame = reference(wild, calibration=KNOWN).calibration, reference(hand).calibration
    whole = made.accel_matrix @ (wild.imu.accel_b_mps2 - made.accel_bias_b_mps2).T
    parts = tame.accel_matrix @ (hand.imu.accel_b_mps2 - tame.accel_bias_b_mps2).T
    np.testing.assert_allclose(whole, parts, atol=1e-3)
    whole = made.mag_matrix @ (wild.mag.mag_b_ut - made.hard_iron_b_ut).T
    parts = tame.mag_matrix @ (hand.mag.mag_b_ut - tame.hard_iron_b_ut).T
    np.testing.assert_allclose(whole, parts, atol=0.05)
    np.testing.assert_allclose(made.gyro_matrix, tame.gyro_matrix @ GYRO, atol=1e-5)


@pytest.mark.slow
def test_a_calibration_found_once_serves_again(hand, call, tmp_path, capsys):
    """On the command line; and a file without one is refused in one line."""
    write(tmp_path / "hand.mcap", hand)
    assert call("reference", tmp_path / "hand.mcap", "-o", tmp_path) == 0
    first = tmp_path / "hand.reference.mcap"
    again = tmp_path / "again"
    assert call("reference", tmp_path / "hand.mcap", "-o", again, "--calibration", first) == 0
    made = read_reference(again / "hand.reference.mcap")
    assert set(made.made_from) == {"hand.mcap", "hand.reference.mcap"}
    sd = read_reference(first).calibration.gyro_matrix_sd
    assert (np.abs(made.calibration.gyro_matrix - read_reference(first).calibration.gyro_matrix) < 2 * sd).all()
    capsys.readouterr()
    assert call("reference", tmp_path / "hand.mcap", "-o", again, "--calibration", tmp_path / "none.mcap") == 2
    assert "there is no such file" in capsys.readouterr().err
    assert call("reference", tmp_path / "hand.mcap", "-o", again, "--calibration", tmp_path / "hand.mcap") == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
