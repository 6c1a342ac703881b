"""Which cases of a long list run in ``make quick``; ``make test`` runs all of them."""

from collections.abc import Callable, Iterable
from typing import Any

import pytest


def mark_slow_except(cases: Iterable[Any], *quick: str, name: Callable[[Any], str] = str) -> list[Any]:
    """Return the cases of a parametrisation; those whose name is not among ``quick`` are marked slow.

    Raises ValueError for a name of no case, which would leave the fast tests without it.
    """
    cases = list(cases)
    if unknown := set(quick) - {name(case) for case in cases}:
        raise ValueError(f"no case is called {', '.join(sorted(unknown))}")
    return [case if name(case) in quick else pytest.param(case, marks=pytest.mark.slow) for case in cases]
