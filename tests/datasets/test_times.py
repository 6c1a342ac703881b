"""Gaps and spans of stamps, against a count by hand and against the plain definition."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stillpoint.datasets.times import GAP_STEPS, find_gaps, find_longest_step_ns, is_inside


def test_an_interval_is_a_gap_from_more_than_five_median_steps_on():
    t_ns = np.array([0, 10, 20, 30, 80, 90, 141, 151], dtype=np.int64)
    assert find_longest_step_ns(t_ns) == GAP_STEPS * 10
    assert find_gaps(t_ns).tolist() == [False, False, False, False, False, True, False]


@pytest.mark.parametrize("t_ns", [[7], [7, 9]])
def test_one_or_two_stamps_have_no_gap(t_ns):
    assert not find_gaps(np.array(t_ns, dtype=np.int64)).any()
    assert len(find_gaps(np.array(t_ns))) == len(t_ns) - 1


stamps = st.lists(st.integers(0, 200), min_size=1, max_size=30, unique=True).map(sorted)
spans = st.lists(st.tuples(st.integers(-10, 210), st.integers(0, 50)), max_size=4)


@given(stamps, spans)
def test_samples_inside_intervals_are_found(t_ns, starts):
    spans_ns = np.array([(first, first + length) for first, length in starts], dtype=np.int64).reshape(-1, 2)
    expected = [any(first <= t <= last for first, last in spans_ns) for t in t_ns]
    assert is_inside(np.array(t_ns), spans_ns).tolist() == expected
