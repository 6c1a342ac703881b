"""Choose the sources of a run besides its IMU: the magnetometer, satellite fixes, and the north that these define."""

from collections.abc import Mapping
from dataclasses import asdict
from math import degrees, pi
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets import BadParameter, BadRecording, Gps, Imu, Mag, Recording
from stillpoint.datasets.earth import local_declination
from stillpoint.datasets.errors import require_known
from stillpoint.datasets.recording import Times
from stillpoint.datasets.settings import Settings, choose_settings
from stillpoint.filters.front import front, guard, heading_source
from stillpoint.filters.front.front import RawLog
from stillpoint.filters.front.heading_source import HEADINGS, Heading
from stillpoint.filters.precision import Precision, to_precision
from stillpoint.filters.sample import Log, collect_counts


class Sources(NamedTuple):
    """The streams that a run uses, and facts about them for the diagnostics."""

    mag: Mag | None
    gps: Gps | None
    declination_rad: float  # east of true north; 0 where it is not known
    front: front.Coefficients
    facts: dict[str, Any]


def make_front(
    heading: Heading,
    heading_params: Settings | Mapping[str, Any] | None,
    ranges: Settings | Mapping[str, Any] | None,
    declination_rad: float | None,
) -> front.Coefficients:
    """Return the constants of the stages in front of an estimator; a declination of None is not known."""
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


def record_choices(
    heading: Heading, heading_params: Settings | Mapping[str, Any] | None, ranges: Settings | Mapping[str, Any] | None
) -> dict[str, Any]:
    """Return what was asked of the stages in front, as diagnostics: ``{"asked": …}``, or nothing where all is default.

    Every setting is written out, so that a later version with other defaults can make the same estimate.
    """
    full_scales = choose_settings(guard.Ranges(), ranges, "range")
    if heading == "mag":
        return {} if full_scales == guard.Ranges() else {"asked": {"heading": heading, "ranges": asdict(full_scales)}}
    by_course = choose_settings(heading_source.Params(), heading_params, "heading")
    return {"asked": {"heading": heading, "heading_params": asdict(by_course), "ranges": asdict(full_scales)}}


def find_sources(
    recording: Recording,
    heading: Heading,
    heading_params: Settings | Mapping[str, Any] | None,
    ranges: Settings | Mapping[str, Any] | None,
) -> Sources:
    """Return the streams to use, and the constants of the stages in front of the estimator.

    A magnetometer that is not calibrated is not used: a hard iron of the field's size or more makes every heading
    wrong. Raises :class:`BadParameter`, and :class:`BadRecording` for a course without fixes.
    """
    mag, declination_rad, facts = choose_magnetometer(recording)
    is_true = facts["heading"].startswith("true north")
    coefficients = make_front(heading, heading_params, ranges, declination_rad if is_true else None)
    if coefficients.heading is None:
        return Sources(mag, None, declination_rad, coefficients, facts)
    if recording.gps is None:
        raise BadRecording(f"{recording.name}: has no satellite fixes (gps) to take a course from; use heading mag")
    least_mps = coefficients.heading.least_speed_mps
    otherwise = "the gyro alone" if mag is None else "the magnetometer, calibrated by them"
    words = f"true north: gps course while fixes are valid and over {least_mps:g} m/s, otherwise {otherwise}"
    return Sources(mag, recording.gps, declination_rad, coefficients, facts | {"heading": words})


def choose_magnetometer(recording: Recording) -> tuple[Mag | None, float, dict[str, Any]]:
    """Return the magnetometer to use, the declination (rad, east positive), and facts about both."""
    facts: dict[str, Any] = {"declination_rad": 0.0}
    if recording.mag is None:
        return None, 0.0, facts | {"heading": "arbitrary: there is no magnetometer"}
    if recording.info.mag_uncalibrated:
        facts["n_mag_uncalibrated"] = len(recording.mag.t_ns)
        return None, 0.0, facts | {"heading": "arbitrary: the magnetometer is not calibrated"}
    declination_rad, heading = local_declination(recording.info)
    return recording.mag, declination_rad, {"declination_rad": declination_rad, "heading": heading}


def prepare_log(imu: Imu, sources: Sources, precision: Precision) -> tuple[Log, dict[str, Any]]:
    """Return the samples that the estimator gets of a recording, and the diagnostics of the stages in front of it."""
    raw, facts = make_raw_log(imu, sources)
    c = to_precision(sources.front, precision)
    state, log = front.filter_log(to_precision(raw, precision), to_precision(front.start(c), precision), c)
    return log, facts | collect_counts(state) | sources.facts | _report_calibration(state.heading)


def make_raw_log(imu: Imu, sources: Sources) -> tuple[RawLog, dict[str, Any]]:
    """Return the samples in the order in which a stream brings them, and how many fields and fixes are never used."""
    mag, gps = sources.mag, sources.gps
    fields, course_rad, speed_mps = np.zeros((1, 3)), np.zeros(1), np.zeros(1)
    facts: dict[str, Any] = {}
    mag_row = fix_row = np.full(len(imu.t_ns), -1, dtype=np.int64)
    if mag is not None:
        fields, mag_row = mag.mag_b_ut.copy(), newest_rows(mag.t_ns, imu.t_ns)
        facts["n_mag_unused"] = len(mag.t_ns) - int((mag_row >= 0).sum())
    if gps is not None:
        course_rad, speed_mps = np.where(gps.valid, gps.course_rad, np.nan), gps.speed_mps.copy()
        fix_row = newest_rows(gps.t_ns, imu.t_ns)
        facts["n_fix_unused"] = len(gps.t_ns) - int((fix_row >= 0).sum())
    columns = (imu.t_ns.copy(), imu.gyro_b_radps.copy(), imu.accel_b_mps2.copy())  # writable: one compiled type for all
    return RawLog(*columns, fields, mag_row, course_rad, speed_mps, fix_row), facts


def newest_rows(t_ns: Times, at_ns: Times) -> NDArray[np.int64]:
    """Return the row of the newest sample at each of the stamps ``at_ns``, -1 where the stamp before had it already."""
    rows = np.searchsorted(t_ns, at_ns, side="right") - 1
    return np.where(np.diff(rows, prepend=-1) > 0, rows, -1).astype(np.int64)


def _report_calibration(state: heading_source.State) -> dict[str, Any]:
    """Return what a run with courses learnt about the magnetometer; empty without courses."""
    calibration = state.calibration
    if not calibration.is_begun:
        return {}
    sd_ut = np.sqrt(np.diagonal(calibration.cov_ut2)[3:])
    return {
        "hard_iron_b_ut": [float(h) for h in calibration.x_ut[3:]],
        "hard_iron_sd_ut": [float(sd) for sd in sd_ut],
        "field_n_ut": [float(f) for f in calibration.x_ut[:3]],
    }
