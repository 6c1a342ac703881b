"""The order in which the unknowns of a graph are eliminated, and what each is tied to by then.

The graph is a chain of states with a few common unknowns. It is linearised several times with the same structure, which
is found once. The nodes of its elimination are an effective bias C, a state (V, X), a bias B, or a common unknown.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.compiled import compiled, compiled_entry
from stillpoint.smoother.attitude.linear.rows import Indices, Rows, starts

_KIND_BITS = 56  # of a gtsam symbol, below its letter
_OF_STATES = b"cvx"  # letters of the unknowns that have the number of a state
_END = np.iinfo(np.int64).max  # behind all states


@dataclass(frozen=True, eq=False)
class Structure:
    """The order in which the D scalars of m nodes are eliminated, and which nodes each is tied to by then."""

    known: Indices  # the keys, rising; the number of a key is its place here
    key_begin: Indices  # first scalar of each key
    key_size: Indices  # its scalars
    key_node: Indices  # node of each key
    first: Indices  # (m + 1,) the first scalar of each node
    later: Indices  # the nodes that each node is tied to, rising, one node after the other
    later_first: Indices  # (m + 1,) where those of a node begin
    parent: Indices  # (m,) the first of them, -1 for none
    factor_of_node: Indices  # the factors, by the node that is eliminated first
    factor_first: Indices  # (m + 1,) where those of a node begin
    number: Indices  # number of the key of each entry of ``Rows.keys``
    key_first: Indices  # that of the rows for which the structure was made

    def has(self, keys: Sequence[int] | Indices) -> NDArray[np.bool_]:
        """Return which of the keys (K,) are unknowns of the system."""
        return np.isin(np.asarray(keys, dtype=np.int64), self.known)

    def numbers(self, keys: Sequence[int] | Indices) -> Indices:
        """Return the numbers (K,) of keys; raises :class:`KeyError` for one that is no unknown of the system."""
        wanted = np.asarray(keys, dtype=np.int64)
        found = np.minimum(np.searchsorted(self.known, wanted), len(self.known) - 1)
        if not (self.known[found] == wanted).all():
            raise KeyError(int(wanted[self.known[found] != wanted][0]))
        return np.asarray(found, dtype=np.int64)

    def scalars(self, keys: Sequence[int] | Indices, size: int) -> Indices:
        """Return the first ``size`` scalars of each key, (K, size)."""
        return np.asarray(self.key_begin[self.numbers(keys)][:, None] + np.arange(size))


def find_structure(rows: Rows, sizes: Mapping[int, int], last: Sequence[int] = ()) -> Structure:
    """Return the order of elimination and its structure for linear factors like these.

    ``sizes`` are the scalars of an unknown by its letter. States follow each other; a bias comes after the last state
    of its step, or first where a gap leaves its step without states. What is common to all comes last, together with
    the keys of ``last``.
    """
    known, number = np.unique(rows.keys, return_inverse=True)
    letter, index = known >> _KIND_BITS, known & ((1 << _KIND_BITS) - 1)
    size = np.array([sizes[int(one)] for one in letter], dtype=np.int64)
    of_state = np.isin(letter, list(_OF_STATES))
    place = np.where(of_state, index, -1)
    latest = np.maximum.reduceat(place[number], rows.key_first[:-1])  # last state of each factor
    reaches = np.full(len(known), -1)
    np.maximum.at(reaches, number, np.repeat(latest, np.diff(rows.key_first)))
    is_bias = letter == ord("b")
    place[is_bias] = reaches[is_bias]  # -1, before all states, for the biases in a gap
    place[~of_state & ~is_bias] = _END
    place[np.isin(known, np.asarray(last, dtype=np.int64))] = _END
    rank = np.select([letter == ord("c"), of_state, is_bias], [0, 1, 2], 3)
    order = np.lexsort((known, rank, place))
    # V and X of a state are one node, all others are nodes of their own
    alone = ~(of_state & (letter != ord("c")))[order]
    begins = alone | (np.diff(index[order], prepend=-2) != 0) | np.roll(alone, 1)
    node = np.empty(len(known), dtype=np.int64)
    node[order] = np.cumsum(begins) - 1
    m = int(node.max()) + 1
    latest_order = np.arange(m)
    while True:
        of_factor = np.minimum.reduceat(node[number], rows.key_first[:-1])
        factor_of_node = np.argsort(of_factor, kind="stable").astype(np.int64)
        factor_first = np.searchsorted(of_factor[factor_of_node], np.arange(m + 1)).astype(np.int64)
        later, later_first, parent = _tie(node[number], rows.key_first, factor_of_node, factor_first)
        latest_order = _postorder(parent)
        if (latest_order == np.arange(m)).all():
            break
        renumbered = np.empty(m, dtype=np.int64)
        renumbered[latest_order] = np.arange(m)
        node = renumbered[node]
    sorted_keys = np.lexsort((known, node))
    begin = np.empty(len(known), dtype=np.int64)
    begin[sorted_keys] = starts(size[sorted_keys])[:-1]
    first = starts(np.bincount(node, weights=size, minlength=m).astype(np.int64))
    return Structure(
        known=known,
        key_begin=begin,
        key_size=size,
        key_node=node,
        first=first,
        later=later,
        later_first=later_first,
        parent=parent,
        factor_of_node=factor_of_node,
        factor_first=factor_first,
        number=number.astype(np.int64),
        key_first=rows.key_first,
    )


@compiled_entry
def _tie(
    nodes: Indices, key_first: Indices, factor_of_node: Indices, factor_first: Indices
) -> tuple[Indices, Indices, Indices]:
    """Return the nodes that each node is tied to when it is eliminated, where they begin, and the first of them."""
    m = len(factor_first) - 1
    later_first, parent = np.zeros(m + 1, dtype=np.int64), np.full(m, -1)
    sibling, child = np.full(m, -1), np.full(m, -1)
    seen = np.full(m, -1)
    later = np.empty(16 * m + 64, dtype=np.int64)
    total = int(np.int64(0))  # a plain 0 has a type of its own, for which callees compile again
    for j in range(m):
        if total + m > len(later) and total + 4096 > len(later):
            longer = np.empty(2 * len(later), dtype=np.int64)
            for k in range(total):  # numba compiles this in a tenth of the time of a slice
                longer[k] = later[k]
            later = longer
        seen[j] = j
        begin = total
        for at in range(factor_first[j], factor_first[j + 1]):
            f = factor_of_node[at]
            total = _append_unseen(nodes, key_first[f], key_first[f + 1], j, seen, later, total)
        c = child[j]
        while c >= 0:
            total = _append_unseen(later, later_first[c], later_first[c + 1], j, seen, later, total)
            c = sibling[c]
        _sort_run(later, begin, total)
        later_first[j + 1] = total
        if total > begin:
            parent[j] = later[begin]
            sibling[j], child[parent[j]] = child[parent[j]], j
    return later[:total].copy(), later_first, parent


@compiled
def _sort_run(values: Indices, begin: int, end: int) -> None:
    """Sort a run of values by insertion: it is short, and made of runs that are sorted.

    numba takes 2 s to compile numpy's sort.
    """
    for k in range(begin + 1, end):
        value, to = values[k], k
        while to > begin and values[to - 1] > value:
            values[to] = values[to - 1]
            to -= 1
        values[to] = value


@compiled
def _append_unseen(nodes: Indices, begin: int, end: int, j: int, seen: Indices, later: Indices, total: int) -> int:
    """Append those of a run of nodes that node j has not seen to ``later``; return how many it then holds."""
    for e in range(begin, end):
        k = nodes[e]
        if seen[k] != j:
            seen[k] = j
            later[total] = k
            total += 1
    return total


@compiled_entry
def _postorder(parent: Indices) -> Indices:
    """Return the nodes in an order in which each follows all its descendants, and they directly precede it."""
    m = len(parent)
    sibling, child = np.full(m, -1), np.full(m, -1)
    for j in range(m - 1, -1, -1):
        if parent[j] >= 0:
            sibling[j], child[parent[j]] = child[parent[j]], j
    order, total = np.empty(m, dtype=np.int64), 0
    for root in range(m):
        if parent[root] >= 0:
            continue
        j = root
        while True:
            while child[j] >= 0:
                c = child[j]
                child[j] = sibling[c]
                j = c
            order[total] = j
            total += 1
            if j == root:
                break
            j = parent[j]
    return order
