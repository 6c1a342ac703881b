"""Signals that end a process by an exception, raised again where Python loses it.

Python runs the handler of a signal between any two steps of the main thread. Where native code called the running
function, what a handler raises goes nowhere: Python prints "Exception ignored" and goes on. Such places are callbacks
of llvmlite while numba compiles, ``__del__``, and callbacks of weak references, as at the end of an import. Python
gives lost exceptions to ``sys.unraisablehook``: for ours it sends the signal once more, a little later.
"""

import _thread
import os
import signal
import sys
import time
from collections.abc import Iterable
from types import FrameType
from typing import Any

_AGAIN_AFTER_S = 0.005


class Interrupted(KeyboardInterrupt):
    """Raised in the main thread when a signal tells this process to end."""

    def __init__(self, number: signal.Signals) -> None:
        super().__init__(number.name)
        self.number = number


class Unwinding:
    """Signals raise :class:`Interrupted`, from its making to :meth:`stop`.

    A signal that the process ignores, as Ctrl-C in the background of a shell, stays ignored.

    Parameters
    ----------
    numbers
        The signals.
    once
        Whether signals that come while the stack unwinds are ignored; they would interrupt the cleaning up.
    """

    def __init__(self, numbers: Iterable[signal.Signals], *, once: bool = False) -> None:
        self.told: list[signal.Signals] = []  # those that came, also where other code replaced what they raised
        self._once, self._unwinds = once, False
        handled = [number for number in numbers if signal.getsignal(number) is not signal.SIG_IGN]
        self._hook = sys.unraisablehook
        sys.unraisablehook = self._see_lost
        self._before: dict[signal.Signals, Any] = {number: signal.signal(number, self._raise) for number in handled}

    def stop(self, *, kill: bool = False) -> None:
        """Let signals do what they did before, or kill: raised while the interpreter ends, exceptions are printed."""
        for number, handler in self._before.items():
            signal.signal(number, signal.SIG_DFL if kill else handler)
        sys.unraisablehook = self._hook

    def _raise(self, number: int, _: FrameType | None) -> None:
        if self._once and self._unwinds:
            return
        self._unwinds = True
        self.told.append(signal.Signals(number))
        raise Interrupted(self.told[-1])

    def _see_lost(self, lost: "sys.UnraisableHookArgs") -> None:
        """Send the signal again whose exception was lost; other exceptions are said, unless they may follow from it."""
        if isinstance(lost.exc_value, Interrupted):
            self._unwinds = False
            # Not threading.Thread: what was interrupted may hold its locks.
            _thread.start_new_thread(_send_later, (lost.exc_value.number,))
        elif not self.told:
            self._hook(lost)


def _send_later(number: signal.Signals) -> None:
    """Send a signal to this process after a short time."""
    time.sleep(_AGAIN_AFTER_S)
    os.kill(os.getpid(), number)
