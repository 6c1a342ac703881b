"""Linear factors as arrays: gtsam makes and linearises the factors, compiled code eliminates them."""

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.recording import Floats

Indices = NDArray[np.int64]
_STIFF = 1e5  # weight of a row that a constrained factor demands exactly: an sd of 1e-5 rad or m


@dataclass(frozen=True, eq=False)
class Rows:
    """Whitened linear factors A x = b: m factors, each of some rows over the unknowns of some keys."""

    keys: Indices  # of all factors, one after the other
    key_first: Indices  # (m + 1,) where those of a factor begin
    count: Indices  # (m,) rows of a factor
    data: Floats  # [A b] of each factor by rows, one after the other


def join_rows(parts: Sequence[Rows], data: Floats | None = None) -> Rows:
    """Return the factors of all parts, one part after the other.

    ``data`` are those of all parts where they are together already.
    """
    before = starts([part.key_first[-1] for part in parts])
    firsts = [part.key_first[1:] + begin for part, begin in zip(parts, before[:-1], strict=True)]
    return Rows(
        keys=np.concatenate([part.keys for part in parts]),
        key_first=np.concatenate([[0], *firsts]),
        count=np.concatenate([part.count for part in parts]),
        data=np.concatenate([part.data for part in parts]) if data is None else data,
    )


def flatten(system: gtsam.GaussianFactorGraph) -> Rows:
    """Return gtsam's linear factors as arrays."""
    factors = [system.at(i) for i in range(system.size())]
    parts = [_whiten(factor) for factor in factors]
    keys = [factor.keys() for factor in factors]
    return Rows(
        keys=np.array([key for each in keys for key in each], dtype=np.int64),
        key_first=starts([len(each) for each in keys]),
        count=np.array([len(part) for part in parts], dtype=np.int64),
        data=np.concatenate([np.empty(0), *(part.ravel() for part in parts)]),
    )


def _whiten(factor: gtsam.GaussianFactor) -> Floats:
    """Return [A b] of a factor; gtsam leaves rows without any noise as they are."""
    columns = factor.augmentedJacobian()
    if isinstance(factor, gtsam.JacobianFactor) and factor.isConstrained():
        columns[factor.get_model().sigmas() == 0] *= _STIFF
    return np.asarray(columns)


def starts(sizes: Sequence[int] | Indices) -> Indices:
    """Return where each of parts of these sizes begins, and where the last one ends."""
    return np.concatenate([[0], np.cumsum(sizes, dtype=np.int64)]).astype(np.int64)


def sums(values: Indices, first: Indices) -> Indices:
    """Return the sum of the values from ``first[k]`` to ``first[k + 1]`` for each k, 0 for none."""
    total = starts(values)
    return np.asarray(total[first[1:]] - total[first[:-1]])
