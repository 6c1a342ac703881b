"""Reference trajectories from recordings of a moving sensor, and scores of estimators against them.

``read`` and ``write`` files, make a ``reference``, run an estimator with ``estimate``, and ``score`` what it gives.
Each name is imported when it is first used, so that ``import stillpoint`` alone is quick.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from stillpoint.datasets import read, write
    from stillpoint.filters import estimate
    from stillpoint.scoring import score
    from stillpoint.smoother import reference

    __version__: str

_HOMES = {
    "read": "stillpoint.datasets",
    "write": "stillpoint.datasets",
    "reference": "stillpoint.smoother",
    "estimate": "stillpoint.filters",
    "score": "stillpoint.scoring",
}
_FOLDERS = ("datasets", "filters", "scoring", "smoother", "studies")

__all__ = ["__version__", "estimate", "read", "reference", "score", "write"]


def __getattr__(name: str) -> Any:
    """Import the function, the folder or the version that is asked for, once."""
    if name == "__version__":
        from importlib.metadata import version

        value: Any = version("stillpoint")
    elif name in _HOMES:
        value = getattr(importlib.import_module(_HOMES[name]), name)
    elif name in _FOLDERS:
        return importlib.import_module(f"stillpoint.{name}")
    else:
        raise AttributeError(f"module 'stillpoint' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the names that can be imported."""
    return sorted({*__all__, *_FOLDERS})
