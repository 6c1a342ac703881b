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
from gtsam.symbol_shorthand import C

from stillpoint.datasets.earth import local_declination
from stillpoint.datasets.recording import Floats, Recording
from stillpoint.smoother.attitude.build import Graph, build_graph, build_start_values
from stillpoint.smoother.attitude.chain import join_chains
from stillpoint.smoother.attitude.evidence import Evidence, has_known_base_pose, turn_start_round
from stillpoint.smoother.attitude.keys import Keys
from stillpoint.smoother.attitude.long.kept_windows import KeptWindows, Window, name_windows, pack_window, unpack_window
from stillpoint.smoother.attitude.long.past import Past, continue_attitudes, hand_over, resume_values
from stillpoint.smoother.attitude.outside.added import Added, find_effective, measure_added, select_added
from stillpoint.smoother.attitude.outside.satellite import find_believed_fixes
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
from stillpoint.smoother.attitude.samples.every_sample import Piece, make_piece
from stillpoint.smoother.attitude.solve import begin, iterate, solve


@dataclass(frozen=True, eq=False)
class Solved:
    """The solved graph of a recording: one piece for each window."""

    pieces: list[Piece]
    fit: Fit
    params: GraphParams  # with the sensor priors that were used
    n_doubtful_fixes: int = 0  # fixes that lose more than half of their weight, summed over the windows


_LEAST_OVERLAP = 2  # states


def solve_both_headings(
    recording: Recording, evidence: Evidence, params: GraphParams, kept: KeptWindows | None = None
) -> Solved:
    """Solve from the start value, and once more with its heading rotated by 180 deg if the field then points south.

    This happens where the magnetometer covers little of the recording, so that the start value has no heading.
    Windows that are ``kept`` are not solved again, and others are added to them as they are solved. Raises
    :class:`Contradiction` when the field points south from both headings.
    """
    solved = _solve_windows(recording, evidence, params, kept)
    if _field_points_north(solved.pieces, recording, evidence):
        return solved
    solved = _solve_windows(recording, turn_start_round(evidence), params, kept)
    if not _field_points_north(solved.pieces, recording, evidence):
        raise Contradiction(recording.name, "the field points away from north, wherever the heading begins")
    return solved


def _solve_windows(recording: Recording, evidence: Evidence, params: GraphParams, kept: KeptWindows | None) -> Solved:
    """Solve window by window; each window begins with everything that the windows before it have found.

    Raises :class:`Unobservable` when a window has no unique optimum or one that no sensor can have produced.
    """
    bounds = split_windows(evidence.keys, params.keys)
    solved: list[Window] = []
    past: Past | None = None
    store = kept if len(bounds) > 1 else None
    names = [""] * len(bounds) if store is None else name_windows(evidence, params, len(bounds))
    for name, bound in zip(names, bounds, strict=True):
        found = None if store is None else store.get(name)
        window = unpack_window(found) if found else _solve_window(recording, evidence, bound, past, params)
        if store is not None and found is None:
            store[name] = pack_window(window, len(bounds))
        past = window.past
        solved.append(replace(window, past=None))
    fit = average_fits([window.fit for window in solved])
    return Solved([window.piece for window in solved], fit, params, sum(one.n_doubtful_fixes for one in solved))


def _solve_window(
    recording: Recording, evidence: Evidence, bound: tuple[int, int, int], past: Past | None, params: GraphParams
) -> Window:
    """Return the solution of one window, after its ``past``; errors as of :func:`_solve_windows`."""
    first, until, end = bound
    window, closed = evidence.within(first, end), evidence.within(first, until)
    start_bias = evidence.start.gyro_bias_b_radps
    bias = start_bias if past is None else past.gyro_bias_b_radps
    before = build_graph(recording, closed, bias, params)
    parts = [before]
    if until < end:
        parts.append(build_graph(recording, evidence.within(until, end), bias, params))
    added = select_added(evidence.added, window.keys.states, window.keys.held)
    votes = window.find_votes()
    problem = window.keys.held, window.measured, recording.name
    approach = begin(*start_window(window, past, added, params), params)
    if votes is not None:
        wide = with_wide_votes(params)
        graph = _push_added(join_graphs(parts, votes, past, wide), added)
        approach = iterate(graph, approach, *problem, wide)
    graph = _push_added(join_graphs(parts, votes, past, params), added)
    solution = solve(graph, approach, *problem, params)
    fit = measure_fit(graph, len(added), solution, window.keys, params)
    fit = replace(fit, squares=fit.squares | measure_added(added, solution.values))
    refuse_contradictions(fit, solution, start_bias, recording.info, recording.name, params)
    n_doubtful_fixes = 0
    if window.fixes is not None:
        believed = find_believed_fixes(window.fixes, solution.values, params.gps)
        refuse_fixes(believed, recording.name)
        n_doubtful_fixes = int((~believed).sum())
    piece = make_piece(window, solution, until, recording.name, params)
    after: Past | None = None
    if until < end:
        closing = select_added(evidence.added, closed.keys.states, closed.keys.held)
        graph = _push_added(join_graphs([before], closed.find_votes(), past, params), closing)
        interval = join_chains([part.chain for part in parts]).interval
        after = hand_over(graph, closed, window.keys.held, interval, solution, recording.name, params)
    return Window(piece, fit, n_doubtful_fixes, after)


