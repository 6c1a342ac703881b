"""Throughput over many recordings: local processes beside the workers of a Dask cluster on this machine."""

import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numba.core import event

from stillpoint.datasets import write
from stillpoint.datasets.errors import StillpointError
from stillpoint.datasets.machine_code import KERNELS_FROM
from stillpoint.datasets.mcap.store import read_recording, read_reference
from stillpoint.datasets.simulate import simulate
from stillpoint.filters import estimate
from stillpoint.scoring import score
from stillpoint.scripts.bench.timing import Timing
from stillpoint.scripts.shared.children import Outcome
from stillpoint.scripts.shared.flags import Workers
from stillpoint.scripts.shared.jobs import run_jobs
from stillpoint.smoother import reference

_RECORDINGS = 16
_MINUTES, _RATE_HZ = 5.0, 100.0
_EMPTY_TASKS = 200
_COUNTS = (1, 2)  # of workers


@dataclass(frozen=True)
class _Used:
    """The cost of one recording: in which process, how long, of that compiling, and the peak of the process."""

    pid: int
    seconds: float
    cpu_s: float
    compiling_s: float
    peak_bytes: int


def bench_scale(_runs: int) -> list[Timing]:
    """Return the rows of reference, estimate and score of sixteen recordings of 5 minutes, and of empty tasks.

    Each is done once: by 1 and 2 processes, by 1 and 2 workers of a cluster, and by 1 process with nothing compiled.
    """
    with tempfile.TemporaryDirectory() as folder:
        files = [_write_recording(Path(folder), seed) for seed in range(_RECORDINGS)]
        run_jobs(_process_recording, files[:1], Workers(1), "compile")
        rows: list[Timing] = []
        for count in _COUNTS:
            pool = _time_batch(files, Workers(count), f"{count} local", rows[0] if rows else None)
            with _start_cluster(count) as address:
                cluster = _time_batch(files, Workers(scheduler=address), f"{count} on Dask", pool)
            rows += [pool, cluster]
        for count in _COUNTS:
            pool = _time_empty(Workers(count), f"{count} local", None)
            with _start_cluster(count) as address:
                rows += [pool, _time_empty(Workers(scheduler=address), f"{count} on Dask", pool)]
        empty = str(Path(folder) / "empty")
        with _set_environment("NUMBA_CACHE_DIR", empty), _set_environment(KERNELS_FROM, empty):
            rows.append(_time_batch(files, Workers(1), "1 local, nothing compiled", rows[0]))
    return rows


def _time_batch(files: Sequence[Path], workers: Workers, name: str, against: Timing | None) -> Timing:
    """Return the row of all recordings; its note holds the rates, the memory and the share of compiling."""
    arrived: list[tuple[int, float]] = []

    def note_arrival(_: int, outcome: Outcome[_Used]) -> None:
        if outcome.value is not None:
            arrived.append((outcome.value.pid, time.perf_counter()))

    begun = time.perf_counter()
    used: list[_Used] = _run_all(_process_recording, files, workers, note_arrival)
    seconds = time.perf_counter() - begun
    peak_bytes = max(one.peak_bytes for one in used)
    compiling = sum(one.compiling_s for one in used) / sum(one.seconds for one in used)
    steady = 60 * _find_steady_rate(arrived)
    figures = {
        "recordings_per_minute": 60 * len(files) / seconds,
        "steady_recordings_per_minute": steady,
        "cpu_s_per_recording": sum(one.cpu_s for one in used) / len(used),
        "peak_bytes_per_process": peak_bytes,
        "compiling_share": compiling,
        "start_s": seconds - 60 * len(files) / steady,
    }
    note = (
        f"{figures['recordings_per_minute']:.1f} recordings/min, {steady:.1f} after {figures['start_s']:.1f} s "
        f"to start, {figures['cpu_s_per_recording']:.1f} s of CPU each, {peak_bytes / 1e6:.0f} MB per process, "
        f"{compiling:.0%} compiling"
    )
    title = f"{len(files)} recordings of {_MINUTES:g} min, {name}"
    return Timing(title, [seconds], None, against, "times as long", figures, note)


def _time_empty(workers: Workers, name: str, against: Timing | None) -> Timing:
    """Return the row of tasks that do nothing, from the second outcome on: the cost of passing them round."""
    arrived: list[float] = []
    _run_all(_do_nothing, range(_EMPTY_TASKS), workers, lambda *_: arrived.append(time.perf_counter()))
    seconds = arrived[-1] - arrived[0]
    each_ms = 1e3 * seconds / (_EMPTY_TASKS - 1)
    extra = {"per_task_ms": each_ms}
    title = f"{_EMPTY_TASKS} empty tasks, {name}"
    return Timing(title, [seconds], None, against, "times as long", extra, f"{each_ms:.2f} ms per task")


def _run_all(
    function: Callable[[Any], Any],
    items: Sequence[Any],
    workers: Workers,
    on_done: Callable[[int, Any], None] | None = None,
) -> list[Any]:
    """Return what the function gives for each item; raises :class:`StillpointError` for the first error."""
    outcomes = run_jobs(function, items, workers, "scale", on_done=on_done)
    for outcome in outcomes:
        if outcome.error is not None:
            raise StillpointError(f"bench scale: {outcome.error}")
    return [outcome.value for outcome in outcomes]


def _process_recording(file: Path) -> _Used:
    """Make reference and estimate of a recording, write both, and score the estimate."""
    import resource

    spent_s: list[float] = []
    begun, begun_cpu = time.perf_counter(), time.process_time()
    with event.install_timer("numba:compile", spent_s.append):
        recording = read_recording(file)
        write(file.with_suffix(f".{os.getpid()}.reference.mcap"), reference(recording))
        made = estimate(recording, "ekf")
        write(file.with_suffix(f".{os.getpid()}.estimate.mcap"), made)
        judge = read_reference(file.with_suffix(f".{os.getpid()}.reference.mcap"))
        score(made, judge)
    peak_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    cpu_s = time.process_time() - begun_cpu
    return _Used(os.getpid(), time.perf_counter() - begun, cpu_s, sum(spent_s), 1024 * peak_kib)


def _do_nothing(number: int) -> int:
    return number


def _find_steady_rate(arrived: Sequence[tuple[int, float]]) -> float:
    """Return the recordings per second of all processes together, each from its first outcome on.

    Until then a process imports, loads compiled code or compiles: what a long batch does not notice.
    """
    times: dict[int, list[float]] = {}
    for pid, at_s in arrived:
        times.setdefault(pid, []).append(at_s)
    return sum((len(of_one) - 1) / (of_one[-1] - of_one[0]) for of_one in times.values() if len(of_one) > 1)


def _write_recording(folder: Path, seed: int) -> Path:
    file = folder / f"{seed}.mcap"
    write(file, simulate("phone-3", seed, minutes=_MINUTES, rate_hz=_RATE_HZ))
    return file


@contextmanager
def _start_cluster(count: int) -> Iterator[str]:
    """Start a scheduler and workers of one thread on this machine; yields the address."""
    from distributed import LocalCluster

    before = set(os.environ)
    try:
        with LocalCluster(
            n_workers=count, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0", host="127.0.0.1"
        ) as cluster:
            yield cluster.scheduler_address
    finally:  # Dask sets variables for its workers, and leaves them to the processes of the next row
        for name in os.environ.keys() - before:
            del os.environ[name]


@contextmanager
def _set_environment(name: str, value: str) -> Iterator[None]:
    """Set a variable for processes started meanwhile."""
    before = os.environ.get(name)
    os.environ[name] = value
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before
