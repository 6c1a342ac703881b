"""Apply what is known about a sensor to a recording, so that every estimator gets the same corrected samples."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from stillpoint.datasets.calibration.device import read_device
from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.mcap.store import read_reference, sha256
from stillpoint.datasets.plausible import FIELD_RANGE_UT
from stillpoint.datasets.recording import Floats, Imu, Mag, Recording
from stillpoint.datasets.trajectory import Calibration, Reference

_DEVICE_MCAP = ".calibration.mcap"


@dataclass(frozen=True, eq=False)
class SensorCalibration:
    """A calibration with the gyro bias of one recording, and the file from which it was read."""

    calibration: Calibration
    gyro_bias_b_radps: Floats | None = None  # (3,) at turn-on; None where the recording is not known
    name: str = ""
    sha256: str = ""
    made_from: Mapping[str, str] = field(default_factory=dict)  # file name -> sha256 of what it was found on


def get_calibration(reference: Reference) -> SensorCalibration:
    """Return the calibration that a reference found, with the gyro bias at its first sample.

    Raises :class:`BadParameter` where the method of the reference finds no calibration.
    """
    if reference.calibration.gyro_matrix is None:
        raise BadParameter(
            f"reference ({reference.method}) of {reference.name}: holds no calibration; make it by the method graph"
        )
    return SensorCalibration(
        reference.calibration, reference.gyro_bias_b_radps[0], reference.name, made_from=reference.made_from
    )


def load_calibration(path: Path) -> SensorCalibration:
    """Read the calibration in ``NAME.reference.mcap``, ``NAME.calibration.toml`` or ``NAME.calibration.mcap``.

    Raises :class:`BadParameter` when there is none, :class:`BadFile` for a file that is damaged.
    """
    if not path.is_file():
        raise BadParameter(
            f"{path}: there is no such file; name a reference of the same sensor (NAME.reference.mcap), or a "
            "calibration of the device (NAME.calibration.toml)"
        )
    if path.name.endswith((".toml", _DEVICE_MCAP)):
        device = read_device(path)
        return SensorCalibration(device.calibration, None, path.name, sha256(path), device.made_from)
    return replace(get_calibration(read_reference(path)), name=path.name, sha256=sha256(path))


def apply_calibration(recording: Recording, known: SensorCalibration, recording_sha256: str = "") -> Recording:
    """Return the recording as the calibrated sensor would have measured it.

    The gyro bias changes each time the sensor is turned on. It is subtracted only where the calibration was found on
    this very recording, which ``recording_sha256`` tells. A magnetometer with a known hard iron counts as calibrated
    if its field then has a plausible size. Raises :class:`BadRecording` when the recording has no IMU.
    """
    imu, mag, found = recording.require_imu(), recording.mag, known.calibration
    same = not known.made_from or recording_sha256 in known.made_from.values()
    bias = known.gyro_bias_b_radps if same else None
    gyro = _correct(imu.gyro_b_radps, found.gyro_matrix, bias)
    accel = _correct(imu.accel_b_mps2, found.accel_matrix, found.accel_bias_b_mps2)
    info = recording.info
    if mag is not None and found.hard_iron_b_ut is not None:
        mag = Mag(mag.t_ns, _correct(mag.mag_b_ut, found.mag_matrix, found.hard_iron_b_ut))
        size_ut = float(np.median(np.linalg.norm(mag.mag_b_ut, axis=1)))
        info = replace(info, mag_uncalibrated=not FIELD_RANGE_UT[0] <= size_ut <= FIELD_RANGE_UT[1])
    done = f"calibrated by {known.name or 'a reference'}{'' if same else '; the gyro bias is not applied'}"
    info = replace(info, conversions=(*info.conversions, done))
    return replace(recording, imu=Imu(imu.t_ns, gyro, accel), mag=mag, info=info)


def _correct(values: Floats, matrix: Floats | None, offset: Floats | None) -> Floats:
    """Return matrix (values - offset) for each row; what is None is left out."""
    shifted = values if offset is None else values - offset
    return shifted if matrix is None else np.ascontiguousarray(shifted @ matrix.T)
