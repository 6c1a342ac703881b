"""What is gathered piece by piece is what the whole says."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stillpoint.datasets.running import RunningClock, ThinnedValues
from stillpoint.datasets.times import GAP_STEPS, find_gaps


@given(st.lists(st.integers(0, 40), max_size=8), st.integers(1, 9))
def test_which_values_are_kept_depends_on_their_places_alone(lengths, most):
    values = np.arange(sum(lengths))
    kept = ThinnedValues(most)
    for end, n in zip(np.cumsum(lengths), lengths, strict=True):
        kept.add(values[end - n : end])
    assert kept.count == len(values)
    assert kept.values().tolist() == values[:: kept.stride].tolist()
    assert len(kept.values()) <= most
    assert kept.stride == 1 or 2 * len(kept.values()) > most - 1, "no more is thrown away than must be"


def test_the_median_of_a_long_column_is_near_that_of_all():
    """Of 2^16 kept values of a normal column the median has an sd of 1.25 / 2^8 = 0.005."""
    values = np.random.default_rng(0).normal(size=1_000_000)
    kept = ThinnedValues(1 << 16)
    for part in np.array_split(values, 13):
        kept.add(part)
    assert abs(np.median(kept.values()) - np.median(values)) < 0.02


def facts_in_pieces(t_ns, count):
    clock = RunningClock(GAP_STEPS)
    for part in np.array_split(t_ns, count):
        clock.add(part)
    if not clock.has_all_gaps:
        again = RunningClock(GAP_STEPS, clock.median_step_ns)
        for part in np.array_split(t_ns, count):
            again.add(part)
        clock = again
    return clock.facts()


@pytest.mark.parametrize("count", [1, 2, 7])
@pytest.mark.parametrize(
    "steps",
    [
        [10] * 50 + [60] + [10] * 30 + [51, 50, 49] + [10] * 20,  # a gap is longer than five steps
        [1000] * 30 + [100] * 300,  # a receiver that becomes ten times as fast: its slow steps are gaps by the whole
        [100] * 30 + [1000] * 300,
        [7],
    ],
)
def test_a_clock_in_pieces_has_the_gaps_of_the_whole(steps, count):
    t_ns = 5 + np.cumsum([0, *steps]).astype(np.int64)
    found = facts_in_pieces(t_ns, min(count, len(t_ns)))
    gaps = np.diff(t_ns)[find_gaps(t_ns)]
    assert (found.samples, found.first_ns, found.last_ns) == (len(t_ns), t_ns[0], t_ns[-1])
    assert found.step_ns == np.median(np.diff(t_ns))
    assert (found.gaps, found.longest_gap_ns) == (len(gaps), gaps.max(initial=0))


def test_a_single_stamp_has_no_step():
    assert facts_in_pieces(np.array([3], np.int64), 1).step_ns == 0
