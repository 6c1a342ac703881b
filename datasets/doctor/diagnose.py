"""Run the tests in order. Each fault is corrected before the next test, so that one fault gives one finding."""

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from stillpoint.datasets.doctor.clocks import check_clocks, check_losses
from stillpoint.datasets.doctor.conventions import TruthFits, check_truth_mismatch, turn_truth
from stillpoint.datasets.doctor.field import check_base_pose, check_field, compute_base_pose_cosine, find_dips
from stillpoint.datasets.doctor.finding import Diagnosis, Finding
from stillpoint.datasets.doctor.hypotheses import (
    Verdict,
    compare_hypotheses,
    find_scale_fault,
    report_axes_faults,
    report_tested_axes,
)
from stillpoint.datasets.doctor.lag import Lag, check_lags
from stillpoint.datasets.doctor.noise import check_noise
from stillpoint.datasets.doctor.remedy import apply
from stillpoint.datasets.doctor.spin import check_spin
from stillpoint.datasets.doctor.truth import ask_truth, check_slips, check_truth_values, find_accel_lag
from stillpoint.datasets.doctor.units import check_field_unit, check_gravity, check_gyro_size
from stillpoint.datasets.doctor.values import check_steps, check_values
from stillpoint.datasets.doctor.witness import Witness, ask_accel, ask_mag, find_lag_by_gravity
from stillpoint.datasets.recording import Floats, Imu, Mag, Recording, Times

_MOST_FAULTS = 6  # of axes and scales in one recording
_UNUSABLE = ("gyro-stuck", "accel-stuck", "imu-short")  # nothing about motion can be tested after these


def diagnose(recording: Recording, rests_ns: Times) -> Diagnosis:
    """Test a recording by physics.

    ``rests_ns`` (R, 2) int64: first and last stamp of each rest; R may be 0. A recording whose units are in doubt is
    opened with ``units_unchecked``. The recording is not changed: see :func:`~stillpoint.datasets.doctor.apply`.
    """
    case = _Case(recording, np.asarray(rests_ns, dtype=np.int64).reshape(-1, 2))
    case.run_test(check_losses)
    case.run_test(check_clocks)
    case.run_test(check_values)
    case.run_test(check_spin)
    if recording.imu is None:
        return case.make_diagnosis()
    if any(finding.code in _UNUSABLE for finding in case.findings):
        case.add_findings(
            [Finding("motion-not-tested", "fact", "axes, lags and field: not tested, as a sensor is unusable")]
        )
        return case.make_diagnosis()
    case.run_test(check_truth_values)
    case.run_test(check_gyro_size)
    case.run_test(lambda now: check_gravity(now, case.rests_ns))
    witnesses, lag_by_truth = _settle_axes(case)
    mag = next((one for one in witnesses if one.name == "mag" and one.choice is not None), None)
    if case.now.mag is not None:
        iron = mag.hard_iron_b_ut if mag is not None and mag.choice is not None and all(mag.choice.tested) else None
        unit = check_field_unit(case.now, iron)
        case.add_findings(unit)
        mag = _convert_iron(mag, unit)
    case.add_findings(report_tested_axes(witnesses))
    lag_by_gravity = None if lag_by_truth is not None else _find_accel_lag(case, witnesses)
    lags = {one.name: one.lag for one in witnesses if one.choice is not None}
    case.add_findings(check_lags(case.now, lags.get("truth"), lag_by_truth, lag_by_gravity, lags.get("mag")))
    case.run_test(lambda now: check_base_pose(now, case.rests_ns))
    if case.now.mag is not None:
        case.run_test(lambda now: check_field(now, mag, case.rests_ns))
    case.run_test(check_steps)
    case.run_test(lambda now: check_noise(now, case.rests_ns, witnesses))
    return case.make_diagnosis()


class _Case:
    """The recording as corrected so far, and the findings so far."""

    def __init__(self, recording: Recording, rests_ns: Times) -> None:
        self.now, self.rests_ns = recording, rests_ns
        self.findings: list[Finding] = []

    def run_test(self, test: Callable[[Recording], Iterable[Finding]]) -> None:
        """Run a test on the recording as the remedies so far leave it."""
        self.add_findings(test(self.now))

    def add_findings(self, findings: Iterable[Finding]) -> None:
        """Keep findings, and apply their remedies to the recording that later tests see."""
        new = list(findings)
        self.findings += new
        remedies = [finding.remedy for finding in new if finding.remedy is not None]
        self.now = apply(self.now, remedies) if remedies else self.now

    def make_diagnosis(self) -> Diagnosis:
        return Diagnosis(self.now.name, tuple(self.findings))


