"""``method="graph"``: the attitude of a moving IMU from one calibrating factor graph.

    gather   rests, returns to the base pose, states, start value, field and satellite fixes     evidence.py
    solve    Gauss-Newton over the whole recording, or over overlapping windows of a long one    windows.py, solve.py
    judge    can a real sensor have produced this solution?                                      plausibility.py
    report   attitude and covariance at every sample, calibration, diagnostics                   report.py

The factors stand in factors.py, magnetometer.py and satellite.py.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stillpoint.datasets.errors import Unobservable
from stillpoint.datasets.recording import Recording
from stillpoint.datasets.trajectory import Calibration, Reference
from stillpoint.smoother.attitude.evidence import Evidence, gather_evidence
from stillpoint.smoother.attitude.long.kept_windows import KeptWindows
from stillpoint.smoother.attitude.outside.added import Generator
from stillpoint.smoother.attitude.params import GraphParams
from stillpoint.smoother.attitude.plausibility import (
    Contradiction,
    SensorPriors,
    describe_disturbed_field,
    leave_out_magnetometer,
    priors_to_try,
    refuse_disturbed_field,
    refuse_surprise,
    refuse_wrong_axes,
    require_gyro_test,
)
from stillpoint.smoother.attitude.report import report_reference
from stillpoint.smoother.attitude.returns import contradicts_lone_return, reject_lone_return
from stillpoint.smoother.attitude.samples.joined import join_attitudes
from stillpoint.smoother.attitude.solve import NoOptimum
from stillpoint.smoother.attitude.trial import find_trial
from stillpoint.smoother.attitude.windows import Solved, solve_both_headings
from stillpoint.smoother.base_pose import Returns
from stillpoint.smoother.known_calibration import correct_recording, express_in_raw_readings
from stillpoint.smoother.long_reference import LongReference

_FAR_RADPS = np.deg2rad(5.0)  # RMS by which the gyro's matrix changes rates; beyond it, the graph is solved again
_RESTORED_COST = 4.0  # of a window: a larger rise of the cost says that the motion is not restored


@dataclass(frozen=True, eq=False)
class _Answer:
    """A solution, and the recording and the evidence that it is of."""

    recording: Recording
    evidence: Evidence
    solved: Solved
    left_out: str | None = None  # why the magnetometer is not used


def make_attitude_reference(
    recording: Recording,
    params: GraphParams,
    generators: Sequence[Generator] = (),
    kept: KeptWindows | None = None,
) -> LongReference:
    """Return the reference trajectory of a recording by the calibrating factor graph.

    If the magnetometer contradicts gyro and accelerometer, but its axes are right, the field is disturbed. The
    reference is then made without the magnetometer if a return to the base pose or satellites test the gyro instead,
    and otherwise with the readings that fit. ``generators`` add factors (outside/added.py). Of a recording of several
    windows those that are ``kept`` are not solved again, and others are added to them as they are solved.

    Raises :class:`Unobservable` when the recording does not determine the attitude, and its subclass
    :class:`Contradiction` when the sensors contradict each other.
    """
    recording = recording if params.magnetic.use else replace(recording, mag=None)
    evidence = gather_evidence(recording, params, generators)
    answer = _solve_in_any_field(recording, evidence, params, generators, kept)
    refuse_wrong_axes(answer.recording, answer.solved.fit.field_inlier_share)
    known = _find_far_calibration(answer)
    if known is not None:
        answer = _solve_corrected(answer, generators, known, kept)
    made = _refine_and_report(answer, kept)
    return made if known is None else express_in_raw_readings(made, known)


def reference_from_evidence(recording: Recording, evidence: Evidence, params: GraphParams) -> Reference:
    """Return the reference for evidence that was gathered, and perhaps changed, before; for studies.

    Raises :class:`Unobservable` as :func:`make_attitude_reference` does, and never leaves out the magnetometer.
    """
    solved = _solve_with_priors(recording, evidence, priors_to_try(params, evidence), None)
    return _refine_and_report(_Answer(recording, evidence, solved), None).whole()


def _solve_in_any_field(
    recording: Recording,
    evidence: Evidence,
    params: GraphParams,
    generators: Sequence[Generator],
    kept: KeptWindows | None,
) -> _Answer:
    """Solve the graph; in a disturbed field without the magnetometer, or with the readings that fit."""
    solved: Solved | None = None
    priors, disturbed = _choose_priors(recording, evidence, priors_to_try(params, evidence))
    try:
        if disturbed:
            raise Contradiction(recording.name, disturbed, of_field=True)
        solved = _solve_with_priors(recording, evidence, priors, kept)
        refuse_disturbed_field(solved.fit, recording.name, solved.params)
    except (Contradiction, NoOptimum) as contradiction:
        try:
            return _solve_without_magnetometer(recording, params, generators, contradiction, kept)
        except Unobservable:
            if solved is None and not disturbed:
                raise
            solved = solved or _solve_with_priors(recording, evidence, priors, kept)
    return _Answer(recording, evidence, solved)


def _refine_and_report(answer: _Answer, kept: KeptWindows | None) -> LongReference:
    """Restore the motion of a slow log, test a lone return, and report what is left."""
    answer = _try_restored(answer, kept)
    answer = _test_lone_return(answer, kept)
    return report_reference(answer.recording, answer.evidence, answer.solved, answer.left_out)


def _find_far_calibration(answer: _Answer) -> Calibration | None:
    """Return the gyro's matrix if it changes rates by too much for the graph's linear equations, None if not."""
    matrix, keys = answer.solved.pieces[-1].calibration.gyro_matrix, answer.evidence.keys
    assert matrix is not None
    moved = keys.gyro_b_radps[~keys.at_rest] @ (matrix - np.eye(3)).T
    return Calibration(gyro_matrix=matrix) if np.sum(moved**2) > len(moved) * _FAR_RADPS**2 else None


def _solve_corrected(
    answer: _Answer, generators: Sequence[Generator], known: Calibration, kept: KeptWindows | None
) -> _Answer:
    """Return the answer for the gyro corrected by the matrix that was found, with unchanged priors.

    A gyro 8 % off makes a bias of 30 deg/s in fast motion, by which preintegration is corrected in the first order
    only: copies of BROAD were wrong by up to 2.1 deg and are right within 0.6 after the correction.
    """
    params = answer.solved.params
    nearer = correct_recording(answer.recording, known)
    evidence = gather_evidence(nearer, params, generators)
    return replace(
        answer, recording=nearer, evidence=evidence, solved=solve_both_headings(nearer, evidence, params, kept)
    )


def _test_lone_return(answer: _Answer, kept: KeptWindows | None) -> _Answer:
    """Return the answer without a lone return that was put back turned.

    Where there is one return only, the first solution counts the magnetometer in full to test it. A return that stands
    the test is kept, and the magnetometer counts less in the second solution. Others are returned as they are.
    """
    evidence, solved = answer.evidence, answer.solved
    if evidence.base is None or evidence.returns is None or len(evidence.returns.spans) != 1:
        return answer
    squares = [square for piece in solved.pieces for square in piece.closing_squares]
    turned = contradicts_lone_return(squares)
    returns = Returns(evidence.returns.verdicts, (), ()) if turned else evidence.returns
    tested = evidence.with_returns(returns, solved.params, tested=True)
    try:
        again = solve_both_headings(answer.recording, tested, solved.params, kept)
    except Unobservable:
        return answer
    if turned:
        q_nb = join_attitudes(again.pieces, evidence.motion)
        tested = replace(tested, returns=reject_lone_return(evidence.base, evidence.returns, q_nb))
    return replace(answer, evidence=tested, solved=again)


def _try_restored(answer: _Answer, kept: KeptWindows | None) -> _Answer:
    """Return the answer for a slow log with the motion between readings restored, if the data allow it.

    Readings of single moments in a violent motion contradict the smaller error: on copies of BROAD at 24 Hz the cost
    rises by 0.5 to 2 where readings were averaged, and by 6 to 120 where they were dropped. Other answers are
    returned as they are.
    """
    evidence, solved = answer.evidence, answer.solved
    if not evidence.motion.gyro_sampling_radps.any():
        return answer
    restored = evidence.as_restored()
    try:
        again = solve_both_headings(answer.recording, restored, solved.params, kept)
    except Unobservable:
        return answer
    rise = sum(piece.cost for piece in again.pieces) - sum(piece.cost for piece in solved.pieces)
    return replace(answer, evidence=restored, solved=again) if rise < _RESTORED_COST * len(solved.pieces) else answer


def _choose_priors(
    recording: Recording, evidence: Evidence, priors: list[SensorPriors]
) -> tuple[list[SensorPriors], str]:
    """Return the priors that are left to try, and how a part of a long recording shows a disturbed field, "" if not.

    If that part finds the field disturbed with all priors, the narrowest that it does not contradict is left. Without
    a verdict of such a part, all priors are.
    """
    trial = find_trial(evidence, priors[0].params)
    if trial is None:
        return priors, ""
    try:
        tried = _solve_with_priors(recording, trial, priors, None)
    except Unobservable:
        return priors, ""
    chosen = next(k for k, prior in enumerate(priors) if prior.params is tried.params)
    found = describe_disturbed_field(tried.fit, tried.params)
    if not found:
        return priors[chosen:], ""
    seconds = evidence.keys.t_s[trial.keys.states.stop - 1] - evidence.keys.t_s[0]
    return priors[chosen : chosen + 1], f"in its first {seconds:.0f} s {found}"


def _solve_with_priors(
    recording: Recording, evidence: Evidence, priors: list[SensorPriors], kept: KeptWindows | None
) -> Solved:
    """Solve the graph with the first of several sensor priors that the data do not contradict.

    If the field is disturbed with all priors, the narrowest ones are used. Raises :class:`Unobservable` when the data
    contradict all priors: the first error that blames the field, if there is one, and otherwise that of the narrowest.
    """
    disturbed: Solved | None = None
    failure: Unobservable | None = None
    for prior in priors:
        try:
            solved = _solve_and_judge(recording, evidence, prior, kept)
        except Unobservable as error:
            blames_field = isinstance(error, Contradiction) and error.of_field
            if failure is None or (blames_field and not (isinstance(failure, Contradiction) and failure.of_field)):
                failure = error
            continue
        if not describe_disturbed_field(solved.fit, prior.params):
            return solved
        disturbed = disturbed or solved
    if disturbed is not None:
        return disturbed
    assert failure is not None
    raise failure


def _solve_without_magnetometer(
    recording: Recording,
    params: GraphParams,
    generators: Sequence[Generator],
    contradiction: Contradiction | NoOptimum,
    kept: KeptWindows | None,
) -> _Answer:
    """Return the answer without the magnetometer, and why it is left out.

    Raises ``contradiction`` where its axes are wrong, nothing tests the gyro instead, or the rest is contradictory too.
    """
    recording, why = leave_out_magnetometer(recording, contradiction)
    evidence = gather_evidence(recording, params, generators)
    require_gyro_test(evidence, contradiction, recording.name)
    # Only the returns show the gyro's scale then, so the priors of a raw sensor are used without a test of the gyro.
    raw = replace(priors_to_try(params, evidence)[:2][-1], surprise_limit_sd=None)
    try:
        return _Answer(recording, evidence, _solve_with_priors(recording, evidence, [raw], kept), why)
    except Unobservable:
        raise contradiction from None


def _solve_and_judge(recording: Recording, evidence: Evidence, prior: SensorPriors, kept: KeptWindows | None) -> Solved:
    solved = solve_both_headings(recording, evidence, prior.params, kept)
    if prior.surprise_limit_sd is not None:
        refuse_surprise(solved.pieces[-1].calibration, prior.surprise_limit_sd, recording.name, prior.params)
    return solved
