"""A recording that a sensor with known errors made is corrected exactly by the calibration that states them."""

from dataclasses import replace

import numpy as np
import pytest

from stillpoint.datasets import BadParameter, Calibration, Imu, Mag, Reference, write
from stillpoint.datasets.calibration.apply import SensorCalibration, apply_calibration, load_calibration
from stillpoint.datasets.simulate import simulate

RNG = np.random.default_rng(5)
FOUND = Calibration(
    gyro_matrix=np.eye(3) + RNG.normal(0, 0.02, (3, 3)),
    accel_matrix=np.eye(3) + RNG.normal(0, 0.02, (3, 3)),
    accel_bias_b_mps2=RNG.normal(0, 0.1, 3),
    mag_matrix=np.eye(3) + RNG.normal(0, 0.05, (3, 3)),
    hard_iron_b_ut=np.array([300.0, -100.0, 50.0]),
)
BIAS = np.array([0.02, -0.05, 0.01])
KNOWN = SensorCalibration(FOUND, BIAS, "it", made_from={"run.mcap": "ab"})


@pytest.fixture(scope="module")
def true():
    return simulate("phone-3", seed=1, minutes=1.5)


@pytest.fixture(scope="module")
def measured(true):
    """The readings of a sensor with the errors of FOUND: reading = matrix^-1 value + offset."""

    def read_by(values, matrix, offset):
        return np.linalg.solve(matrix, values.T).T + offset

    imu, mag = true.imu, true.mag
    return replace(
        true,
        imu=Imu(
            imu.t_ns,
            read_by(imu.gyro_b_radps, FOUND.gyro_matrix, BIAS),
            read_by(imu.accel_b_mps2, FOUND.accel_matrix, FOUND.accel_bias_b_mps2),
        ),
        mag=Mag(mag.t_ns, read_by(mag.mag_b_ut, FOUND.mag_matrix, FOUND.hard_iron_b_ut)),
        info=replace(true.info, mag_uncalibrated=True),
    )


def test_calibration_undoes_the_errors_it_states(true, measured):
    corrected = apply_calibration(measured, KNOWN, "ab")
    np.testing.assert_allclose(corrected.imu.gyro_b_radps, true.imu.gyro_b_radps, atol=1e-12)
    np.testing.assert_allclose(corrected.imu.accel_b_mps2, true.imu.accel_b_mps2, atol=1e-12)
    np.testing.assert_allclose(corrected.mag.mag_b_ut, true.mag.mag_b_ut, atol=1e-10)
    assert not corrected.info.mag_uncalibrated


def test_gyro_bias_of_another_recording_is_not_applied(true, measured):
    corrected = apply_calibration(measured, KNOWN, "cd")
    expected = true.imu.gyro_b_radps + FOUND.gyro_matrix @ BIAS
    np.testing.assert_allclose(corrected.imu.gyro_b_radps, expected, atol=1e-12)
    assert "gyro bias is not applied" in corrected.info.conversions[-1]


def test_magnetometer_without_known_hard_iron_stays_uncalibrated(measured):
    found = replace(FOUND, hard_iron_b_ut=None, mag_matrix=None)
    corrected = apply_calibration(measured, replace(KNOWN, calibration=found), "ab")
    assert corrected.info.mag_uncalibrated
    assert np.array_equal(corrected.mag.mag_b_ut, measured.mag.mag_b_ut)


def test_field_of_implausible_size_stays_uncalibrated(measured):
    found = replace(FOUND, hard_iron_b_ut=np.zeros(3))
    assert apply_calibration(measured, replace(KNOWN, calibration=found), "ab").info.mag_uncalibrated


def test_reference_without_calibration_is_refused(tmp_path, true):
    q_nb = np.tile([1.0, 0, 0, 0], (len(true.imu.t_ns), 1))
    cov = np.tile(np.eye(3), (len(q_nb), 1, 1))
    made = Reference(true.imu.t_ns, q_nb, cov, np.zeros((len(q_nb), 3)), "redistribution", "phone")
    write(tmp_path / "x.reference.mcap", made)
    with pytest.raises(BadParameter, match="holds no calibration"):
        load_calibration(tmp_path / "x.reference.mcap")


def test_missing_calibration_file_is_named(tmp_path):
    with pytest.raises(BadParameter, match=r"none\.reference\.mcap: there is no such file"):
        load_calibration(tmp_path / "none.reference.mcap")
