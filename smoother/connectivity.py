"""Is every unknown of a graph tied to the others? Checked before native code eliminates it.

gtsam's elimination and METIS's ordering expect a connected graph in which every variable has a factor. Given anything
else they end in a segmentation fault, an abort or a hang, none of which Python can catch.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from stillpoint.datasets.errors import Unobservable

_NAMED = 3  # unknowns that a message names


def require_connected(
    factor_keys: NDArray[np.int64],
    lengths: NDArray[np.int64],
    variables: Sequence[int] | NDArray[np.int64],
    describe: Callable[[int], str],
    name: str,
    may_stand_alone: Sequence[int] = (),
) -> bool:
    """Raise :class:`Unobservable` unless the factors tie all variables together.

    ``factor_keys`` are the variables of each factor, one factor after the other, and ``lengths`` how many it has;
    ``variables`` are all that the solution must contain. ``describe`` says in words what a variable is; ``name`` is the
    recording's. Variables of ``may_stand_alone`` have a prior of their own; returns whether one of them is indeed tied
    to nothing else.
    """
    of_factor = np.repeat(np.arange(len(lengths)), lengths)
    known, number = np.unique(factor_keys, return_inverse=True)
    lost = np.setdiff1d(np.asarray(variables), known)
    if len(lost):
        raise Unobservable(f"{name}: no measurement determines {_names(lost.tolist(), describe)}; {_ADVICE}")
    size = len(lengths) + len(known)
    edges = coo_array((np.ones(len(number)), (of_factor, len(lengths) + number)), shape=(size, size))
    parts, label = connected_components(edges, directed=False)
    of_variable = label[len(lengths) :]
    sizes = np.bincount(of_variable, minlength=parts)
    alone = np.isin(known, may_stand_alone) & (sizes[of_variable] == 1)
    cut_off = (of_variable != sizes.argmax()) & ~alone
    if cut_off.any():
        raise Unobservable(
            f"{name}: nothing connects {_names(known[cut_off].tolist(), describe)} to the rest; {_ADVICE}"
        )
    return bool(alone.any())


_ADVICE = (
    "cut the recording at its gaps (stillpoint cut --drop-gap), and check that every added factor refers to states of "
    "this recording"
)


def _names(keys: Sequence[int], describe: Callable[[int], str]) -> str:
    named = ", ".join(describe(key) for key in keys[:_NAMED])
    return named if len(keys) <= _NAMED else f"{named} and {len(keys) - _NAMED} more"
