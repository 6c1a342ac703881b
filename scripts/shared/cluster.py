"""Run one function over many inputs on the workers of a Dask cluster.

Only the function's name, the items and their outcomes pass through the scheduler; the workers open files themselves.
Each thread of a worker gives its inputs to a child process of its own, so that a crash of native code costs one input
and not the worker with what else it does. When a worker itself dies, Dask gives its inputs to another one.
"""

import asyncio
import multiprocessing
import os
import pickle
import secrets
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from distributed import Client, Future, Worker, WorkerPlugin, as_completed, get_worker

from stillpoint.datasets.errors import StillpointError
from stillpoint.datasets.files.result_store import get_product_version
from stillpoint.scripts.shared.children import (
    Child,
    Item,
    Outcome,
    Result,
    Surroundings,
    end_children,
    start_child,
)
from stillpoint.scripts.shared.flags import Workers
from stillpoint.scripts.shared.output import print_line

_CONNECT_S = 20.0
_LEAST_AHEAD = 64  # inputs that the scheduler knows of at a time, so that ten million do not fill it
_AHEAD_PER_THREAD = 4
_TRIM, _TRIM_BY_DASK = "MALLOC_TRIM_THRESHOLD_", "65536"  # bytes of freed memory from which malloc gives it back


class _Children(WorkerPlugin):
    """The child processes of one worker for one batch; Dask makes one on each worker, also on those that join later."""

    def __init__(self, function: bytes, surroundings: Surroundings, version: str) -> None:
        self._function = function
        self._surroundings = surroundings
        self._version = version  # of the stillpoint that asks

    def setup(self, worker: Worker) -> None:
        """Prepare a worker; called by Dask."""
        # A nanny starts its worker as a daemon, and Python lets a daemon have no children. They end with it all the
        # same: each watches for the end of its parent.
        multiprocessing.current_process().daemon = False
        self._lock = threading.Lock()
        self._idle: list[Child] = []
        self._all: set[Child] = set()
        here = get_product_version()
        self._problem = (
            f"the worker {worker.address} runs stillpoint {here}, and this is {self._version}; install the same on both"
            if here != self._version
            else None
        )

    def run(self, item: object) -> Outcome[Any]:
        """Return the outcome of one item, worked on by a child process."""
        if self._problem is not None:
            return Outcome(error=self._problem)
        child = self._take()
        child.send(item)
        outcome = child.receive()
        with self._lock:
            if child.alive:
                self._idle.append(child)
            else:
                self._all.discard(child)
        return outcome

    def _take(self) -> Child:
        """Return a child that has nothing to do; a new one when there is none."""
        with self._lock:
            while self._idle:
                child = self._idle.pop()
                if child.alive:
                    return child
                self._all.discard(child)
            with _keep_freed_memory():
                child = start_child(self._function, self._surroundings)
            self._all.add(child)
            return child

    async def teardown(self, worker: Worker) -> None:
        """End the children; called by Dask when the batch or the worker ends."""
        with self._lock:
            ending, self._all, self._idle = self._all, set(), []
        await asyncio.to_thread(end_children, ending)


@contextmanager
def _keep_freed_memory() -> Iterator[None]:
    """Start processes meanwhile without the setting of malloc that Dask gives its workers, unless a user chose another.

    With it, an array that is freed goes back to the system, and the next one is made of new pages: 40 % more CPU.
    """
    before = os.environ.get(_TRIM)
    if before == _TRIM_BY_DASK:
        del os.environ[_TRIM]
    try:
        yield
    finally:
        if before is not None:
            os.environ[_TRIM] = before


def run_on_cluster(
    function: Callable[[Item], Result], items: Sequence[Item], workers: Workers
) -> Iterator[tuple[int, Outcome[Result]]]:
    """Yield the place and the outcome of every item, as they are done.

    Raises :class:`StillpointError` when the scheduler cannot be reached or is lost.
    """
    assert workers.scheduler is not None
    name = f"stillpoint-{secrets.token_hex(8)}"  # two batches on one cluster do not share their children
    environment = {key: value for key, value in os.environ.items() if key.startswith("STILLPOINT_")}
    surroundings = Surroundings(workers.memory_limit, os.getcwd(), environment)
    client = _connect(workers.scheduler)
    try:
        client.register_plugin(_Children(pickle.dumps(function), surroundings, get_product_version()), name=name)
        if not client.nthreads():
            print_line(f"stillpoint: {workers.scheduler} has no worker yet; waiting for one", sys.stderr)
        yield from _gather(client, items, name, workers.scheduler)
    finally:
        _leave(client, name)


def _run_in_child(item: object, name: str) -> Outcome[Any]:
    """Return the outcome of one item on the worker that runs this; the task that the scheduler knows."""
    children = get_worker().plugins[name]
    assert isinstance(children, _Children)
    return children.run(item)


def _connect(address: str) -> Client:
    """Return a client of the scheduler; raises :class:`StillpointError` where it cannot be reached."""
    try:
        return Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:  # TimeoutError is an OSError
        reason = " ".join(str(error).split())
        raise StillpointError(
            f"--scheduler {address}: cannot be reached ({reason}); start one with `dask scheduler`, or leave this out"
        ) from None


def _gather(client: Client, items: Sequence[Item], name: str, address: str) -> Iterator[tuple[int, Outcome[Any]]]:
    """Yield the outcomes; the scheduler knows of a bounded number of items at a time."""
    waiting = iter(enumerate(items))
    places: dict[object, int] = {}

    def submit(ahead: int) -> list[Future]:
        """Submit the next items to the scheduler, and remember their places."""
        futures = []
        for _, (place, item) in zip(range(ahead), waiting, strict=False):
            future = client.submit(_run_in_child, item, name, key=f"{name}-{place}", pure=False)
            places[future.key] = place
            futures.append(future)
        return futures

    ahead = max(_LEAST_AHEAD, _AHEAD_PER_THREAD * sum(client.nthreads().values()))
    done = as_completed(submit(ahead), loop=client.loop)
    for future in done:
        place = places.pop(future.key)
        if future.status == "finished":
            outcome = future.result()
        elif future.status == "error":
            outcome = Outcome(error=_describe_failure(future.exception()))
        else:
            raise StillpointError(f"--scheduler {address}: was lost; run the command again, what is done is kept")
        future.release()
        done.update(submit(1))
        yield place, outcome


def _describe_failure(error: BaseException) -> str:
    """Return one line for an item that Dask itself gave up."""
    if type(error).__name__ == "KilledWorker":
        return "every worker that worked on it died; if memory ran out, use fewer threads or --memory-limit"
    return f"the cluster could not work on it: {type(error).__name__}: {' '.join(str(error).split())}"


def _leave(client: Client, name: str) -> None:
    """End what the workers still do for us, and the connection."""
    try:
        if client.status == "running":
            client.unregister_worker_plugin(name)
    except Exception as error:  # the batch is over; errors of the scheduler no longer matter
        print_line(f"stillpoint: the workers could not be told to end: {type(error).__name__}: {error}", sys.stderr)
    finally:
        client.close(timeout=_CONNECT_S)
