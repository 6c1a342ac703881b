"""What a recording brings to a run besides its IMU: the magnetometer, satellite fixes, and which north that gives."""

from collections.abc import Mapping
from math import degrees, pi
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets import BadParameter, BadRecording, Gps, Imu, Mag, Recording
from stillpoint.datasets.earth import local_declination
from stillpoint.datasets.nearest import require_known
from stillpoint.datasets.recording import Times
from stillpoint.datasets.settings import Settings, choose_settings
from stillpoint.filters.front import front, guard, heading_source
from stillpoint.filters.front.front import RawLog
from stillpoint.filters.front.heading_source import HEADINGS, Heading
from stillpoint.filters.precision import Precision, in_precision
from stillpoint.filters.sample import Log, counts


class Sources(NamedTuple):
    """What a run goes by, and words about it for the diagnostics."""

    mag: Mag | None
    gps: Gps | None
    declination_rad: float  # east of true north; 0 where it is not known
    front: front.Coefficients
    facts: dict[str, Any]


def front_of(
    heading: Heading,
    heading_params: Settings | Mapping[str, Any] | None,
    ranges: Settings | Mapping[str, Any] | None,
    declination_rad: float | None,
) -> front.Coefficients:
    """What stands in front of an estimator; a declination of None is not known. Raises :class:`BadParameter`."""
    require_known(heading, HEADINGS, "heading")
    if declination_rad is not None and not abs(declination_rad) <= pi:  # nor where it is no number
        raise BadParameter(f"declination {degrees(declination_rad):g} deg: give an angle within +-180 deg")
    if heading == "mag" and heading_params:
        raise BadParameter("heading mag has no settings; they are those of heading gps-course")
    full_scales = guard.coefficients(choose_settings(guard.Ranges(), ranges, "range"))
    if heading == "mag":
        return front.Coefficients(full_scales, None)
    by_course = choose_settings(heading_source.Params(), heading_params, "heading")
    return front.Coefficients(full_scales, heading_source.coefficients(by_course, declination_rad))


def sources_of(
    recording: Recording,
    heading: Heading,
    heading_params: Settings | Mapping[str, Any] | None,
    ranges: Settings | Mapping[str, Any] | None,
) -> Sources:
    """The streams to use, and what is in front of the estimator.

    A magnetometer that is not calibrated is not used: a hard iron of the field's size or more makes every heading
    wrong. Raises :class:`BadParameter`, and :class:`BadRecording` for a course without fixes.
    """
    mag, declination_rad, facts = magnetometer(recording)
    is_true = facts["heading"].startswith("true north")
    coefficients = front_of(heading, heading_params, ranges, declination_rad if is_true else None)
    if coefficients.heading is None:
        return Sources(mag, None, declination_rad, coefficients, facts)
    if recording.gps is None:
        raise BadRecording(f"{recording.name}: has no satellite fixes (gps) to take a course from; use heading mag")
    least_mps = coefficients.heading.least_speed_mps
    otherwise = "the gyro alone" if mag is None else "the magnetometer, calibrated by them"
    words = f"true north: gps course while fixes are valid and over {least_mps:g} m/s, otherwise {otherwise}"
    return Sources(mag, recording.gps, declination_rad, coefficients, facts | {"heading": words})


def magnetometer(recording: Recording) -> tuple[Mag | None, float, dict[str, Any]]:
    """The magnetometer to use, if there is one, the declination (rad, east positive), and words about both."""
    facts: dict[str, Any] = {"declination_rad": 0.0}
    if recording.mag is None:
        return None, 0.0, facts | {"heading": "arbitrary: there is no magnetometer"}
    if recording.info.mag_uncalibrated:
        facts["n_mag_uncalibrated"] = len(recording.mag.t_ns)
        return None, 0.0, facts | {"heading": "arbitrary: the magnetometer is not calibrated"}
    declination_rad, heading = local_declination(recording.info)
    return recording.mag, declination_rad, {"declination_rad": declination_rad, "heading": heading}


def passed(imu: Imu, sources: Sources, precision: Precision) -> tuple[Log, dict[str, Any]]:
    """What the estimator gets of a recording, and the diagnostics of what stands in front of it."""
    raw, facts = as_raw_log(imu, sources)
    c = in_precision(sources.front, precision)
    state, log = front.run(in_precision(raw, precision), in_precision(front.start(c), precision), c)
    return log, facts | counts(state) | sources.facts | learnt(state.heading)


def as_raw_log(imu: Imu, sources: Sources) -> tuple[RawLog, dict[str, Any]]:
    """The samples in the order in which a stream would bring them, and how many fields and fixes never get a turn."""
    mag, gps = sources.mag, sources.gps
    fields, course_rad, speed_mps = np.zeros((1, 3)), np.zeros(1), np.zeros(1)
    facts: dict[str, Any] = {}
    mag_row = fix_row = np.full(len(imu.t_ns), -1, dtype=np.int64)
    if mag is not None:
        fields, mag_row = mag.mag_b_ut.copy(), newest(mag.t_ns, imu.t_ns)
        facts["n_mag_unused"] = len(mag.t_ns) - int((mag_row >= 0).sum())
    if gps is not None:
        course_rad, speed_mps = np.where(gps.valid, gps.course_rad, np.nan), gps.speed_mps.copy()
        fix_row = newest(gps.t_ns, imu.t_ns)
        facts["n_fix_unused"] = len(gps.t_ns) - int((fix_row >= 0).sum())
    columns = (imu.t_ns.copy(), imu.gyro_b_radps.copy(), imu.accel_b_mps2.copy())  # writable: one compiled type for all
    return RawLog(*columns, fields, mag_row, course_rad, speed_mps, fix_row), facts


def newest(t_ns: Times, at_ns: Times) -> NDArray[np.int64]:
    """At each of the stamps ``at_ns`` the row of the newest sample, -1 where the stamp before had it already."""
    rows = np.searchsorted(t_ns, at_ns, side="right") - 1
    return np.where(np.diff(rows, prepend=-1) > 0, rows, -1).astype(np.int64)


def learnt(state: heading_source.State) -> dict[str, Any]:
    """What a run with courses found out about the magnetometer; empty without."""
    calibration = state.calibration
    if not calibration.is_begun:
        return {}
    sd_ut = np.sqrt(np.diagonal(calibration.cov_ut2)[3:])
    return {
        "hard_iron_b_ut": [float(h) for h in calibration.x_ut[3:]],
        "hard_iron_sd_ut": [float(sd) for sd in sd_ut],
        "field_n_ut": [float(f) for f in calibration.x_ut[:3]],
    }
