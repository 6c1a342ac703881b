"""Scores of trajectories with few poses, and of trajectories in another convention."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation
from swings import as_reference, as_truth, swing

from stillpoint.datasets import Estimate
from stillpoint.datasets.frames import heading_rotation, quaternion, rotation
from stillpoint.scoring import compare, score


@pytest.mark.parametrize("every", [50, 200])
def test_few_poses_are_scored_at_their_own_stamps(every):
    """Poses every 0.5 or 2 s, each 1.41 deg off: the path between them is not the estimate's to answer for."""
    t_ns, q_true = swing(6000)
    off = Rotation.from_rotvec(np.deg2rad([1.0, 1.0, 0.0]))
    q_est = quaternion(rotation(q_true[::every]) * off)
    found = score(Estimate(t_ns[::every], "slam", q_nb=q_est), as_truth(t_ns, q_true), "none")
    assert found.samples == 6000 // every
    assert found.total_rmse_deg == pytest.approx(np.sqrt(2), rel=1e-6)
    assert found.total_max_deg == pytest.approx(np.sqrt(2), rel=1e-6)


def test_few_poses_keep_the_truths_mask_and_both_covariances():
    t_ns, q_true = swing(6000)
    cov = (1.0 + np.arange(30.0))[:, None, None] * np.eye(3) * 1e-4
    estimate = Estimate(t_ns[::200], "slam", q_nb=q_true[::200], cov_b_rad2=cov)
    pairs = compare(estimate, as_reference(t_ns, q_true, rests_ns=np.array([[t_ns[0], t_ns[1999]]])), "none")
    assert list(np.flatnonzero(~pairs.moving)) == list(range(10))
    np.testing.assert_allclose(pairs.cov_b_rad2, cov)
    np.testing.assert_allclose(pairs.true_cov_b_rad2, np.broadcast_to(1e-4 * np.eye(3), (30, 3, 3)))


@pytest.mark.slow
def test_the_clock_of_few_poses_is_found():
    """A random walk of attitude, which repeats nowhere, seen every half second and 2.5 s late."""
    t_ns = np.arange(12000) * 10_000_000
    walk = np.random.default_rng(9).normal(size=(12000, 3)).cumsum(axis=0) * 0.04
    q_true = quaternion(Rotation.from_rotvec(gaussian_filter1d(walk, 25, axis=0)))
    estimate = Estimate(t_ns[::50] + 2_500_000_000, "slam", q_nb=q_true[::50])
    found = score(estimate, as_truth(t_ns, q_true), "heading+mounting+time")
    assert found.alignment.time_offset_s == pytest.approx(2.5, abs=1e-3)
    assert found.total_rmse_deg < 0.1


NED = Rotation.from_matrix([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
FRD = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))
CONVENTIONS = {
    "inverse": (lambda q: q * [1, -1, -1, -1], "it is the inverse"),
    "xyzw": (lambda q: np.roll(q, -1, axis=1), "x, y, z, w where w, x, y, z was read"),
    "wxyz": (lambda q: np.roll(q, 1, axis=1), "w, x, y, z where x, y, z, w was read"),
    "ned": (lambda q: quaternion(NED * rotation(q)), "its world is North-East-Down:"),
    "ned-frd": (lambda q: quaternion(NED * rotation(q) * FRD), "North-East-Down and its body forward-right-down"),
    "left-handed": (lambda q: q * [1, -1, 1, -1], "it is left-handed (y mirrored)"),
}


@pytest.mark.parametrize("name", CONVENTIONS)
def test_an_error_that_a_fixed_conversion_explains_is_named(name):
    change, words = CONVENTIONS[name]
    t_ns, q_true = swing(3000)
    q_est = quaternion(heading_rotation(0.3) * rotation(q_true) * Rotation.from_rotvec([0.02, 0.0, 0.01]))
    found = score(Estimate(t_ns, name, q_nb=change(q_est)), as_truth(t_ns, q_true))
    assert found.total_rmse_deg > 20
    assert words in found.conversion
    assert score(Estimate(t_ns, name, q_nb=q_est), as_truth(t_ns, q_true)).conversion is None


def test_a_bad_estimate_is_not_explained_away():
    """An attitude of another motion is far off in every convention."""
    t_ns, q_true = swing(3000)
    rng = np.random.default_rng(5)
    q_est = quaternion(Rotation.from_rotvec(rng.normal(size=(3000, 3)).cumsum(axis=0) * 0.05))
    found = score(Estimate(t_ns, "e", q_nb=q_est), as_truth(t_ns, q_true))
    assert found.total_rmse_deg > 50
    assert found.conversion is None
