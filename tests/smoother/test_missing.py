"""Short gaps: what stands in for the missing samples, how far it may be wrong, and what a reference makes of it."""

import numpy as np
import pytest
from known_motion import without

from stillpoint.datasets.simulate import simulate
from stillpoint.scoring import score
from stillpoint.smoother import reference
from stillpoint.smoother.missing import bridge_gaps

STEP_S = 0.01


def test_without_a_gap_nothing_changes():
    values = np.random.default_rng(0).normal(size=(50, 3))
    filled, wrong = bridge_gaps(np.full(50, STEP_S), values, np.ones(50, bool))
    assert filled is values
    assert not wrong.any()


def test_a_straight_line_is_bridged_exactly():
    """The mean over the gap is the mean of its ends, and the recording shows that it always is."""
    t_s = np.arange(200) * STEP_S
    keep = (t_s < 0.8) | (t_s > 1.1)
    values = np.outer(t_s, [1.0, -2.0, 0.5])[keep]
    filled, wrong = bridge_gaps(np.diff(t_s[keep], prepend=-STEP_S), values, np.ones(keep.sum(), bool))
    after = np.flatnonzero(np.diff(t_s[keep]) > 0.1)[0] + 1
    np.testing.assert_allclose(filled[after], (values[after - 1] + values[after]) / 2)
    assert np.delete(np.abs(filled - values), after, axis=0).max() == 0
    assert wrong[after].max() < 0.2  # the one place where the line breaks is the gap itself


@pytest.mark.parametrize("length_s", [0.06, 0.1, 0.2, 0.4])
def test_how_wrong_a_bridge_may_be_is_read_off_the_motion(length_s):
    """Of a sine the mean over T less the mean of its ends has an RMS of (sin x / x - cos x) / sqrt(2), x = pi f T.

    Half a step more, 0.03 of the amplitude a radian: a reading is of the interval before its stamp.
    """
    t_s = np.arange(3000) * STEP_S
    values = np.repeat(np.sin(2 * np.pi * t_s)[:, None], 3, axis=1)
    keep = (t_s <= 10) | (t_s > 10 + length_s)
    dt_s = np.diff(t_s[keep], prepend=-STEP_S)
    _, wrong = bridge_gaps(dt_s, values[keep], np.ones(keep.sum(), bool))
    x = np.pi * dt_s.max()
    assert wrong.max() == pytest.approx((np.sin(x) / x - np.cos(x)) / np.sqrt(2), rel=0.1, abs=0.015)


@pytest.mark.slow
def test_covariance_of_a_violent_hand_with_a_short_gap_is_consistent():
    """Over four hands, in the band that is asked of each kind of recording; no single one is below 0.75."""
    scores = []
    for seed in (1, 2, 3, 4):
        hand = simulate("phone-3", seed=seed, minutes=1.6)
        scores.append(score(reference(without(hand, 70.0, 70.2)), hand.truth, "heading"))
    assert 0.4 < np.mean([one.nees_per_dof for one in scores]) < 1.5
    assert np.mean([one.coverage95 for one in scores]) > 0.85
    assert min(one.coverage95 for one in scores) > 0.75


@pytest.mark.slow
@pytest.mark.parametrize("length_s", [0.1, 0.2, 0.4])
@pytest.mark.parametrize("start_s", [66.0, 70.0])
def test_a_short_gap_in_a_violent_hand_costs_tenths_of_a_degree(hand, start_s, length_s):
    """It cost up to 24 deg when the last rate was held, at a covariance that knew nothing of it."""
    hand = simulate("phone-3", seed=1, minutes=1.6)
    made = reference(without(hand, start_s, start_s + length_s))
    found = score(made, hand.truth, "heading")
    assert found.total_rmse_deg < 1.2
    assert made.diagnostics["gaps"] == 1
    assert made.diagnostics["longest_gap_s"] == pytest.approx(length_s, abs=0.03)
