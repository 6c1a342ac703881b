"""An entry for tests into what only compiled functions call."""

from collections.abc import Callable
from typing import Any

from numba import njit


def from_python(function: Callable[..., Any]) -> Callable[..., Any]:
    """The compiled function itself, called from Python."""

    @njit
    def call(*args: Any) -> Any:
        return function(*args)

    entry: Callable[..., Any] = call
    return entry
