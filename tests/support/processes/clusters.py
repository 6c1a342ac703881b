"""A Dask scheduler and its workers as processes of their own over loopback TCP, for the tests of clusters."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

START_S = 120.0  # of a scheduler on a loaded machine


@dataclass
class Cluster:
    """The address of a scheduler, and the processes of its workers."""

    address: str
    workers: list[subprocess.Popen[bytes]] = field(default_factory=list)


@contextmanager
def start_cluster(folder: Path, workers: int, threads: int = 1) -> Iterator[Cluster]:
    """Start a scheduler and workers without nannies, so that one that is killed stays away; end them."""
    place = folder / "scheduler.json"
    with open(folder / "cluster.log", "wb") as log:
        options = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(place)]
        scheduler = start_dask(["scheduler", *options], log)
        started: list[subprocess.Popen[bytes]] = []
        try:
            deadline = time.monotonic() + START_S
            while not place.exists() or not place.read_text():
                assert time.monotonic() < deadline, (folder / "cluster.log").read_text()
                time.sleep(0.05)
            address = json.loads(place.read_text())["address"]
            for _ in range(workers):
                started.append(start_worker(address, folder, log, threads))
            yield Cluster(address, started)
        finally:
            for process in (*started, scheduler):
                process.kill()  # a worker's children watch for its end
            for process in (*started, scheduler):
                process.wait(30)


def start_worker(
    address: str, folder: Path, log: object, threads: int = 1, nanny: bool = False
) -> subprocess.Popen[bytes]:
    """Start a worker of a scheduler; with a nanny it is a daemon of another process."""
    kind = "--nanny" if nanny else "--no-nanny"
    options = ["--host", "127.0.0.1", "--nthreads", str(threads), "--no-dashboard", "--local-directory", str(folder)]
    return start_dask(["worker", address, kind, *options], log)


def start_dask(words: list[str], log: object) -> subprocess.Popen[bytes]:
    """Start a program of Dask that can import the helpers of the tests."""
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parent)}
    return subprocess.Popen([sys.executable, "-m", "dask", *words], env=environment, stdout=log, stderr=log)
