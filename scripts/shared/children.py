"""Child processes that work on one input at a time, so that the death of one costs its own input and no other.

The pool of this machine and each worker of a cluster use the same children. A child ends when the pipe to it is closed,
and when its parent dies.
"""

import gc
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any, Generic, TypeVar

from stillpoint.datasets.errors import BadFile, BadParameter, StillpointError
from stillpoint.scripts.main import GARBAGE_THRESHOLD
from stillpoint.scripts.shared.signals import Unwinding

# A process that is asked to end first removes the file that it is writing, and native code, as that of the compiler,
# hears of a signal only when it returns.
_END_WAIT_S = 20.0
_NO_MEMORY = "needs more memory than it may use; give more (--memory-limit, fewer --jobs), or `stillpoint cut` it"

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Outcome(Generic[Result]):
    """The result of one input: a value, or the one line that says why there is none."""

    value: Result | None = None
    error: str | None = None
    defect: bool = False  # True: the error is a defect of stillpoint, and the command ends with exit code 1
    refused: bool = False  # True: the error follows from the input, so that another run would give it again
    kept: bool = False  # True: from an earlier run


@dataclass(frozen=True)
class Surroundings:
    """The limits and the place in which a child works."""

    memory_limit_bytes: int | None = None  # of what a child allocates; None: as much as the machine gives
    folder: str | None = None  # where relative paths begin; None: as in the parent
    environment: Mapping[str, str] = field(default_factory=dict)


@dataclass(eq=False)
class Child:
    """A process, the pipe to it, and the limit that it works under."""

    process: SpawnProcess
    pipe: Connection
    surroundings: Surroundings

    def send(self, item: object) -> None:
        """Give it an input; one that has died says so when its outcome is received."""
        try:
            self.pipe.send(item)
        except OSError:
            return

    def receive(self) -> Outcome[Any]:
        """Return the outcome of its input; of a child that died meanwhile, the signal that it died of."""
        try:
            outcome: Outcome[Any] = self.pipe.recv()
        except (EOFError, OSError):
            self.process.join()
            return _describe_death(self.process, self.surroundings)
        return outcome

    @property
    def alive(self) -> bool:
        """Return whether the process still runs."""
        return self.process.is_alive()


def start_child(function: bytes, surroundings: Surroundings) -> Child:
    """Start a process that applies a pickled function to each input it is sent."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_work, args=(theirs, function, surroundings), daemon=True)
    with _block_interrupt(), _hide_main(function):
        process.start()
    theirs.close()
    return Child(process, ours, surroundings)


def end_children(children: Iterable[Child]) -> None:
    """End children that still work; each first removes the file that it is writing."""
    ending = list(children)
    for child in ending:
        child.process.terminate()
    for child in ending:
        child.process.join(_END_WAIT_S)
        if child.process.is_alive():
            child.process.kill()
            child.process.join()


def run_item(function: Callable[[Item], Result], item: Item) -> Outcome[Result]:
    """Return the outcome of one item in this process; a defect carries its traceback behind its first line."""
    try:
        return Outcome(function(item))
    except StillpointError as error:
        return Outcome(error=str(error), refused=not isinstance(error, BadParameter | BadFile))
    except MemoryError:
        return Outcome(error=_NO_MEMORY)
    except Exception as error:
        return Outcome(error=_describe_defect(error), defect=True)


def require_memory_limits() -> None:
    """Raise :class:`BadParameter` where the system does not bound the memory of a process."""
    if not sys.platform.startswith("linux"):
        raise BadParameter("--memory-limit: only Linux bounds the memory of a process; leave it out")


def _describe_defect(error: Exception) -> str:
    """Return one line that names the exception and where it was raised, then the traceback."""
    frame = traceback.extract_tb(error.__traceback__)[-1]
    reason = " ".join(str(error).split())
    line = f"a defect of stillpoint: {type(error).__name__}: {reason} ({Path(frame.filename).name}:{frame.lineno})"
    return f"{line}; please report it\n{''.join(traceback.format_exception(error))}"


def _describe_death(process: SpawnProcess, surroundings: Surroundings) -> Outcome[Any]:
    """Say by which signal or exit code a process ended. What the system kills is no defect of ours."""
    code = process.exitcode or 0
    name = _name_signal(-code) if code < 0 else f"exit code {code}"
    if name == "SIGKILL":
        return Outcome(error="its process was killed (SIGKILL); if memory ran out, use fewer --jobs")
    if name == "SIGTERM":
        return Outcome(error="its process was told to end (SIGTERM)")
    if surroundings.memory_limit_bytes is not None:  # native code ends so when it gets no memory
        return Outcome(error=f"its process died of {name}, perhaps of its --memory-limit; try it with a larger one")
    if code < 0:
        return Outcome(error=f"a defect of stillpoint: its process died of {name}; please report it", defect=True)
    return Outcome(error=f"a defect of stillpoint: its process ended with {name}", defect=True)


def _name_signal(number: int) -> str:
    return signal.Signals(number).name if number in set(signal.Signals) else f"signal {number}"


@contextmanager
def _block_interrupt() -> Iterator[None]:
    """Block Ctrl-C. Processes started meanwhile never receive it: this process ends them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # the first process would start it, and that lets the signal through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _hide_main(function: bytes) -> Iterator[None]:
    """Keep a new process from running the main script again, unless its function is defined there.

    Without this, a script that calls us must guard its own lines by ``if __name__ == "__main__"``.
    """
    main = sys.modules["__main__"]
    hidden = [name for name in ("__file__", "__spec__") if getattr(main, name, None) is not None]
    if b"__main__" in function:
        hidden = []
    saved = {name: getattr(main, name) for name in hidden}
    for name in hidden:
        setattr(main, name, None)
    try:
        yield
    finally:
        for name, value in saved.items():
            setattr(main, name, value)


