"""Solve a recording in windows: one for a short recording, overlapping ones for a long recording.

    |------- window 1 -------|
                     |------- window 2 -------|        the answer goes over linearly from one to the other
                     ^ until                           in the overlap

The past of a window consists of the states before the first state of the next window. Their factors are linearised at
the optimum and reduced to the unknowns that both windows share (the state in between, its bias, calibration, field and
hard iron, common rest pose). The result is a Gaussian on these unknowns with all correlations, so that no measurement
is counted twice or forgotten. A window's own answer uses the future only as far as the overlap.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, C, H, L, M, V, X
from scipy.spatial.transform import Rotation

from stillpoint.datasets.earth import local_declination
from stillpoint.datasets.frames import heading_rotation, quaternion, rotation
from stillpoint.datasets.recording import Floats, Recording
from stillpoint.smoother.attitude.build import build_graph, build_start_values
from stillpoint.smoother.attitude.evidence import Evidence, has_known_base_pose, turn_start_round
from stillpoint.smoother.attitude.factors import bias_steps
from stillpoint.smoother.attitude.keys import Keys
from stillpoint.smoother.attitude.outside.added import Added, measure_added, select_added
from stillpoint.smoother.attitude.outside.satellite import believed
from stillpoint.smoother.attitude.params import GraphParams, KeyParams
from stillpoint.smoother.attitude.plausibility import (
    Contradiction,
    Fit,
    average_fits,
    measure_fit,
    refuse_contradictions,
    refuse_fixes,
)
from stillpoint.smoother.attitude.returns import Votes, vote_factors, with_wide_votes
from stillpoint.smoother.attitude.samples.every_sample import Piece, sample_solution
from stillpoint.smoother.attitude.solve import Solution, begin, iterate, linearise, solve


@dataclass(frozen=True, eq=False)
class Solved:
    """The solved graph of a recording: one piece for each window."""

    pieces: list[Piece]
    fit: Fit
    params: GraphParams  # with the sensor priors that were used
    n_doubtful_fixes: int = 0  # fixes that lose more than half of their weight, summed over the windows


_LEAST_OVERLAP = 2  # states


@dataclass(frozen=True, eq=False)
class Past:
    """The information that a window hands over to the next one."""

    factors: tuple[gtsam.LinearContainerFactor, ...]  # on the unknowns that both share
    values: gtsam.Values  # of all unknowns of the window
    held: range  # its states in the overlap
    gyro_bias_b_radps: Floats  # (3,) at the first state of the next window


def solve_both_headings(recording: Recording, evidence: Evidence, params: GraphParams) -> Solved:
    """Solve from the start value, and once more with its heading rotated by 180 deg if the field then points south.

    This happens where the magnetometer covers little of the recording, so that the start value has no heading.
    Raises :class:`Contradiction` when the field points south from both headings.
    """
    solved = _solve_windows(recording, evidence, params)
    if _field_points_north(solved.pieces, recording, evidence):
        return solved
    solved = _solve_windows(recording, turn_start_round(evidence), params)
    if not _field_points_north(solved.pieces, recording, evidence):
        raise Contradiction(recording.name, "the field points away from north, wherever the heading begins")
    return solved


def _solve_windows(recording: Recording, evidence: Evidence, params: GraphParams) -> Solved:
    """Solve window by window; each window begins with everything that the windows before it have found.

    Raises :class:`Unobservable` when a window has no unique optimum or one that no sensor can have produced.
    """
    pieces: list[Piece] = []
    fits: list[Fit] = []
    past: Past | None = None
    n_doubtful_fixes = 0
    for first, until, end in split_windows(evidence.keys, params.keys):
        window, closed = evidence.within(first, end), evidence.within(first, until)
        start_bias = evidence.start.gyro_bias_b_radps
        bias = start_bias if past is None else past.gyro_bias_b_radps
        before = build_graph(recording, closed, bias, params)
        parts = [before]
        if until < end:
            parts.append(build_graph(recording, evidence.within(until, end), bias, params))
        added = select_added(evidence.added, window.keys.states, window.keys.held)
        values, votes = start_window(window, past, params), window.find_votes()
        problem = window.keys.held, window.measured, recording.name
        approach = begin(values, params)
        if votes is not None:
            wide = with_wide_votes(params)
            graph = _push_added(join_graphs(parts, votes, past, wide), added)
            approach = iterate(graph, approach, *problem, wide)
        graph = _push_added(join_graphs(parts, votes, past, params), added)
        solution = solve(graph, approach, *problem, params)
        inherited = len(added) + (0 if past is None else len(past.factors))
        fit = measure_fit(graph, inherited, solution, window.keys, params)
        fits.append(replace(fit, squares=fit.squares | measure_added(added, solution.values)))
        refuse_contradictions(fits[-1], solution, start_bias, recording.info, recording.name, params)
        if window.fixes is not None:
            kept = believed(window.fixes, solution.values, params.gps)
            refuse_fixes(kept, recording.name)
            n_doubtful_fixes += int((~kept).sum())
        pieces.append(sample_solution(window, solution, until, recording.name, params))
        if until < end:
            closing = select_added(evidence.added, closed.keys.states, closed.keys.held)
            graph = _push_added(join_graphs([before], closed.find_votes(), past, params), closing)
            past = hand_over(graph, closed, window.keys, solution, params)
    return Solved(pieces, average_fits(fits), params, n_doubtful_fixes)


def split_windows(keys: Keys, params: KeyParams) -> list[tuple[int, int, int]]:
    """Return for each window its first state, the first state of the next window, and its end.

    All windows have the same length, at most ``window_s``.
    """
    n, length_s = len(keys.t_s), keys.t_s[-1] - keys.t_s[0]
    overlap_s = min(params.overlap_s, params.window_s / 2)
    count = int(np.ceil((length_s - overlap_s) / (params.window_s - overlap_s)))
    if count <= 1:
        return [(0, n, n)]
    begin_s = keys.t_s[0] + (length_s - overlap_s) / count * np.arange(count)
    first = np.append(np.searchsorted(keys.t_s, begin_s), n)
    end = np.append(np.searchsorted(keys.t_s, begin_s[1:] + overlap_s), n)
    end[:-1] = np.minimum(np.maximum(end[:-1], first[1:-1] + _LEAST_OVERLAP), n)  # a gap may take up the overlap
    windows = np.flatnonzero(np.diff(first) > 0)  # or a whole window
    return [(int(first[k]), int(first[k + 1]), int(end[k])) for k in windows]


def _push_added(graph: gtsam.NonlinearFactorGraph, added: list[Added]) -> gtsam.NonlinearFactorGraph:
    """Return the graph with the added factors at its end."""
    for one in added:
        graph.push_back(one.factor)
    return graph


def join_graphs(
    parts: Sequence[gtsam.NonlinearFactorGraph], votes: Votes | None, past: Past | None, params: GraphParams
) -> gtsam.NonlinearFactorGraph:
    """Return one graph of stretches of states, the votes of their returns and, last, the factors of the past."""
    graph = gtsam.NonlinearFactorGraph()
    for part in parts:
        graph.push_back(part)
    for vote in () if votes is None else vote_factors(votes, params):
        graph.push_back(vote)
    for factor in () if past is None else past.factors:
        graph.push_back(factor)
    return graph


def start_window(window: Evidence, past: Past | None, params: GraphParams) -> gtsam.Values:
    """Return the start values of a window: those of the evidence, overwritten by the past where the two overlap."""
    if past is None:
        return build_start_values(window, window.q_nb, window.start.gyro_bias_b_radps, params)
    values = build_start_values(window, _continue_attitudes(past, window), past.gyro_bias_b_radps, params)
    _resume(values, past, window.keys, params)
    return values


def hand_over(
    graph: gtsam.NonlinearFactorGraph, closed: Evidence, window: Keys, solution: Solution, params: GraphParams
) -> Past:
    """Reduce the factors of a window's past to the unknowns that it shares with the next window.

    ``graph`` holds the factors of ``closed``, the part of the window before the next one.
    """
    keys, values = closed.keys, solution.values
    until = keys.states.stop
    system, _ = linearise(graph, values, closed.measured, solution.field_scale_ut, params, solution.field_widening)
    step = int(bias_steps(keys, params)[until])
    common = [X(until), V(until), B(step), M(0)]
    common += [key for key in (H(0), L(0)) if values.exists(key) and key in system.keyVector()]
    _, rest = system.eliminatePartialSequential(_order_without(solution.ordering, system, common))
    return Past(
        factors=tuple(gtsam.LinearContainerFactor(rest.at(k), values) for k in range(rest.size())),
        values=values,
        held=range(until, window.held.stop),
        gyro_bias_b_radps=values.atConstantBias(B(step)).gyroscope(),
    )


def _field_points_north(pieces: list[Piece], recording: Recording, evidence: Evidence) -> bool:
    """Return whether the local field points to the north of the declination; True if the field is not the heading."""
    field_n_ut = pieces[-1].calibration.field_n_ut
    if field_n_ut is None or has_known_base_pose(recording, evidence) or evidence.fixes is not None:
        return True
    azimuth, _ = local_declination(recording.info)
    return bool(field_n_ut[0] * np.sin(azimuth) + field_n_ut[1] * np.cos(azimuth) > 0)


def _order_without(ordering: gtsam.Ordering, system: gtsam.GaussianFactorGraph, kept: list[int]) -> gtsam.Ordering:
    """Return the unknowns of a system except those kept, in the order of the whole window."""
    wanted = set(system.keyVector()).difference(kept)
    shorter = gtsam.Ordering()
    for k in range(ordering.size()):
        if ordering.at(k) in wanted:
            shorter.push_back(ordering.at(k))
    return shorter


def _continue_attitudes(past: Past, window: Evidence) -> Floats:
    """Return the start attitudes (n, 4), rotated to the heading of the past if no magnetometer shows the heading."""
    if window.measured is not None:
        return window.q_nb
    last = past.held[-1]
    turn = rotation(window.q_nb[last]).inv()
    difference = quaternion(Rotation.from_matrix(past.values.atPose3(X(last)).rotation().matrix()) * turn)
    angle_rad = float(2 * np.arctan2(difference[3], difference[0]))
    return quaternion(heading_rotation(angle_rad) * rotation(window.q_nb))


def _resume(values: gtsam.Values, past: Past, keys: Keys, params: GraphParams) -> None:
    """Overwrite start values with the optimum of the window before, for all unknowns that both windows have."""
    before = past.values
    for i in past.held:
        values.update(X(i), before.atPose3(X(i)))
        values.update(V(i), before.atVector(V(i)))
        if before.exists(C(i)) and values.exists(C(i)):
            values.update(C(i), before.atConstantBias(C(i)))
    step = bias_steps(keys, params)[past.held]
    for k in range(step[0], step[-1] + 1):
        values.update(B(k), before.atConstantBias(B(k)))
    values.update(M(0), before.atVector(M(0)))
    if values.exists(H(0)):
        values.update(H(0), before.atVector(H(0)))
    if before.exists(L(0)):
        values.insert_or_assign(L(0), before.atPose3(L(0)))
