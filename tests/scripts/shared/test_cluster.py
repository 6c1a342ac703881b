"""The same function on a real Dask cluster over loopback TCP: every failure costs its own input and no other."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import farm_work
import psutil
import pytest
from clusters import start_cluster, start_worker
from distributed import Client
from farm_work import lines, run_orders, work

from stillpoint.datasets.errors import StillpointError
from stillpoint.scripts.shared import cluster as cluster_module
from stillpoint.scripts.shared.flags import Workers
from stillpoint.scripts.shared.jobs import choose_exit_code, run_jobs

pytestmark = pytest.mark.slow
ENDED_S = 300.0  # for processes on a busy machine to do what they were told


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    with start_cluster(tmp_path_factory.mktemp("cluster"), workers=1, threads=3) as started:
        yield started


def test_outcomes_are_those_of_the_local_pool(cluster, capfd):
    """Four of six inputs fail, each in its way; order, values and words are the same on both.

    The children of a batch end with it, and the worker stays for the next one.
    """
    orders = ["here", "SIGSEGV", "SIGKILL", "fail", "hold 1000", "here"]
    on_cluster = run_jobs(work, orders, Workers(scheduler=cluster.address, memory_limit=400_000_000), "cluster")
    assert _list_children(cluster.workers[0].pid) == []
    local = run_jobs(work, orders, Workers(2, memory_limit=400_000_000), "pool")
    assert [one.error for one in on_cluster] == [one.error for one in local]
    assert [one.error is None for one in local] == [True, False, False, False, False, True]
    assert "SIGSEGV" in local[1].error
    assert "memory" in local[4].error
    assert choose_exit_code(on_cluster) == choose_exit_code(local) == 1
    assert capfd.readouterr().err.count("Traceback") == 2


def test_a_task_that_dies_of_a_signal_leaves_the_other_tasks_of_its_worker_alone(cluster, tmp_path):
    """The worker has three threads: what sleeps beside a crash is begun once and arrives."""
    sleepers = [f"sleep 3 {tmp_path / str(k)}" for k in range(2)]
    orders = [*sleepers, *["SIGSEGV"] * 4, "here"]
    outcomes = run_jobs(work, orders, Workers(scheduler=cluster.address), "cluster")
    assert {one.value for one in outcomes if one.error is None} <= {worker.pid for worker in cluster.workers}
    assert [one.error is None for one in outcomes] == [True, True, *[False] * 4, True]
    for k in range(2):
        assert [line.split()[0] for line in lines(tmp_path / str(k))] == ["begun", "done"]


@pytest.mark.parametrize(("given", "seen"), [("65536", None), ("1000000", "1000000"), (None, None)])
def test_what_dask_sets_for_malloc_does_not_reach_children(monkeypatch, given, seen):
    """Arrays that are freed stay with the process. A setting of the user's does reach them."""
    monkeypatch.delenv("MALLOC_TRIM_THRESHOLD_", raising=False)
    if given is not None:
        monkeypatch.setenv("MALLOC_TRIM_THRESHOLD_", given)
    with cluster_module._keep_freed_memory():
        assert os.environ.get("MALLOC_TRIM_THRESHOLD_") == seen
    assert os.environ.get("MALLOC_TRIM_THRESHOLD_") == given


def _list_children(pid: int) -> list[psutil.Process]:
    """Return the processes that work for a worker; the one that Python keeps for its semaphores is none."""
    children = psutil.Process(pid).children(recursive=True)
    return [child for child in children if "resource_tracker" not in " ".join(child.cmdline())]


def test_a_worker_under_a_nanny_works_too(cluster, tmp_path):
    """A nanny makes its worker a daemon, which Python forbids to have children."""
    with open(tmp_path / "log", "wb") as log, Client(cluster.address, set_as_default=False) as client:
        nanny = start_worker(cluster.address, tmp_path, log, nanny=True)
        try:
            client.wait_for_workers(2, timeout=ENDED_S)
            orders = [f"sleep 0.5 {tmp_path / 'order'}"] * 8
            outcomes = run_jobs(work, orders, Workers(scheduler=cluster.address), "cluster")
        finally:
            nanny.terminate()
            nanny.wait(ENDED_S)
    assert choose_exit_code(outcomes) == 0
    assert len({one.value for one in outcomes}) == 2, "both workers did some of it"