def _work(pipe: Connection, pickled: bytes, surroundings: Surroundings) -> None:
    """Work on items until the pipe is closed. On SIGTERM the stack unwinds, so that a half-written file is removed."""
    unwinding = Unwinding((signal.SIGTERM,), once=True)  # a second one comes of the group, or of the parent
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        os.environ.update(surroundings.environment)
        if surroundings.folder is not None and Path(surroundings.folder).is_dir():
            os.chdir(surroundings.folder)
        gc.set_threshold(GARBAGE_THRESHOLD)
        function = pickle.loads(pickled)
        if surroundings.memory_limit_bytes is not None:
            _limit_memory(surroundings.memory_limit_bytes)
        for outcome in _work_on_items(pipe, function):
            if unwinding.told:  # what the signal raised was caught, as the import of a compiled module does
                sys.exit(1)
            _send(pipe, outcome)
    except (KeyboardInterrupt, Exception):
        if not unwinding.told:
            raise
        sys.exit(1)
    unwinding.stop(kill=True)  # nothing is half-written now


def _work_on_items(pipe: Connection, function: Callable[[Any], Any]) -> Iterator[Outcome[Any]]:
    """Yield the outcome of each item until the pipe is closed."""
    while True:
        try:
            item = pipe.recv()
        except (EOFError, OSError):
            return
        yield run_item(function, item)


def _send(pipe: Connection, outcome: Outcome[Any]) -> None:
    """Send an outcome; a parent that is gone takes none, which the next item shows."""
    try:
        pipe.send(outcome)
    except OSError:
        return
    except Exception as error:  # a result that does not pickle
        pipe.send(Outcome(error=_describe_defect(error), defect=True))


def _limit_memory(limit_bytes: int) -> None:
    """Let this process hold so much: what it holds already, and what it allocates from now on.

    What is reserved and not used, as the stacks of threads are, does not count.
    """
    import resource

    pages = [int(word) for word in Path("/proc/self/statm").read_text().split()]
    resident, shared, data = pages[1], pages[2], pages[5]
    reserved_bytes = (data - (resident - shared)) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_DATA, (max(reserved_bytes, 0) + limit_bytes,) * 2)


def _end_with_parent() -> None:
    """Wait for the end of the parent, then end: nobody would take the result."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    parent.join()
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(_END_WAIT_S)
    os._exit(1)
