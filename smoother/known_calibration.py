"""Correct readings by an earlier calibration of the sensor, and build the new one on it.

Both calibrations have the form of :class:`Calibration`: corrected = matrix (measured - bias). The gyro's bias changes
from day to day and is found anew.
"""

from dataclasses import replace

import numpy as np

from stillpoint.datasets.errors import Unobservable
from stillpoint.datasets.recording import Floats, Imu, Mag, Recording
from stillpoint.datasets.trajectory import Calibration
from stillpoint.smoother.long_reference import Columns, LongReference

_IDENTITY = np.eye(3)


def correct_recording(recording: Recording, known: Calibration) -> Recording:
    """Return the recording as the calibrated sensor would have read it; raises :class:`Unobservable` without an IMU."""
    if recording.imu is None:
        raise Unobservable(f"{recording.name}: has no gyro and accelerometer; leave the calibration out")
    imu, mag = recording.imu, recording.mag
    accel = _apply(known.accel_matrix, imu.accel_b_mps2 - _vector(known.accel_bias_b_mps2))
    changed = replace(recording, imu=Imu(imu.t_ns, _apply(known.gyro_matrix, imu.gyro_b_radps), accel))
    if mag is None or known.mag_matrix is None:
        return changed
    field = _apply(known.mag_matrix, mag.mag_b_ut - _vector(known.hard_iron_b_ut))
    return replace(changed, mag=Mag(mag.t_ns, field))


def express_in_raw_readings(made: LongReference, known: Calibration) -> LongReference:
    """Return the reference of a corrected recording, with calibration and gyro bias as of the readings before."""
    found: Calibration = made.facts["calibration"]
    gyro, accel, magnet = (_matrix(m) for m in (known.gyro_matrix, known.accel_matrix, known.mag_matrix))
    iron = None
    if found.hard_iron_b_ut is not None:
        iron = _vector(known.hard_iron_b_ut) + np.linalg.solve(magnet, found.hard_iron_b_ut)
    bias = _vector(known.accel_bias_b_mps2) + np.linalg.solve(accel, _vector(found.accel_bias_b_mps2))
    whole = replace(
        found,
        gyro_matrix=_matrix(found.gyro_matrix) @ gyro,
        accel_matrix=_matrix(found.accel_matrix) @ accel,
        accel_bias_b_mps2=bias,
        mag_matrix=None if found.mag_matrix is None else found.mag_matrix @ magnet,
        hard_iron_b_ut=iron,
    )

    def express_bias(columns: Columns) -> Columns:
        raw_bias: Floats = np.asarray(np.linalg.solve(gyro, columns["gyro_bias_b_radps"].T).T, dtype=np.float64)
        return {**columns, "gyro_bias_b_radps": raw_bias}

    return made.with_facts(calibration=whole).with_columns(express_bias)


def _apply(matrix: Floats | None, values: Floats) -> Floats:
    return values if matrix is None else values @ matrix.T


def _matrix(matrix: Floats | None) -> Floats:
    return _IDENTITY if matrix is None else matrix


def _vector(vector: Floats | None) -> Floats:
    return np.zeros(3) if vector is None else vector
