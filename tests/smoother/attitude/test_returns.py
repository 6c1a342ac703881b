"""Returns to the base pose: each rest votes on one common pose, and the majority decides on the heading."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, X
from scipy.spatial.transform import Rotation

from stillpoint.datasets.frames import heading_rotation, quaternion, rotation
from stillpoint.datasets.trajectory import BasePoseReturn
from stillpoint.smoother.attitude.params import GraphParams
from stillpoint.smoother.attitude.returns import Votes, judge_returns_again, vote_factors
from stillpoint.smoother.base_pose import BasePose, Returns

PARAMS = GraphParams()
POSE = Rotation.from_euler("ZYX", [0.7, 0.2, -0.4])
UP_B = POSE.as_matrix()[2]


def values_of(turns_rad, tilt_rad=0.0):
    """The common pose, and rests that are turned about the vertical and tilted against it."""
    values = gtsam.Values()
    values.insert(L(0), gtsam.Pose3(gtsam.Rot3(POSE.as_matrix()), np.zeros(3)))
    for i, turn in enumerate(turns_rad):
        turned = heading_rotation(turn) * Rotation.from_rotvec([tilt_rad, 0.0, 0.0]) * POSE
        values.insert(X(i), gtsam.Pose3(gtsam.Rot3(turned.as_matrix()), np.zeros(3)))
    return values


def test_a_vote_measures_the_heading_by_itself():
    """One sd of heading costs the Cauchy loss of 1 sd, whatever the tilt of the pose; the tilt factor sees nothing."""
    sd = PARAMS.returns.heading_sd_rad
    tilt, heading = vote_factors(Votes((0,), UP_B), PARAMS)
    assert tilt.error(values_of([0.0])) == pytest.approx(0.0, abs=1e-12)
    assert heading.error(values_of([sd])) == pytest.approx(0.5 * np.log(2), rel=1e-3)
    assert tilt.error(values_of([sd])) < 1e-5
    tilted = values_of([0.0], tilt_rad=PARAMS.returns.repeat_sd_rad)
    assert tilt.error(tilted) == pytest.approx(0.5, rel=0.06)
    assert heading.error(tilted) < 1e-5


def test_agreeing_returns_outvote_a_turned_one():
    """Three rests at 0 and one turned by 2.5 deg: the common heading stays within a sixth of the turned one's vote."""
    factors = list(vote_factors(Votes((0, 1, 2, 3), UP_B), PARAMS))
    turns = [0.0, 0.0, 0.0, np.deg2rad(2.5)]

    def cost(common_rad):
        values = values_of(turns)
        values.update(L(0), gtsam.Pose3(gtsam.Rot3((heading_rotation(common_rad) * POSE).as_matrix()), np.zeros(3)))
        return sum(factor.error(values) for factor in factors)

    grid = np.deg2rad(np.linspace(-0.5, 3.0, 701))
    assert np.rad2deg(grid[int(np.argmin([cost(angle) for angle in grid]))]) < 0.4 / 6


@pytest.mark.parametrize(("turn_deg", "accepted"), [(0.3, True), (-0.3, True), (2.0, False)])
def test_verdicts_state_the_heading_of_each_return(turn_deg, accepted):
    accepted_at_first = BasePoseReturn(20, 30, 0.0, True, "gravity 0.1 deg off the base's")
    elsewhere = BasePoseReturn(40, 50, 0.5, False, "another pose")
    base = BasePose(quaternion(POSE), 0, 10, np.zeros(3), np.zeros(3), "")
    returns = Returns((accepted_at_first, elsewhere, accepted_at_first), ((20, 30), (60, 70)), ())
    q_nb = np.tile(quaternion(POSE), (80, 1))
    q_nb[15:35] = quaternion(heading_rotation(np.deg2rad(turn_deg)) * rotation(q_nb[15:35]))
    verdicts = judge_returns_again(base, returns, q_nb, quaternion(POSE), PARAMS)
    assert [each.accepted for each in verdicts] == [accepted, False, True]
    assert f"{turn_deg:+.2f} deg" in verdicts[0].reason
    assert verdicts[1] == elsewhere
    lone = judge_returns_again(base, replace(returns, verdicts=(accepted_at_first,), spans=((60, 70),)), q_nb,
                               quaternion(POSE), PARAMS)  # fmt: skip
    assert "alone test its heading" in lone[0].reason
