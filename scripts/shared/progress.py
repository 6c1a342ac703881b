"""Progress of long work on stderr: a bar on a terminal, a line every ten seconds in a log."""

import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from stillpoint.scripts.shared.output import print_line

LOG_EVERY_S = 10.0

Item = TypeVar("Item")


@contextmanager
def show_progress(what: str, total: int) -> Iterator[Callable[[], None]]:
    """Show how much of ``total`` inputs is done; the function that is yielded counts one more."""
    console = Console(stderr=True)
    with _show_bar(what, total, console) if console.is_terminal else _log_lines(what, total) as count:
        yield count


def track(items: Sequence[Item], what: str) -> Iterable[Item]:
    """Yield the items one by one with progress."""
    with show_progress(what, len(items)) as count:
        for item in items:
            yield item
            count()


@contextmanager
def _show_bar(what: str, total: int, console: Console) -> Iterator[Callable[[], None]]:
    """Yield a function to call after each item; it moves a bar, or without a count only a spinner and the time."""
    alone = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    columns = alone if total == 1 else Progress.get_default_columns()
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task(what, total=total)
        yield lambda: progress.advance(task)


@contextmanager
def _log_lines(what: str, total: int) -> Iterator[Callable[[], None]]:
    """Print a line every LOG_EVERY_S from a thread, because one input alone may take longer than that."""
    begin, done, ended = time.monotonic(), 0, threading.Event()

    def count() -> None:
        nonlocal done
        done += 1

    def print_lines() -> None:
        """Print a line about the progress every LOG_EVERY_S until the work has ended."""
        while not ended.wait(LOG_EVERY_S):
            text = f"{what}: {done} of {total} done after {time.monotonic() - begin:.0f} s"
            print_line(text, file=sys.stderr, flush=True)

    thread = threading.Thread(target=print_lines, daemon=True)
    thread.start()
    try:
        yield count
    finally:
        ended.set()
        thread.join()
