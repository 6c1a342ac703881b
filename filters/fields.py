"""Gravity and the magnetic field as the sensors read them: low pass, tilt and heading.

Elmi Aziz and Mohseni Araste 2021, eqs (4)-(9).
"""

from math import atan2, pi, sqrt
from typing import NamedTuple

from stillpoint.datasets.compiled import compiled, compiled_inside
from stillpoint.filters.rotation import (
    Quaternion,
    Vector,
    blend,
    cross,
    dot,
    norm,
    quaternion_from_rows,
    rotate,
    rotation_between,
    scale,
)
from stillpoint.filters.sample import GAP_S, Sample

# Less specific force than that is free fall: its direction says nothing about up.
_FREE_FALL_MPS2 = 1.0
FREE_FALL_M2PS4 = _FREE_FALL_MPS2**2
# Body x within 0.006 deg of the vertical (the square of the sine) has no azimuth to speak of.
_STEEP = 1e-8
# A field whose horizontal part is a smaller share than that points nowhere: at the poles, or shaken along the field.
_LEAST_HORIZONTAL = 0.01
_LEAST_HORIZONTAL_SQUARE = _LEAST_HORIZONTAL**2
# Up this close to straight down: the smallest turn to the true up has no axis of its own, and the one about x is taken.
_UPSIDE_DOWN = -1 + 1e-6
# One field stands for at most that long: after a pause of the magnetometer, a single sample is not taken at its word.
LONGEST_HOLD_S = 1.0


class Fields(NamedTuple):
    """The last raw vectors, for the low pass (9), and the last usable smoothed ones, held in body axes."""

    raw_accel_b_mps2: Vector
    raw_mag_b_ut: Vector
    accel_b_mps2: Vector
    mag_b_ut: Vector
    since_accel_s: float  # time since the last usable one
    since_mag_s: float
    has_accel: bool  # False before the first usable one
    has_mag: bool
    n_free_fall: int  # accelerometer samples left out: too short to point up
    n_no_field: int  # magnetometer samples left out: zero


class Fresh(NamedTuple):
    """The fields of one sample."""

    accel: bool  # a usable specific force
    mag: bool  # a usable field
    mag_hold_s: float  # the time since the field before, which this one stands for


@compiled
def start_fields(zero: float) -> Fields:
    """Return the fields before the first sample."""
    none = (zero, zero, zero)
    return Fields(none, none, none, none, zero, zero, False, False, 0, 0)


@compiled_inside
def smooth_fields(fields: Fields, sample: Sample, kappa: float) -> tuple[Fields, Fresh]:
    """Apply eq (9), x_bar_k = kappa x_k + (1 - kappa) x_(k-1), to raw samples, each sensor at its own rate.

    The first sample, and the first after a gap, stand alone. Samples that are not usable take no part.
    """
    raw_accel, raw_mag, accel, mag, since_accel_s, since_mag_s, has_accel, has_mag, n_free_fall, n_no_field = fields
    gap_s = GAP_S
    since_accel_s += sample.dt_s
    since_mag_s += sample.dt_s
    hold_s = since_mag_s
    new_accel = new_mag = False
    if sample.has_accel:
        follows = has_accel and since_accel_s <= gap_s
        smooth = blend(sample.accel_b_mps2, raw_accel if follows else sample.accel_b_mps2, kappa)
        least = FREE_FALL_M2PS4
        if dot(sample.accel_b_mps2, sample.accel_b_mps2) >= least and dot(smooth, smooth) >= least:
            raw_accel, accel, since_accel_s, has_accel, new_accel = sample.accel_b_mps2, smooth, 0.0, True, True
        else:
            n_free_fall += 1
    if sample.has_mag:
        if dot(sample.mag_b_ut, sample.mag_b_ut) > 0:
            follows = has_mag and since_mag_s <= gap_s
            mag = blend(sample.mag_b_ut, raw_mag if follows else sample.mag_b_ut, kappa)
            raw_mag, since_mag_s, has_mag, new_mag = sample.mag_b_ut, 0.0, True, True
        else:
            n_no_field += 1
    return (
        Fields(raw_accel, raw_mag, accel, mag, since_accel_s, since_mag_s, has_accel, has_mag, n_free_fall, n_no_field),
        Fresh(new_accel, new_mag, hold_s),
    )


@compiled
def level_attitude(accel_b: Vector) -> Quaternion:
    """Return eq (4) as a rotation: the attitude with this up, with the body's x axis north (the paper's yaw is 0)."""
    up = scale(accel_b, 1.0 / norm(accel_b))
    if up[1] * up[1] + up[2] * up[2] > _STEEP:
        west = cross(up, (1.0, 0.0, 0.0))
    else:  # x is vertical, its azimuth undefined: y over west, where eq (4) has roll 0
        west = cross(cross(up, (0.0, 1.0, 0.0)), up)
    west = scale(west, 1.0 / norm(west))
    return quaternion_from_rows((-west[0], -west[1], -west[2]), cross(west, up), up)


@compiled
def level_rotation(q_nb: Quaternion, accel_b: Vector) -> Quaternion:
    """Return the smallest rotation of n, about a horizontal axis, from an attitude's measured up to the true one."""
    return rotation_between(rotate(q_nb, accel_b), (0.0, 0.0, 1.0))


@compiled
def tilt_error(up_n: Vector) -> tuple[float, float]:
    """Return that rotation as a rotation vector without its third component, 0; ``up_n`` may have any length."""
    flat = sqrt(up_n[0] * up_n[0] + up_n[1] * up_n[1])
    if flat == 0:
        return 0.0 if up_n[2] > 0 else pi, flat
    share = atan2(flat, up_n[2]) / flat
    return up_n[1] * share, -up_n[0] * share


@compiled
def level_vector(v_n: Vector, up_n: Vector) -> Vector:
    """Apply eq (5): rotate ``v_n`` by that rotation (Rodrigues' formula); ``up_n`` is of length 1."""
    along = up_n[0] * v_n[0] + up_n[1] * v_n[1]
    if up_n[2] < _UPSIDE_DOWN:
        return v_n[0], -v_n[1], -v_n[2]
    share = v_n[2] + along / (1.0 + up_n[2])
    return v_n[0] - up_n[0] * share, v_n[1] - up_n[1] * share, along + up_n[2] * v_n[2]


@compiled
def north_error(field_n: Vector, declination_rad: float) -> tuple[float, bool]:
    """Return eqs (6)-(8): the turn about up, in (-pi, pi], after which a levelled field points to magnetic north.

    The declination is east of true north. False where the field has no horizontal part.
    """
    east, north, up = field_n
    flat, least = east * east + north * north, _LEAST_HORIZONTAL_SQUARE
    turn = atan2(east, north) - declination_rad
    whole, half = 2.0 * pi, pi
    if turn > half:
        turn -= whole
    elif turn <= -half:
        turn += whole
    return turn, flat > least * (flat + up * up)
