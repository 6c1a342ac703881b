"""Recordings by the protocol of Elmi Aziz and Mohseni Araste 2021: out of a base pose and back, by a perfect sensor."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from stillpoint.datasets import Imu, Recording, Truth
from stillpoint.datasets.frames import quaternion
from stillpoint.smoother.strapdown import GyroErrors, walk_steps

BASE = Rotation.from_rotvec([0.3, -0.2, 1.0])
UP = np.array([0.0, 0.0, 9.81])


def swings(t_s, times_s, turns_rad):
    """Rotation vectors (N, 3): between each pair of ``times_s`` a smooth way out along ``turns_rad`` and back."""
    vector = np.zeros((len(t_s), 3))
    for (start, end), turn in zip(times_s, turns_rad, strict=True):
        s = np.clip((t_s - start) / (end - start), 0, 1)[:, None]
        vector += np.sin(np.pi * s) ** 2 * np.sin(np.pi * s * [2.0, 3.0, 1.0]) * np.asarray(turn)
    return vector


def carried(q, t_s, name="carried", moving=None, **streams):
    """A recording by a perfect sensor that follows the rotations ``q`` at ``t_s``."""
    t_ns = np.round(t_s * 1e9).astype(np.int64)
    step = (q[:-1].inv() * q[1:]).as_rotvec() / (np.diff(t_ns) / 1e9)[:, None]
    gyro = np.concatenate([np.zeros((1, 3)), step])
    moving = np.ones(len(t_s), dtype=bool) if moving is None else moving
    truth = Truth(t_ns, quaternion(q), moving)
    return Recording(name, imu=Imu(t_ns, gyro, q.inv().apply(UP)), truth=truth, **streams)


def protocol(jitter=0.3, final=(0.0, 0.0, 0.0), **streams):
    """Rest 10 s, move 15 s, rest 5 s, move 15 s, rest 5 s at 100 Hz; ``final`` turns the last rest in n."""
    rng = np.random.default_rng(1)
    t_s = (np.arange(5000) + jitter * rng.uniform(-0.5, 0.5, 5000)) / 100
    t_s -= t_s[0]
    vector = swings(t_s, [(10, 25), (30, 45)], [(2.0, -1.5, 2.5), (-1.0, 2.5, 3.0)])
    turned = np.clip((t_s - 30) / 15, 0, 1)[:, None] * np.asarray(final)
    q = Rotation.from_rotvec(turned) * BASE * Rotation.from_rotvec(vector)
    moving = ((t_s > 10) & (t_s < 25)) | ((t_s > 30) & (t_s < 45))
    return carried(q, t_s, moving=moving, **{"base_pose": quaternion(BASE), **streams})


def with_gyro(recording, gyro_b_radps):
    imu = recording.imu
    return replace(recording, imu=Imu(imu.t_ns, gyro_b_radps, imu.accel_b_mps2))


def walk_of(imu):
    return walk_steps(imu.t_ns, GyroErrors())
