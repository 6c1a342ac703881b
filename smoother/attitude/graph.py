"""``method="graph"``: one calibrating factor graph over the whole recording, or over overlapping windows of a long one.

Rests and returns -> start value -> keys -> factors -> optimum -> covariances -> every sample.
"""

from collections.abc import Iterable
from dataclasses import replace
from itertools import chain

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, H, M
from scipy.spatial.transform import Rotation

from stillpoint.datasets.earth import local_declination
from stillpoint.datasets.errors import Unobservable
from stillpoint.datasets.frames import quaternion, rotation
from stillpoint.datasets.recording import Floats, Recording
from stillpoint.datasets.times import gaps
from stillpoint.datasets.trajectory import CONVENTION, BasePoseReturn, Calibration, Reference
from stillpoint.smoother.attitude import factors
from stillpoint.smoother.attitude.disturbed_field import refuse_wrong_axes, require_test_of_gyro, without_magnetometer
from stillpoint.smoother.attitude.every_sample import between_keys, covariance_between, states_with_covariance
from stillpoint.smoother.attitude.evidence import (
    Evidence,
    gather,
    gravity_mps2,
    sign_of_gravity,
    turned_round,
    with_bias_prior,
)
from stillpoint.smoother.attitude.magnetometer import field_matrix, field_prior
from stillpoint.smoother.attitude.params import GraphParams
from stillpoint.smoother.attitude.plausibility import (
    DOUBT_SD,
    SURPRISE_LIMIT_SD,
    Contradiction,
    Fit,
    fit_of,
    judged_again,
    mean_fit,
    raw_sensor,
    refuse_contradictions,
    refuse_fixes,
    refuse_surprise,
    surprise,
)
from stillpoint.smoother.attitude.satellite import believed_share, fix_factors
from stillpoint.smoother.attitude.solve import NoOptimum, Solution, accuracy_of, rotations_of, scale_of, solve
from stillpoint.smoother.attitude.windows import Past, Piece, attitudes_after, hand_over, joined, resume, split

UNKNOWN_RAD = 2.0  # sd of an attitude that nothing is known of
DEFINED_RAD = 1e-3  # sd of a heading that is defined by the first attitude


def calibrating_graph(recording: Recording, params: GraphParams) -> Reference:
    """The reference by the calibrating factor graph; without the magnetometer where that stands in disturbed fields.

    Raises :class:`Unobservable` when the recording does not fix an attitude, or the sensors contradict each other.
    """
    recording = recording if params.magnetic.use else replace(recording, mag=None)
    try:
        made = reference_from(recording, gather(recording, params), params)
    except (Contradiction, NoOptimum) as contradiction:
        return _without_magnetometer(recording, contradiction, params)
    refuse_wrong_axes(recording, made.diagnostics["field_inlier_share"])
    return made


def _without_magnetometer(
    recording: Recording, contradiction: Contradiction | NoOptimum, params: GraphParams
) -> Reference:
    """The reference by all but the magnetometer; raises ``contradiction`` where that is none either.

    Nothing vouches for the gyro's scale then but what its returns show, so it is taken for a raw sensor's.
    """
    less, why = without_magnetometer(recording, contradiction)
    evidence = gather(less, params)
    require_test_of_gyro(evidence, contradiction, recording.name)
    try:
        made = reference_from(less, evidence, raw_sensor(params) or params)
    except Unobservable:
        raise contradiction from None
    return replace(made, diagnostics={**made.diagnostics, "magnetometer_left_out": why})


def reference_from(recording: Recording, evidence: Evidence, params: GraphParams) -> Reference:
    """The graph solved; once more with the priors of a raw sensor where the data contradict those of a good one."""
    params = with_bias_prior(params, evidence)
    raw = raw_sensor(params)
    try:
        pieces, fit = _solved(recording, evidence, params)
        if raw is not None:
            refuse_surprise(pieces[-1].calibration, DOUBT_SD, recording.name, params)
        return _reference_of(recording, evidence, pieces, fit, params)
    except Unobservable:
        if raw is None:
            raise
    pieces, fit = _solved(recording, evidence, raw)
    refuse_surprise(pieces[-1].calibration, SURPRISE_LIMIT_SD, recording.name, raw)
    return _reference_of(recording, evidence, pieces, fit, raw)


