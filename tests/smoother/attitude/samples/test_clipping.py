"""Readings at the end of a sensor's range, and what is put in their place."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stillpoint.smoother.attitude.samples.clipping import FARTHEST, UNSEEN_SHARE, extend_clipped, find_range_ends

T_S = np.arange(2000) / 200


def swings(amplitude: float, period_s: float, phase: float) -> np.ndarray:
    angle = 2 * np.pi * T_S / period_s + phase
    return amplitude * np.stack([np.sin(angle), np.cos(angle), 0.1 * np.sin(2 * angle)], axis=1)


@given(
    amplitude=st.floats(10.0, 30.0),
    limit=st.floats(8.0, 9.9),
    period_s=st.floats(0.3, 4.0),
    phase=st.floats(0.0, 6.3),
)
def test_what_is_not_clipped_is_not_touched_and_the_rest_goes_outward(amplitude, limit, period_s, phase):
    whole = swings(amplitude, period_s, phase)
    cut = np.clip(whole, -limit, limit)
    made, wrong = extend_clipped(T_S, cut, 5.0)
    clipped = np.abs(cut) >= limit * (1 - 1e-9)
    np.testing.assert_array_equal(made[~clipped], cut[~clipped])
    assert not wrong[~clipped].any()
    assert (np.sign(cut[clipped]) * (made - cut)[clipped] >= 0).all()
    assert np.abs(made).max() <= (1 + FARTHEST) * limit
    assert (wrong[clipped] >= UNSEEN_SHARE * limit).all()


@pytest.mark.parametrize(("limit", "left"), [(9.0, 0.15), (7.0, 0.05), (5.0, 0.1)])
def test_the_peak_of_a_sine_comes_back(limit, left):
    """Cut at 0.9, 0.7 and 0.5 of its height: of what was lost to an integral, this share still is."""
    whole = swings(10.0, 1.0, 0.4)[:, :1]
    cut = np.clip(whole, -limit, limit)
    made, _ = extend_clipped(T_S, cut, 4.0)
    one = (T_S > 0.1) & (T_S < 0.3)  # the first crest
    lost, found = (whole - cut)[one].sum(), (made - cut)[one].sum()
    assert abs(found / lost - 1) < left


def test_each_end_of_the_range_has_its_own_limit():
    """A phone's y axis ends at +19.55 and -19.45: its maker took an offset off."""
    cut = np.clip(swings(30.0, 1.0, 0.0), -19.45, 19.55)
    limits = find_range_ends(cut, 19.0)
    assert sorted(set(limits[:, 1])) == [-19.45, 0.0, 19.55]
    np.testing.assert_array_equal(limits[:, 1] != 0, (cut[:, 1] == 19.55) | (cut[:, 1] == -19.45))


def test_a_few_equal_readings_are_chance():
    noise = np.random.default_rng(1).normal(0.0, 10.0, (2000, 3))
    assert not find_range_ends(noise, 5.0).any()
    noise[100:104, 0] = 60.0
    assert not find_range_ends(noise, 5.0).any()
    noise[104, 0] = 60.0
    assert find_range_ends(noise, 5.0)[:, 0].sum() == 5 * 60.0


def test_clipped_from_the_first_sample_to_the_last_is_left_as_it_is():
    """No slope is known: nothing is made up, but it is said to be uncertain."""
    made, wrong = extend_clipped(T_S, np.full((2000, 3), 8.0), 5.0)
    np.testing.assert_array_equal(made, 8.0)
    np.testing.assert_allclose(wrong, UNSEEN_SHARE * 8.0)


def test_an_edge_beside_a_gap_has_no_slope():
    whole = swings(10.0, 1.0, 0.4)
    cut = np.clip(whole, -7.0, 7.0)
    keep = ~((cut[:, 0] < 7.0) & (T_S < 0.5))  # all before the first crest, and what comes after it, is missing
    made, wrong = extend_clipped(T_S[keep], cut[keep], 5.0)
    first = T_S[keep] < 0.5
    np.testing.assert_array_equal(made[first, 0], 7.0)
    assert (wrong[first, 0] > 0).all()
