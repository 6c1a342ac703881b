"""A recording cut at a rest: each half gives what the whole gives, within its own standard deviation."""

import json
from dataclasses import replace

import numpy as np
import pytest
from known_motion import between

from stillpoint.datasets.frames import heading_rotation, rotation
from stillpoint.datasets.simulate import simulate
from stillpoint.smoother import reference

pytest.importorskip("gtsam")


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "seed"), [("phone-2", 1), ("phone-3", 2)])
def test_halves_cut_at_a_rest_are_the_whole_within_their_sd(kind, seed):
    """The whole knows all that a half knows: sample by sample they differ by less than the half's sd, beside a heading
    and a mounting that all samples share. Those, which each half takes from its own share of the field and of the
    motion, differ by less than their own sd."""
    recording = simulate(kind, seed=seed, minutes=2.5)
    cut_s = np.array(json.loads(recording.info.extra["rests_s"]))[2].mean()
    whole = reference(replace(recording, base_pose=None))
    assert len(whole.returns) >= 3
    for first_s, last_s in ((-1.0, cut_s), (cut_s, 1e9)):
        half = reference(between(recording, first_s, last_s))
        there = rotation(whole.q_nb[np.searchsorted(whole.t_ns, half.t_ns)])
        apart = (rotation(half.q_nb) * there.inv()).as_quat(scalar_first=True)
        heading_rad = float(np.mean(2 * np.arctan2(apart[:, 3], apart[:, 0])))
        assert abs(heading_rad) < np.hypot(half.heading_sd_rad, whole.heading_sd_rad)
        left_b = (rotation(half.q_nb).inv() * heading_rotation(heading_rad) * there).as_rotvec()
        mounting_b = left_b.mean(axis=0)
        of_both = half.mounting_cov_b_rad2 + whole.mounting_cov_b_rad2
        assert mounting_b @ np.linalg.solve(of_both, mounting_b) < 1.0 * 3
        left_b = left_b - mounting_b
        squares = np.einsum("ki,kij,kj->k", left_b, np.linalg.inv(half.cov_b_rad2), left_b)
        assert squares.max() < 1.0 * 3
