"""Attitude from gravity and the magnetic field: what every estimator of paper 002 leans on (eqs (4)-(9)).

The accelerometer gives up, the field gives east = field x up: the axes of n seen from the body are the attitude. That
is eqs (4)-(6) without their singularity at a pitch of 90 deg; eqs (7) and (8) turn it by the declination.
"""

from typing import NamedTuple

from stillpoint.filters.compiled import compiled, like
from stillpoint.filters.rotation import (
    Quaternion,
    Vector,
    about_up,
    blend,
    cross,
    dot,
    from_rows,
    multiply,
    norm,
    scale,
)
from stillpoint.filters.sample import Sample

# Less specific force than that is free fall: its direction says nothing about up.
FREE_FALL_MPS2 = 1.0
# A field whose horizontal part is a smaller share than that points nowhere: at the poles, or shaken along the field.
LEAST_HORIZONTAL = 0.01


class Fields(NamedTuple):
    """The last raw vectors, for the low pass (9), and the last usable smoothed ones."""

    raw_accel: Vector
    raw_mag: Vector
    accel: Vector
    mag: Vector  # held in body axes between samples of the magnetometer
    has_accel: bool
    has_mag: bool
    n_free_fall: int  # accelerometer samples left out: too short to point up
    n_no_field: int  # magnetometer samples left out: zero


@compiled
def no_fields(zero: float) -> Fields:
    """Before the first sample."""
    none = (zero, zero, zero)
    return Fields(none, none, none, none, False, False, 0, 0)


@compiled
def low_pass(fields: Fields, sample: Sample, share: float) -> tuple[Fields, bool, bool]:
    """Eq (9): x_bar_k = share x_k + (1 - share) x_(k-1), the raw sample before; each sensor at its own rate.

    Also returns whether this sample brought a usable specific force, and a usable field.
    """
    raw_accel, accel, has_accel, n_free_fall = fields.raw_accel, fields.accel, fields.has_accel, fields.n_free_fall
    new_accel, new_mag = False, False
    if sample.has_accel:
        smooth = blend(sample.accel_b_mps2, raw_accel if has_accel else sample.accel_b_mps2, share)
        raw_accel = sample.accel_b_mps2
        if dot(smooth, smooth) >= like(share, FREE_FALL_MPS2 * FREE_FALL_MPS2):
            accel, has_accel, new_accel = smooth, True, True
        else:
            n_free_fall += 1
    raw_mag, mag, has_mag, n_no_field = fields.raw_mag, fields.mag, fields.has_mag, fields.n_no_field
    if sample.has_mag:
        if dot(sample.mag_b_ut, sample.mag_b_ut) > 0:
            mag = blend(sample.mag_b_ut, raw_mag if has_mag else sample.mag_b_ut, share)
            raw_mag, has_mag, new_mag = sample.mag_b_ut, True, True
        else:
            n_no_field += 1
    fields = Fields(raw_accel, raw_mag, accel, mag, has_accel, has_mag, n_free_fall, n_no_field)
    return fields, new_accel, new_mag


@compiled
def level(accel: Vector) -> Quaternion:
    """The attitude with this up and the body's x axis over north: yaw 0 in the paper's angles."""
    up = scale(accel, like(accel[0], 1.0) / norm(accel))
    flat = like(up[0], 1.0) - up[0] * up[0]
    zero = like(flat, 0.0)
    if flat > like(flat, LEAST_HORIZONTAL * LEAST_HORIZONTAL):
        north = scale(
            (flat, -up[0] * up[1], -up[0] * up[2]), like(flat, 1.0) / norm((flat, -up[0] * up[1], -up[0] * up[2]))
        )
    else:  # x is vertical: y over west, where eq (4) has roll 0
        side = cross((zero, like(flat, 1.0), zero), up)
        north = scale(side, like(flat, 1.0) / norm(side))
    return from_rows(cross(north, up), north, up)


@compiled
def compass(accel: Vector, mag: Vector, declination_rad: float) -> tuple[Quaternion, bool]:
    """The attitude by up and the field, and False where the field has no horizontal part (the attitude is then level).

    ``declination_rad`` is east of true north.
    """
    up = scale(accel, like(accel[0], 1.0) / norm(accel))
    east = cross(mag, up)
    size = norm(east)
    if not size > like(size, LEAST_HORIZONTAL) * norm(mag):
        return level(accel), False
    east = scale(east, like(size, 1.0) / size)
    return multiply(about_up(-declination_rad), from_rows(east, cross(up, east), up)), True
