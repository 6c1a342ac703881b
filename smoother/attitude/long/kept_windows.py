"""Solved windows as arrays and plain facts, so that a run that was stopped goes on with the next window.

A window is named by everything that decides it within a run: evidence, settings, and its place in the order. What
decides a run (recording, code) is for those to know who keep windows from run to run.
"""

import hashlib
from collections.abc import Mapping, MutableMapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import cattrs
import gtsam
import numpy as np
from numpy.typing import NDArray

from stillpoint.smoother.attitude.evidence import Evidence
from stillpoint.smoother.attitude.long.past import Past, pack_values, unpack_values
from stillpoint.smoother.attitude.params import GraphParams
from stillpoint.smoother.attitude.plausibility import Fit
from stillpoint.smoother.attitude.samples.every_sample import Piece

WINDOWS = "windows"  # the fact that says how many windows the recording has


@dataclass(frozen=True, eq=False)
class Window:
    """A solved window: its answer, how well it fits, and what it hands over to the next one."""

    piece: Piece
    fit: Fit
    n_doubtful_fixes: int  # that lose more than half of their weight
    past: Past | None  # None after the last window


@dataclass(frozen=True, eq=False)
class PackedWindow:
    """A solved window as plain JSON that refers to arrays by their names."""

    facts: Mapping[str, Any]
    arrays: Mapping[str, NDArray[Any]]


KeptWindows = MutableMapping[str, PackedWindow]  # by name


def name_windows(evidence: Evidence, params: GraphParams, count: int) -> list[str]:
    """Return the names of the windows of a recording."""
    digest = hashlib.sha256()
    _add_to(digest, (evidence, params))
    whole = digest.hexdigest()
    return [hashlib.sha256(f"{whole} {number}".encode()).hexdigest() for number in range(count)]


def pack_window(window: Window, count: int) -> PackedWindow:
    """Return a window, one of ``count``, as arrays and plain facts."""
    arrays: dict[str, NDArray[Any]] = {}

    def take(array: NDArray[Any]) -> str:
        name = f"a{len(arrays)}"
        arrays[name] = array  # in its order: sums of another order have other bits
        return name

    converter = cattrs.Converter()
    converter.register_unstructure_hook_func(_is_array, take)
    converter.register_unstructure_hook(gtsam.Values, lambda values: [take(part) for part in pack_values(values)])
    converter.register_unstructure_hook(range, lambda held: [held.start, held.stop])
    return PackedWindow({WINDOWS: count, "window": converter.unstructure(window, Window)}, arrays)


def unpack_window(packed: PackedWindow) -> Window:
    """Return the window that :func:`pack_window` packed, bit for bit."""
    converter = cattrs.Converter()
    converter.register_structure_hook_func(_is_array, lambda name, _: packed.arrays[name])
    converter.register_structure_hook(
        gtsam.Values, lambda names, _: unpack_values(*(packed.arrays[name] for name in names))
    )
    converter.register_structure_hook(range, lambda held, _: range(*held))
    return converter.structure(packed.facts["window"], Window)


def _is_array(kind: Any) -> bool:
    return getattr(kind, "__origin__", None) is np.ndarray


def _add_to(digest: Any, thing: Any) -> None:
    """Add the content of dataclasses, sequences and arrays to a hash; a factor counts by what stands beside it."""
    if isinstance(thing, np.ndarray):
        digest.update(f"{thing.dtype} {thing.shape}".encode())
        digest.update(np.ascontiguousarray(thing).data)
    elif is_dataclass(thing):
        for each in fields(thing):
            digest.update(each.name.encode())
            _add_to(digest, getattr(thing, each.name))
    elif isinstance(thing, tuple | list):
        digest.update(str(len(thing)).encode())
        for one in thing:
            _add_to(digest, one)
    elif not isinstance(thing, gtsam.NonlinearFactor):
        digest.update(repr(thing).encode())
