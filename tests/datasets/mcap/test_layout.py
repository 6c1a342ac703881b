"""Where messages lie in a chunk, and in which order they come."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stillpoint.datasets.mcap.file import find_step, take_records, windows
from stillpoint.datasets.mcap.writer import _InTurn, _Merged


@pytest.mark.parametrize("offsets", [[0, 7, 14, 21], [3, 8, 30], [21, 14, 7], [4], []])
def test_records_are_those_at_their_offsets_whether_these_are_even_or_not(offsets: list[int]) -> None:
    data, at = bytes(range(40)), np.array(offsets, np.int64)
    assert take_records(data, 5, at).tobytes() == windows(data, 5)[at].tobytes()


def test_only_evenly_spaced_offsets_have_a_step() -> None:
    assert find_step(np.array([2, 5, 8])) == 3
    assert find_step(np.array([2, 5, 9])) == 0
    assert find_step(np.array([2])) == 0


@pytest.mark.parametrize("offsets", [[20, 30, 40], [-5, 0, 5], [0, 50]])
def test_records_beyond_the_buffer_are_refused(offsets: list[int]) -> None:
    with pytest.raises(IndexError):
        take_records(bytes(42), 5, np.array(offsets))


@given(
    st.lists(st.integers(0, 50), min_size=1, max_size=12).map(sorted),
    st.lists(st.integers(1, 9), min_size=1, max_size=4),
    st.data(),
)
def test_topics_in_turn_have_the_order_of_topics_that_are_merged(
    times: list[int], sizes: list[int], data: st.DataObject
) -> None:
    t_ns = np.array(sorted(set(times)), np.int64)  # the stamps of a topic rise
    in_turn, merged = _InTurn(t_ns, sizes), _Merged([t_ns] * len(sizes), sizes)
    assert in_turn.count == merged.count
    for m in range(merged.count):
        assert (in_turn.get_time(m), in_turn.get_end(m)) == (merged.get_time(m), merged.get_end(m))
    for size in range(1, merged.get_end(merged.count - 1) + 3):
        assert in_turn.find_end(size) == merged.find_end(size)
    for t in (*range(52), 2**63, 2**70):
        assert in_turn.find_time(t) == merged.find_time(t)
    first = data.draw(st.integers(0, merged.count - 1))
    last = data.draw(st.integers(first + 1, merged.count))
    for stream in range(len(sizes)):
        rows, offsets = in_turn.find_rows(stream, first, last)
        expected, at = merged.find_rows(stream, first, last)
        assert offsets.tolist() == at.tolist()
        assert len(offsets) == 0 or rows == expected
