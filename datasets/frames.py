"""Convert quaternion orders, local frames and Euler angles; wrap angles and interpolate attitudes.

In memory a quaternion is Hamilton, ``w, x, y, z``, and ``q_nb`` takes body vectors to n = East-North-Up. ROS, scipy's
default and the viewers write ``x, y, z, w``: only :func:`to_xyzw` and :func:`from_xyzw` convert.
"""

from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]
EulerFrame = Literal["enu", "nwu", "ned"]

# Rows are the axes of the local frame, written in ENU.
_LOCAL_FROM_ENU: dict[str, Floats] = {
    "enu": np.eye(3),
    "nwu": np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    "ned": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
}
EULER_FRAMES: tuple[EulerFrame, ...] = ("enu", "nwu", "ned")


def to_xyzw(q_wxyz: Floats) -> Floats:
    """Return quaternions ``(..., 4)`` in the order of ROS and the viewers; the bits are kept."""
    return np.ascontiguousarray(q_wxyz[..., [1, 2, 3, 0]])


def from_xyzw(q_xyzw: Floats) -> Floats:
    """Return wxyz quaternions ``(..., 4)`` from the order of ROS and the viewers; the bits are kept."""
    return np.ascontiguousarray(q_xyzw[..., [3, 0, 1, 2]])


def _import_rotation() -> "type[Rotation]":
    """Return scipy's class, which takes a quarter of a second to import; most streaming estimators need none."""
    from scipy.spatial.transform import Rotation

    return Rotation


def rotation(q_wxyz: ArrayLike) -> "Rotation":
    """Return scipy's ``Rotation`` of wxyz quaternions ``(4,)`` or ``(N, 4)``."""
    return _import_rotation().from_quat(np.asarray(q_wxyz, dtype=np.float64), scalar_first=True)


def quaternion(rot: "Rotation") -> Floats:
    """Return the unit quaternions wxyz of a ``Rotation``, with w >= 0."""
    return np.asarray(rot.as_quat(canonical=True, scalar_first=True), dtype=np.float64)


def compose(second: "Rotation", first: "Rotation") -> "Rotation":
    """Return ``second * first``, the same bits; scipy 1.17 takes 15 times as long for arrays (N,)."""
    px, py, pz, pw = np.moveaxis(second.as_quat(), -1, 0)
    qx, qy, qz, qw = np.moveaxis(first.as_quat(), -1, 0)
    x = pw * qx + qw * px + (py * qz - pz * qy)
    y = pw * qy + qw * py + (pz * qx - px * qz)
    z = pw * qz + qw * pz + (px * qy - py * qx)
    w = pw * qw - px * qx - py * qy - pz * qz
    return _import_rotation().from_quat(np.stack([x, y, z, w], axis=-1))


def wrap(angle_rad: ArrayLike) -> Floats:
    """Wrap angles to (-pi, pi]."""
    wrapped = np.pi - np.mod(np.pi - np.asarray(angle_rad, dtype=np.float64), 2 * np.pi)
    return np.asarray(wrapped, dtype=np.float64)


def local_from_enu(frame: EulerFrame) -> "Rotation":
    """Return the rotation that takes ENU vectors to the axes of ``frame``."""
    return _import_rotation().from_matrix(_LOCAL_FROM_ENU[frame])


def euler(q_nb: Floats, frame: EulerFrame) -> Floats:
    """Return roll, pitch, yaw in rad, shape ``(..., 3)``, as users of the named frame define them.

    ``"nwu"``  Elmi Aziz and Mohseni Araste 2021, eqs (2)-(8): C = R3(yaw) R2(pitch) R1(roll) with the
    *passive* R_i of its eq (3), so that roll = atan2(-a2, a3), pitch = asin(a1 / |a|) and yaw is the azimuth of
    the body x axis, clockwise from north.
    ``"ned"``  Zia 2022: the aerospace z-y-x angles of a forward-right-down body in North-East-Down.
    ``"enu"``  z-y-x angles in East-North-Up, as ROS uses them.
    """
    rot = compose(local_from_enu(frame), rotation(q_nb))
    angles = rot.as_euler("ZYX")[..., ::-1]
    return wrap(-angles) if frame == "nwu" else wrap(angles)


def from_euler(angles_rad: ArrayLike, frame: EulerFrame) -> Floats:
    """Return quaternions ``q_nb`` from roll, pitch, yaw ``(..., 3)`` in rad; the inverse of :func:`euler`."""
    angles = np.asarray(angles_rad, dtype=np.float64)[..., ::-1]
    rot = _import_rotation().from_euler("ZYX", -angles if frame == "nwu" else angles)
    return quaternion(compose(local_from_enu(frame).inv(), rot))


def slerp(t_ns: NDArray[np.int64], q_wxyz: Floats, at_ns: NDArray[np.int64]) -> Floats:
    """Interpolate attitude at other times along the great-circle path between neighbouring samples.

    ``t_ns`` (N,) rising, ``q_wxyz`` (N, 4), ``at_ns`` (M,) within ``[t_ns[0], t_ns[-1]]``; returns (M, 4), w >= 0.
    Raises ``ValueError`` for a time outside: an attitude is never extrapolated.
    """
    if len(at_ns) and (at_ns.min() < t_ns[0] or at_ns.max() > t_ns[-1]):
        raise ValueError("slerp: a time lies outside the samples; cut to the common span first")
    if len(t_ns) == 1:
        return quaternion(rotation(np.repeat(q_wxyz, len(at_ns), axis=0)))
    right = np.clip(np.searchsorted(t_ns, at_ns, side="right"), 1, len(t_ns) - 1)
    left = right - 1
    share = (at_ns - t_ns[left]) / (t_ns[right] - t_ns[left])
    found = q_wxyz[np.where(share < 1, left, right)]
    between = np.flatnonzero((share > 0) & (share < 1))  # elsewhere a sample is hit: nothing to interpolate
    first = rotation(found[between])
    step = compose(first.inv(), rotation(q_wxyz[right[between]]))
    part = _import_rotation().from_rotvec(step.as_rotvec() * share[between, None])
    found[between] = quaternion(compose(first, part))
    return quaternion(rotation(found))


def heading_rotation(angle_rad: float | Floats) -> "Rotation":
    """Return the rotation by an angle, or those by angles (N,), about up, counter-clockwise seen from above."""
    return _import_rotation().from_rotvec(np.multiply.outer(angle_rad, [0.0, 0.0, 1.0]))
