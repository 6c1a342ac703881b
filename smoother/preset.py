"""Which preset fits a recording: how the sensor was moved, by the evidence of its own streams.

    vehicle    satellites saw it go far, or it hardly turns but keeps accelerating by more than tilting explains
    bench      it has a shaft encoder, or it is turned over without being pushed
    handheld   everything else: where the evidence is ambiguous nothing changes

The limits lie between what was measured: a simulated car turns by 5 deg/s (RMS) and accelerates by 0.6 m/s^2, phones in
hands and pockets turn by 29 deg/s and more (10 Tyrex trials), BROAD by 38 and more.
"""

from dataclasses import dataclass

import numpy as np

from stillpoint.datasets.earth import enu_m
from stillpoint.datasets.frames import rotation
from stillpoint.datasets.recording import Floats, Gps, Imu, Recording
from stillpoint.smoother.strapdown import integrate

_FAR_M, _FAST_MPS = 50.0, 4.0  # a vehicle goes that far, or so fast
_SLOW_TURNING_RADPS = np.deg2rad(15.0)  # RMS of the rate: nothing held by a person turns so little
_UPRIGHT_RAD = np.deg2rad(25.0)  # from the mean up for 95 % of the time: a vehicle does not turn over
_DRIVEN_MPS2 = 0.35  # level acceleration, RMS of means over a second
_WINDOW_S = 10.0  # in which the gyro keeps the level
_TURNED_OVER_RAD = np.deg2rad(30.0)
_PUSHED_MPS2 = 0.15  # RMS of the specific force's length about its median
_TURNING_RADPS = np.deg2rad(10.0)


@dataclass(frozen=True)
class PresetChoice:
    """A preset and why it was chosen."""

    name: str
    reason: str


def choose_preset(recording: Recording) -> PresetChoice:
    """Return the preset that the streams of a recording speak for."""
    imu = recording.require_imu()
    if recording.gps is not None and (travelled := _describe_travel(recording.gps)):
        return PresetChoice("vehicle", travelled)
    if recording.encoder is not None:
        return PresetChoice("bench", "it has a shaft encoder")
    if len(imu.t_ns) < 100:
        return PresetChoice("handheld", "the recording is too short to tell how it was moved")
    rate = float(np.sqrt(np.mean(np.sum((imu.gyro_b_radps - np.median(imu.gyro_b_radps, axis=0)) ** 2, axis=1))))
    up_b, off_rad = _spread_of_up(imu)
    if rate < _SLOW_TURNING_RADPS and off_rad < _UPRIGHT_RAD:
        driven = _level_acceleration(imu, up_b)
        if driven > _DRIVEN_MPS2:
            reason = f"it turns by {np.rad2deg(rate):.0f} deg/s only, but accelerates by {driven:.1f} m/s^2 (RMS)"
            return PresetChoice("vehicle", reason)
    length = np.linalg.norm(imu.accel_b_mps2, axis=1)
    pushed = float(np.sqrt(np.mean((length - np.median(length)) ** 2)))
    if rate > _TURNING_RADPS and off_rad > _TURNED_OVER_RAD and pushed < _PUSHED_MPS2:
        return PresetChoice("bench", f"it is turned over, but pushed by {pushed:.2f} m/s^2 (RMS) only")
    return PresetChoice("handheld", "nothing speaks for a vehicle or a bench")


def _describe_travel(gps: Gps) -> str:
    """Return how far or fast the satellites saw it move, "" for less than a vehicle does."""
    valid = gps.valid
    if valid.sum() < 2:
        return ""
    origin = (float(gps.lat_deg[valid][0]), float(gps.lon_deg[valid][0]), 0.0)
    place = enu_m(gps.lat_deg[valid], gps.lon_deg[valid], np.zeros(int(valid.sum())), origin)
    distance = float(np.percentile(np.hypot(place[:, 0], place[:, 1]), 90))
    known = gps.speed_mps[valid & np.isfinite(gps.speed_mps)]
    speed = float(np.percentile(known, 90)) if len(known) else 0.0
    if distance < _FAR_M and speed < _FAST_MPS:
        return ""
    return f"the satellites saw it {distance:.0f} m away, at {speed:.1f} m/s"


def _spread_of_up(imu: Imu) -> tuple[Floats, float]:
    """Return the mean direction of the specific force in the body (3,) and how far 95 % of the seconds are off."""
    up_b = _means(imu.accel_b_mps2, (imu.t_ns - imu.t_ns[0]) / 1e9)
    up_b = up_b / np.maximum(np.linalg.norm(up_b, axis=1), 1e-9)[:, None]
    middle = np.median(up_b, axis=0)
    middle = middle / max(float(np.linalg.norm(middle)), 1e-9)
    return middle, float(np.percentile(np.arccos(np.clip(up_b @ middle, -1, 1)), 95))


def _level_acceleration(imu: Imu, up_b: Floats) -> float:
    """Return the median over windows of the level acceleration (RMS of means over a second).

    Within a window the gyro keeps the level: its mean across up is taken for bias, as a vehicle does not turn over.
    """
    t_s = (imu.t_ns - imu.t_ns[0]) / 1e9
    dt_s = np.diff(t_s, prepend=t_s[0])
    sizes = []
    for start_s in np.arange(0.0, t_s[-1] - _WINDOW_S, _WINDOW_S):
        rows = slice(*np.searchsorted(t_s, [start_s, start_s + _WINDOW_S]))
        if rows.stop - rows.start < 10 or dt_s[rows][1:].max() > 1.0:
            continue
        mean = imu.gyro_b_radps[rows].mean(axis=0)
        rate = imu.gyro_b_radps[rows] - (mean - (mean @ up_b) * up_b)
        step_s = dt_s[rows].copy()
        step_s[0] = 0.0
        turn = rotation(integrate(np.array([1.0, 0.0, 0.0, 0.0]), rate, step_s))
        force = _means(turn.apply(imu.accel_b_mps2[rows].copy()), t_s[rows] - t_s[rows.start])
        up = force.mean(axis=0) / max(float(np.linalg.norm(force.mean(axis=0))), 1e-9)
        level = force - (force @ up)[:, None] * up
        sizes.append(float(np.sqrt(np.mean(np.sum((level - level.mean(axis=0)) ** 2, axis=1)))))
    return float(np.median(sizes)) if sizes else 0.0


def _means(values: Floats, t_s: Floats) -> Floats:
    """Return the means (S, 3) of values (N, 3) over the seconds that have samples."""
    first = np.flatnonzero(np.diff(np.floor(t_s), prepend=-1.0))
    counts = np.diff(first, append=len(t_s))
    return np.asarray(np.add.reduceat(values, first, axis=0) / counts[:, None])
