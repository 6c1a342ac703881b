"""Motions with exact truth, as perfect or noisy sensors see them, and how to feed a stream with a recording."""

from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stillpoint.datasets import Imu, Info, Mag, Recording
from stillpoint.datasets.frames import rotation
from stillpoint.filters import Stream

GRAVITY_N = np.array([0.0, 0.0, 9.81])
FIELD_N = np.array([0.0, 20.0, -44.0])

Attitude = Callable[[NDArray[np.float64]], Rotation]


def record(attitude: Attitude, t_s: NDArray[np.float64], mag_t_s: NDArray[np.float64] | None = None) -> Recording:
    """Perfect sensors on a body whose rate is constant between samples: integration is exact."""
    t_ns = np.round(t_s * 1e9).astype(np.int64)
    mag_t_ns = t_ns if mag_t_s is None else np.round(mag_t_s * 1e9).astype(np.int64)
    rot = attitude(t_ns / 1e9)
    turned = (rot[:-1].inv() * rot[1:]).as_rotvec() / (np.diff(t_ns) / 1e9)[:, None]
    gyro = np.vstack([turned[:1], turned])
    mag = Mag(mag_t_ns, attitude(mag_t_ns / 1e9).inv().apply(FIELD_N))
    return Recording("motion", Imu(t_ns, gyro, rot.inv().apply(GRAVITY_N)), mag=mag, info=Info(units_unchecked=True))


def turning(axis: tuple[float, float, float], rate_degps: float, start: Rotation | None = None) -> Attitude:
    begin = Rotation.identity() if start is None else start
    unit = np.array(axis) / np.linalg.norm(axis)
    return lambda t_s: Rotation.from_rotvec(np.deg2rad(rate_degps) * np.atleast_1d(t_s)[:, None] * unit) * begin


def resting(rot: Rotation) -> Attitude:
    return lambda t_s: Rotation.from_quat(np.tile(rot.as_quat(), (len(t_s), 1)))


def wobble(t_s: NDArray[np.float64]) -> Rotation:
    angles = np.column_stack([0.7 * np.sin(1.1 * t_s), 0.5 * np.sin(1.7 * t_s + 1), 2.0 * np.sin(0.6 * t_s)])
    return Rotation.from_rotvec(angles)


def errors_deg(estimated: NDArray[np.float64], recording: Recording, attitude: Attitude) -> NDArray[np.float64]:
    truth = attitude(recording.require_imu().t_ns / 1e9)
    return np.rad2deg((rotation(estimated) * truth.inv()).magnitude())


def regular(seconds: float, rate_hz: float = 100.0) -> NDArray[np.float64]:
    return np.arange(0, seconds, 1 / rate_hz)


def jittered(seconds: float, seed: int = 5) -> NDArray[np.float64]:
    """Steps of 2 to 18 ms."""
    return np.cumsum(np.random.default_rng(seed).uniform(0.002, 0.018, int(seconds * 100)))


@cache
def untidy(seed: int = 3) -> Recording:
    """Jitter, a slower magnetometer on its own clock, a gap of 3 s, noise: nothing is round."""
    draw = np.random.default_rng(seed)
    t_s = jittered(20.0, seed)
    t_s = t_s[(t_s < 9) | (t_s > 12)]
    clean = record(wobble, t_s, np.arange(0.013, t_s[-1], 0.0437))
    imu, mag = clean.require_imu(), clean.mag
    assert mag is not None
    noisy = Imu(
        imu.t_ns,
        imu.gyro_b_radps + draw.normal(0, 0.05, (len(t_s), 3)),
        imu.accel_b_mps2 + draw.normal(0, 2.0, (len(t_s), 3)),
    )
    field = Mag(mag.t_ns, mag.mag_b_ut + draw.normal(0, 1.0, mag.mag_b_ut.shape))
    return Recording("untidy", noisy, mag=field, info=Info(units_unchecked=True))


def feed(stream: Stream, recording: Recording, first: int = 0, last: int | None = None) -> NDArray[np.float64]:
    """The quaternions of a stream that gets a recording's samples in the order of their stamps."""
    imu, mag, gps = recording.require_imu(), recording.mag, recording.gps
    new_field = [] if mag is None else arrivals(mag.t_ns, imu.t_ns)
    new_fix = [] if gps is None else arrivals(gps.t_ns, imu.t_ns)
    out = []
    for k in range(first, len(imu.t_ns) if last is None else last):
        field = mag.mag_b_ut[new_field[k]] if mag is not None and k in new_field else None
        fix = None
        if gps is not None and k in new_fix:
            row = new_fix[k]
            fix = (gps.course_rad[row], gps.speed_mps[row]) if gps.valid[row] else (np.nan, np.nan)
        out.append(stream.update(int(imu.t_ns[k]), imu.gyro_b_radps[k], imu.accel_b_mps2[k], field, fix).q_nb)
    return np.array(out)


def arrivals(t_ns: NDArray[np.int64], imu_t_ns: NDArray[np.int64]) -> dict[int, int]:
    """Row of the IMU -> row of another stream that is there by then for the first time; the newest of several."""
    return {int(k): row for row, k in enumerate(np.searchsorted(imu_t_ns, t_ns)) if k < len(imu_t_ns)}
