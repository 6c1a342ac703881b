"""The axes about which the z-y-x Euler angles of an attitude turn, in body axes, and conversions with them."""

from math import sqrt
from typing import NamedTuple

from stillpoint.datasets.compiled import compiled_apart, compiled_inside
from stillpoint.datasets.quaternion import half_angle
from stillpoint.filters.kalman.covariance import ANY_ANGLE_RAD2
from stillpoint.filters.rotation import Quaternion, Vector, cross

# Cosine of the pitch below which roll and heading are one angle: the body's x axis is within 1.1 deg of the vertical.
GIMBAL = 0.02
# And below which roll and heading begin to be: it is within 14 deg.
STEEP = 0.25
_PER_STEEP = 1 / STEEP


Nine = tuple[float, float, float, float, float, float, float, float, float]  # a 3 x 3 by rows


class Frame(NamedTuple):
    """The axes about which the Euler angles of an attitude turn, in body axes."""

    up_b: Vector  # axis of heading: (-sin pitch, cos pitch sin roll, cos pitch cos roll)
    pitch_b: Vector  # axis of pitch: (0, cos roll, -sin roll)
    cos_pitch: float


@compiled_inside
def euler_frame(q: Quaternion) -> Frame:
    """Return the axes about which the Euler angles turn; that of pitch is arbitrary where x is vertical."""
    w, x, y, z = q
    up_x, up_y, up_z = (x * z - w * y) * 2.0, (y * z + w * x) * 2.0, 1.0 - (x * x + y * y) * 2.0
    square = up_y * up_y + up_z * up_z
    cos_pitch = sqrt(square)
    if cos_pitch < GIMBAL:
        return Frame((up_x, up_y, up_z), (1.0 - 1.0, 1.0, 1.0 - 1.0), cos_pitch)
    share = cos_pitch * (1.0 / square)  # sooner there than 1 / cos_pitch
    return Frame((up_x, up_y, up_z), (1.0 - 1.0, up_z * share, -up_y * share), cos_pitch)


@compiled_inside
def _half_angle_cos_sin(angle: float) -> tuple[float, float]:
    """Return cosine and sine of half an angle in rad."""
    cosine, share = half_angle(angle * angle)
    return cosine, angle * share


@compiled_inside
def tilt_rotation(roll: float, pitch: float, pitch_b: Vector) -> Quaternion:
    """Return a turn by ``pitch`` about the axis of pitch, then by ``roll`` about body x, to multiply from the right."""
    (cp, sp), (cr, sr) = _half_angle_cos_sin(pitch), _half_angle_cos_sin(roll)
    y, z = pitch_b[1] * sp, pitch_b[2] * sp
    return cp * cr, cp * sr, y * cr + z * sr, z * cr - y * sr


@compiled_inside
def turn_about_up(q: Quaternion, angle: float) -> Quaternion:
    """Return the attitude after a turn about up."""
    c, s = _half_angle_cos_sin(angle)
    return c * q[0] - s * q[3], c * q[1] - s * q[2], c * q[2] + s * q[1], c * q[3] + s * q[0]


@compiled_inside
def body_rate(roll: float, pitch: float, frame: Frame) -> Vector:
    """Return the body rate of these rates of roll and pitch: the inverse of (1)."""
    return roll, frame.pitch_b[1] * pitch, frame.pitch_b[2] * pitch


@compiled_inside
def bound_hidden_turns(q_nb: Quaternion, hidden_b_rad: Vector) -> Vector:
    """Return the largest roll, pitch and heading that turns about the body's axes, of either sign, can make: (1)."""
    up, (_, across_y, across_z), cos_pitch = euler_frame(q_nb)
    x, y, z = hidden_b_rad
    least = GIMBAL
    if cos_pitch < least:  # any horizontal axis may be that of pitch
        across_y = across_z = 1.0
    heading = (abs(up[1]) * y + abs(up[2]) * z) / max(cos_pitch * cos_pitch, least * least)
    return x + abs(up[0]) * heading, abs(across_y) * y + abs(across_z) * z, heading


@compiled_inside
def _add_axis_error(cov: Nine, variance: float, axis: Vector) -> Nine:
    """Add an independent error about this axis to a 3 x 3 covariance."""
    x, y, z = axis
    ax, ay, az = variance * x, variance * y, variance * z
    xy, xz, yz = cov[1] + ax * y, cov[2] + ax * z, cov[5] + ay * z
    return cov[0] + ax * x, xy, xz, xy, cov[4] + ay * y, yz, xz, yz, cov[8] + az * z


@compiled_apart
def _steep_covariance(roll: float, pitch: float, heading: float, frame: Frame) -> Nine:
    """Compute :func:`covariance` near the vertical."""
    (ux, uy, uz), across, cos_pitch = frame
    share = cos_pitch * _PER_STEEP
    mirrored = min(roll, ANY_ANGLE_RAD2) * (1.0 - share * share) / 2.0
    tilt = max(pitch - roll * cos_pitch * cos_pitch, 0.0) * (1.0 - share * share)
    cov = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    cov = _add_axis_error(cov, min(roll, ANY_ANGLE_RAD2) - mirrored, (1.0, 0.0, 0.0))
    cov = _add_axis_error(cov, mirrored, (1.0 - 2.0 * ux * ux, -2.0 * ux * uy, -2.0 * ux * uz))
    cov = _add_axis_error(cov, pitch, across)
    cov = _add_axis_error(cov, heading, (ux, uy, uz))
    return _add_axis_error(cov, tilt, cross((ux, uy, uz), across))


@compiled_inside
def covariance(roll: float, pitch: float, heading: float, frame: Frame) -> Nine:
    """Return the variances of the Euler angles as the covariance of a small rotation in body axes.

    An error of roll is one about body x. Where x is near the vertical that is up as well, but what the filters know is
    the tilt, about a horizontal axis, and the turn about up, each by its own sensor; the sum of three independent
    angles would have tilt and turn cancel each other, down to a variance of 0. So from ``STEEP`` on the two go over
    into independent ones: half of the roll's variance along x, half along its mirror image in the horizontal plane.
    And the tilt is never known better than that about the axis of pitch, by the same sensor.
    """
    up, (_, py, pz) = frame.up_b, frame.pitch_b
    if frame.cos_pitch < STEEP:
        return _steep_covariance(roll, pitch, heading, frame)
    xy, xz, yz = heading * up[0] * up[1], heading * up[0] * up[2], heading * up[1] * up[2] + pitch * py * pz
    xx, yy = roll + heading * up[0] * up[0], pitch * py * py + heading * up[1] * up[1]
    return xx, xy, xz, xy, yy, yz, xz, yz, pitch * pz * pz + heading * up[2] * up[2]