def split_windows(keys: Keys, params: KeyParams) -> list[tuple[int, int, int]]:
    """Return for each window its first state, the first state of the next window, and its end.

    All windows have the same length, at most ``window_s``. Keys that hold a part of the states begin with the first.
    """
    n = keys.states.stop
    length_s = keys.t_s[n - 1] - keys.t_s[0]
    overlap_s = min(params.overlap_s, params.window_s / 2)
    count = int(np.ceil((length_s - overlap_s) / (params.window_s - overlap_s)))
    if count <= 1:
        return [(0, n, n)]
    begin_s = keys.t_s[0] + (length_s - overlap_s) / count * np.arange(count)
    first = np.append(np.searchsorted(keys.t_s[:n], begin_s), n)
    end = np.append(np.searchsorted(keys.t_s[:n], begin_s[1:] + overlap_s), n)
    end[:-1] = np.minimum(np.maximum(end[:-1], first[1:-1] + _LEAST_OVERLAP), n)  # a gap may take up the overlap
    windows = np.flatnonzero(np.diff(first) > 0)  # or a whole window
    return [(int(first[k]), int(first[k + 1]), int(end[k])) for k in windows]


def _push_added(graph: Graph, added: list[Added]) -> Graph:
    """Return the graph with the added factors at its end, and the effective biases that they have as unknowns."""
    for one in added:
        graph.others.push_back(one.factor)
    return replace(graph, chain=graph.chain.with_explicit(find_effective(added)))


def join_graphs(parts: Sequence[Graph], votes: Votes | None, past: Past | None, params: GraphParams) -> Graph:
    """Return one graph of stretches of states, the votes of their returns, and what the past leaves."""
    others = gtsam.NonlinearFactorGraph()
    for part in parts:
        others.push_back(part.others)
    for vote in () if votes is None else vote_factors(votes, params):
        others.push_back(vote)
    return Graph(join_chains([part.chain for part in parts]), others, None if past is None else past.inherited)


def start_window(
    window: Evidence, past: Past | None, added: Sequence[Added], params: GraphParams
) -> tuple[gtsam.Values, Floats]:
    """Return the start values of a window and its effective biases (m, 6).

    They are those of the evidence, overwritten by the past where the two overlap.
    """
    q_nb = window.q_nb if past is None else continue_attitudes(past, window)
    bias = window.start.gyro_bias_b_radps if past is None else past.gyro_bias_b_radps
    of_added = find_effective(added)
    values = build_start_values(window, q_nb, bias, of_added, params)
    intervals = window.keys.intervals(~window.keys.gap)
    effective = np.tile(np.concatenate([np.zeros(3), bias]), (len(intervals), 1))
    if past is not None:
        resume_values(values, past, window.keys, params)
        _, here, before = np.intersect1d(intervals, past.interval, assume_unique=True, return_indices=True)
        effective[here] = past.effective[before]
    for i, each in zip(of_added, effective[np.searchsorted(intervals, of_added)], strict=True):
        values.update(C(i), gtsam.imuBias.ConstantBias(each[:3], each[3:]))
    return values, effective


def _field_points_north(pieces: list[Piece], recording: Recording, evidence: Evidence) -> bool:
    """Return whether the local field points to the north of the declination; True if the field is not the heading."""
    field_n_ut = pieces[-1].calibration.field_n_ut
    if field_n_ut is None or has_known_base_pose(recording, evidence) or evidence.fixes is not None:
        return True
    azimuth, _ = local_declination(recording.info)
    return bool(field_n_ut[0] * np.sin(azimuth) + field_n_ut[1] * np.cos(azimuth) > 0)
