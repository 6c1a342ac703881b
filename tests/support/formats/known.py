"""One known recording, with an attitude that no axis swap or sign leaves unchanged."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from stillpoint.datasets import Recording
from stillpoint.datasets.frames import quaternion, rotation
from stillpoint.datasets.importers.table import IMPORTERS

G = 9.80665
START_NS = 1_700_000_000_123_456_789
FIELD_N_UT = np.array([1.5, 20.0, -40.0])


@dataclass(frozen=True)
class Known:
    """Turns about changing axes from a tilted start, sampled at 100 Hz."""

    t_ns: np.ndarray
    q_nb: np.ndarray
    gyro_b_radps: np.ndarray
    accel_b_mps2: np.ndarray
    mag_b_ut: np.ndarray

    @property
    def t_s(self) -> np.ndarray:
        return self.t_ns / 1e9


def known_recording() -> Known:
    """The one that every importer is to give back."""
    t_ns = np.arange(600, dtype=np.int64) * 10_000_000
    t_s = t_ns / 1e9
    turn = Rotation.from_rotvec(np.stack([0.9 * np.sin(t_s), 0.5 * t_s, 0.3 * np.cos(2 * t_s)], axis=1))
    attitude = Rotation.from_euler("ZYX", [70, -35, 20], degrees=True) * turn
    step = (attitude[:-1].inv() * attitude[1:]).as_rotvec() / 0.01
    gyro = np.concatenate([step[:1], step])
    accel = attitude.inv().apply([0, 0, G])
    return Known(t_ns, quaternion(attitude), gyro, accel, attitude.inv().apply(FIELD_N_UT))


def assert_known(recording: Recording, known: Known, start_ns: int = 0, near: float = 1e-9, truth: bool = True) -> None:
    """Times exact, vectors and attitude equal, and the body's vectors lead to up and north through the truth."""
    assert (recording.imu.t_ns == known.t_ns + start_ns).all()
    np.testing.assert_allclose(recording.imu.gyro_b_radps, known.gyro_b_radps, atol=near)
    np.testing.assert_allclose(recording.imu.accel_b_mps2, known.accel_b_mps2, atol=10 * near)
    np.testing.assert_allclose(recording.mag.mag_b_ut, known.mag_b_ut, atol=100 * near)
    assert recording.info.sha256
    assert recording.info.conversions
    if truth:
        here = np.isin(known.t_ns + start_ns, recording.truth.t_ns)
        assert len(recording.truth.t_ns) == here.sum() > 500
        error = rotation(recording.truth.q_nb) * rotation(known.q_nb[here]).inv()
        assert error.magnitude().max() < 1e-6
        imu = np.isin(recording.imu.t_ns, recording.truth.t_ns)
        up = rotation(recording.truth.q_nb).apply(recording.imu.accel_b_mps2[imu])
        np.testing.assert_allclose(up, np.tile([0, 0, G], (len(up), 1)), atol=1e-5)


def only(kind: str, source: Path, options=None) -> Recording:
    recordings = list(IMPORTERS[kind](source, options))
    assert len(recordings) == 1
    return recordings[0]
