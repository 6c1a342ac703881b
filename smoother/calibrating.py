"""``method="graph"``: one calibrating factor graph over the whole recording.

Rests and returns -> start value -> keys -> factors -> optimum -> covariances -> every sample.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import chain

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, H, M
from scipy.spatial.transform import Rotation

from stillpoint.datasets.earth import declination_rad, normal_gravity_mps2
from stillpoint.datasets.errors import BadParameter, Unobservable
from stillpoint.datasets.frames import heading_rotation, quaternion, rotation
from stillpoint.datasets.recording import Floats, Info, Recording, Times
from stillpoint.datasets.trajectory import BasePoseReturn, Calibration, Reference
from stillpoint.smoother import attitude_graph as factors
from stillpoint.smoother.base_pose import BasePose, Returns, find_base_pose, find_returns
from stillpoint.smoother.field import FieldMeasurements, field_prior, measurements_at, start_of_field
from stillpoint.smoother.full_rate import between_keys, covariance_between
from stillpoint.smoother.graph_params import GraphParams
from stillpoint.smoother.keys import Keys, Motion, choose_keys, motion_of
from stillpoint.smoother.rest import find_rests
from stillpoint.smoother.satellite import Fixes, fix_factors, fixes_at, heading_of_fixes, path_of_fixes, standing
from stillpoint.smoother.solve import Solution, accuracy_of, rotations_of, solve
from stillpoint.smoother.start import Start, find_start
from stillpoint.smoother.strapdown import GyroErrors

SHORTEST_S = 2.0
STANDARD_GRAVITY_MPS2 = 9.80665
UNKNOWN_RAD = 2.0  # sd of an attitude that nothing is known of
DEFINED_RAD = 1e-3  # sd of a heading that is defined by the first attitude


@dataclass(frozen=True, eq=False)
class Evidence:
    """All that the graph is built from."""

    motion: Motion
    keys: Keys
    start: Start
    rests_ns: Times
    base: BasePose | None
    returns: Returns | None
    measured: FieldMeasurements | None
    fixes: Fixes | None
    heading: str  # what the heading refers to


def calibrating_graph(recording: Recording, params: GraphParams) -> Reference:
    """The reference by the calibrating factor graph.

    Raises :class:`Unobservable` when the recording does not fix an attitude, or the sensors contradict each other.
    """
    evidence = gather(recording, params)
    graph, values = build(recording, evidence, params)
    solution = solve(graph, values, len(evidence.keys.t_s), evidence.measured, recording.name, params)
    return reference_of(recording, evidence, solution, params)


def gather(recording: Recording, params: GraphParams) -> Evidence:
    """Rests, returns, keys, start value and field measurements of a recording."""
    imu = recording.require_imu()
    seconds = (imu.t_ns[-1] - imu.t_ns[0]) / 1e9
    if seconds < SHORTEST_S:
        raise Unobservable(
            f"{recording.name}: {seconds:.2f} s are too short to tell bias from motion; give {SHORTEST_S:.0f} s or more"
        )
    rests_ns = find_rests(imu, params.rest)
    motion = motion_of(imu, rests_ns)
    keys = choose_keys(motion, params.keys)
    bias = motion.gyro_b_radps[motion.at_rest].mean(axis=0) if motion.at_rest.any() else None
    start = find_start(motion, recording.mag, int(imu.t_ns[0]), bias)
    measured = None
    if recording.mag is not None:
        measured = measurements_at(keys, recording.mag, int(imu.t_ns[0]), params.magnetic)
    fixes = None if recording.gps is None else fixes_at(keys, recording.gps, int(imu.t_ns[0]), params.gps)
    base, returns = _base(recording, rests_ns, params)
    heading = _heading(recording, measured, fixes)
    return Evidence(motion, keys, start, rests_ns, base, returns, measured, fixes, heading)


def _base(recording: Recording, rests_ns: Times, params: GraphParams) -> tuple[BasePose | None, Returns | None]:
    """Base pose and returns, None for a recording that does not begin at rest: the graph needs neither."""
    try:
        base = find_base_pose(recording, rests_ns, params.returns)
    except Unobservable:
        return None, None
    return base, find_returns(recording, rests_ns, base, GyroErrors(), params.returns)


def _heading(recording: Recording, measured: FieldMeasurements | None, fixes: Fixes | None) -> str:
    if recording.base_pose is not None:
        return "of the base pose that the recording carries"
    if measured is None and fixes is not None:
        return "true north, from the satellite course"
    if measured is None:
        return "relative to the first attitude: there is no magnetometer"
    return "true north" if _declination(recording.info) is not None else "magnetic north: date or place is not known"


def _declination(info: Info) -> float | None:
    if not info.date or info.place_lat_lon_alt is None:
        return None
    try:
        return declination_rad(info.place_lat_lon_alt, info.date)
    except BadParameter:
        return None


def gravity_mps2(info: Info) -> float:
    """Normal gravity at the place of the recording, or the standard value."""
    if info.place_lat_lon_alt is None:
        return STANDARD_GRAVITY_MPS2
    return normal_gravity_mps2(info.place_lat_lon_alt[0], info.place_lat_lon_alt[2])


def build(
    recording: Recording, evidence: Evidence, params: GraphParams
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """The graph and where to start."""
    keys, bias = evidence.keys, evidence.start.gyro_bias_b_radps
    q_nb = _start_attitudes(recording, evidence)
    graph = gtsam.NonlinearFactorGraph()
    everything: Iterable[gtsam.NonlinearFactor] = chain(
        factors.imu_factors(evidence.motion, keys, bias, gravity_mps2(recording.info), params),
        factors.calibration_factors(keys, params),
        factors.bias_factors(keys, bias, params),
        factors.motion_factors(keys, evidence.fixes is not None, params),
        () if evidence.fixes is None else fix_factors(evidence.fixes, params.gps),
        factors.rest_factors(keys, params),
        factors.gap_factors(keys, params),
        factors.anchor_factors(_anchors(recording, evidence, q_nb[0], params), params),
    )
    for factor in everything:
        graph.push_back(factor)
    place, velocity = standing(keys) if evidence.fixes is None else path_of_fixes(evidence.fixes, keys)
    values = factors.start_values(keys, q_nb, place, velocity, bias, params)
    if evidence.measured is not None:
        seen_from = q_nb[evidence.measured.state]
        begin = start_of_field(evidence.measured, seen_from, evidence.start.hard_iron_b_ut)
        azimuth = _declination(recording.info) or 0.0
        values.insert(H(0), begin)
        graph.push_back(field_prior(begin, azimuth, recording.base_pose is None, params.magnetic))
    return graph, values


def _start_attitudes(recording: Recording, evidence: Evidence) -> Floats:
    """The start's attitudes at the states, (n, 4), turned to the heading that n has."""
    q_nb = evidence.start.q_nb[evidence.keys.row]
    return quaternion(heading_rotation(_start_turn(recording, evidence)) * rotation(q_nb))