def _solved(recording: Recording, evidence: Evidence, params: GraphParams) -> tuple[list[Piece], Fit]:
    """From the start value; once more from half a turn away where the field that is found points away from north.

    So it does where the magnetometer covers little of the recording and the start value's heading is none.
    """
    pieces, fit = _windows_solved(recording, evidence, params)
    if _points_north(pieces, recording, evidence):
        return pieces, fit
    pieces, fit = _windows_solved(recording, turned_round(evidence), params)
    if not _points_north(pieces, recording, evidence):
        raise Contradiction(recording.name, "the field points away from north, wherever the heading begins")
    return pieces, fit


def _points_north(pieces: list[Piece], recording: Recording, evidence: Evidence) -> bool:
    """Is the field that was found on the side of north that the declination says? True where it is not the heading."""
    field_n_ut = pieces[-1].calibration.field_n_ut
    if field_n_ut is None or _posed(recording, evidence) or evidence.fixes is not None:
        return True
    azimuth, _ = local_declination(recording.info)
    return bool(field_n_ut[0] * np.sin(azimuth) + field_n_ut[1] * np.cos(azimuth) > 0)


def _windows_solved(recording: Recording, evidence: Evidence, params: GraphParams) -> tuple[list[Piece], Fit]:
    """Window by window where it is long: each begins with all that those before it say."""
    pieces: list[Piece] = []
    fits: list[Fit] = []
    past: Past | None = None
    for first, until, end in split(evidence.keys, params.keys):
        window, closed = evidence.within(first, end), evidence.within(first, until)
        bias = _first_bias(evidence, past)
        before = own_factors(recording, closed, bias, params)
        after = own_factors(recording, evidence.within(until, end), bias, params) if until < end else None
        graph = summed(before, after, past)
        values = start_of(window, past, params)
        solution = solve(graph, values, window.keys.held, window.measured, recording.name, params)
        inherited = 0 if past is None else len(past.factors)
        fits.append(fit_of(graph, inherited, solution, window.keys, params))
        found_bias = evidence.start.gyro_bias_b_radps
        refuse_contradictions(fits[-1], solution, found_bias, recording.info, recording.name, params)
        if window.fixes is not None:
            refuse_fixes(believed_share(window.fixes, solution.values, params.gps), recording.name)
        pieces.append(_piece_of(recording, window, solution, until, params))
        if until < end:
            past = hand_over(summed(before, None, past), closed, window.keys, solution, params)
    return pieces, mean_fit(fits)


