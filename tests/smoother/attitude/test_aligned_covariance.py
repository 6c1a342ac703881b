"""The stated covariance is that of the errors which are left after a score has aligned heading and mounting."""

from dataclasses import replace

import numpy as np
import pytest
from gtsam.symbol_shorthand import X
from scipy.spatial.transform import Rotation

from stillpoint.datasets.frames import quaternion
from stillpoint.datasets.recording import Floats
from stillpoint.datasets.simulate import simulate
from stillpoint.scoring.align import AlignKind, align_pairs
from stillpoint.scoring.errors import compute_normalised_square, compute_rotation_error_b
from stillpoint.smoother.attitude.build import build_graph
from stillpoint.smoother.attitude.covariance import compute_accuracy
from stillpoint.smoother.attitude.evidence import gather_evidence
from stillpoint.smoother.attitude.linear.elimination import eliminate, optimise
from stillpoint.smoother.attitude.params import HANDHELD
from stillpoint.smoother.attitude.solve import Solution, begin, rotations_of, solve
from stillpoint.smoother.attitude.windows import join_graphs, start_window

_DRAWS = 30
_SMALL = 1e-2  # errors are made so much smaller, and covariances by its square, that the model is linear


def _draw_errors(solution: Solution, states: np.ndarray, rng: np.random.Generator) -> Floats:
    """Return errors (n, 3) of states in body axes: the solution of the linear factors with noise of one sd."""
    rows, structure = solution.rows, solution.structure
    columns = np.add.reduceat(structure.key_size[structure.number], structure.key_first[:-1]) + 1
    right = np.cumsum(np.repeat(columns, rows.count)) - 1
    data = rows.data.copy()
    data[right] = rng.normal(size=len(right))
    step = optimise(eliminate(structure, replace(rows, data=data)))
    return np.asarray(step[structure.scalars([X(int(i)) for i in states], 3)])


@pytest.mark.slow
def test_errors_drawn_from_the_graph_fit_the_covariance_once_they_are_aligned() -> None:
    """NEES/3 of one draw scatters by 0.3, so that of 30 draws by 0.06. Unaligned errors are far larger than stated."""
    recording = replace(simulate("phone-3", seed=3, minutes=2.0), base_pose=None)
    evidence = gather_evidence(recording, HANDHELD)
    bias, votes = evidence.start.gyro_bias_b_radps, evidence.find_votes()
    graph = join_graphs([build_graph(recording, evidence, bias, HANDHELD)], votes, None, HANDHELD)
    start = begin(*start_window(evidence, None, (), HANDHELD), HANDHELD)
    held = evidence.keys.held
    solution = solve(graph, start, held, evidence.measured, recording.name, HANDHELD)
    moving = np.array(held)[~np.append(evidence.keys.at_rest, evidence.keys.at_rest[-1])]
    accuracy = compute_accuracy(solution, moving, moving, (), recording.name, HANDHELD, with_velocity=False)

    rng = np.random.default_rng(4)
    found = Rotation.from_matrix(rotations_of(solution.values, moving))
    nees: dict[AlignKind, list[float]] = {"none": [], "heading+mounting": []}
    for _ in range(_DRAWS):
        errors = _SMALL * _draw_errors(solution, moving, rng)
        q_est, q_true = quaternion(found), quaternion(found * Rotation.from_rotvec(errors))
        for kind, values in nees.items():
            aligned = align_pairs(q_est, q_true, kind).attitude(q_est)
            left = compute_rotation_error_b(aligned, q_true)
            values.append(float(compute_normalised_square(left, _SMALL**2 * accuracy.attitude_b_rad2).mean() / 3))
    assert 0.8 < np.mean(nees["heading+mounting"]) < 1.2
    assert np.mean(nees["none"]) > 2.0
