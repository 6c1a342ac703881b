"""Where the graph's states stand, and what is said of the intervals between them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stillpoint.datasets import Imu
from stillpoint.smoother.attitude.keys import LONG_GAP_S, choose_keys, prepare_motion
from stillpoint.smoother.attitude.params import KeyParams

PARAMS = KeyParams()


def stream(t_s, scale=1.0):
    rng = np.random.default_rng(len(t_s))
    gyro, accel = scale * rng.standard_normal((2, len(t_s), 3))
    return Imu(np.round(np.asarray(t_s) * 1e9).astype(np.int64), gyro, accel + np.array([0.0, 0.0, 9.81]))


def rests(imu, *spans_s):
    return np.array([[imu.t_ns[0] + round(a * 1e9), imu.t_ns[0] + round(b * 1e9)] for a, b in spans_s]).reshape(-1, 2)


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(
    rate_hz=st.floats(20.0, 400.0),
    jitter=st.floats(0.0, 0.4),
    gaps_s=st.lists(st.tuples(st.floats(1.0, 9.0), st.floats(0.05, 4.0)), max_size=3),
    rest_s=st.tuples(st.floats(0.5, 8.0), st.floats(0.0, 4.0)),
)
def test_no_sample_is_left_out_and_none_is_used_twice(rate_hz, jitter, gaps_s, rest_s):
    steps = np.full(int(10 * rate_hz), 1 / rate_hz)
    t_s = np.cumsum(steps) + jitter / rate_hz * np.random.default_rng(1).uniform(-1, 1, len(steps))
    for at_s, length_s in gaps_s:
        t_s = t_s[(t_s < at_s) | (t_s > at_s + length_s)]
    imu = stream(t_s - t_s[0])
    motion = prepare_motion(imu, rests(imu, (rest_s[0], rest_s[0] + rest_s[1])))
    keys = choose_keys(motion, PARAMS)
    assert keys.row[0] == 0
    assert keys.row[-1] == len(t_s) - 1
    assert (np.diff(keys.row) > 0).all()
    moving = ~keys.at_rest & ~keys.gap
    assert (keys.span_s[moving] <= PARAMS.resting_s + LONG_GAP_S + 2 / rate_hz).all()
    turned = (keys.gyro_b_radps * keys.span_s[:, None]).sum(axis=0)
    np.testing.assert_allclose(turned, (motion.gyro_b_radps[1:] * motion.dt_s[1:, None]).sum(axis=0), atol=1e-9)


def test_states_are_dense_in_motion_and_sparse_at_rest():
    imu = stream(np.arange(3000) / 100)
    keys = choose_keys(prepare_motion(imu, rests(imu, (10.0, 20.0))), PARAMS)
    assert keys.at_rest.sum() == pytest.approx(10, abs=1)
    assert (~keys.at_rest).sum() == pytest.approx(200, abs=4)


def test_a_long_gap_has_a_state_on_either_side_and_is_not_integrated():
    t_s = np.arange(1000) / 100
    imu = stream(t_s[(t_s < 4.0) | (t_s >= 6.0)])
    keys = choose_keys(prepare_motion(imu, rests(imu)), PARAMS)
    (gap,) = np.flatnonzero(keys.gap)
    assert keys.t_s[gap] == pytest.approx(3.99)
    assert keys.t_s[gap + 1] == pytest.approx(6.0)


def test_a_clipped_interval_says_for_how_long_it_may_be_wrong():
    imu = stream(np.arange(2000) / 100, scale=10.0)
    limited = Imu(imu.t_ns, np.clip(imu.gyro_b_radps, -8.0, 8.0), imu.accel_b_mps2)
    motion = prepare_motion(limited, rests(imu))
    np.testing.assert_array_equal(motion.gyro_beyond_radps > 0, np.abs(imu.gyro_b_radps) >= 8.0)
    assert not motion.accel_beyond_mps2.any()
    keys = choose_keys(motion, PARAMS)
    wrong = motion.gyro_beyond_radps * motion.dt_s[:, None]
    np.testing.assert_allclose(keys.gyro_clipped_rad.sum(axis=0), wrong[1:].sum(axis=0))
    slow = Imu(imu.t_ns, np.clip(imu.gyro_b_radps, -2.0, 2.0), imu.accel_b_mps2)
    assert not prepare_motion(slow, rests(imu)).gyro_beyond_radps.any()  # below the smallest range a sensor has


@pytest.mark.parametrize("count", [2, 3, 10])
def test_a_handful_of_samples_is_enough(count):
    imu = stream(np.arange(count) / 100)
    keys = choose_keys(prepare_motion(imu, rests(imu)), PARAMS)
    assert len(keys.t_s) >= 2
    assert len(keys.at_rest) == len(keys.t_s) - 1


def test_the_rate_around_an_interval_is_that_of_the_motion_beside_it() -> None:
    """0.5 rad/s for 20 s, then 3 rad/s: each away from the change, the root of the mean square at it."""
    t_s = np.arange(0, 40, 0.01)
    gyro = np.zeros((len(t_s), 3))
    gyro[:, 1] = np.where(t_s < 20, 0.5, 3.0)
    imu = Imu(np.round(t_s * 1e9).astype(np.int64), gyro, np.tile([0.0, 0.0, 9.81], (len(t_s), 1)))
    keys = choose_keys(prepare_motion(imu, rests(imu)), PARAMS)
    middle_s = (keys.t_s[1:] + keys.t_s[:-1]) / 2
    np.testing.assert_allclose(keys.rate_rms_radps[middle_s < 17], 0.5, rtol=1e-6)
    np.testing.assert_allclose(keys.rate_rms_radps[middle_s > 23], 3.0, rtol=1e-6)
    at_change = keys.rate_rms_radps[np.argmin(np.abs(middle_s - 20))]
    assert at_change == pytest.approx(np.sqrt((0.5**2 + 3.0**2) / 2), abs=0.05)