def _settle_axes(case: _Case) -> tuple[list[Witness], Lag | None]:
    """Compare the hypotheses, correct the faults of the best one, and repeat until it has none.

    Returns what the sensors say of the gyro, and the lag of the accelerometer by the positions of the truth.
    """
    asked: tuple[Imu | None, Mag | None] = (None, None)
    of_sensors: list[Witness] = []
    for _ in range(_MOST_FAULTS):
        imu = case.now.require_imu()
        if asked[0] is not imu or asked[1] is not case.now.mag:  # a remedy of the truth changes neither
            asked, of_sensors = (imu, case.now.mag), _ask_sensors(case)
        witnesses = list(of_sensors)
        fits = None if case.now.truth is None else TruthFits(imu, case.now.truth)
        mag = next((one for one in witnesses if one.name == "mag"), None)
        dips = find_dips(case.now, case.rests_ns, mag)
        verdict = compare_hypotheses(witnesses, dips, compute_base_pose_cosine(case.now, case.rests_ns), fits)
        if case.now.truth is not None and fits is not None:
            view = verdict.best.view
            truth = case.now.truth if view is None else view.correct(case.now.truth)
            witnesses.append(ask_truth(imu, truth) if view is not None else Witness("truth", None))
        scale = find_scale_fault(witnesses)
        faults = [] if scale is None else [scale]
        if scale is None or scale.remedy is None:
            faults += report_axes_faults(verdict, witnesses)
        if scale is None and fits is not None and case.now.truth is not None and not fits.informative:
            confirmed = verdict.best.changes_nothing and any(one.choice is not None for one in witnesses)
            faults = check_truth_mismatch(fits, case.now.truth, confirmed) + faults
        mended = [one for one in faults if one.remedy is not None]
        case.add_findings(mended or faults)  # faults without a remedy are reported last, after all others are corrected
        if not mended:
            break
    return witnesses, _compare_truth(case, verdict, witnesses)


def _ask_sensors(case: _Case) -> list[Witness]:
    """Return what the accelerometer and, where there is one, the magnetometer say of the gyro."""
    imu = case.now.require_imu()
    witnesses = [] if case.now.mag is None else [ask_mag(imu, case.now.mag)]
    return [ask_accel(imu, _find_bias(imu, case.rests_ns, witnesses)), *witnesses]


def _compare_truth(case: _Case, verdict: Verdict, witnesses: list[Witness]) -> Lag | None:
    """Look for slips, and return the lag of the accelerometer; the truth is turned to the IMU's body for the tests."""
    view, truth = verdict.best.view, case.now.truth
    if truth is None or view is None:
        return None
    imu, turned = case.now.require_imu(), turn_truth(truth, view)
    gyro = next(one for one in witnesses if one.name == "truth")
    if gyro.choice is not None:
        case.add_findings(check_slips(imu, turned, gyro.lag.lag_s if gyro.lag is not None else 0.0))
    return None if view.wrong or verdict.best.fault.corrections else find_accel_lag(imu, turned)


def _convert_iron(mag: Witness | None, findings: list[Finding]) -> Witness | None:
    """Convert the hard iron, which was found in the unit before the remedy."""
    for finding in findings:
        scaled = finding.remedy is not None and finding.remedy.kind == "matrix"
        if scaled and finding.remedy is not None and mag is not None and mag.hard_iron_b_ut is not None:
            mag = replace(mag, hard_iron_b_ut=finding.remedy.values[0] * mag.hard_iron_b_ut)
    return mag


def _find_accel_lag(case: _Case, witnesses: list[Witness]) -> Lag | None:
    """Return how late the accelerometer is against the gyro; None where its axes or its scale are not known."""
    accel = next((one for one in witnesses if one.name == "accel" and one.choice is not None), None)
    if accel is None or accel.choice is None or accel.scale is None:
        return None
    imu = case.now.require_imu()
    return find_lag_by_gravity(imu, _find_bias(imu, case.rests_ns, witnesses), accel.scale * accel.choice.matrix)


def _find_bias(imu: Imu, rests_ns: Times, witnesses: list[Witness]) -> Floats:
    """Return the best estimate of the gyro's bias before its axes are known."""
    if len(rests_ns):
        first, last = np.searchsorted(imu.t_ns, rests_ns[0])
        return np.asarray(imu.gyro_b_radps[first : last + 1].mean(axis=0))
    for one in witnesses:
        if one.gyro_bias_b_radps is not None:
            return one.gyro_bias_b_radps
    return np.zeros(3)