def test_a_killed_worker_costs_no_result_and_gives_none_twice(tmp_path):
    arrived, children = [], []
    with start_cluster(tmp_path, workers=2) as cluster:
        orders = [f"sleep 0.5 {tmp_path / f'{k}.txt'}" for k in range(12)]

        def kill_once(place, outcome):
            arrived.append(place)
            if len(arrived) == 4:
                children.extend(_list_children(cluster.workers[0].pid))
                cluster.workers[0].send_signal(signal.SIGKILL)

        outcomes = run_jobs(work, orders, Workers(scheduler=cluster.address), "cluster", on_done=kill_once)
        assert cluster.workers[0].wait(ENDED_S) == -signal.SIGKILL
        killed, other = (worker.pid for worker in cluster.workers)
    assert choose_exit_code(outcomes) == 0
    assert sorted(arrived) == list(range(12))
    assert {one.value for one in outcomes[-4:]} == {other}
    assert sum(one.value == killed for one in outcomes) <= 4
    begun = [line for k in range(12) for line in lines(tmp_path / f"{k}.txt") if line.startswith("begun")]
    assert children
    assert 12 <= len(begun) <= 12 + 2, "what the killed worker did is begun again, and nothing else"
    _, alive = psutil.wait_procs(children, timeout=ENDED_S)
    assert not alive, "each child watches for the end of its worker"


def test_after_a_killed_client_the_next_run_computes_the_rest(cluster, tmp_path, capfd):
    """Twelve results, of which the client that is killed has got some: the second run begins the others only."""
    for k in range(12):
        (tmp_path / f"{k:02}.order").write_text(f"sleep 1.5 {tmp_path / f'{k}.txt'}")
    program = "import sys; from farm_work import run_orders; run_orders(*sys.argv[1:])"
    environment = os.environ | {"PYTHONPATH": str(Path(farm_work.__file__).parent)}
    client = subprocess.Popen([sys.executable, "-c", program, cluster.address, str(tmp_path)], env=environment)
    deadline = time.monotonic() + ENDED_S
    while len(_list_kept()) < 4:
        assert client.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.05)
    client.send_signal(signal.SIGKILL)
    client.wait()
    kept = len(_list_kept())
    assert kept < 12
    outcomes = run_orders(cluster.address, str(tmp_path))
    assert choose_exit_code(outcomes) == 0
    assert sum(one.kept for one in outcomes) == kept
    assert f"orders: {kept} of 12 kept from an earlier run, {12 - kept} to compute" in capfd.readouterr().err
    begun = [sum(line.startswith("begun") for line in lines(tmp_path / f"{k}.txt")) for k in range(12)]
    again = [times for times, one in zip(begun, outcomes, strict=True) if one.kept]
    assert again == [1] * kept, "what is kept is not begun again"
    assert max(begun) <= 2, "what was under way, or had not reached the client, is begun once more and no oftener"
    assert all(one.kept for one in run_orders(cluster.address, str(tmp_path)))


def _list_kept() -> list[Path]:
    return list(Path(os.environ["STILLPOINT_RESULTS"]).glob("*.npz"))


def test_no_scheduler_is_one_line_that_says_what_to_do(monkeypatch):
    monkeypatch.setattr(cluster_module, "_CONNECT_S", 1.0)  # how long a user waits does not matter here
    with pytest.raises(StillpointError, match=r"tcp://127.0.0.1:9: cannot be reached .*dask scheduler"):
        run_jobs(work, ["here"], Workers(scheduler="tcp://127.0.0.1:9"), "cluster")
