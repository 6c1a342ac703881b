"""File locks that end with the process that holds them, however it ends."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

if sys.platform == "win32":
    import msvcrt

    def _try_lock(handle: int) -> bool:
        """Lock an open file; return False where another process holds the lock."""
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True

    def _wait_for_lock(handle: int) -> None:
        msvcrt.locking(handle, msvcrt.LK_LOCK, 1)
else:
    import fcntl

    def _try_lock(handle: int) -> bool:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return False
        return True

    def _wait_for_lock(handle: int) -> None:
        fcntl.flock(handle, fcntl.LOCK_EX)


@contextmanager
def hold_lock(path: Path) -> Iterator[None]:
    """Hold the lock of this file, which is made when it is not there; wait for it while another process holds it."""
    handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        _wait_for_lock(handle)
        yield
    finally:
        os.close(handle)


class OwnLock:
    """A lock file of this process alone: others see from it whether this process lives."""

    def __init__(self, path: Path) -> None:
        """Lock the file, and make it where it is missing; waits for a process that is just deleting it."""
        self.path = path
        while True:
            self._handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
            if _try_lock(self._handle) and _is_same_file(self._handle, path):
                return
            os.close(self._handle)  # a sweeper removed the file between its creation and its lock

    def release(self) -> None:
        """Remove the file and let the lock go."""
        self.path.unlink(missing_ok=True)
        os.close(self._handle)


@contextmanager
def lock_of_dead_process(path: Path) -> Iterator[bool]:
    """Yield whether the process that made this lock file is gone; the lock is held meanwhile.

    A lock file that is not there counts as one of a dead process.
    """
    handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        yield _try_lock(handle) and _is_same_file(handle, path)
    finally:
        os.close(handle)


def _is_same_file(handle: int, path: Path) -> bool:
    """Return whether an open file is still the one under this path."""
    try:
        return os.path.samestat(os.fstat(handle), os.stat(path))
    except FileNotFoundError:
        return False
