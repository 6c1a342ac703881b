"""The bench of many recordings: a failure ends it, and the start of a process is no part of the rate."""

import pytest

from stillpoint.datasets.errors import StillpointError
from stillpoint.scripts.bench.scale import _find_steady_rate, _run_all
from stillpoint.scripts.shared.flags import LOCAL


def test_an_input_that_fails_ends_the_bench():
    with pytest.raises(StillpointError, match=r"bench scale: a defect of stillpoint: ValueError"):
        _run_all(int, ["no number"], LOCAL)


def test_the_steady_rate_leaves_out_what_comes_before_the_first_outcome_of_a_process():
    arrived = [(1, 30.0), (2, 33.0), (1, 31.0), (2, 35.0), (1, 32.0), (3, 99.0)]  # 3 did one, which tells nothing
    assert _find_steady_rate(arrived) == 1.0 + 0.5
