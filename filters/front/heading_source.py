"""``gps-course``: GPS course as the source of the heading, in front of any estimator (Zia 2022, source selection).

While satellite fixes are valid and the body moves (a vehicle on the surface), each field that the estimator gets is the
one that would be measured at the heading of the course: its tilt-compensated heading *is* the course. The body's x axis
is assumed to lie along the track, ``mounting_yaw_rad`` beside it; drift by current, wind and waves is an error of the
heading. Between fixes the heading follows the gyro, and fields come at the magnetometer's own rate; without a
magnetometer they come with the fixes. Without a valid course the estimator gets the magnetometer, corrected by what was
learnt meanwhile. A field of zero is not a measurement: nothing is learnt from it, and the estimator leaves it out and
counts it. When the magnetometer has brought nothing else for ``longest_age_s``, the fields come with the fixes.

**What is learnt.** With attitude R (tilt by the stage's own complementary filter, heading by the course) the
magnetometer reads ``m = R^T F + h``: the Earth's field F in n and the hard iron h. The model is linear in both, so
recursive least squares estimates six numbers. A single heading fixes only the sideways part of h, and this heading
needs no more; a turn fixes the rest. Where the motion shows nothing the prior stays: h = 0, and the azimuth of F at
the declination.

**The gyro.** The same complementary filter estimates the gyro's bias: about the horizontal axes always, about the
vertical while there is a course. Estimators with a bias state find it themselves from the fields they get; ``gyro_bias
= "remove"`` removes it from the rates for those that have none.

An estimator sees nothing of this but its samples.
"""

from dataclasses import dataclass
from math import atan2, cos, pi, sin
from typing import Literal, NamedTuple

from stillpoint.datasets.compiled import compiled_inside, like
from stillpoint.datasets.settings import Settings, choice, degrees, number
from stillpoint.filters import rotation
from stillpoint.filters.fields import FREE_FALL_M2PS4, tilt_error
from stillpoint.filters.front.guard import Fix
from stillpoint.filters.front.mag_calibration import (
    Calibration,
    Prior,
    begin_calibration,
    correct_field,
    learn_field,
    predict_field,
    start_calibration,
)
from stillpoint.filters.rotation import Quaternion, Vector, add, conjugate, dot, multiply, normalise, rotate, scale
from stillpoint.filters.sample import GAP_S, Sample

Heading = Literal["mag", "gps-course"]
HEADINGS: dict[str, str] = {
    "mag": "the magnetometer as it is",
    "gps-course": "gps course while it is valid, the magnetometer calibrated by it otherwise",
}
# So many fixes in succession before the heading counts: the first ones alone are as noisy as one fix.
_FIXES_TO_SETTLE = 3
# Body x this close to the vertical (its horizontal part, squared) has no heading to compare with a course.
_STEEP = 0.25
# How well the declination is known when it is given, and when it is not.
_DECLINATION_SD_RAD = (pi / 180, pi / 9)


@dataclass(frozen=True)
class Params(Settings):
    """Parameters of the heading source ``gps-course``."""

    least_speed_mps: float = number(0.5, 0.0, 1e3, "lowest speed over ground at which a course is used, m/s")
    longest_age_s: float = number(2.5, 0.01, 600.0, "time for which a fix is used, s")
    course_time_s: float = number(10.0, 0.0, 600.0, "time constant of following the courses, s; 0 = no averaging")
    tilt_time_s: float = number(10.0, 0.01, 600.0, "time constant of the stage's own tilt, s")
    mounting_yaw_rad: float = degrees(0.0, -180.0, 180.0, "angle from the track to body x, clockwise from above")
    hard_iron_sd_ut: float = number(20.0, 0.0, 1e3, "sd of the hard iron, uT; 0 = none is estimated")
    field_sd_ut: float = number(1.0, 1e-3, 1e3, "error of one second of fields, by noise, tilt and course, uT")
    gyro_bias: Literal["leave", "remove"] = choice("leave", "leave the gyro's bias to the estimator, or subtract it")


class Coefficients(NamedTuple):
    """Constants derived once from the parameters."""

    least_speed_mps: float
    longest_age_s: float
    course_time_s: float
    tilt_time_s: float
    mounting_yaw_rad: float
    removes_bias: bool
    prior: Prior


class Attitude(NamedTuple):
    """The stage's own attitude, by gyro and accelerometer; its heading follows the course while there is one."""

    q_nb: Quaternion
    bias_b_radps: Vector  # of the gyro
    is_level: bool
    age_s: float  # since it was levelled, up to the time constant


class Courses(NamedTuple):
    """The stage's memory of the fixes."""

    since_s: float  # the last one that counted
    in_row: int  # of those that counted
    n_course_used: int
    n_course_left_out: int  # not finite, too slow, or the body too steep to have a heading


class State(NamedTuple):
    """The state of the filter between two samples."""

    attitude: Attitude
    courses: Courses
    calibration: Calibration
    since_mag_s: float  # the last field that was not zero
    n_mag_by_course: int  # fields given with the heading of the course
    n_mag_corrected: int  # fields given without a course, corrected by what was learnt


def coefficients(params: Params, declination_rad: float | None) -> Coefficients:
    """Precompute the constants from the parameters and the local declination (None if it is not known)."""
    p = params
    return Coefficients(
        p.least_speed_mps,
        p.longest_age_s,
        p.course_time_s,
        p.tilt_time_s,
        p.mounting_yaw_rad,
        p.gyro_bias == "remove",
        Prior(
            0.0 if declination_rad is None else declination_rad,
            _DECLINATION_SD_RAD[declination_rad is None],
            p.hard_iron_sd_ut,
            p.field_sd_ut,
        ),
    )


