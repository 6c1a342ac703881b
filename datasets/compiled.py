"""How hot loops are compiled: numba, kept on disk between processes, the same bits in batch and in streaming.

No fast maths: reassociated sums would make a batch run differ from the same samples one by one.
"""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit, types
from numba.extending import overload

Function = TypeVar("Function", bound=Callable[..., Any])

STAMP = "stillpoint-sources.sha256"
SHARED = ("compiled.py", "quaternion.py")


def compiled(function: Function) -> Function:
    """Compile at the first call for the argument types at hand, and keep the machine code on disk.

    It lies beside the package, or in numba's user cache where the package cannot be written; where neither can, every
    process compiles anew. The function is copied into its callers.
    """
    return _compiled(function, inline=True)


def compiled_apart(function: Function) -> Function:
    """The same for what runs once in many samples, or is long and called from many places: not copied into callers.

    Copied into ``step``, and with that into ``run``, it would only make both slow to compile.
    """
    return _compiled(function, inline=False)


def _compiled(function: Function, inline: bool) -> Function:
    try:
        dispatcher = _with_numba(function, inline, cache=True)
    except RuntimeError:  # numba found no folder to write to
        return cast(Function, _with_numba(function, inline, cache=False))
    drop_stale(Path(dispatcher.stats.cache_path), Path(function.__code__.co_filename).parent)
    return cast(Function, dispatcher)


def _with_numba(function: Callable[..., Any], inline: bool, cache: bool) -> Any:
    # Steps are chains of small functions that hand structures on: without inlining these go through memory.
    return njit(cache=cache, error_model="numpy", nogil=True, forceinline=inline)(function)


def drop_stale(cache: Path, folder: Path) -> None:
    """Forget machine code of other sources than those of the folder, and of what all folders call from this one.

    numba notices when the file of a function changes, but not when a function that it *calls* does: after an upgrade
    the cached ``complementary.run`` would go on with the old ``rotation.exp`` in it.
    """
    if cache in _CHECKED:
        return
    _CHECKED.add(cache)
    stamp = cache / STAMP
    sources = _fingerprint(folder)
    try:
        if stamp.exists() and stamp.read_text() == sources:
            return
        for machine_code in cache.glob("*.nb[ci]"):
            machine_code.unlink(missing_ok=True)
        stamp.write_text(sources)
    except OSError:
        return  # a cache that cannot be written is not one that numba uses


def _fingerprint(folder: Path) -> str:
    sources = hashlib.sha256()
    for path in (*sorted(folder.glob("*.py")), *(Path(__file__).with_name(name) for name in SHARED)):
        sources.update(path.name.encode() + b"\0" + path.read_bytes())
    return sources.hexdigest()


_CHECKED: set[Path] = set()


def like(x: float, value: float) -> float:
    """``value`` in the precision of ``x``: a bare 0.5 would turn a single-precision filter into a double one."""
    return type(x)(value)


@overload(like)
def _like(x: Any, value: Any) -> Callable[[Any, Any], Any]:
    kind = x if isinstance(x, types.Float) else types.float64

    def cast_to_kind(x: Any, value: Any) -> Any:
        return kind(value)

    return cast_to_kind
