"""A right-invariant EKF written with errors in body axes, in dense numpy, with an update at every sample.

State (d, b, v): attitude error in body axes, gyro bias, horizontal velocity. An update leaves the covariance as it is
in n, which is the right-invariant form. After J. Sola, arXiv:1711.02508, chapters 5 and 6, with the measurements of
``ekf``: the velocity is 0, the field points north. Written apart from the filters.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from stillpoint.datasets.recording import Floats
from stillpoint.filters.kalman.model import ErrorStateParams

UP = np.array([0.0, 0.0, 1.0])


def cross_matrix(v: Floats) -> Floats:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


class TextbookEkf:
    """Mutable, slow, plain."""

    def __init__(self, attitude: Rotation, p: ErrorStateParams) -> None:
        self.rot, self.b, self.v, self.params = attitude, np.zeros(3), np.zeros(2), p
        sd = [p.tilt_sd_rad, p.tilt_sd_rad, p.heading_sd_rad]
        to_body = attitude.as_matrix().T
        self.p = np.zeros((8, 8))
        self.p[:3, :3] = to_body @ np.diag(np.square(sd)) @ to_body.T
        self.p[3:6, 3:6] = np.eye(3) * p.bias_sd_radps**2
        self.p[6:, 6:] = np.eye(2) * p.velocity_mps_rts**2

    def predict(self, gyro_b: Floats, accel_b: Floats, dt_s: float) -> None:
        p, before = self.params, self.rot.as_matrix()
        q = self.rot.as_quat()
        self.rot = self.rot * Rotation.from_rotvec((gyro_b - self.b) * dt_s)
        after, other = self.rot.as_matrix(), self.rot.as_quat()
        spread = Rotation.from_quat(q + other * np.sign(q @ other)).as_matrix() * dt_s
        push = after @ accel_b * dt_s
        self.v = self.v + push[:2]
        to_velocity = -cross_matrix([0, 0, push[2]])[:2]  # e x f, horizontal, by the vertical part of f
        f = np.eye(8)
        f[:3, :3], f[:3, 3:6] = after.T @ before, -after.T @ spread
        f[6:, :3], f[6:, 3:6] = to_velocity @ before, -to_velocity @ spread / 2
        turn = (
            p.gyro_noise_rad_rts**2 * dt_s
            + p.turn_error**2 * np.linalg.norm(gyro_b - self.b) * dt_s
            + p.bias_walk_radps**2 * dt_s**3 / 3
        )
        walk = p.bias_walk_radps**2 * dt_s
        noise = np.zeros((8, 8))
        noise[:3, :3], noise[3:6, 3:6] = np.eye(3) * turn, np.eye(3) * walk
        noise[:3, 3:6] = -after.T @ spread * walk / 2
        noise[6:, :3] = to_velocity @ after * turn / 2
        noise[6:, 6:] = np.eye(2) * p.accel_noise_mps_rts**2 * dt_s + to_velocity @ to_velocity.T * turn / 3
        upper = noise + noise.T - np.diag(np.diag(noise))
        upper[:3, :3], upper[3:6, 3:6], upper[6:, 6:] = noise[:3, :3], noise[3:6, 3:6], noise[6:, 6:]
        self.p = f @ self.p @ f.T + upper
        self.spread = spread

    def update(self, mag_b: Floats, dt_s: float, known_flat_ut: float | None) -> None:
        """Velocity, then heading, both linearised at the prediction; the heading keeps the tilt."""
        p, x = self.params, np.zeros(8)
        to_n = self.rot.as_matrix()
        h = np.hstack([np.zeros((2, 6)), np.eye(2)])
        s = h @ self.p @ h.T + np.eye(2) * p.velocity_mps_rts**2 / dt_s
        k = self.p @ h.T @ np.linalg.inv(s)
        x = x + k @ (-self.v)
        self.p = (np.eye(8) - k @ h) @ self.p
        field = to_n @ mag_b
        flat = np.hypot(field[0], field[1])
        row_n = np.array([0.0, -field[2] / flat, 1.0])
        h = np.concatenate([row_n @ to_n, self.spread[2] / 2, np.zeros(2)])
        r = p.field_noise_ut_rts**2 / dt_s / (flat if known_flat_ut is None else known_flat_ut) ** 2
        s1 = h @ self.p @ h + r
        gain = self.p @ h / s1
        gain[:3] = to_n.T @ (np.outer(UP, UP) @ (to_n @ gain[:3]))
        x = x + gain * (np.arctan2(field[0], field[1]) - h @ x)
        left = np.eye(8) - np.outer(gain, h)
        self.p = left @ self.p @ left.T + np.outer(gain, gain) * r
        self.p[:3, :3] += np.eye(3) * (x[:3] @ x[:3] / 2) ** 2  # what the update leaves out is of the second order
        self.rot, self.b, self.v = self.rot * Rotation.from_rotvec(x[:3]), self.b + x[3:6], self.v + x[6:]
        reset = np.eye(8)
        reset[:3, :3] = Rotation.from_rotvec(-x[:3]).as_matrix()  # the covariance stays as it is in n
        self.p = reset @ self.p @ reset.T
