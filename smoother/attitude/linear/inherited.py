"""Hand linear factors, made at the optimum of earlier windows, to the next window."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from stillpoint.datasets.recording import Floats
from stillpoint.smoother.attitude.linear.elimination import Eliminated
from stillpoint.smoother.attitude.linear.rows import Rows, starts

_POSES, _BIAS = b"xl", ord("b")


@dataclass(frozen=True, eq=False)
class Inherited:
    """Linear factors on changes from the values at which they were made."""

    rows: Rows
    values: gtsam.Values

    def at(self, values: gtsam.Values) -> Rows:
        """Return the factors on changes from other values."""
        data, begin = self.rows.data.copy(), 0
        for f, count in enumerate(self.rows.count.tolist()):
            keys = self.rows.keys[self.rows.key_first[f] : self.rows.key_first[f + 1]].tolist()
            moved = np.concatenate([_difference(self.values, values, key) for key in keys])
            end = begin + count * (len(moved) + 1)
            part = data[begin:end].reshape(count, len(moved) + 1)
            part[:, -1] -= part[:, :-1] @ moved
            begin = end
        return replace(self.rows, data=data)


def remaining_rows(eliminated: Eliminated, keys: Sequence[int]) -> Rows:
    """Return what is known of the keys, the last that were eliminated, as linear factors."""
    e, s = eliminated, eliminated.structure
    order = np.argsort(s.key_begin)
    found: list[list[int]] = []
    parts: list[Floats] = []
    counts = []
    there = np.array(keys, dtype=np.int64)
    for j in np.unique(s.key_node[s.numbers(there[s.has(there)])]):
        tied = np.append(s.later[s.later_first[j] : s.later_first[j + 1]], j)
        n = int(s.first[j + 1] - s.first[j])
        root = e.roots[e.roots_first[j] : e.roots_first[j + 1]].reshape(n, n)
        tie = e.ties[e.ties_first[j] : e.ties_first[j + 1]].reshape(n, -1)
        right = e.right[s.first[j] : s.first[j + 1], None]
        found.append(s.known[order[np.isin(s.key_node[order], tied)]].tolist())
        parts.append(np.hstack([root, tie, right]).ravel())
        counts.append(n)
    return Rows(
        keys=np.array([key for each in found for key in each], dtype=np.int64),
        key_first=starts([len(each) for each in found]),
        count=np.array(counts, dtype=np.int64),
        data=np.concatenate(parts),
    )


def _difference(before: gtsam.Values, after: gtsam.Values, key: int) -> Floats:
    """Return the change of a value, in the coordinates in which gtsam adds changes."""
    letter = gtsam.Symbol(key).chr()
    if letter in _POSES:
        return np.asarray(before.atPose3(key).localCoordinates(after.atPose3(key)))
    if letter == _BIAS:
        return np.asarray(after.atConstantBias(key).vector() - before.atConstantBias(key).vector())
    return np.asarray(after.atVector(key) - before.atVector(key))
