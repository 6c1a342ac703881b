"""The axes about which the z-y-x Euler angles of an attitude turn, in body axes; turns about them and back."""

from math import sqrt
from typing import NamedTuple

from stillpoint.datasets.quaternion import half_angle
from stillpoint.filters.compiled import compiled_inside, like
from stillpoint.filters.rotation import Quaternion, Vector

# Cosine of the pitch below which roll and heading are one angle: the body's x axis is within 1.1 deg of the vertical.
GIMBAL = 0.02


class Frame(NamedTuple):
    """Where the Euler angles of an attitude turn, in body axes."""

    up_b: Vector  # axis of heading: (-sin pitch, cos pitch sin roll, cos pitch cos roll)
    pitch_b: Vector  # axis of pitch: (0, cos roll, -sin roll)
    cos_pitch: float


@compiled_inside
def frame_of(q: Quaternion) -> Frame:
    """Where the Euler angles of an attitude turn; the pitch's axis is arbitrary where x is vertical."""
    w, x, y, z = q
    one, two = like(w, 1.0), like(w, 2.0)
    up_x, up_y, up_z = (x * z - w * y) * two, (y * z + w * x) * two, one - (x * x + y * y) * two
    square = up_y * up_y + up_z * up_z
    cos_pitch = sqrt(square)
    if cos_pitch < like(w, GIMBAL):
        return Frame((up_x, up_y, up_z), (one - one, one, one - one), cos_pitch)
    share = cos_pitch * (one / square)  # sooner there than 1 / cos_pitch
    return Frame((up_x, up_y, up_z), (one - one, up_z * share, -up_y * share), cos_pitch)


@compiled_inside
def half_turn(angle: float) -> tuple[float, float]:
    """Cosine and sine of half an angle in rad."""
    cosine, share = half_angle(angle * angle)
    return cosine, angle * share


@compiled_inside
def tilting(roll: float, pitch: float, pitch_b: Vector) -> Quaternion:
    """A turn by ``pitch`` about the axis of pitch, then by ``roll`` about body x: on the right of an attitude."""
    (cp, sp), (cr, sr) = half_turn(pitch), half_turn(roll)
    y, z = pitch_b[1] * sp, pitch_b[2] * sp
    return cp * cr, cp * sr, y * cr + z * sr, z * cr - y * sr


@compiled_inside
def turned_about_up(q: Quaternion, angle: float) -> Quaternion:
    """The attitude after a turn about up."""
    c, s = half_turn(angle)
    return c * q[0] - s * q[3], c * q[1] - s * q[2], c * q[2] + s * q[1], c * q[3] + s * q[0]


@compiled_inside
def in_body(roll: float, pitch: float, frame: Frame) -> Vector:
    """The body rate of these rates of roll and pitch: the inverse of (1)."""
    return roll, frame.pitch_b[1] * pitch, frame.pitch_b[2] * pitch


@compiled_inside
def hidden_turns(q_nb: Quaternion, hidden_b_rad: Vector) -> Vector:
    """The most that turns about the body's axes, of either sign, make of roll, pitch and heading: (1)."""
    up, (_, across_y, across_z), cos_pitch = frame_of(q_nb)
    x, y, z = hidden_b_rad
    least = like(x, GIMBAL)
    heading = (abs(up[1]) * y + abs(up[2]) * z) / max(cos_pitch * cos_pitch, least * least)
    return x + abs(up[0]) * heading, abs(across_y) * y + abs(across_z) * z, heading


@compiled_inside
def covariance(roll: float, pitch: float, heading: float, frame: Frame) -> tuple[float, ...]:
    """Variances of the Euler angles as the covariance of a small rotation in body axes."""
    up, (_, py, pz) = frame.up_b, frame.pitch_b
    xy, xz, yz = heading * up[0] * up[1], heading * up[0] * up[2], heading * up[1] * up[2] + pitch * py * pz
    xx, yy = roll + heading * up[0] * up[0], pitch * py * py + heading * up[1] * up[1]
    return xx, xy, xz, xy, yy, yz, xz, yz, pitch * pz * pz + heading * up[2] * up[2]
