"""Recordings for the doctor to look at: a sensor at rest, and the part of a recording between two times."""

from dataclasses import replace

import numpy as np

from stillpoint.datasets import Imu, Info, Recording

NO_RESTS = np.empty((0, 2), dtype=np.int64)
RNG = np.random.default_rng(11)
FIELD_UT = np.array([20.0, 0.0, -40.0])
UP_MPS2 = np.array([0.0, 0.0, 9.81])
UNCHECKED = Info(units_unchecked=True)


def stamps(n, rate_hz=100.0):
    return np.round(np.arange(n) / rate_hz * 1e9).astype(np.int64)


def still(n=3000, **streams):
    gyro, accel = RNG.normal(0, 0.002, (n, 3)), RNG.normal(0, 0.02, (n, 3)) + UP_MPS2
    return Recording("still", imu=Imu(stamps(n), gyro, accel), info=UNCHECKED, **streams)


def cut(recording, start_s, end_s):
    """The part between two times from the start."""
    origin = recording.imu.t_ns[0]
    parts = {}
    for name in ("imu", "mag", "truth"):
        stream = getattr(recording, name)
        keep = (stream.t_ns >= origin + start_s * 1e9) & (stream.t_ns < origin + end_s * 1e9)
        columns = {key: value[keep] for key, value in vars(stream).items() if isinstance(value, np.ndarray)}
        parts[name] = replace(stream, **columns)
    return replace(recording, **parts)
