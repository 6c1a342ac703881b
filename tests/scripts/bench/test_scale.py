"""The bench of many recordings: a failure ends it, and times belong to the process that spent them."""

import pytest

from stillpoint.datasets.errors import StillpointError
from stillpoint.scripts.bench.scale import _run_all, _sum_by_process, _Used
from stillpoint.scripts.shared.flags import LOCAL


def test_an_input_that_fails_ends_the_bench():
    with pytest.raises(StillpointError, match=r"bench scale: a defect of stillpoint: ValueError"):
        _run_all(int, ["no number"], LOCAL)


def test_seconds_are_summed_by_process():
    used = [_Used(1, 2.0, 1.0, 0.0, 10), _Used(2, 5.0, 4.0, 0.0, 10), _Used(1, 3.0, 1.0, 0.0, 10)]
    assert _sum_by_process(used) == {1: 5.0, 2: 5.0}
