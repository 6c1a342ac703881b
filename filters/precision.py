"""Single precision, as on a microcontroller: the same functions, compiled for float32 arguments."""

from typing import Any, Literal

import numpy as np

from stillpoint.datasets.errors import BadParameter

Precision = Literal["double", "single"]


def in_precision(tree: Any, precision: Precision) -> Any:
    """Tuples, named tuples and arrays with their floats in this precision; integers and truth values as they are.

    Raises :class:`BadParameter` for another precision.
    """
    if precision == "double":
        return tree
    if precision != "single":
        raise BadParameter(f"precision {precision!r}: there are double and single")
    return _single(tree)


def _single(tree: Any) -> Any:
    if isinstance(tree, float):
        return np.float32(tree)
    if isinstance(tree, np.ndarray) and tree.dtype == np.float64:
        return tree.astype(np.float32)
    if isinstance(tree, tuple):
        parts = [_single(part) for part in tree]
        return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)
    return tree
