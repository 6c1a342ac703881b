"""Suggest the name that a user may have meant."""

from collections.abc import Iterable
from difflib import get_close_matches

from stillpoint.datasets.errors import BadParameter

SIMILAR = 0.5  # share of common letters, in runs, above which a name counts as a slip of the pen


def nearest(name: str, known: Iterable[str]) -> str:
    """Return ``"did you mean ...?"`` or the list of known names; for dotted names the last part counts first."""
    names = list(known)
    if not names:
        return "there are none"
    near = [one for one in names if one.rpartition(".")[2] == name.rpartition(".")[2]]
    near = near or get_close_matches(name, names, n=1, cutoff=SIMILAR)
    return f"did you mean {near[0]!r}?" if near else f"there are {', '.join(names)}"


def require_known(name: str, known: Iterable[str], what: str) -> None:
    """Raise :class:`BadParameter` with the nearest known name when ``name`` is unknown; ``what`` names the kind of
    thing.
    """
    names = list(known)
    if name not in names:
        raise BadParameter(f"no {what} {name!r}; {nearest(name, names)}")
