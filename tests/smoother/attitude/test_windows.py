"""Windows of a long recording: what one hands over to the next, and how they are joined."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import H, M, X

from stillpoint.datasets.frames import rotation
from stillpoint.datasets.recording import Recording
from stillpoint.datasets.trajectory import compute_total_sd_rad
from stillpoint.smoother.attitude.build import Graph, build_graph
from stillpoint.smoother.attitude.evidence import Evidence, gather_evidence
from stillpoint.smoother.attitude.graph import reference_from_evidence
from stillpoint.smoother.attitude.linear.elimination import eliminate, optimise
from stillpoint.smoother.attitude.linear.inverse import compute_covariances
from stillpoint.smoother.attitude.linear.structure import find_structure
from stillpoint.smoother.attitude.long.past import Past, hand_over
from stillpoint.smoother.attitude.params import HANDHELD, GraphParams
from stillpoint.smoother.attitude.solve import SIZES, begin, linearise, solve
from stillpoint.smoother.attitude.windows import join_graphs, split_windows, start_window


@pytest.fixture(scope="module")
def evidence(swings: Recording) -> Evidence:
    return gather_evidence(swings, HANDHELD)


def test_windows_cover_all_states_and_share_no_factor(evidence: Evidence, windowed: GraphParams) -> None:
    keys = evidence.keys
    windows = split_windows(keys, windowed.keys)
    assert len(windows) == 3
    own = np.concatenate([np.arange(first, until) for first, until, _ in windows])
    np.testing.assert_array_equal(own, np.arange(len(keys.t_s)))
    for first, until, end in windows:
        assert keys.t_s[min(end, len(keys.t_s) - 1)] - keys.t_s[first] <= windowed.keys.window_s + 1.0
        assert set(keys.within(first, until).states).isdisjoint(keys.within(until, end).states)
    assert split_windows(keys, HANDHELD.keys) == [(0, len(keys.t_s), len(keys.t_s))]


def build(recording: Recording, window: Evidence, past: Past | None) -> tuple[Graph, gtsam.Values, np.ndarray]:
    """Return the graph of a window, its start values, and its effective biases."""
    bias = window.start.gyro_bias_b_radps if past is None else past.gyro_bias_b_radps
    graph = join_graphs([build_graph(recording, window, bias, HANDHELD)], window.find_votes(), past, HANDHELD)
    return graph, *start_window(window, past, (), HANDHELD)


@pytest.mark.slow
def test_past_handed_over_holds_all_information_of_its_factors(swings: Recording, evidence: Evidence) -> None:
    """At the optimum of the whole graph, the later half with the reduced past has the same covariances and step."""
    n, held = len(evidence.keys.t_s), evidence.keys.held
    graph, *start = build(swings, evidence, None)
    whole = solve(graph, begin(*start, HANDHELD), held, evidence.measured, "whole", HANDHELD)
    closed, later = evidence.within(0, n // 2), evidence.within(n // 2, n)
    interval = graph.chain.interval
    past = hand_over(build(swings, closed, None)[0], closed, held, interval, whole, "whole", HANDHELD)
    rest, resumed, effective = build(swings, later, past)
    settings = whole.field_scale_ut, HANDHELD
    measured = whole.measured.at(later.keys.states)
    system, _ = linearise(rest, resumed, effective, later.keys.held, measured, *settings)
    there, _ = linearise(graph, whole.values, whole.effective, held, whole.measured, *settings)
    keys = [M(0), H(0), X(n // 2), X(3 * n // 4), X(n - 1)]
    found = []
    for rows in (there, system):
        eliminated = eliminate(find_structure(rows, SIZES), rows)
        step, at = optimise(eliminated), eliminated.structure.scalars
        covariances = compute_covariances(eliminated, [(key, key) for key in keys])
        found.append(
            [(step[at([k], len(c))[0]], np.sqrt(np.diagonal(c))) for k, c in zip(keys, covariances, strict=True)]
        )
    for (wanted, sd), (got, same_sd) in zip(*found, strict=True):
        np.testing.assert_allclose(same_sd, sd, rtol=1e-3)
        assert np.abs((got - wanted) / sd).max() < 0.02


@pytest.mark.slow
def test_windows_agree_with_the_whole_recording(swings: Recording, evidence: Evidence, windowed: GraphParams) -> None:
    """Windows of 60 s see less of the future than one graph does: on average they agree within its sd."""
    whole, parts = (reference_from_evidence(swings, evidence, params) for params in (HANDHELD, windowed))
    assert parts.diagnostics["windows"] == 3
    assert [each.accepted for each in parts.returns] == [each.accepted for each in whole.returns] != []
    apart_rad = np.linalg.norm((rotation(whole.q_nb).inv() * rotation(parts.q_nb)).as_rotvec(), axis=1)
    assert np.mean(apart_rad / compute_total_sd_rad(whole.cov_b_rad2)) < 1.0
    steps_rad = (rotation(parts.q_nb[:-1]).inv() * rotation(parts.q_nb[1:])).magnitude()
    likewise_rad = (rotation(whole.q_nb[:-1]).inv() * rotation(whole.q_nb[1:])).magnitude()
    assert np.abs(steps_rad - likewise_rad).max() < np.deg2rad(0.1)  # no jump where windows meet