def _start_turn(recording: Recording, evidence: Evidence) -> float:
    """Angle about up that takes the start's heading to n's: the base pose's, or the declination's."""
    if recording.base_pose is not None and evidence.base is not None:
        known, found = rotation(recording.base_pose), rotation(evidence.start.q_nb[evidence.base.start])
        difference = quaternion(known * found.inv())
        return float(2 * np.arctan2(difference[3], difference[0]))
    if evidence.measured is not None:
        return -(_declination(recording.info) or 0.0)
    if evidence.fixes is not None:
        return heading_of_fixes(evidence.fixes, evidence.motion, evidence.start.q_nb) or 0.0
    return 0.0


def _anchors(recording: Recording, evidence: Evidence, first_q_nb: Floats, params: GraphParams) -> factors.Anchors:
    """Rests in the base pose as states, and how well the first attitude is known."""
    base, returns = _return_states(evidence)
    posed = recording.base_pose is not None and base is not None
    absolute = evidence.measured is not None or evidence.fixes is not None or posed
    spread = np.diag([UNKNOWN_RAD**2, UNKNOWN_RAD**2, UNKNOWN_RAD**2 if absolute else DEFINED_RAD**2])
    turn = rotation(first_q_nb).as_matrix()
    return factors.Anchors(
        base=base,
        base_q_nb=recording.base_pose if base is not None else None,
        base_sd_rad=params.returns.repeat_sd_rad,
        returns=returns,
        first_q_nb=first_q_nb,
        first_cov_b_rad2=turn.T @ spread @ turn,
    )


