"""Run one function over many inputs on local processes, so that a failure costs its own input and no other.

Every process works on one input at a time. An error of the user's, a defect of ours and a process that dies all become
the outcome of the input concerned, and the batch goes on.
"""

import multiprocessing
import os
import pickle
import signal
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnContext, SpawnProcess
from pathlib import Path
from typing import Any, Generic, TypeVar

from stillpoint.datasets.errors import BadParameter, StillpointError
from stillpoint.scripts.shared.output import print_line
from stillpoint.scripts.shared.progress import show_progress

MANY = 16  # short items, from which on processes are worth their start
ITEMS_PER_WORKER = 4  # a process takes seconds to start, an input about one second
END_WAIT_S = 5.0  # a process that is told to end first removes the file that it is writing

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Outcome(Generic[Result]):
    """The result of one input: a value, or the one line that says why there is none."""

    value: Result | None = None
    error: str | None = None
    defect: bool = False  # True: the error is a defect of stillpoint, and the command ends with exit code 1


def run_jobs(
    function: Callable[[Item], Result], items: Sequence[Item], jobs: int | None, what: str
) -> list[Outcome[Result]]:
    """Return the outcome of ``function`` for each item, in their order, with progress on stderr.

    ``jobs`` is the number of processes (None: one per core and per four inputs). A single item runs in this process;
    several always run in others, so that a crash of native code costs one item. ``function`` and items must pickle.
    Raises :class:`BadParameter` for fewer than one process.
    """
    if jobs is not None and jobs < 1:
        raise BadParameter(f"--jobs {jobs}: give 1 or more")
    worthwhile = min(os.cpu_count() or 1, -(-len(items) // ITEMS_PER_WORKER))
    with show_progress(what, len(items)) as count:
        if len(items) < 2:
            return [_print_defect(item, _run(function, item)) for item in items]
        outcomes: list[Outcome[Result]] = [Outcome() for _ in items]
        for place, outcome in _run_in_processes(function, items, min(jobs or worthwhile, len(items))):
            outcomes[place] = _print_defect(items[place], outcome)
            count()
    return outcomes


def run_short_jobs(
    function: Callable[[Item], Result], items: Sequence[Item], jobs: int | None, what: str
) -> list[Outcome[Result]]:
    """Do the same as :func:`run_jobs` for work of less than a second an item.

    Without ``jobs``, fewer than ``MANY`` items run in this process: others would take longer to start.
    """
    if jobs is not None or len(items) >= MANY:
        return run_jobs(function, items, jobs, what)
    outcomes: list[Outcome[Result]] = []
    with show_progress(what, len(items)) as count:
        for item in items:
            outcomes.append(_print_defect(item, _run(function, item)))
            count()
    return outcomes


def exit_code(outcomes: Sequence[Outcome[Any]]) -> int:
    """Return 1 when an outcome is a defect of stillpoint, 2 when one is another error, else 0."""
    if any(outcome.defect for outcome in outcomes):
        return 1
    return 2 if any(outcome.error is not None for outcome in outcomes) else 0


def _run(function: Callable[[Item], Result], item: Item) -> Outcome[Result]:
    try:
        return Outcome(function(item))
    except StillpointError as error:
        return Outcome(error=str(error))
    except Exception as error:
        return Outcome(error=_describe_defect(error), defect=True)


def _describe_defect(error: Exception) -> str:
    """Return one line that names the exception and where it was raised, then the traceback."""
    frame = traceback.extract_tb(error.__traceback__)[-1]
    reason = " ".join(str(error).split())
    line = f"a defect of stillpoint: {type(error).__name__}: {reason} ({Path(frame.filename).name}:{frame.lineno})"
    return f"{line}; please report it\n{''.join(traceback.format_exception(error))}"


def _print_defect(item: object, outcome: Outcome[Result]) -> Outcome[Result]:
    """Print the traceback that a defect carries; the outcome returned keeps its first line."""
    if not outcome.defect or outcome.error is None or "\n" not in outcome.error:
        return outcome
    line, trace = outcome.error.split("\n", 1)
    for text in (f"stillpoint: {item}: {line}", *trace.splitlines()):
        print_line(text, file=sys.stderr)
    return Outcome(error=line, defect=True)


@dataclass(eq=False)
class _Worker:
    """A process, the pipe to it, and the place of the item that it works on."""

    process: SpawnProcess
    pipe: Connection
    place: int


def _run_in_processes(
    function: Callable[[Item], Result], items: Sequence[Item], count: int
) -> Iterator[tuple[int, Outcome[Result]]]:
    """Yield the place and the outcome of every item, as they are done. A process that dies is replaced."""
    context = multiprocessing.get_context("spawn")
    waiting = iter(range(len(items)))
    workers = [_start(context, function, items, next(waiting)) for _ in range(count)]
    try:
        while workers:
            ready = wait([worker.pipe for worker in workers])
            for worker in [worker for worker in workers if worker.pipe in ready]:
                outcome = _receive(worker)
                yield worker.place, outcome if outcome is not None else _describe_death(worker.process)
                following = next(waiting, None)
                if following is None or outcome is None:
                    workers.remove(worker)
                    worker.pipe.close()  # the process reads the end of its work and ends
                if following is not None and outcome is None:
                    workers.append(_start(context, function, items, following))
                elif following is not None:
                    worker.place = following
                    worker.pipe.send(items[following])
    finally:
        _end(workers)


def _start(context: SpawnContext, function: Callable[[Item], Result], items: Sequence[Item], place: int) -> _Worker:
    ours, theirs = context.Pipe()
    process = context.Process(target=_work, args=(theirs, function))
    with _block_interrupt(), _hide_main(function, items[place]):
        process.start()
    theirs.close()
    ours.send(items[place])
    return _Worker(process, ours, place)


def _receive(worker: _Worker) -> Outcome[Any] | None:
    """Return the outcome that a worker sent, None when it died instead."""
    try:
        outcome: Outcome[Any] = worker.pipe.recv()
    except (EOFError, OSError):
        worker.process.join()
        return None
    return outcome


def _describe_death(process: SpawnProcess) -> Outcome[Any]:
    """Say by which signal or exit code a process ended. What the system kills is no defect of ours."""
    code = process.exitcode or 0
    if code >= 0:
        return Outcome(error=f"a defect of stillpoint: its process ended with exit code {code}", defect=True)
    name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
    if name == "SIGKILL":
        return Outcome(error="its process was killed (SIGKILL); if memory ran out, use fewer --jobs")
    if name == "SIGTERM":
        return Outcome(error="its process was told to end (SIGTERM)")
    return Outcome(error=f"a defect of stillpoint: its process died of {name}; please report it", defect=True)


def _end(workers: Sequence[_Worker]) -> None:
    """End workers that still work; each first removes the file that it is writing."""
    for worker in workers:
        worker.process.terminate()
    for worker in workers:
        worker.process.join(END_WAIT_S)
        if worker.process.is_alive():
            worker.process.kill()


@contextmanager
def _block_interrupt() -> Iterator[None]:
    """Block Ctrl-C. Processes started meanwhile never receive it: this process ends them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _hide_main(*work: object) -> Iterator[None]:
    """Keep a new process from running the main script again, unless its work is defined there.

    Without this, a script that calls us must guard its own lines by ``if __name__ == "__main__"``.
    """
    main = sys.modules["__main__"]
    hidden = [name for name in ("__file__", "__spec__") if getattr(main, name, None) is not None]
    if b"__main__" in pickle.dumps(work):
        hidden = []
    saved = {name: getattr(main, name) for name in hidden}
    for name in hidden:
        setattr(main, name, None)
    try:
        yield
    finally:
        for name, value in saved.items():
            setattr(main, name, value)


def _work(pipe: Connection, function: Callable[[Any], Any]) -> None:
    """Work on items until the pipe is closed. On SIGTERM the stack unwinds, so that a half-written file is removed."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    while True:
        try:
            item = pipe.recv()
        except EOFError:
            return
        outcome = _run(function, item)
        try:
            pipe.send(outcome)
        except OSError:
            return
        except Exception as error:  # a result that does not pickle
            pipe.send(Outcome(error=_describe_defect(error), defect=True))
