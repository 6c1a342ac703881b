"""The tests in their order. What a test finds is put right before the next one, so that one fault gives one finding."""

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from stillpoint.datasets.doctor.axes import find_axes_fault, find_scale_fault, find_truth_fault, report_axes
from stillpoint.datasets.doctor.clocks import check_clocks
from stillpoint.datasets.doctor.field import check_field, check_gravity_sign
from stillpoint.datasets.doctor.finding import Diagnosis, Finding
from stillpoint.datasets.doctor.lag import Lag
from stillpoint.datasets.doctor.lags import check_lags
from stillpoint.datasets.doctor.noise import check_noise
from stillpoint.datasets.doctor.remedy import apply
from stillpoint.datasets.doctor.sizes import check_field_unit, check_gravity, check_gyro_size
from stillpoint.datasets.doctor.spin import check_spin
from stillpoint.datasets.doctor.truth import accel_against_truth, ask_truth
from stillpoint.datasets.doctor.values import check_steps, check_values
from stillpoint.datasets.doctor.whole import check_whole
from stillpoint.datasets.doctor.witness import Witness, accel_lag, ask_accel, ask_mag
from stillpoint.datasets.recording import Floats, Imu, Recording, Times

MOST_FAULTS = 6  # of axes and scales in one recording
UNUSABLE = ("gyro-stuck", "accel-stuck", "imu-short")  # nothing about motion can be tested after these


def diagnose(recording: Recording, rests_ns: Times) -> Diagnosis:
    """Test a recording by physics.

    ``rests_ns`` (R, 2) int64: first and last stamp of each rest; R may be 0. A recording whose units are in doubt is
    opened with ``units_unchecked``. The recording is not changed: see :func:`~stillpoint.datasets.doctor.apply`.
    """
    case = _Case(recording, np.asarray(rests_ns, dtype=np.int64).reshape(-1, 2))
    case.run(check_whole)
    case.run(check_clocks)
    case.run(check_values)
    case.run(check_spin)
    if recording.imu is None:
        return case.diagnosis()
    if any(finding.code in UNUSABLE for finding in case.findings):
        case.found([Finding("motion-not-tested", "fact", "axes, lags and field: not tested, as a sensor is unusable")])
        return case.diagnosis()
    case.run(check_gyro_size)
    case.run(lambda now: check_gravity(now, case.rests_ns))
    witnesses, by_truth = _settle_axes(case)
    mag = next((one for one in witnesses if one.name == "mag" and one.choice is not None), None)
    if case.now.mag is not None:
        iron = mag.hard_iron_b_ut if mag is not None and mag.choice is not None and all(mag.choice.tested) else None
        unit = check_field_unit(case.now, iron)
        case.found(unit)
        mag = _in_new_unit(mag, unit)
    case.found(report_axes(witnesses))
    by_gravity = None if by_truth is not None else _accel_lag(case, witnesses)
    case.found(check_lags(case.now, witnesses, by_truth, by_gravity))
    case.run(lambda now: check_gravity_sign(now, case.rests_ns))
    if case.now.mag is not None:
        case.run(lambda now: check_field(now, mag))
    case.run(check_steps)
    case.run(lambda now: check_noise(now, case.rests_ns, witnesses))
    return case.diagnosis()


class _Case:
    """The recording as far as it has been put right, and the findings so far."""

    def __init__(self, recording: Recording, rests_ns: Times) -> None:
        self.now, self.rests_ns = recording, rests_ns
        self.findings: list[Finding] = []

    def run(self, test: Callable[[Recording], Iterable[Finding]]) -> None:
        self.found(test(self.now))

    def found(self, findings: Iterable[Finding]) -> None:
        new = list(findings)
        self.findings += new
        remedies = [finding.remedy for finding in new if finding.remedy is not None]
        self.now = apply(self.now, remedies) if remedies else self.now

    def diagnosis(self) -> Diagnosis:
        return Diagnosis(self.now.name, tuple(self.findings))


def _settle_axes(case: _Case) -> tuple[list[Witness], Lag | None]:
    """Ask the witnesses, put the first fault right, and ask again until there is none."""
    for _ in range(MOST_FAULTS):
        witnesses, accel_by_truth, lag_by_truth = _ask(case.now, case.rests_ns)
        truth = next((one for one in witnesses if one.name == "truth"), None)
        fault = None if truth is None else find_truth_fault(case.now, truth)
        fault = fault or find_scale_fault(witnesses) or find_axes_fault(witnesses, accel_by_truth)
        if fault is None:
            break
        case.found([fault])
        if fault.remedy is None:
            break
    return witnesses, lag_by_truth


def _in_new_unit(mag: Witness | None, findings: list[Finding]) -> Witness | None:
    """The hard iron was found in the unit before the remedy."""
    for finding in findings:
        scaled = finding.remedy is not None and finding.remedy.kind == "matrix"
        if scaled and finding.remedy is not None and mag is not None and mag.hard_iron_b_ut is not None:
            mag = replace(mag, hard_iron_b_ut=finding.remedy.values[0] * mag.hard_iron_b_ut)
    return mag


def _ask(recording: Recording, rests_ns: Times) -> tuple[list[Witness], Floats | None, Lag | None]:
    imu = recording.require_imu()
    witnesses = [] if recording.mag is None else [ask_mag(imu, recording.mag)]
    witnesses.insert(0, ask_accel(imu, _bias(imu, rests_ns, witnesses)))
    if recording.truth is None:
        return witnesses, None, None
    witnesses.append(ask_truth(imu, recording.truth))
    return witnesses, *accel_against_truth(imu, recording.truth)


def _accel_lag(case: _Case, witnesses: list[Witness]) -> Lag | None:
    accel = next((one for one in witnesses if one.name == "accel" and one.choice is not None), None)
    if accel is None or accel.choice is None or accel.scale is None:
        return None
    imu = case.now.require_imu()
    return accel_lag(imu, _bias(imu, case.rests_ns, witnesses), accel.scale * accel.choice.matrix)


def _bias(imu: Imu, rests_ns: Times, witnesses: list[Witness]) -> Floats:
    """The gyro's bias as well as it is known before the axes are."""
    if len(rests_ns):
        first, last = np.searchsorted(imu.t_ns, rests_ns[0])
        return np.asarray(imu.gyro_b_radps[first : last + 1].mean(axis=0))
    for one in witnesses:
        if one.gyro_bias_b_radps is not None:
            return one.gyro_bias_b_radps
    return np.zeros(3)
