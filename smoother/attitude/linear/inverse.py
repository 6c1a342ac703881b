"""Covariances of chosen unknowns from an eliminated system, from the last node back to the first.

With R x + S y = d for a node x and what it is tied to, y (Takahashi, Fagan and Chen (1973)),

    cov(x, y) = -R^-1 S cov(y, y),    cov(x, x) = (R'R)^-1 - cov(x, y) (R^-1 S)'.

cov(y, y) is known by then, as all pairs of y are tied to each other. gtsam's own marginals start at the root for
each one that is asked for.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.compiled import compiled_entry
from stillpoint.datasets.recording import Floats
from stillpoint.smoother.attitude.linear.elimination import Eliminated
from stillpoint.smoother.attitude.linear.rows import Indices, starts, sums


def compute_covariances(eliminated: Eliminated, pairs: Sequence[tuple[int, int]]) -> list[Floats]:
    """Return the covariance of the unknowns of each pair of keys, whose nodes must be tied to each other."""
    e, s = eliminated, eliminated.structure
    numbers = s.numbers(np.array(pairs, dtype=np.int64).ravel()).reshape(-1, 2)
    swapped = s.key_node[numbers[:, 0]] > s.key_node[numbers[:, 1]]
    numbers[swapped] = numbers[swapped][:, ::-1]
    order = np.argsort(s.key_node[numbers[:, 0]], kind="stable")
    wanted = numbers[order]
    shape = s.key_size[wanted]
    begin = starts(shape[:, 0] * shape[:, 1])
    found = np.empty(begin[-1])
    needed = np.zeros(len(s.parent), dtype=np.bool_)
    needed[s.key_node[wanted[:, 0]]] = True
    _invert(
        (s.first, s.later, s.later_first, s.parent),
        (e.roots, e.roots_first, e.ties, e.ties_first),
        (s.key_node[wanted], s.key_begin[wanted], shape, begin),
        needed,
        int((np.diff(s.first) + sums(np.diff(s.first)[s.later], s.later_first)).max()),
        found,
    )
    covariances: list[Floats] = [np.empty((0, 0))] * len(pairs)
    for k, at in enumerate(order.tolist()):
        block = found[begin[k] : begin[k + 1]].reshape(shape[k])
        covariances[at] = block.T if swapped[at] else block
    return covariances


@compiled_entry
def _invert(
    tree: tuple[Indices, Indices, Indices, Indices],
    system: tuple[Floats, Indices, Floats, Indices],
    wanted: tuple[Indices, Indices, Indices, Indices],
    needed: NDArray[np.bool_],
    largest: int,
    found: Floats,
) -> None:
    """Write the wanted blocks of the covariance.

    The covariance of a node and its ties is kept until those of its children are made.
    """
    first, later, later_first, parent = tree
    roots, roots_first, ties, ties_first = system
    node, begin, shape, found_first = wanted
    m = len(parent)
    children = np.zeros(m, dtype=np.int64)
    for j in range(m):
        if needed[j] and parent[j] >= 0:
            needed[parent[j]] = True
            children[parent[j]] += 1
    slot, n_slots, n_free = np.full(m, -1), 8, 8
    free = np.empty(8, dtype=np.int64)
    for k in range(8):  # numba compiles this in a tenth of the time of arange
        free[k] = k
    blocks = np.empty((8, largest, largest))
    at = np.zeros(m, dtype=np.int64)
    position = np.empty(largest, dtype=np.int64)
    tied, inverse = np.empty((largest, largest)), np.empty((largest, largest))
    last = len(node)
    for j in range(m - 1, -1, -1):
        if not needed[j]:
            continue
        if n_free == 0:
            more = np.empty((2 * n_slots, largest, largest))
            for k in range(n_slots):
                for a in range(largest):
                    for b in range(largest):
                        more[k, a, b] = blocks[k, a, b]
            blocks = more
            free = np.empty(n_slots, dtype=np.int64)
            for k in range(n_slots):
                free[k] = n_slots + k
            n_free, n_slots = n_slots, 2 * n_slots
        n_free -= 1
        slot[j] = free[n_free]
        here = blocks[slot[j]]
        d, p = first[j + 1] - first[j], parent[j]
        s = 0
        if p >= 0:  # where the scalars of the ties stand in the block of the parent
            at[p] = 0
            width = first[p + 1] - first[p]
            for e in range(later_first[p], later_first[p + 1]):
                at[later[e]] = width
                width += first[later[e] + 1] - first[later[e]]
            for e in range(later_first[j], later_first[j + 1]):
                for c in range(first[later[e] + 1] - first[later[e]]):
                    position[s] = at[later[e]] + c
                    s += 1
            above = blocks[slot[p]]
            for a in range(s):
                for b in range(s):
                    here[d + a, d + b] = above[position[a], position[b]]
        for i in range(d):
            for b in range(s):
                tied[i, b] = ties[ties_first[j] + i * s + b]
            for b in range(d):
                inverse[i, b] = 1.0 if i == b else 0.0
        for i in range(d - 1, -1, -1):
            for k in range(i + 1, d):
                r = roots[roots_first[j] + i * d + k]
                for b in range(s):
                    tied[i, b] -= r * tied[k, b]
                for b in range(d):
                    inverse[i, b] -= r * inverse[k, b]
            r = 1.0 / roots[roots_first[j] + i * d + i]
            for b in range(s):
                tied[i, b] *= r
            for b in range(d):
                inverse[i, b] *= r
        for i in range(d):
            for b in range(s):
                here[i, d + b] = 0.0
            for a in range(s):
                w = tied[i, a]
                for b in range(s):
                    here[i, d + b] -= w * here[d + a, d + b]
            for b in range(s):
                here[d + b, i] = here[i, d + b]
        for i in range(d):
            for k in range(d):
                total = 0.0
                for c in range(d):
                    total += inverse[i, c] * inverse[k, c]
                for b in range(s):
                    total -= here[i, d + b] * tied[k, b]
                here[i, k] = total
        while last > 0 and node[last - 1, 0] == j:
            last -= 1
            other = node[last, 1]
            start = begin[last, 1] - first[other]
            if other != j:
                start += d
                for e in range(later_first[j], later_first[j + 1]):
                    if later[e] == other:
                        break
                    start += first[later[e] + 1] - first[later[e]]
            for i in range(shape[last, 0]):
                for k in range(shape[last, 1]):
                    value = here[begin[last, 0] - first[j] + i, start + k]
                    found[found_first[last] + i * shape[last, 1] + k] = value
        if children[j] == 0:
            free[n_free] = slot[j]
            n_free += 1
        if p >= 0:
            children[p] -= 1
            if children[p] == 0:
                free[n_free] = slot[p]
                n_free += 1
