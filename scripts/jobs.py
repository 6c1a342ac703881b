"""Run one function over many inputs on a local process pool; what a user can put right becomes a result, not an end."""

import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Generic, TypeVar

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from stillpoint.datasets.errors import BadParameter, StillpointError

ITEMS_PER_WORKER = 4  # a process takes seconds to start, an input about one second

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Outcome(Generic[Result]):
    """What one input gave: a value, or the one line that says why there is none."""

    value: Result | None = None
    error: str | None = None


def run_jobs(
    function: Callable[[Item], Result], items: Sequence[Item], jobs: int | None, what: str
) -> list[Outcome[Result]]:
    """``function`` of each item, in their order, with progress on stderr.

    ``jobs`` processes (None: one per core and per four inputs); with 1 everything runs in this process. ``function``
    and items must pickle. A :class:`StillpointError`, and a worker that dies, become outcomes; any other exception is
    raised.
    """
    if jobs is not None and jobs < 1:
        raise BadParameter(f"--jobs {jobs}: give 1 or more")
    worthwhile = min(os.cpu_count() or 1, -(-len(items) // ITEMS_PER_WORKER))
    workers = min(jobs or worthwhile, len(items))
    outcomes: list[Outcome[Result]] = [Outcome() for _ in items]
    alone = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    columns = alone if len(items) == 1 else Progress.get_default_columns()
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(what, total=len(items))
        if workers < 2:
            for place, item in enumerate(items):
                outcomes[place] = _caught(function, item)
                progress.advance(task)
            return outcomes
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(workers, mp_context=context, initializer=_end_when_told) as pool:
            with _interrupt_later():
                places: dict[Future[Outcome[Result]], int] = {
                    pool.submit(_caught, function, item): place for place, item in enumerate(items)
                }
            try:
                for future in as_completed(places):
                    outcomes[places[future]] = _result(future)
                    progress.advance(task)
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                for worker in multiprocessing.active_children():
                    worker.terminate()
                raise
    return outcomes


@contextmanager
def _interrupt_later() -> Iterator[None]:
    """Hold Ctrl-C back. Processes begun meanwhile never see it, and leave it to this one to end them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end_when_told() -> None:
    """In a worker: unwind on SIGTERM, so that a file that is being written is taken away."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))


def _caught(function: Callable[[Item], Result], item: Item) -> Outcome[Result]:
    try:
        return Outcome(function(item))
    except StillpointError as error:
        return Outcome(error=str(error))


def _result(future: Future[Outcome[Result]]) -> Outcome[Result]:
    try:
        return future.result()
    except BrokenProcessPool:
        return Outcome(error="the process that worked on it, or one beside it, died (out of memory?); use fewer --jobs")
