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
from stillpoint.datasets.recording import Floats, Head, Times
from stillpoint.datasets.settings import Settings, choose_settings
from stillpoint.filters.front import front, guard, heading_source
from stillpoint.filters.front.front import RawLog
from stillpoint.filters.front.heading_source import HEADINGS, Heading
from stillpoint.filters.precision import Precision, to_precision
from stillpoint.filters.sample import Log, collect_counts


class Plan(NamedTuple):
    """Which streams a run uses besides its IMU, and facts about them for the diagnostics."""

    uses_mag: bool
    uses_gps: bool
    declination_rad: float  # east of true north; 0 where it is not known
    front: front.Coefficients
    facts: dict[str, Any]


class Sources(NamedTuple):
    """The streams that a run uses, and the plan by which they were chosen."""

    mag: Mag | None
    gps: Gps | None
    plan: Plan


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
    """Return the streams of a recording to use, chosen by :func:`plan_sources`."""
    plan = plan_sources(recording.head, heading, heading_params, ranges)
    return Sources(recording.mag if plan.uses_mag else None, recording.gps if plan.uses_gps else None, plan)


def plan_sources(
    head: Head,
    heading: Heading,
    heading_params: Settings | Mapping[str, Any] | None,
    ranges: Settings | Mapping[str, Any] | None,
) -> Plan:
    """Return which streams to use, and the constants of the stages in front of the estimator.

    A magnetometer that is not calibrated is not used: a hard iron of the field's size or more makes every heading
    wrong. Raises :class:`BadParameter`, and :class:`BadRecording` for a course without fixes.
    """
    uses_mag, declination_rad, facts = plan_heading(head)
    is_true = facts["heading"].startswith("true north")
    coefficients = make_front(heading, heading_params, ranges, declination_rad if is_true else None)
    if coefficients.heading is None:
        return Plan(uses_mag, False, declination_rad, coefficients, facts)
    if "gps" not in head.samples:
        raise BadRecording(f"{head.name}: has no satellite fixes (gps) to take a course from; use heading mag")
    least_mps = coefficients.heading.least_speed_mps
    otherwise = "the magnetometer, calibrated by them" if uses_mag else "the gyro alone"
    words = f"true north: gps course while fixes are valid and over {least_mps:g} m/s, otherwise {otherwise}"
    return Plan(uses_mag, True, declination_rad, coefficients, facts | {"heading": words})


def choose_magnetometer(recording: Recording) -> tuple[Mag | None, float, dict[str, Any]]:
    """Return the magnetometer to use, the declination (rad, east positive), and facts about both."""
    uses_mag, declination_rad, facts = plan_heading(recording.head)
    return recording.mag if uses_mag else None, declination_rad, facts


def plan_heading(head: Head) -> tuple[bool, float, dict[str, Any]]:
    """Return whether to use the magnetometer, the declination (rad, east positive), and facts about both."""
    facts: dict[str, Any] = {"declination_rad": 0.0}
    if "mag" not in head.samples:
        return False, 0.0, facts | {"heading": "arbitrary: there is no magnetometer"}
    if head.info.mag_uncalibrated:
        facts["n_mag_uncalibrated"] = head.samples["mag"]
        return False, 0.0, facts | {"heading": "arbitrary: the magnetometer is not calibrated"}
    declination_rad, heading = local_declination(head.info)
    return True, declination_rad, {"declination_rad": declination_rad, "heading": heading}


class FrontRun:
    """The stages in front of an estimator, run over a recording piece by piece."""

    def __init__(self, plan: Plan, precision: Precision) -> None:
        self._plan, self._precision = plan, precision
        self._c = to_precision(plan.front, precision)
        self._state = to_precision(front.start(self._c), precision)
        self._raw = RawLogs(plan.uses_mag, plan.uses_gps)

    def add(self, imu: Imu, mag: Mag | None, gps: Gps | None) -> Log:
        """Return the samples that the estimator gets of the next piece."""
        raw = to_precision(self._raw.add(imu, mag, gps), self._precision)
        state, log = front.filter_log(raw, self._state, self._c)
        self._state = to_precision(state, self._precision)  # compiled code returns Python's floats
        return log

    def skip(self, mag: Mag | None, gps: Gps | None) -> None:
        """Keep the fields and fixes of a piece without an IMU sample."""
        self._raw.keep(mag, gps)

    def report(self) -> dict[str, Any]:
        """Return the diagnostics of the stages after the last piece."""
        counted = self._raw.count_unused() | collect_counts(self._state)
        return counted | self._plan.facts | _report_calibration(self._state.heading)


