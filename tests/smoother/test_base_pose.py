"""Which rests count as returns to the base pose."""

import numpy as np

from stillpoint.datasets import Imu, Recording
from stillpoint.smoother.base_pose import ReturnParams, find_base_pose, find_returns
from stillpoint.smoother.strapdown import GyroErrors

STEP_S = 0.01
RESTS_S = ((0.0, 5.0), (6.0, 11.0), (21.0, 26.0))


def test_a_rest_after_a_tap_is_no_return_and_one_after_a_turn_is():
    """Between the first two rests the sensor is shaken by 0.2 deg, before the third it turns by 90 deg and back."""
    t_s = np.arange(0.0, 26.1, STEP_S)
    rate = np.zeros((len(t_s), 3))
    tap, turn = (t_s > 5.0) & (t_s < 6.0), (t_s > 11.0) & (t_s < 21.0)
    rate[tap, 0] = np.deg2rad(0.2) * 2 * np.pi * np.cos(2 * np.pi * (t_s[tap] - 5.0))
    rate[turn, 2] = np.deg2rad(90.0) * np.pi / 10 * np.cos(np.pi * (t_s[turn] - 11.0) / 10)
    imu = Imu(np.round(t_s * 1e9).astype(np.int64), rate, np.tile([0.0, 0.0, 9.81], (len(t_s), 1)))
    recording = Recording("tapped", imu=imu)
    rests_ns = np.round(np.array(RESTS_S) * 1e9).astype(np.int64)
    base = find_base_pose(recording, rests_ns, ReturnParams())
    found = find_returns(recording, rests_ns, base, GyroErrors(), ReturnParams())
    assert [verdict.accepted for verdict in found.verdicts] == [False, True]
    assert "not moved since the rest before" in found.verdicts[0].reason
    assert len(found.spans) == 1
