"""Many inputs over processes: order is kept, and a failure of any kind is the outcome of its own input alone."""

import math
import os
import signal
import time

import pytest
from farm_work import work

from stillpoint.datasets import BadParameter
from stillpoint.datasets.earth import to_decimal_year
from stillpoint.scripts.shared import jobs as jobs_module
from stillpoint.scripts.shared.flags import LOCAL, Workers
from stillpoint.scripts.shared.jobs import choose_exit_code, run_jobs


def fail_by(how: str) -> str:
    """Work of a test: dies, raises or succeeds as its input says."""
    if how.startswith("SIG"):
        os.kill(os.getpid(), getattr(signal, how))
        time.sleep(10)
    if how == "defect":
        raise ZeroDivisionError("a test's division\nby zero")
    if how == "no pickle":
        return lambda: 0
    return how


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 2])
def test_results_and_errors_keep_the_order_of_the_inputs(jobs):
    outcomes = run_jobs(to_decimal_year, ["2020-01-01", "yesterday", "2022-01-01"], Workers(jobs), "years")
    assert [one.value for one in outcomes] == [2020.0, None, 2022.0]
    assert [one.error is None for one in outcomes] == [True, False, True]
    assert "'yesterday'" in outcomes[1].error
    assert choose_exit_code(outcomes) == 2


@pytest.mark.slow
def test_a_dead_process_and_a_defect_cost_their_own_input_only(capfd):
    """Five of seven inputs fail, each in its way; the other two get their results from the same pool.

    With one process all wait behind the one that dies; two are in ``tests/scripts/shared/test_cluster.py``.
    """
    inputs = ["a", "SIGSEGV", "SIGABRT", "SIGKILL", "defect", "no pickle", "b"]
    outcomes = dict(zip(inputs, run_jobs(fail_by, inputs, Workers(1), "tests"), strict=True))
    assert [name for name, one in outcomes.items() if one.error is None] == ["a", "b"]
    assert [name for name, one in outcomes.items() if one.defect] == ["SIGSEGV", "SIGABRT", "defect", "no pickle"]
    assert "SIGSEGV" in outcomes["SIGSEGV"].error
    assert "memory" in outcomes["SIGKILL"].error
    assert "ZeroDivisionError: a test's division by zero (test_jobs.py:" in outcomes["defect"].error
    assert all("\n" not in one.error for one in outcomes.values() if one.error)
    assert "Traceback" in capfd.readouterr().err, "a defect of ours shows where it happened"
    assert choose_exit_code(list(outcomes.values())) == 1


@pytest.mark.slow
def test_two_inputs_run_in_another_process_where_nobody_asks_for_one(monkeypatch):
    """So that a crash of native code costs one of them; up to four share a process."""
    monkeypatch.setattr(jobs_module, "HERE_UP_TO", 1)
    pids = {one.value for one in run_jobs(work, ["here"] * 2, LOCAL, "tests")}
    assert pids == {os.getpid()}, "the parent of the process that did the work"
    assert [one.value for one in run_jobs(work, ["here"] * 2, LOCAL, "tests", here_up_to=2)] == [os.getppid()] * 2


def test_a_single_input_runs_here_and_its_defect_is_an_outcome_too(capfd):
    (outcome,) = run_jobs(math.sqrt, [-1.0], LOCAL, "roots")
    assert outcome.defect
    assert "ValueError" in capfd.readouterr().err


def test_no_input_gives_no_outcome():
    assert run_jobs(math.sqrt, [], LOCAL, "roots") == []


def test_no_process_is_refused():
    with pytest.raises(BadParameter, match="give 1 or more"):
        run_jobs(math.sqrt, [1.0], Workers(0), "roots")
