"""A saved stream as plain lists and numbers, for JSON, and back."""

from typing import Any, TypeVar

import numpy as np

from stillpoint.datasets.errors import BadParameter
from stillpoint.filters.spin.stream import SavedRoll
from stillpoint.filters.stream import Saved

AnySaved = TypeVar("AnySaved", Saved, SavedRoll)


def plain(tree: Any) -> Any:
    """Named tuples as mappings, tuples as lists, arrays as nested lists: every number as it is."""
    if isinstance(tree, np.ndarray):
        return tree.tolist()
    if hasattr(tree, "_asdict"):
        return {name: plain(value) for name, value in tree._asdict().items()}
    if isinstance(tree, tuple):
        return [plain(value) for value in tree]
    return tree


def rebuilt(kept: Any, like: AnySaved) -> AnySaved:
    """What :func:`plain` was made of; ``like`` is a saved stream of the same kind.

    Raises :class:`BadParameter` when it is of another one, or of another version of the estimator.
    """
    try:
        saved = _rebuilt(kept, like)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise BadParameter(f"the saved state is not one of {like.name} as it is now ({error}); start anew") from None
    assert isinstance(saved, type(like))
    return saved


def _rebuilt(kept: Any, like: Any) -> Any:
    if isinstance(like, np.ndarray):
        array = np.array(kept, dtype=like.dtype)
        if array.shape != like.shape:
            raise ValueError(f"an array is {array.shape}, not {like.shape}")
        return array
    if hasattr(like, "_asdict"):
        if set(kept) != set(like._fields):
            raise ValueError(f"it holds {', '.join(kept)}")
        return type(like)(*(_rebuilt(kept[name], value) for name, value in like._asdict().items()))
    if isinstance(like, tuple):
        return tuple(_rebuilt(value, one) for value, one in zip(kept, like, strict=True))
    if isinstance(like, bool | str) or like is None:
        if type(kept) is not type(like):
            raise ValueError(f"{kept!r} stands for {like!r}")
        return kept
    return type(like)(kept)
