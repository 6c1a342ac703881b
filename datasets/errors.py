"""The errors that a user can correct: each becomes one line on stderr and exit code 2.

A message says what is wrong, where, and what to do about it: ``run7.mcap: time does not rise at sample 2
(0.010000 s); sort or drop the sample first``. Any other exception is a defect of stillpoint (exit code 1).
"""

from collections.abc import Iterable
from difflib import get_close_matches

from stillpoint.datasets.names import make_printable

_SIMILAR = 0.5  # share of common letters, in runs, above which a name counts as a slip of the pen


class StillpointError(Exception):
    """Base of all errors that a user can correct; ``str(error)`` is the one line to show.

    What a message quotes of an input may hold line breaks and escape sequences, which are shown as ``\\n``, ``\\x1b``.
    """

    def __str__(self) -> str:
        return make_printable(super().__str__())


class BadRecording(StillpointError):
    """Arrays of a recording, reference or estimate break a rule of the data types."""


class BadFile(StillpointError):
    """An MCAP file cannot be read or written as the requested kind."""


class BadSource(StillpointError):
    """A source given to an importer lacks something, or contradicts itself."""


class BadParameter(StillpointError):
    """An option, name or value given by the user does not exist or is not allowed."""


class Unobservable(StillpointError):
    """The data does not determine the requested quantity."""


def nearest(name: str, known: Iterable[str]) -> str:
    """Return ``"did you mean ...?"`` or the list of known names; for dotted names the last part counts first."""
    names = list(known)
    if not names:
        return "there are none"
    near = [one for one in names if one.rpartition(".")[2] == name.rpartition(".")[2]]
    near = near or get_close_matches(name, names, n=1, cutoff=_SIMILAR)
    return f"did you mean {near[0]!r}?" if near else f"there are {', '.join(names)}"


def require_known(name: str, known: Iterable[str], what: str) -> None:
    """Raise :class:`BadParameter` with the nearest known name when ``name`` is unknown; ``what`` names the kind of
    thing.
    """
    names = list(known)
    if name not in names:
        raise BadParameter(f"no {what} {name!r}; {nearest(name, names)}")
