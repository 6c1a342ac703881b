"""Least squares for a magnetometer whose attitude is known: the Earth's field and the hard iron (Zia 2022).

A magnetometer at attitude R reads ``m = R^T F + h``: the Earth's field F in n and the hard iron h in b, six numbers, in
which the model is linear. They are estimated recursively, one field after another. Where the attitudes so far show
nothing the prior stays: no hard iron, and the azimuth of F at the declination.

A component further off than ``_GATE_SD`` gets a variance that puts it at the gate: one wrong field changes next to
nothing, and the estimate still leaves a wrong start. A field that the Earth and a hard iron cannot make together does
not start the estimate.
"""

from math import atan2, cos, sin, sqrt
from typing import NamedTuple

import numpy as np

from stillpoint.datasets.compiled import compiled_inside
from stillpoint.datasets.plausible import FIELD_RANGE_UT
from stillpoint.datasets.recording import Floats
from stillpoint.filters.rotation import Quaternion, Vector, conjugate, dot, rotate, rotation_about_up

# Errors of fields in succession are alike (waves, the noise of one course): those of one second count as one.
_INDEPENDENT_S = 1.0
# How far F may be from the first field besides the hard iron, uT.
_FIRST_FIELD_SD_UT = 5.0
_FIRST_FIELD_UT2 = _FIRST_FIELD_SD_UT**2
# F and h wander that much, uT/sqrt(s): old fields are forgotten over hours, and the covariance stays positive.
_WALK_UT_RTS = 0.01
_WALK_UT2PS = _WALK_UT_RTS**2
# The horizontal field where there is no magnetometer, uT; only its direction matters.
_NOMINAL_UT = 20.0
# A component of a field further off its expectation than so many sd counts less.
_GATE_SD = 5.0
_PER_GATE = 1 / _GATE_SD**2


class Prior(NamedTuple):
    """The prior before the first field."""

    declination_rad: float  # east of true north
    declination_sd_rad: float
    hard_iron_sd_ut: float
    field_sd_ut: float  # error of one second of fields


class Calibration(NamedTuple):
    """The estimate so far. The arrays are passed from step to step and written in place."""

    x_ut: Floats  # (6,) F East, North, Up, then h in b
    cov_ut2: Floats  # (6, 6) of x
    is_begun: bool
    n_mag_learnt: int  # fields that it was learnt from


@compiled_inside
def start_calibration(zero: float) -> Calibration:
    """Return the calibration before the first field."""
    return Calibration(np.full(6, zero), np.full((6, 6), zero), False, 0)


@compiled_inside
def begin_calibration(calibration: Calibration, q_nb: Quaternion, mag: Vector, prior: Prior) -> Calibration:
    """Set the prior by the first field: F has its size, and points to the declination.

    A field above the Earth's largest with three sd of hard iron on it does not begin it.
    """
    largest = FIELD_RANGE_UT[1] + prior.hard_iron_sd_ut * 3.0
    if calibration.is_begun or dot(mag, mag) > largest * largest:
        return calibration
    x, cov = calibration.x_ut, calibration.cov_ut2
    east, north, up = rotate(q_nb, mag)
    flat = sqrt(east * east + north * north)
    e, n = sin(prior.declination_rad), cos(prior.declination_rad)
    x[0], x[1], x[2] = flat * e, flat * n, up
    iron = prior.hard_iron_sd_ut * prior.hard_iron_sd_ut
    along = iron + _FIRST_FIELD_UT2
    across = flat * flat * prior.declination_sd_rad * prior.declination_sd_rad
    cov[0, 0], cov[1, 1] = along * e * e + across * n * n, along * n * n + across * e * e
    cov[0, 1] = cov[1, 0] = (along - across) * e * n
    cov[2, 2] = along
    for i in range(3, 6):
        cov[i, i] = iron
    return Calibration(x, cov, True, 0)


@compiled_inside
def learn_field(calibration: Calibration, q_nb: Quaternion, mag: Vector, since_s: float, prior: Prior) -> Calibration:
    """Update the least squares by one field, ``since_s`` after the one before: its three components in turn."""
    x, cov, is_begun, n_learnt = calibration
    if not is_begun:
        return calibration
    q_bn, independent_s = conjugate(q_nb), _INDEPENDENT_S
    east, north, up = rotate(q_bn, (1.0, 0.0, 0.0)), rotate(q_bn, (0.0, 1.0, 0.0)), rotate(q_bn, (0.0, 0.0, 1.0))
    stands_s = min(max(since_s, 1e-3), independent_s)
    variance = prior.field_sd_ut * prior.field_sd_ut * independent_s / stands_s
    moved = np.full(6, 0.0)
    for i in range(6):
        cov[i, i] += _WALK_UT2PS * stands_s
    for axis in range(3):
        for i in range(6):
            moved[i] = cov[i, 0] * east[axis] + cov[i, 1] * north[axis] + cov[i, 2] * up[axis] + cov[i, 3 + axis]
        spread = moved[0] * east[axis] + moved[1] * north[axis] + moved[2] * up[axis] + moved[3 + axis] + variance
        left = mag[axis] - (x[0] * east[axis] + x[1] * north[axis] + x[2] * up[axis] + x[3 + axis])
        spread = max(spread, left * left * _PER_GATE)
        for i in range(6):
            x[i] += moved[i] * left / spread
            for j in range(6):
                cov[i, j] -= moved[i] * moved[j] / spread
    return Calibration(x, cov, is_begun, n_learnt + 1)


@compiled_inside
def predict_field(calibration: Calibration, q_nb: Quaternion, prior: Prior) -> Vector:
    """Return the field in b that F makes at this attitude, with its azimuth at the declination."""
    x = calibration.x_ut
    flat, up = sqrt(x[0] * x[0] + x[1] * x[1]), x[2]
    if not calibration.is_begun:
        flat, up = _NOMINAL_UT, 0.0
    return rotate(conjugate(q_nb), (flat * sin(prior.declination_rad), flat * cos(prior.declination_rad), up))


@compiled_inside
def correct_field(calibration: Calibration, q_nb: Quaternion, mag: Vector, prior: Prior) -> Vector:
    """Remove the hard iron from a field, and turn it about up by the azimuth error of F."""
    x = calibration.x_ut
    field_n = rotate(q_nb, (mag[0] - x[3], mag[1] - x[4], mag[2] - x[5]))
    turn = atan2(x[0], x[1]) - prior.declination_rad
    return rotate(conjugate(q_nb), rotate(rotation_about_up(turn), field_n))
