"""Attitudes on their stamps for scores: a swing, as truth and as reference; a trial of BROAD with a peer's estimate."""

import numpy as np
import pytest
import scipy.io
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stillpoint.datasets import Estimate, Reference, Truth
from stillpoint.datasets.frames import quaternion

angles = st.floats(-np.pi, np.pi)
attitudes = st.builds(lambda a, b, c: quaternion(Rotation.from_euler("ZYX", [[a, b, c]])), angles, angles, angles)


def swing(n=3000, rate_hz=100.0, late_s=0.0):
    """Stamps and an attitude that turns about all axes, with its exact value at ``t - late_s``."""
    t_ns = np.round(np.arange(n) / rate_hz * 1e9).astype(np.int64)
    t_s = t_ns / 1e9 - late_s
    zyx = np.stack([1.5 * np.sin(0.9 * t_s), 0.8 * np.sin(2.1 * t_s + 1), 1.2 * np.cos(1.7 * t_s)], axis=1)
    return t_ns, quaternion(Rotation.from_euler("ZYX", zyx))


def as_truth(t_ns, q_nb, moving=None):
    return Truth(t_ns, q_nb, np.ones(len(t_ns), dtype=bool) if moving is None else moving)


def as_reference(t_ns, q_nb, sd_rad=0.01, **more):
    cov = np.broadcast_to(np.eye(3) * np.square(sd_rad), (len(t_ns), 3, 3))
    return Reference(t_ns, q_nb, cov, np.zeros((len(t_ns), 3)), "redistribution", name="run", **more)


def broad(data_dir, trial, filtered):
    """One trial's truth, and what ``filtered(gyro, accel, mag, rate_hz)`` makes of it, by an independent reader."""
    (path,) = (data_dir / "broad").glob(f"{trial}_*.mat")
    raw = scipy.io.loadmat(path, squeeze_me=True)
    gyro, accel, mag = (np.ascontiguousarray(raw[name]) for name in ("imu_gyr", "imu_acc", "imu_mag"))
    rate_hz = float(raw["sampling_rate"])
    t_ns = np.round(np.arange(len(gyro)) / rate_hz * 1e9).astype(np.int64)
    known = np.isfinite(raw["opt_quat"]).all(axis=1)
    q_true = raw["opt_quat"][known]
    q_true = q_true / np.linalg.norm(q_true, axis=1, keepdims=True)
    truth = Truth(t_ns[known], q_true, raw["movement"].astype(bool)[known])
    return Estimate(t_ns, filtered.__name__, q_nb=filtered(gyro, accel, mag, rate_hz), recording=path.stem), truth


def offline_vqf(gyro_b_radps, accel_b_mps2, mag_b_ut, rate_hz):
    vqf = pytest.importorskip("vqf", reason="the peer package vqf is not installed")
    return vqf.offlineVQF(gyro_b_radps, accel_b_mps2, mag_b_ut, 1 / rate_hz)["quat9D"]