@compiled_inside
def start(zero: float) -> State:
    """Return the state before the first sample."""
    attitude = Attitude((1.0, zero, zero, zero), (zero, zero, zero), False, zero)
    return State(attitude, Courses(zero, 0, 0, 0), start_calibration(zero), zero, 0, 0)


@compiled_inside
def _correction_gains(error_s: float, age_s: float, time_s: float) -> tuple[float, float]:
    """Return, for an error held over ``error_s``, the share to turn by and the share to take off the bias (1/s).

    A critically damped PI filter of this time constant, and at first, up to this age, the mean of what there is.
    """
    longest_s = max(time_s, error_s)
    turn = error_s / max(min(age_s, longest_s), error_s) if error_s > 0 else 1.0
    bias = error_s / (4.0 * longest_s * longest_s) if error_s > 0 else 0.0
    return turn, bias


@compiled_inside
def _correct_attitude(attitude: Attitude, error_n: Vector, share: tuple[float, float]) -> Attitude:
    """Turn by a share of an error (a rotation vector in n), and take another share of it off the bias."""
    q_nb, bias, is_level, age_s = attitude
    bias = add(bias, rotate(conjugate(q_nb), scale(error_n, -share[1])))
    return Attitude(normalise(multiply(rotation.exp(scale(error_n, share[0])), q_nb)), bias, is_level, age_s)


@compiled_inside
def _follow_gravity(attitude: Attitude, sample: Sample, c: Coefficients) -> Attitude:
    """Turn by the rate less its bias, then towards the accelerometer's up."""
    q_nb, bias, is_level, age_s = attitude
    dt_s = sample.dt_s
    if dt_s > GAP_S:
        is_level = False
    if is_level:
        q_nb = multiply(q_nb, rotation.exp(scale(add(sample.gyro_b_radps, scale(bias, -1.0)), dt_s)))
        age_s = min(age_s + dt_s, c.tilt_time_s)
    if not sample.has_accel or dot(sample.accel_b_mps2, sample.accel_b_mps2) < FREE_FALL_M2PS4:
        return Attitude(normalise(q_nb), bias, is_level, age_s)
    tilt_x, tilt_y = tilt_error(rotate(q_nb, sample.accel_b_mps2))
    share = _correction_gains(dt_s, age_s, c.tilt_time_s) if is_level else (1.0, 0.0)
    return _correct_attitude(Attitude(q_nb, bias, True, age_s if is_level else 0.0), (tilt_x, tilt_y, 0.0), share)


@compiled_inside
def _follow_course(attitude: Attitude, courses: Courses, fix: Fix, c: Coefficients) -> tuple[Attitude, Courses, bool]:
    """Turn towards the course of one fix; False where the fix does not count."""
    since_s, in_row, n_used, n_left_out = courses
    east, north, _ = rotate(attitude.q_nb, (1.0, 0.0, 0.0))
    is_steep = east * east + north * north < _STEEP
    course_rad, speed_mps = like(since_s, fix.course_rad), like(since_s, fix.speed_mps)
    counts = attitude.is_level and not is_steep and abs(course_rad) < 1e3
    if not (counts and speed_mps >= c.least_speed_mps):
        return attitude, Courses(since_s, in_row, n_used, n_left_out + 1), False
    behind = course_rad + c.mounting_yaw_rad - atan2(east, north)
    error_n = (0.0, 0.0, -atan2(sin(behind), cos(behind)))
    share = (
        _correction_gains(since_s, since_s * like(since_s, in_row + 1), c.course_time_s) if in_row > 0 else (1.0, 0.0)
    )
    return _correct_attitude(attitude, error_n, share), Courses(0.0, in_row + 1, n_used + 1, n_left_out), True


@compiled_inside
def step(state: State, sample: Sample, fix: Fix, has_fix: bool, c: Coefficients | None) -> tuple[State, Sample]:
    """Return the sample that the estimator gets in place of this one; None keeps the magnetometer as it is.

    numba leaves out what follows a None that it knows of: without courses nothing of it is compiled.
    """
    if c is None:
        return state, sample
    dt_s, gyro, accel, mag, has_accel, has_mag, hidden = sample
    attitude, (since_s, in_row, n_used, n_left_out) = _follow_gravity(state.attitude, sample, c), state.courses
    since_s += dt_s
    if since_s > c.longest_age_s or dt_s > GAP_S:
        in_row = 0
    courses, is_new = Courses(since_s, in_row, n_used, n_left_out), False
    if has_fix:
        attitude, courses, is_new = _follow_course(attitude, courses, fix, c)
    calibration, since_mag_s = state.calibration, state.since_mag_s + dt_s
    n_by_course, n_corrected = state.n_mag_by_course, state.n_mag_corrected
    is_field = has_mag and dot(mag, mag) > 0
    if courses.in_row >= _FIXES_TO_SETTLE:
        if is_field:
            calibration = learn_field(
                begin_calibration(calibration, attitude.q_nb, mag, c.prior), attitude.q_nb, mag, since_mag_s, c.prior
            )
        if is_field or (is_new and (not calibration.is_begun or since_mag_s > c.longest_age_s)):
            has_mag = True
            mag = predict_field(calibration, attitude.q_nb, c.prior)
            n_by_course += 1
    elif is_field and calibration.is_begun:
        mag = correct_field(calibration, attitude.q_nb, mag, c.prior)
        n_corrected += 1
    if is_field:
        since_mag_s = 0.0
    if c.removes_bias:
        gyro = add(gyro, scale(attitude.bias_b_radps, -1.0))
    state = State(attitude, courses, calibration, since_mag_s, n_by_course, n_corrected)
    return state, Sample(dt_s, gyro, accel, mag, has_accel, has_mag, hidden)
