"""Convert a saved stream to plain lists and numbers, for JSON, and back."""

from typing import Any, TypeVar

import numpy as np

from stillpoint.datasets.errors import BadParameter
from stillpoint.filters.spin.stream import SavedSpin
from stillpoint.filters.stream import Saved

AnySaved = TypeVar("AnySaved", Saved, SavedSpin)


def to_plain(tree: Any) -> Any:
    """Return named tuples as mappings, tuples as lists, arrays as nested lists; numbers stay."""
    if isinstance(tree, np.ndarray):
        return tree.tolist()
    if hasattr(tree, "_asdict"):
        return {name: to_plain(value) for name, value in tree._asdict().items()}
    if isinstance(tree, tuple):
        return [to_plain(value) for value in tree]
    return tree


def from_plain(kept: Any, like: AnySaved) -> AnySaved:
    """Return what :func:`to_plain` was given; ``like`` is a saved stream of the same kind.

    Raises :class:`BadParameter` when it is of another one, or of another version of the estimator.
    """
    try:
        saved = _restore_value(kept, like)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise BadParameter(
            f"the saved state is not one of the present {like.name} ({error}); start without it"
        ) from None
    assert isinstance(saved, type(like))
    return saved


def _restore_value(kept: Any, like: Any) -> Any:
    if isinstance(like, np.ndarray):
        array = np.array(kept, dtype=like.dtype)
        if array.shape != like.shape:
            raise ValueError(f"an array is {array.shape}, not {like.shape}")
        return array
    if hasattr(like, "_asdict"):
        if set(kept) != set(like._fields):
            raise ValueError(f"it holds {', '.join(kept)}")
        return type(like)(*(_restore_value(kept[name], value) for name, value in like._asdict().items()))
    if isinstance(like, tuple):
        return tuple(_restore_value(value, one) for value, one in zip(kept, like, strict=True))
    if isinstance(like, bool | str) or like is None:
        if type(kept) is not type(like):
            raise ValueError(f"{kept!r} stands for {like!r}")
        return kept
    return type(like)(kept)