def _return_states(evidence: Evidence) -> tuple[int | None, tuple[int, ...]]:
    """The states in the middle of the base rest and of each return."""
    if evidence.base is None or evidence.returns is None:
        return None, ()
    middle = [(evidence.base.start + evidence.base.end) // 2, *(sum(span) // 2 for span in evidence.returns.spans)]
    base, *returns = (int(np.abs(evidence.keys.row - row).argmin()) for row in middle)
    return base, tuple(returns)


def reference_of(recording: Recording, evidence: Evidence, solution: Solution, params: GraphParams) -> Reference:
    """The solution at every sample, with what was found about the sensor."""
    imu, keys, motion = recording.require_imu(), evidence.keys, evidence.motion
    states = np.arange(len(keys.t_s))
    moving = ~np.append(keys.at_rest, keys.at_rest[-1])
    base, returns = _return_states(evidence)
    accuracy = accuracy_of(solution, moving, base, returns, recording.name, params)
    vector = solution.values.atVector(M(0))
    gyro_matrix = np.eye(3) - vector[9:18].reshape(3, 3)
    step = factors.steps_of_bias(keys, params)
    biases = np.array([solution.values.atConstantBias(B(k)).gyroscope() for k in range(step[-1] + 1)])
    biases = np.linalg.solve(gyro_matrix, biases.T).T
    of_sample = step[np.clip(np.searchsorted(keys.t_s, motion.t_s, side="right") - 1, 0, len(states) - 1)]
    rate = (motion.gyro_b_radps - biases[of_sample]) @ gyro_matrix.T
    key_q = quaternion(Rotation.from_matrix(rotations_of(solution.values, states)))
    q_nb = between_keys(keys.row, key_q, rate, motion.dt_s)
    cov = covariance_between(
        motion.t_s, keys.t_s, accuracy.attitude_b_rad2, params.inertial.gap_rate_sd_radps, keys.gap
    )
    return Reference(
        t_ns=imu.t_ns,
        q_nb=q_nb,
        cov_b_rad2=cov,
        gyro_bias_b_radps=biases[of_sample],
        heading_sd_rad=accuracy.heading_sd_rad,
        method="graph",
        name=recording.name,
        calibration=_calibration(solution, vector, accuracy.calibration),
        rests_ns=evidence.rests_ns,
        returns=_verdicts(evidence),
        diagnostics={
            "heading": evidence.heading,
            "iterations": len(solution.q_steps_rad),
            "cost": solution.cost,
            "closing_squares": list(accuracy.closing_squares),
        },
    )


def _calibration(solution: Solution, vector: Floats, covariance: Floats) -> Calibration:
    sd = np.sqrt(np.diagonal(covariance))
    field = solution.values.atVector(H(0)) if solution.values.exists(H(0)) else None
    return Calibration(
        gyro_matrix=np.eye(3) - vector[9:18].reshape(3, 3),
        gyro_matrix_sd=sd[9:18].reshape(3, 3),
        accel_matrix=np.eye(3) - vector[:9].reshape(3, 3),
        accel_matrix_sd=sd[:9].reshape(3, 3),
        accel_bias_b_mps2=solution.values.atConstantBias(B(0)).accelerometer(),
        hard_iron_b_ut=None if field is None else field[3:],
        field_n_ut=None if field is None else field[:3],
        clock_offset_s={"accel": float(vector[18])},
    )


def _verdicts(evidence: Evidence) -> tuple[BasePoseReturn, ...]:
    return () if evidence.returns is None else evidence.returns.verdicts
