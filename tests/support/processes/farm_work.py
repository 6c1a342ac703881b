"""Work for the tests of pools and clusters: it dies, sleeps, allocates or tells where it runs, as its input says.

Dozens of processes import this module, so it imports itself only what all of them need.
"""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from stillpoint.scripts.shared.children import Outcome
    from stillpoint.scripts.shared.kept import Deciding, Task


def work(order: str) -> int:
    """Follow an order such as ``SIGSEGV``, ``sleep 0.5 FILE`` or ``hold 300``; return the pid of the parent process.

    ``sleep`` writes a line into the file before and after; ``hold`` fills so many MB.
    """
    words = order.split()
    if words[0].startswith("SIG"):
        os.kill(os.getpid(), getattr(signal, words[0]))
        time.sleep(30)
    if words[0] == "sleep":
        note(words[2], f"begun by {os.getppid()}")
        time.sleep(float(words[1]))
        note(words[2], "done")
    if words[0] == "hold":
        import numpy as np

        np.ones(int(words[1]) * 125_000)
    if words[0] == "fail":
        raise ZeroDivisionError("of a test")
    return os.getppid()


def follow(task: Task[Path]) -> int:
    """Follow the order that stands in a file."""
    return work(task.item.read_text())


def decide(order: Path) -> Deciding:
    """Say that the file alone decides what comes of it."""
    from stillpoint.scripts.shared.kept import Deciding

    return Deciding((order,), {})


def run_orders(scheduler: str, folder: str) -> list[Outcome[int]]:
    """Follow all orders of a folder on a cluster; what is kept is not followed again."""
    from stillpoint.scripts.shared.flags import Workers
    from stillpoint.scripts.shared.kept import REUSE, run_kept

    orders = sorted(Path(folder).glob("*.order"))
    return run_kept(follow, orders, decide, Workers(scheduler=scheduler), REUSE, "orders", int)


def note(file: str, line: str) -> None:
    """Append a line to a file."""
    with open(file, "a") as log:
        log.write(f"{line}\n")


def lines(file: Path) -> list[str]:
    """Return the lines of a file; none where it is not there."""
    return file.read_text().splitlines() if file.exists() else []
