"""Run one function over many inputs, so that a failure costs its own input and no other.

The work is done in this process, on a pool of local processes, or by the workers of a Dask cluster, by the same
function. Every process works on one input at a time. An error of the user's, a defect of ours and a process that dies
all become the outcome of the input concerned, and the batch goes on.
"""

import os
import pickle
import sys
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import wait
from typing import Any

from stillpoint.datasets.errors import BadParameter
from stillpoint.scripts.shared.children import (
    Child,
    Item,
    Outcome,
    Result,
    Surroundings,
    end_children,
    require_memory_limits,
    run_item,
    start_child,
)
from stillpoint.scripts.shared.flags import Workers
from stillpoint.scripts.shared.output import print_line
from stillpoint.scripts.shared.progress import show_progress

HERE_UP_TO = 1  # items that a batch works on in this process where it is not told how many
SHORT = 15  # items of less than a second, up to which processes are not worth their start
ITEMS_PER_WORKER = 4  # a process takes seconds to start, an input about one second


def run_jobs(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    workers: Workers,
    what: str,
    *,
    here_up_to: int | None = None,
    on_done: Callable[[int, Outcome[Result]], None] | None = None,
) -> list[Outcome[Result]]:
    """Return the outcome of ``function`` for each item, in their order, with progress on stderr.

    Parameters
    ----------
    function
        Applied to each item; like the items and what it returns, it must pickle.
    items
        Files are named by paths or URLs; their content never goes through a pipe or a scheduler.
    workers
        Who works. By default this process for a single item (up to ``here_up_to``), else one process per core and
        per four items: with several processes, a crash of native code costs one item.
    what
        Names the work in the progress.
    here_up_to
        The number of items up to which this process does the work where ``workers`` asks for nothing; None:
        ``HERE_UP_TO``.
    on_done
        Called with the place and the outcome of each item as soon as it is there.

    Raises
    ------
    BadParameter
        For fewer than one process, and for limits that the system does not have.
    StillpointError
        When the scheduler cannot be reached or is lost.
    """
    if workers.jobs is not None and workers.jobs < 1:
        raise BadParameter(f"--jobs {workers.jobs}: give 1 or more")
    if workers.memory_limit is not None:
        require_memory_limits()
    outcomes: list[Outcome[Result]] = [Outcome() for _ in items]
    with show_progress(what, len(items)) as count:
        up_to = HERE_UP_TO if here_up_to is None else here_up_to
        for place, outcome in _run_anywhere(function, items, workers, up_to):
            outcomes[place] = _print_defect(items[place], outcome)
            if on_done is not None:
                on_done(place, outcomes[place])
            count()
    return outcomes


def choose_exit_code(outcomes: Sequence[Outcome[Any]]) -> int:
    """Return 1 when an outcome is a defect of stillpoint, 2 when one is another error, else 0."""
    if any(outcome.defect for outcome in outcomes):
        return 1
    return 2 if any(outcome.error is not None for outcome in outcomes) else 0


def _run_anywhere(
    function: Callable[[Item], Result], items: Sequence[Item], workers: Workers, here_up_to: int
) -> Iterator[tuple[int, Outcome[Result]]]:
    """Yield the place and the outcome of every item from where the work is done."""
    if not items:
        return iter(())
    if workers.scheduler is not None:
        try:
            from stillpoint.scripts.shared.cluster import run_on_cluster  # imports Dask, which is an extra
        except ImportError as error:
            raise BadParameter(
                f"--scheduler: needs the extra cluster ({error}); install it: pip install 'stillpoint[cluster]'"
            ) from None
        return run_on_cluster(function, items, workers)
    if workers.memory_limit is None and (len(items) == 1 or (workers.jobs is None and len(items) <= here_up_to)):
        return ((place, run_item(function, item)) for place, item in enumerate(items))
    worthwhile = min(os.cpu_count() or 1, -(-len(items) // ITEMS_PER_WORKER))
    count = min(workers.jobs or worthwhile, len(items))
    return _run_in_processes(function, items, count, Surroundings(workers.memory_limit))


def _print_defect(item: object, outcome: Outcome[Result]) -> Outcome[Result]:
    """Print the traceback that a defect carries; the outcome returned keeps its first line."""
    if not outcome.defect or outcome.error is None or "\n" not in outcome.error:
        return outcome
    line, trace = outcome.error.split("\n", 1)
    for text in (f"stillpoint: {item}: {line}", *trace.splitlines()):
        print_line(text, file=sys.stderr)
    return Outcome(error=line, defect=True)


def _run_in_processes(
    function: Callable[[Item], Result], items: Sequence[Item], count: int, surroundings: Surroundings
) -> Iterator[tuple[int, Outcome[Result]]]:
    """Yield the place and the outcome of every item, as they are done. A process that dies is replaced."""
    pickled = pickle.dumps(function)
    waiting = iter(range(len(items)))
    places: dict[Child, int] = {}

    def start_job(place: int) -> None:
        child = start_child(pickled, surroundings)
        places[child] = place
        child.send(items[place])

    try:
        for _ in range(count):
            start_job(next(waiting))
        while places:
            ready = wait([child.pipe for child in places])
            for child in [child for child in places if child.pipe in ready]:
                place = places.pop(child)
                yield place, child.receive()
                following = next(waiting, None)
                if following is None:
                    child.pipe.close()  # the process reads the end of its work and ends
                elif child.alive:
                    places[child] = following
                    child.send(items[following])
                else:
                    start_job(following)
    finally:
        end_children(places)
