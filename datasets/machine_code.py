"""Machine code that was compiled before: numba's cache of this machine, and kernels that come with the package.

numba compiles at the first call, for 15 s and more on a filter, and keeps the result for this machine and these files.
So the first estimate after an installation would wait. ``python -m stillpoint.scripts.kernels`` compiles the usual
functions once, for any processor of the platform, into the folder ``kernels`` beside this file; a wheel carries them
along. A kernel is used where numba, Python, the platform and the sources are those it was made with, and the machine's
own cache has nothing. Otherwise numba compiles as ever.

This module, and :mod:`stillpoint.datasets.compiled`, hold all that is private of numba; a test names the versions.
"""

import hashlib
import os
import pickle
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba import types
from numba.core.caching import FunctionCache
from numba.core.serialize import dumps

# Where the kernels are; another folder, as an empty one, can be named in the environment.
KERNELS_FROM = "STILLPOINT_KERNELS"
KERNELS = Path(os.environ.get(KERNELS_FROM) or Path(__file__).with_name("kernels"))
# The environment of the process that makes the kernels: where to put them.
TARGET = "STILLPOINT_KERNELS_TO"
# And of a process in which a user waits: say on stderr that something compiles.
ANNOUNCE = "STILLPOINT_SAY_COMPILING"
_SHARED = ("compiled.py", "quaternion.py")
# How long a process waits for another one to compile a function before it compiles the function itself.
_LONGEST_WAIT_S = 120.0
_LOCKS = "stillpoint-compiling.lock"  # in each folder of the cache


class _KernelCache(FunctionCache):
    """numba's cache of one function, with the kernels of the package behind it."""

    ships = False  # whether the function is a kernel: Python calls it

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the machine code for these argument types, or None where it is to be compiled.

        Of several processes that want a function one compiles it, the others wait and load what it saved.
        """
        found = self._find(sig, target_context)
        if found is None:
            _hold_lock(self._lock_file, self._lock_byte)
            found = self._find(sig, target_context)
        if found is None:
            _announce()
        else:
            _release_lock(self._lock_file, self._lock_byte)
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep machine code that was just compiled.

        Under the lock: numba reads, changes and writes its index of a function, and two processes that save the
        function for different argument types would give both the same file.
        """
        _hold_lock(self._lock_file, self._lock_byte)
        try:
            super().save_overload(sig, data)
        finally:
            _release_lock(self._lock_file, self._lock_byte)
        if self.ships and TARGET in os.environ and self._impl.check_cachable(data):
            path = Path(os.environ[TARGET]) / self._kernel_name(sig, data.codegen)
            path.write_bytes(dumps(self._impl.reduce(data)))

    def _find(self, sig: Any, target_context: Any) -> Any:
        """Return the machine code from this machine's cache, else from the package's kernels, else None."""
        found = super().load_overload(sig, target_context)
        if found is None and self.ships and TARGET not in os.environ:
            found = self._load_kernel(sig, target_context)
        return found

    @property
    def _lock_file(self) -> Path:
        return Path(self.cache_path) / _LOCKS

    @property
    def _lock_byte(self) -> int:
        """The byte of the lock file that stands for this function."""
        name = f"{self._py_func.__module__}.{self._py_func.__qualname__}"
        return int.from_bytes(hashlib.sha256(name.encode()).digest()[:7])

    def _load_kernel(self, sig: Any, target_context: Any) -> Any:
        try:
            data = (KERNELS / self._kernel_name(sig, target_context.codegen())).read_bytes()
        except OSError:
            return None
        return self._impl.rebuild(target_context, pickle.loads(data))

    def _kernel_name(self, sig: Any, codegen: Any) -> str:
        """Return the name of the file for these argument types: a digest of all that the machine code depends on."""
        function = self._py_func
        closed = [getattr(cell.cell_contents, "__name__", "") for cell in function.__closure__ or ()]
        triple = codegen.magic_tuple()[0]
        sources = hash_sources(find_top_folder(Path(function.__code__.co_filename)))
        python = f"{sys.implementation.name} {sys.version_info[0]}.{sys.version_info[1]}"
        about = [numba.__version__, python, triple, sources, function.__module__, function.__qualname__, *closed]
        about += [_describe(kind) for kind in sig]
        return hashlib.sha256("\n".join(about).encode()).hexdigest()[:40] + ".kernel"


def keep_on_disk(dispatcher: Any, ships: bool) -> None:
    """Let a compiled function use :class:`_KernelCache`; ``ships``: Python calls it, so it is one of the kernels.

    Raises RuntimeError where no folder can be written. This is numba's private ``_cache`` of a dispatcher, which
    ``njit(cache=True)`` sets; checked with numba 0.68.1.
    """
    dispatcher._cache = _KernelCache(dispatcher.py_func)
    dispatcher._cache.ships = ships


def find_top_folder(source: Path) -> Path:
    """Return the outermost folder of packages that holds the source file."""
    folder = source.parent
    while (folder.parent / "__init__.py").exists():
        folder = folder.parent
    return folder


@cache
def hash_sources(folder: Path) -> str:
    """Return a digest of all sources in a folder, and of those that all folders call (``_SHARED``)."""
    sources = hashlib.sha256()
    for path in (*sorted(folder.rglob("*.py")), *(Path(__file__).with_name(name) for name in _SHARED)):
        sources.update(path.name.encode() + b"\0" + path.read_bytes())
    return sources.hexdigest()


if sys.platform == "win32":  # without locks, two processes may compile the same function

    def _hold_lock(file: Path, byte: int) -> None:
        """Do nothing."""

    def _release_lock(file: Path, byte: int) -> None:
        """Do nothing."""

else:
    import fcntl

    _HANDLES: dict[Path, int | None] = {}  # of this process; one per file, since closing any would free all its locks

    def _hold_lock(file: Path, byte: int) -> None:
        """Lock a byte of a file; wait while another process holds it. Does nothing where the file cannot be opened.

        Locks of bytes end with the process. A compilation that fails keeps its lock until then, so the wait is limited.
        """
        if file not in _HANDLES:
            try:
                file.parent.mkdir(parents=True, exist_ok=True)
                _HANDLES[file] = os.open(file, os.O_RDWR | os.O_CREAT, 0o666)
            except OSError:
                _HANDLES[file] = None
        handle = _HANDLES[file]
        give_up = time.monotonic() + _LONGEST_WAIT_S
        while handle is not None and time.monotonic() < give_up:
            try:
                fcntl.lockf(handle, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, byte)
                return
            except (BlockingIOError, PermissionError):
                time.sleep(0.02)
            except OSError:  # a file system without locks
                return

    def _release_lock(file: Path, byte: int) -> None:
        """Let the byte go."""
        handle = _HANDLES.get(file)
        if handle is not None:
            with suppress(OSError):
                fcntl.lockf(handle, fcntl.LOCK_UN, 1, byte)


def _describe(kind: Any) -> str:
    """Return the name of a numba type that tells apart named tuples of the same fields."""
    if isinstance(kind, types.BaseTuple):
        parts: Any = kind
        made = getattr(kind, "instance_class", tuple)
        return f"{made.__module__}.{made.__qualname__}({', '.join(_describe(part) for part in parts)})"
    if isinstance(kind, types.ListType):
        return f"list({_describe(kind.dtype)})"
    return str(kind)


def _announce(say: Callable[[str], Any] = sys.stderr.write) -> None:
    """Say once, in a process that a user waits for, that machine code is being compiled."""
    if os.environ.pop(ANNOUNCE, None):
        say("compiling, once (about 15 s)\n")