def build(
    recording: Recording, evidence: Evidence, past: Past | None, params: GraphParams
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """The graph of a window and where to start; ``past`` is None for the first."""
    bias = _first_bias(evidence, past)
    graph = summed(own_factors(recording, evidence, bias, params), None, past)
    return graph, start_of(evidence, past, params)


def _first_bias(evidence: Evidence, past: Past | None) -> Floats:
    """The gyro's bias (3,) where a window begins: the start value's, or where the past left it."""
    return evidence.start.gyro_bias_b_radps if past is None else past.gyro_bias_b_radps


def own_factors(
    recording: Recording, evidence: Evidence, bias_b_radps: Floats, params: GraphParams
) -> gtsam.NonlinearFactorGraph:
    """What the recording says of the states of ``evidence``; two stretches of states have no factor in common."""
    keys = evidence.keys
    everything: Iterable[gtsam.NonlinearFactor] = chain(
        factors.imu_factors(evidence.motion, keys, bias_b_radps, gravity_mps2(recording.info), params),
        factors.calibration_factors(keys, params),
        factors.bias_factors(keys, bias_b_radps, params),
        factors.motion_factors(keys, evidence.fixes is not None, params),
        () if evidence.fixes is None else fix_factors(evidence.fixes, params.gps),
        factors.rest_factors(keys, params),
        factors.gap_factors(keys, params),
        factors.anchor_factors(_anchors(recording, evidence, params), params),
    )
    graph = gtsam.NonlinearFactorGraph()
    for factor in everything:
        graph.push_back(factor)
    if evidence.field_start is not None and keys.first == 0:
        azimuth, _ = local_declination(recording.info)
        graph.push_back(field_prior(evidence.field_start, azimuth, not _posed(recording, evidence), params.magnetic))
    return graph


def summed(
    before: gtsam.NonlinearFactorGraph, after: gtsam.NonlinearFactorGraph | None, past: Past | None
) -> gtsam.NonlinearFactorGraph:
    """One graph of two stretches, and last of what the past says."""
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(before)
    if after is not None:
        graph.push_back(after)
    for factor in () if past is None else past.factors:
        graph.push_back(factor)
    return graph


def start_of(evidence: Evidence, past: Past | None, params: GraphParams) -> gtsam.Values:
    """Where the states begin: the start value, or where the past left off."""
    keys = evidence.keys
    bias = _first_bias(evidence, past)
    q_nb = evidence.q_nb if past is None else attitudes_after(past, evidence)
    values = factors.start_values(keys, q_nb, evidence.place_n_m, evidence.velocity_n_mps, bias, params)
    if evidence.field_start is not None:
        values.insert(H(0), evidence.field_start)
    if past is not None:
        resume(values, past, keys, params)
    return values


def _posed(recording: Recording, evidence: Evidence) -> bool:
    """Is the heading that of the base pose that the recording carries?"""
    return recording.base_pose is not None and evidence.base is not None


def _anchors(recording: Recording, evidence: Evidence, params: GraphParams) -> factors.Anchors:
    """Rests in the base pose as states, and how well the first attitude is known."""
    keys = evidence.keys
    base, returns = evidence.return_states()
    posed = _posed(recording, evidence)
    absolute = evidence.field_start is not None or evidence.fixes is not None or posed
    spread = np.diag([UNKNOWN_RAD**2, UNKNOWN_RAD**2, UNKNOWN_RAD**2 if absolute else DEFINED_RAD**2])
    turn = rotation(evidence.q_nb[0]).as_matrix()
    return factors.Anchors(
        base=base,
        base_q_nb=recording.base_pose if base in keys.states else None,
        base_sd_rad=params.returns.repeat_sd_rad,
        returns=returns,
        first_q_nb=evidence.q_nb[0] if keys.first == 0 else None,
        first_cov_b_rad2=turn.T @ spread @ turn,
    )


def _piece_of(recording: Recording, evidence: Evidence, solution: Solution, until: int, params: GraphParams) -> Piece:
    """A window's solution at every sample; of its returns only those before the state ``until`` are its own."""
    keys, motion, values = evidence.keys, evidence.motion, solution.values
    held = np.array(keys.held)
    chosen = states_with_covariance(keys)
    resting = np.append(keys.at_rest, keys.at_rest[-1])[held]
    counted = held if resting.all() else held[~resting]
    base, returns = evidence.return_states()
    own = tuple(state for state in returns if state < until)
    accuracy = accuracy_of(solution, chosen, counted, base, own, recording.name, params)

    vector = values.atVector(M(0))
    gyro_matrix = np.eye(3) - vector[9:18].reshape(3, 3)
    samples = slice(keys.row[held[0]], keys.row[held[-1]] + 1)
    t_s, dt_s = motion.t_s[samples], motion.dt_s[samples]
    step = factors.steps_of_bias(keys, params)[held]
    found = np.array([values.atConstantBias(B(k)).gyroscope() for k in range(step[0], step[-1] + 1)])
    biases = np.linalg.solve(gyro_matrix, found.T).T
    of_sample = step[np.clip(np.searchsorted(keys.t_s[held], t_s, side="right") - 1, 0, len(held) - 1)] - step[0]
    rate = (motion.gyro_b_radps[samples] - biases[of_sample]) @ gyro_matrix.T
    key_q = quaternion(Rotation.from_matrix(rotations_of(values, held)))
    q_nb = between_keys(keys.row[held] - samples.start, key_q, rate, dt_s)
    cov = covariance_between(t_s, q_nb, keys.t_s[chosen], accuracy.attitude_b_rad2, key_q[chosen - held[0]])
    return Piece(
        samples=samples,
        q_nb=q_nb,
        cov_b_rad2=cov,
        gyro_bias_b_radps=biases[of_sample],
        heading_rad2=accuracy.heading_rad2,
        closing_squares=accuracy.closing_squares,
        calibration=_calibration(solution, int(step[0]), accuracy.calibration),
        late_sd_s=float(np.sqrt(accuracy.calibration[18, 18])),
        iterations=len(solution.q_steps_rad),
        cost=solution.cost,
    )


def _reference_of(
    recording: Recording, evidence: Evidence, pieces: list[Piece], fit: Fit, params: GraphParams
) -> Reference:
    """The pieces as one, with what was found about the sensor."""
    whole = joined(pieces, evidence.motion.t_s)
    gap = gaps(recording.require_imu().t_ns)
    verdicts = _verdicts(evidence, whole.q_nb, params)
    closing = _closing_squares(evidence, verdicts, pieces)
    scale = scale_of(closing, params)
    return Reference(
        t_ns=recording.require_imu().t_ns,
        q_nb=whole.q_nb,
        cov_b_rad2=scale * whole.cov_b_rad2,
        gyro_bias_b_radps=whole.gyro_bias_b_radps,
        heading_sd_rad=float(np.sqrt(scale * whole.heading_rad2)),
        method="graph",
        name=recording.name,
        calibration=whole.calibration,  # its sd is mostly the prior's, of which returns say nothing
        rests_ns=evidence.rests_ns,
        returns=verdicts,
        diagnostics={
            "heading": evidence.heading,
            "sign_of_gravity": sign_of_gravity(recording, evidence),
            "n_rests_under_way": evidence.n_rests_under_way,
            "gaps": int(gap.sum()),
            "longest_gap_s": float(evidence.motion.dt_s[1:][gap].max(initial=0.0)),
            "windows": len(pieces),
            "iterations": whole.iterations,
            "cost": whole.cost,
            "closing_squares": closing,
            "residuals": fit.squares,
            "gyro_bias_prior_sd_radps": params.inertial.gyro_bias_sd_radps,
            "gyro_matrix_prior_sd": params.inertial.gyro_matrix_sd,
            "accel_matrix_prior_sd": params.inertial.accel_matrix_sd,
            "accel_late_sd_s": whole.late_sd_s,
            "calibration_surprise_sd": surprise(whole.calibration, params),
            "field_inlier_share": fit.field_inlier_share,
            "field_misfit_ut": fit.field_misfit_ut,
            "convention": CONVENTION,
        },
    )


def _verdicts(evidence: Evidence, q_nb: Floats, params: GraphParams) -> tuple[BasePoseReturn, ...]:
    """What came of each rest, given the attitudes (N, 4) that were found."""
    if evidence.base is None or evidence.returns is None:
        return ()
    return judged_again(evidence.base, evidence.returns, q_nb, params)


def _closing_squares(evidence: Evidence, verdicts: tuple[BasePoseReturn, ...], pieces: list[Piece]) -> list[float]:
    """Of the returns that were accepted before and after the solution: a knocked pose says nothing about the gyro."""
    if evidence.returns is None:
        return []
    pairs = zip(evidence.returns.verdicts, verdicts, strict=True)
    kept = [after.accepted for before, after in pairs if before.accepted]
    squares = [square for piece in pieces for square in piece.closing_squares]
    return [square for square, good in zip(squares, kept, strict=True) if good]


def _calibration(solution: Solution, bias_step: int, covariance: Floats) -> Calibration:
    vector = solution.values.atVector(M(0))
    sd = np.sqrt(np.diagonal(covariance))
    field = solution.values.atVector(H(0)) if solution.values.exists(H(0)) else None
    return Calibration(
        gyro_matrix=np.eye(3) - vector[9:18].reshape(3, 3),
        gyro_matrix_sd=sd[9:18].reshape(3, 3),
        accel_matrix=np.eye(3) - vector[:9].reshape(3, 3),
        accel_matrix_sd=sd[:9].reshape(3, 3),
        accel_bias_b_mps2=solution.values.atConstantBias(B(bias_step)).accelerometer(),
        mag_matrix=None if field is None else np.asarray(np.linalg.inv(field_matrix(field)), dtype=np.float64),
        hard_iron_b_ut=None if field is None else field[3:6],
        field_n_ut=None if field is None else field[:3],
        clock_offset_s={"accel": float(vector[18])} | ({} if field is None else {"mag": float(field[6])}),
    )
