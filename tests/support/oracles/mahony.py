"""Mahony's filter as BROAD ran it, to meet its published figures: only the figures of the score are in question."""

import numpy as np
from numba import njit
from scipy.spatial.transform import Rotation

from stillpoint.datasets.frames import heading_rotation, quaternion
from stillpoint.filters.rotation import add, conjugate, cross, multiply, norm, normalise, rotate, scale


def mahony(gyro_b_radps, accel_b_mps2, mag_b_ut, rate_hz, kp_per_s, ki_per_s2):
    """Attitudes (N, 4): Mahony, Hamel, Pflimlin, IEEE TAC 53(5), 2008, by Euler's step, from BROAD's own start."""
    up, down = accel_b_mps2[0], -mag_b_ut[0]
    north = np.cross(np.cross(up, down), up)
    axes = np.array([north, np.cross(up, north), up])
    start = quaternion(Rotation.from_matrix((axes / np.linalg.norm(axes, axis=1, keepdims=True)).T))
    turned = run(tuple(start), gyro_b_radps, accel_b_mps2, mag_b_ut, 1 / rate_hz, kp_per_s, ki_per_s2)
    return quaternion(heading_rotation(np.pi / 2) * Rotation.from_quat(turned, scalar_first=True))  # x was north


@njit
def run(q, gyro, accel, mag, dt_s, kp, ki):
    """The loop; x over the horizontal field."""
    found, bias = np.empty((len(gyro), 4)), (0.0, 0.0, 0.0)
    for k in range(len(gyro)):
        a, m = (accel[k, 0], accel[k, 1], accel[k, 2]), (mag[k, 0], mag[k, 1], mag[k, 2])
        a, m = scale(a, 1 / norm(a)), scale(m, 1 / norm(m))
        seen, back = rotate(q, m), conjugate(q)
        field = rotate(back, (np.hypot(seen[0], seen[1]), 0.0, seen[2]))
        error = add(cross(a, rotate(back, (0.0, 0.0, 1.0))), cross(m, field))
        bias = add(bias, scale(error, ki * dt_s))
        rate = add(add((gyro[k, 0], gyro[k, 1], gyro[k, 2]), bias), scale(error, kp))
        change = multiply(q, (0.0, rate[0], rate[1], rate[2]))
        half_s = 0.5 * dt_s
        q = normalise(
            (q[0] + half_s * change[0], q[1] + half_s * change[1], q[2] + half_s * change[2], q[3] + half_s * change[3])
        )
        found[k] = q
    return found
