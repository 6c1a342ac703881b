"""Errors of one attitude against another: angles that are exact for small errors too, and Euler errors.

All functions take quaternions wxyz of shape (N, 4), ``q_nb``, and return radians.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.frames import EulerFrame, compose, euler, quaternion, rotation, wrap
from stillpoint.datasets.recording import Floats

_GIMBAL_RAD = np.deg2rad(80.0)  # beyond this pitch, roll and yaw errors are large for any small rotation


@dataclass(frozen=True, eq=False)
class AttitudeError:
    """The error of BROAD (Laidig et al., Data 6(7):72, 2021): the earth-frame rotation from truth to estimate, split.

    heading is the part about the vertical, inclination the smallest rotation about a horizontal axis that is left.
    """

    total_rad: Floats  # (N,) 2 acos |w|
    heading_rad: Floats  # (N,) 2 atan |z / w|
    inclination_rad: Floats  # (N,) 2 acos sqrt(w^2 + z^2)


def _compute_error_quaternion(q_est: Floats, q_true: Floats) -> Floats:
    """Return the earth-frame error e in ``q_est = e * q_true``, (N, 4) with w >= 0."""
    return quaternion(compose(rotation(q_est), rotation(q_true).inv()))


def compute_attitude_error(q_est: Floats, q_true: Floats) -> AttitudeError:
    """Return total, heading and inclination error, each in [0, pi]; arctangents keep errors of 1e-9 rad exact."""
    w, x, y, z = _compute_error_quaternion(q_est, q_true).T
    return AttitudeError(
        total_rad=2 * np.arctan2(np.sqrt(x * x + y * y + z * z), np.abs(w)),
        heading_rad=2 * np.arctan2(np.abs(z), np.abs(w)),
        inclination_rad=2 * np.arctan2(np.hypot(x, y), np.hypot(w, z)),
    )


def compute_heading_offset(q_est: Floats, q_true: Floats) -> Floats:
    """Return the signed heading error (N,) in (-pi, pi], positive when the estimate is turned counter-clockwise."""
    w, _, _, z = _compute_error_quaternion(q_est, q_true).T
    return wrap(2 * np.arctan2(z, w))


def compute_euler_error(q_est: Floats, q_true: Floats, frame: EulerFrame) -> Floats:
    """Return estimate minus truth in roll, pitch, yaw, (N, 3), wrapped to (-pi, pi].

    Near a pitch of +-90 deg roll and yaw are not defined and their errors say nothing; see :func:`find_near_gimbal`.
    """
    return wrap(euler(q_est, frame) - euler(q_true, frame))


def find_near_gimbal(q_true: Floats, frame: EulerFrame) -> NDArray[np.bool_]:
    """Return where the true pitch lies beyond +-80 deg, (N,)."""
    return np.abs(euler(q_true, frame)[:, 1]) > _GIMBAL_RAD


def compute_rotation_error_b(q_est: Floats, q_true: Floats) -> Floats:
    """Return d (N, 3) in body axes of ``q_true = q_est * exp(d)``, the error whose covariance is ``cov_b_rad2``."""
    return np.asarray(compose(rotation(q_est).inv(), rotation(q_true)).as_rotvec(), dtype=np.float64)


def compute_rotation_error_n(q_est: Floats, q_true: Floats) -> Floats:
    """Return the rotation vector e (N, 3) about east, north, up of ``q_est = exp(e) * q_true``."""
    return np.asarray(compose(rotation(q_est), rotation(q_true).inv()).as_rotvec(), dtype=np.float64)


def compute_normalised_square(d_rad: Floats, cov_rad2: Floats) -> Floats:
    """Return d' C^-1 d of each row, (N,): chi-square with 3 degrees of freedom when the covariance is right."""
    return np.einsum("ni,ni->n", d_rad, np.linalg.solve(cov_rad2, d_rad[..., None])[..., 0])