def prepare_log(imu: Imu, sources: Sources, precision: Precision) -> tuple[Log, dict[str, Any]]:
    """Return the samples that the estimator gets of a recording, and the diagnostics of the stages in front of it."""
    run = FrontRun(sources.plan, precision)
    log = run.add(imu, sources.mag, sources.gps)
    return log, run.report()


def make_raw_log(imu: Imu, sources: Sources) -> tuple[RawLog, dict[str, Any]]:
    """Return the samples in the order in which a stream brings them, and how many fields and fixes are never used."""
    logs = RawLogs(sources.plan.uses_mag, sources.plan.uses_gps)
    return logs.add(imu, sources.mag, sources.gps), logs.count_unused()


class RawLogs:
    """Makes the log of each piece; fields and fixes after the last IMU sample of a piece wait for the next."""

    def __init__(self, uses_mag: bool, uses_gps: bool) -> None:
        self._fields = _Waiting(3) if uses_mag else None
        self._fixes = _Waiting(2) if uses_gps else None

    def add(self, imu: Imu, mag: Mag | None, gps: Gps | None) -> RawLog:
        """Return the samples of the next piece, in the order in which a stream brings them."""
        self.keep(mag, gps)
        none = np.full(len(imu.t_ns), -1, dtype=np.int64)
        field, mag_row = (np.zeros((1, 3)), none) if self._fields is None else self._fields.take(imu.t_ns)
        fix, fix_row = (np.zeros((1, 2)), none) if self._fixes is None else self._fixes.take(imu.t_ns)
        course_rad, speed_mps = np.ascontiguousarray(fix.T)
        columns = (imu.t_ns.copy(), imu.gyro_b_radps.copy(), imu.accel_b_mps2.copy())  # writable: one compiled type
        return RawLog(*columns, field, mag_row, course_rad, speed_mps, fix_row)

    def keep(self, mag: Mag | None, gps: Gps | None) -> None:
        """Keep fields and fixes for the IMU samples to come."""
        if self._fields is not None and mag is not None:
            self._fields.add(mag.t_ns, mag.mag_b_ut)
        if self._fixes is not None and gps is not None:
            course_rad = np.where(gps.valid, gps.course_rad, np.nan)
            self._fixes.add(gps.t_ns, np.stack([course_rad, gps.speed_mps], axis=1))

    def count_unused(self) -> dict[str, int]:
        """Return how many fields and fixes no sample brought: a newer one came before the next IMU sample."""
        named = {"n_mag_unused": self._fields, "n_fix_unused": self._fixes}
        return {name: waiting.n_given - waiting.n_used for name, waiting in named.items() if waiting is not None}


class _Waiting:
    """The rows of a slow stream that no IMU sample has brought yet."""

    def __init__(self, width: int) -> None:
        self._t_ns, self._rows = np.empty(0, np.int64), np.empty((0, width))
        self.n_given = self.n_used = 0

    def add(self, t_ns: Times, rows: Floats) -> None:
        """Add rows, which come after those before."""
        self._t_ns, self._rows = np.concatenate([self._t_ns, t_ns]), np.concatenate([self._rows, rows])
        self.n_given += len(t_ns)

    def take(self, at_ns: Times) -> tuple[Floats, NDArray[np.int64]]:
        """Return rows (M, width), M >= 1, and which of them each IMU stamp brings, -1 for none."""
        t_ns, rows = self._t_ns, self._rows
        brought = newest_rows(t_ns, at_ns)
        self.n_used += int((brought >= 0).sum())
        had = int(np.searchsorted(t_ns, at_ns[-1], side="right"))
        self._t_ns, self._rows = t_ns[had:].copy(), rows[had:].copy()
        return (rows if len(rows) else np.zeros((1, rows.shape[1]))), brought


def newest_rows(t_ns: Times, at_ns: Times) -> NDArray[np.int64]:
    """Return the row of the newest sample at each of the stamps ``at_ns``, -1 where the stamp before had it already."""
    rows = np.full(len(at_ns) + 1, -1, np.int64)
    rows[np.searchsorted(at_ns, t_ns)] = np.arange(len(t_ns))  # of several before one stamp, the newest is the last
    return rows[:-1]


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
