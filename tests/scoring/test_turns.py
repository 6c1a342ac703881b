"""Errors of turns over a given time: closed forms, which samples count, and times that are none."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from swings import as_truth, swing

from stillpoint.datasets import BadParameter, Estimate, Unobservable
from stillpoint.datasets.frames import quaternion, rotation
from stillpoint.scoring import score


def test_a_heading_that_drifts_evenly_errs_by_rate_times_time():
    """And a heading that is wrong throughout errs by nothing, although none was aligned away."""
    t_ns, q_true = swing(4000)
    t_s = (t_ns - t_ns[0]) / 1e9
    drift = Rotation.from_rotvec((0.4 + np.deg2rad(0.5) * t_s)[:, None] * [0.0, 0.0, 1.0])
    drifting = Estimate(t_ns, "drifts", q_nb=quaternion(drift * rotation(q_true)))
    for turn in score(drifting, as_truth(t_ns, q_true), "none", over_s=(1.0, 4.0)).turns:
        assert turn.turns == len(t_ns) - np.searchsorted(t_s, turn.over_s)
        assert turn.rmse_deg == pytest.approx(0.5 * turn.over_s, rel=1e-6)
        assert turn.max_deg == pytest.approx(turn.rmse_deg, rel=1e-6)


def test_white_errors_count_twice_however_far_apart():
    """A turn has two ends, each with its own error: sqrt(2) times that of one attitude."""
    t_ns, q_true = swing(6000)
    noise = Rotation.from_rotvec(np.random.default_rng(3).normal(0, 0.01, (6000, 3)))
    made = Estimate(t_ns, "noisy", q_nb=quaternion(rotation(q_true) * noise))
    found = score(made, as_truth(t_ns, q_true), "none", over_s=(0.5, 5.0))
    for turn in found.turns:
        assert turn.rmse_deg == pytest.approx(np.sqrt(2) * found.total_rmse_deg, rel=0.03)


def test_only_moving_ends_count_and_no_stamp_is_far_from_where_it_should_be():
    t_ns, q_true = swing(1000)
    keep = np.ones(1000, dtype=bool)
    keep[300:600] = False
    moving = np.arange(1000) < 800
    made = Estimate(t_ns, "exact", q_nb=q_true)
    step_s = (t_ns[1] - t_ns[0]) / 1e9
    (turn,) = score(made, as_truth(t_ns[keep], q_true[keep], moving[keep]), over_s=(100 * step_s,)).turns
    # Ends: 0-299 and 600-799; both ends of a turn lie in one of the two.
    assert turn.turns == 200 + 100
    assert turn.max_deg < 1e-10


@pytest.mark.parametrize("seconds", [0.0, -1.0, float("nan"), float("inf")])
def test_an_invalid_time_is_named(seconds):
    t_ns, q_true = swing(100)
    with pytest.raises(BadParameter, match="give seconds above 0"):
        score(Estimate(t_ns, "exact", q_nb=q_true), as_truth(t_ns, q_true), over_s=(seconds,))


@pytest.mark.parametrize("seconds", [1000.0, 1e10, 1e30])
def test_a_time_longer_than_the_recording_is_said(seconds):
    t_ns, q_true = swing(100)
    with pytest.raises(Unobservable, match="give a shorter time"):
        score(Estimate(t_ns, "exact", q_nb=q_true), as_truth(t_ns, q_true), over_s=(seconds,))


def test_a_time_shorter_than_a_step_is_said():
    t_ns, q_true = swing(100)
    step_s = (t_ns[1] - t_ns[0]) / 1e9
    with pytest.raises(BadParameter, match="less than a step"):
        score(Estimate(t_ns, "exact", q_nb=q_true), as_truth(t_ns, q_true), over_s=(0.4 * step_s,))
