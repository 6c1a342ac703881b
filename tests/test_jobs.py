"""Many inputs over processes: order is kept, users' errors are results, dead workers too, defects are raised."""

import math
import os

import pytest

from stillpoint.datasets import BadParameter
from stillpoint.datasets.earth import decimal_year
from stillpoint.scripts.jobs import run_jobs


@pytest.mark.parametrize("jobs", [1, 2])
def test_results_and_errors_come_in_the_order_of_the_inputs(jobs):
    outcomes = run_jobs(decimal_year, ["2020-01-01", "yesterday", "2022-01-01"], jobs, "years")
    assert [one.value for one in outcomes] == [2020.0, None, 2022.0]
    assert [one.error is None for one in outcomes] == [True, False, True]
    assert "'yesterday'" in outcomes[1].error


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_defect_is_raised(jobs):
    with pytest.raises(ValueError, match=r"domain|nonnegative"):
        run_jobs(math.sqrt, [4.0, -1.0], jobs, "roots")


def test_a_worker_that_dies_is_a_result():
    outcomes = run_jobs(os._exit, [3, 3], 2, "exits")
    assert all("died" in one.error for one in outcomes)


def test_nothing_to_do_is_nothing_done():
    assert run_jobs(math.sqrt, [], None, "roots") == []


def test_no_process_is_refused():
    with pytest.raises(BadParameter, match="give 1 or more"):
        run_jobs(math.sqrt, [1.0], 0, "roots")
