"""How hot loops are compiled: numba, kept on disk between processes, the same bits in batch and in streaming.

No fast maths: reassociated sums would make a batch run differ from the same samples one by one.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit, types
from numba.core import ir
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import FunctionPass, register_pass
from numba.core.untyped_passes import IRProcessing
from numba.extending import overload

from stillpoint.datasets.machine_code import find_top_folder, hash_sources, keep_on_disk

Function = TypeVar("Function", bound=Callable[..., Any])

STAMP = "stillpoint-sources.sha256"


def compiled(function: Function) -> Function:
    """Compile at the first call for the argument types at hand, and keep the machine code on disk.

    It lies beside the package, or in numba's user cache where the package cannot be written; where neither can, every
    process compiles anew. The function is copied into its compiled callers.
    """
    return _compile(function, inline=True)


def compiled_entry(function: Function) -> Function:
    """Compile a function that Python calls with a whole recording or a sample; it is not copied into its callers."""
    return _compile(function, inline=False)


def compiled_inside(function: Function) -> Function:
    """Compile a function that only compiled functions call; from Python it raises TypeError.

    An entry makes objects of every field of the structures that a function takes and gives, and back: for a step that
    takes as long to compile as the step itself.
    """
    return _without_entry(_compile(function, inline=True, has_entry=False))


def compiled_apart(function: Function) -> Function:
    """Compile as :func:`compiled_inside` what runs rarely or is long, without copying it into its callers.

    It is not copied into callers: copied into ``step``, and with that into ``run``, it would only make both slow to
    compile.
    """
    return _without_entry(_compile(function, inline=False, has_entry=False))


def _compile(function: Function, inline: bool, has_entry: bool = True) -> Function:
    dispatcher = _with_numba(function, inline, has_entry)
    try:
        keep_on_disk(dispatcher, ships=has_entry)
    except RuntimeError:  # numba found no folder to write to
        return cast(Function, dispatcher)
    drop_stale(Path(dispatcher.stats.cache_path), Path(function.__code__.co_filename))
    return cast(Function, dispatcher)


def _with_numba(function: Callable[..., Any], inline: bool, has_entry: bool) -> Any:
    # Steps are chains of small functions that hand structures on: without inlining these go through memory. Nothing
    # takes a function as an argument, so none needs the entry for that.
    wrappers: dict[str, Any] = {"no_cpython_wrapper": not has_entry, "no_cfunc_wrapper": True}
    options: dict[str, Any] = {"error_model": "numpy", "nogil": True, "forceinline": inline}
    return njit(pipeline_class=_Compiler, **options, **wrappers)(function)


@register_pass(mutates_CFG=False, analysis_only=False)
class _RoundConstants(FunctionPass):
    """Give the float constants of a function single precision when it is compiled for float32 arguments.

    numba takes 0.5 for a double, and a product with a double is a double. With this pass an equation reads the same in
    both precisions. Whole numbers stay integers, which numba promotes to double too: write 2.0, not 2. A constant that
    has to stay a double is an ``np.float64``.
    """

    _name = "stillpoint_round_constants"

    def __init__(self) -> None:
        FunctionPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        if not any(_has_single(kind) for kind in state.args):
            return False
        for block in state.func_ir.blocks.values():
            for statement in block.find_insts(ir.Assign):
                constant = statement.value
                if isinstance(constant, ir.Const | ir.Global | ir.FreeVar):
                    rounded = _round_to_single(constant.value)
                    if rounded is not constant.value:
                        statement.value = ir.Const(rounded, constant.loc)
        return True


class _Compiler(CompilerBase):
    """numba's compiler with :class:`_RoundConstants`."""

    def define_pipelines(self) -> list[Any]:
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.add_pass_after(_RoundConstants, IRProcessing)
        passes.finalize()
        return [passes]


def _round_to_single(value: Any) -> Any:
    """Return a float, or a tuple that holds floats, in single precision; anything else as it is."""
    if type(value) is float:
        return np.float32(value)
    if type(value) is tuple:
        return tuple(_round_to_single(part) for part in value)
    return value


def _has_single(kind: Any) -> bool:
    """Return whether a numba type is float32, or holds one."""
    if isinstance(kind, types.Float):
        return bool(kind == types.float32)
    if isinstance(kind, types.BaseTuple):
        parts: Any = kind
        return any(_has_single(part) for part in parts)
    return isinstance(kind, types.Array | types.ListType) and _has_single(kind.dtype)


def _without_entry(function: Function) -> Function:
    def refuse(*args: Any, **names: Any) -> Any:
        raise TypeError(f"{function.__name__}: only compiled functions can call it; from Python, see compiled_entry")

    # numba's dispatcher would jump to the address of an entry that there is not.
    dispatcher: Any = function
    dispatcher._compile_for_args, dispatcher._insert = refuse, lambda *code: None
    return function


def drop_stale(cache_folder: Path, source: Path) -> None:
    """Delete cached machine code that was compiled from other sources than those of the source's top-level folder.

    numba notices when the file of a function changes, but not when a function that it *calls* does: after an upgrade
    the cached ``complementary.run`` would go on with the old ``rotation.exp`` in it. What all folders call, the files
    named in ``SHARED``, counts too.
    """
    if cache_folder in _CHECKED:
        return
    _CHECKED.add(cache_folder)
    stamp = cache_folder / STAMP
    sources = hash_sources(find_top_folder(source))
    try:
        if stamp.exists() and stamp.read_text() == sources:
            return
        for machine_code in cache_folder.glob("*.nb[ci]"):
            machine_code.unlink(missing_ok=True)
        stamp.write_text(sources)
    except OSError:
        return  # a cache that cannot be written is not one that numba uses


_CHECKED: set[Path] = set()


def like(x: float, value: float) -> float:
    """Return ``value``, a whole number or a double, in the precision of ``x``."""
    return type(x)(value)


@overload(like)
def _like(x: Any, value: Any) -> Callable[[Any, Any], Any]:
    kind = x if isinstance(x, types.Float) else types.float64

    def cast_to_kind(x: Any, value: Any) -> Any:
        return kind(value)

    return cast_to_kind
