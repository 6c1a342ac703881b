"""Covariances of chosen unknowns from one elimination of the linear system.

gtsam eliminates the unknowns one after the other: R x + S y = d for the unknown x and those eliminated later that it is
tied to, y. From the last unknown back to the first (Takahashi, Fagan and Chen (1973)),

    cov(x, y) = -R^-1 S cov(y, y),    cov(x, x) = (R'R)^-1 - cov(x, y) (R^-1 S)'.

cov(y, y) is known by then, as all pairs of y are tied to each other. gtsam's own marginals start at the root for
each one that is asked for.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.compiled import compiled, compiled_entry
from stillpoint.datasets.recording import Floats

Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Eliminated:
    """m unknowns of a system in the order of their elimination, with D scalars in all, but none that was left out."""

    number: Mapping[int, int]  # of each key, 0 to m - 1
    first: Indices  # (m + 1,) the first scalar of each unknown
    later: Indices  # the scalars that each unknown is tied to, one unknown after the other
    later_first: Indices  # (m + 1,) where those of an unknown begin
    roots: Floats  # R of each unknown by rows
    roots_first: Indices  # (m + 1,)
    ties: Floats  # S of each unknown by rows
    ties_first: Indices  # (m + 1,)


def eliminate(system: gtsam.GaussianFactorGraph, ordering: gtsam.Ordering, keys: Iterable[int]) -> Eliminated:
    """Eliminate all unknowns in this order, and return those that the covariances of ``keys`` depend on.

    Raises RuntimeError where the system is singular.
    """
    net = system.eliminateSequential(ordering)
    needed = set(keys)
    number: dict[int, int] = {}
    roots: list[Floats] = []
    ties: list[Floats] = []
    tied_to: list[list[int]] = []
    for j in range(net.size()):
        conditional = net.at(j)  # gtsam keeps the order only along each branch of its tree
        key, *later = conditional.keys()
        if key in needed:
            number[key] = len(number)
            needed.update(later)
            tied_to.append(later)
            roots.append(conditional.R())
            ties.append(conditional.S())
    first = _starts([len(root) for root in roots])
    blocks = np.array([number[key] for later in tied_to for key in later], dtype=np.int64)
    sizes = np.diff(first)[blocks]
    return Eliminated(
        number=number,
        first=first,
        later=np.arange(sizes.sum()) + np.repeat(first[blocks] - np.cumsum(sizes) + sizes, sizes),
        later_first=_starts([tie.shape[1] for tie in ties]),
        roots=np.concatenate([root.ravel() for root in roots]),
        roots_first=_starts([root.size for root in roots]),
        ties=np.concatenate([tie.ravel() for tie in ties]),
        ties_first=_starts([tie.size for tie in ties]),
    )


def compute_covariances(eliminated: Eliminated, keys: Iterable[int]) -> list[Floats]:
    """Return the covariance (d, d) of each unknown."""
    size, width = np.diff(eliminated.first), np.diff(eliminated.later_first)
    begin = _starts((size * (size + width)).tolist())
    rows = _invert(*_arrays(eliminated), begin)
    numbers = [eliminated.number[key] for key in keys]
    return [rows[begin[j] : begin[j + 1]].reshape(size[j], -1)[:, : size[j]] for j in numbers]


def multiply_covariance(eliminated: Eliminated, columns: Floats) -> Floats:
    """Return P b for the covariance P of the D scalars, and columns b (D, k)."""
    return _solve(*_arrays(eliminated), np.ascontiguousarray(columns, dtype=np.float64))


def _arrays(eliminated: Eliminated) -> tuple[Indices, Indices, Indices, Floats, Indices, Floats, Indices]:
    e = eliminated
    return e.first, e.later, e.later_first, e.roots, e.roots_first, e.ties, e.ties_first


def _starts(sizes: list[int]) -> Indices:
    return np.concatenate([[0], np.cumsum(sizes, dtype=np.int64)]).astype(np.int64)


@compiled
def _divide(root: Floats, values: Floats, size: int, width: int) -> None:
    """Replace ``values`` (size * width,) by R^-1 values, with R (size * size,) by rows."""
    for i in range(size - 1, -1, -1):
        for c in range(width):
            for j in range(i + 1, size):
                values[i * width + c] -= root[i * size + j] * values[j * width + c]
            values[i * width + c] /= root[i * size + i]


@compiled_entry
def _invert(
    first: Indices,
    later: Indices,
    later_first: Indices,
    roots: Floats,
    roots_first: Indices,
    ties: Floats,
    ties_first: Indices,
    begin: Indices,
) -> Floats:
    """Return the rows cov(x, [x, y]) of all unknowns x, one after the other from ``begin`` (m + 1,)."""
    rows = np.zeros(begin[-1])
    m = len(first) - 1
    owner, place = np.empty(first[-1], dtype=np.int64), np.empty(first[-1], dtype=np.int64)
    for j in range(m):
        owner[first[j] : first[j + 1]] = j
    for j in range(m - 1, -1, -1):
        n, s = first[j + 1] - first[j], later_first[j + 1] - later_first[j]
        after = later[later_first[j] : later_first[j + 1]]
        root = roots[roots_first[j] : roots_first[j + 1]]
        tied, inverse = ties[ties_first[j] : ties_first[j + 1]].copy(), np.zeros(n * n)
        for i in range(n):
            inverse[i * n + i] = 1.0
        _divide(root, tied, n, s)
        _divide(root, inverse, n, n)
        # cov(y, y): for each scalar of y, its row to those of y that were eliminated with it or later
        among = np.zeros((s, s))
        last = -1
        for a in range(s):
            p = owner[after[a]]
            np_, sp = first[p + 1] - first[p], later_first[p + 1] - later_first[p]
            if p != last:
                for c in range(np_):
                    place[first[p] + c] = c
                for c in range(sp):
                    place[later[later_first[p] + c]] = np_ + c
                last = p
            start = begin[p] + (after[a] - first[p]) * (np_ + sp)
            for b in range(s):
                if owner[after[b]] >= p:
                    among[a, b] = rows[start + place[after[b]]]
                    among[b, a] = among[a, b]
        out = rows[begin[j] : begin[j + 1]].reshape((n, n + s))
        for i in range(n):
            for a in range(s):
                for b in range(s):
                    out[i, n + b] -= tied[i * s + a] * among[a, b]
        for i in range(n):
            for k in range(n):
                total = 0.0
                for c in range(n):
                    total += inverse[i * n + c] * inverse[k * n + c]
                for b in range(s):
                    total -= out[i, n + b] * tied[k * s + b]
                out[i, k] = total
    return rows


@compiled_entry
def _solve(
    first: Indices,
    later: Indices,
    later_first: Indices,
    roots: Floats,
    roots_first: Indices,
    ties: Floats,
    ties_first: Indices,
    columns: Floats,
) -> Floats:
    """Return R^-1 R^-T of the whole system times columns (D, k)."""
    x = columns.copy()
    m, width = len(first) - 1, columns.shape[1]
    for j in range(m):
        n, s, root, tie = first[j + 1] - first[j], later_first[j + 1] - later_first[j], roots_first[j], ties_first[j]
        for i in range(n):
            for c in range(width):
                for k in range(i):
                    x[first[j] + i, c] -= roots[root + k * n + i] * x[first[j] + k, c]
                x[first[j] + i, c] /= roots[root + i * n + i]
            for a in range(s):
                for c in range(width):
                    x[later[later_first[j] + a], c] -= ties[tie + i * s + a] * x[first[j] + i, c]
    for j in range(m - 1, -1, -1):
        n, s, root, tie = first[j + 1] - first[j], later_first[j + 1] - later_first[j], roots_first[j], ties_first[j]
        for i in range(n - 1, -1, -1):
            for a in range(s):
                for c in range(width):
                    x[first[j] + i, c] -= ties[tie + i * s + a] * x[later[later_first[j] + a], c]
            for c in range(width):
                for k in range(i + 1, n):
                    x[first[j] + i, c] -= roots[root + i * n + k] * x[first[j] + k, c]
                x[first[j] + i, c] /= roots[root + i * n + i]
    return x
