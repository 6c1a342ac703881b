"""Solve the linear system of a graph by eliminating node after node, in compiled code.

gtsam's elimination serves any graph, and makes several objects for each unknown; here the structure is known before.
The method is the multifrontal Cholesky factorisation of Duff and Reid (1983). A node x is tied to the unknowns y of
other nodes when it is eliminated: R x + S y = d. From the last node back to the first x = R^-1 (d - S y).
"""

from dataclasses import dataclass

import numpy as np

from stillpoint.datasets.compiled import compiled, compiled_entry
from stillpoint.datasets.recording import Floats
from stillpoint.smoother.attitude.linear.rows import Indices, Rows, starts, sums
from stillpoint.smoother.attitude.linear.structure import Structure


class SingularSystem(ArithmeticError):
    """The system does not determine all unknowns."""


@dataclass(frozen=True, eq=False)
class Eliminated:
    """The triangular system R x + S y = d of each node, by rows, one node after the other."""

    structure: Structure
    roots: Floats
    roots_first: Indices  # (m + 1,)
    ties: Floats
    ties_first: Indices  # (m + 1,)
    right: Floats  # (D,) d


def eliminate(structure: Structure, rows: Rows) -> Eliminated:
    """Eliminate all unknowns; raises :class:`SingularSystem` where the rows do not determine them."""
    s = structure
    size = np.diff(s.first)
    width = sums(size[s.later], s.later_first)
    roots_first, ties_first = starts(size**2), starts(size * width)
    roots, ties, right = np.zeros(roots_first[-1]), np.empty(ties_first[-1]), np.empty(s.first[-1])
    key_size = s.key_size[s.number]
    columns = np.add.reduceat(key_size, s.key_first[:-1]) + 1
    failed = _eliminate(
        (s.first, s.later, s.later_first, s.parent, s.factor_of_node, s.factor_first),
        (s.key_node[s.number], s.key_begin[s.number], key_size, s.key_first),
        (rows.count, rows.data, starts(rows.count * columns)),
        (int((size + width).max()) + 1, _stack_size(width, s.parent), int(rows.count.max()), int(columns.max())),
        (roots, roots_first, ties, ties_first, right),
    )
    if failed:
        raise SingularSystem("the system does not determine all unknowns")
    return Eliminated(s, roots, roots_first, ties, ties_first, right)


def optimise(eliminated: Eliminated) -> Floats:
    """Return the solution (D,)."""
    e, s = eliminated, eliminated.structure
    x = e.right.copy()[:, None]
    _substitute(s.first, s.later, s.later_first, e.roots, e.roots_first, e.ties, e.ties_first, x)
    return x[:, 0]


def multiply_covariance(eliminated: Eliminated, columns: Floats) -> Floats:
    """Return P b for the covariance P of the D scalars, and columns b (D, k)."""
    e, s = eliminated, eliminated.structure
    x = np.array(columns, dtype=np.float64, order="C")
    arrays = s.first, s.later, s.later_first, e.roots, e.roots_first, e.ties, e.ties_first, x
    _forward(*arrays)
    _substitute(*arrays)
    return x


@compiled_entry
def _stack_size(width: Indices, parent: Indices) -> int:
    """Return the largest number of scalars that remainders, which are not yet taken up, need."""
    waiting = np.zeros(len(parent) + 1, dtype=np.int64)
    held = largest = 0
    for j in range(len(parent)):
        held -= waiting[j]
        if parent[j] >= 0:
            size = (width[j] + 1) ** 2
            held += size
            waiting[parent[j]] += size
        largest = max(largest, held)
    return largest


@compiled_entry
def _eliminate(
    tree: tuple[Indices, Indices, Indices, Indices, Indices, Indices],
    tied: tuple[Indices, Indices, Indices, Indices],
    rows: tuple[Indices, Floats, Indices],
    sizes: tuple[int, int, int, int],
    out: tuple[Floats, Indices, Floats, Indices, Floats],
) -> bool:
    """Write the triangular system of each node; return whether one is singular.

    The front of a node is the information matrix of its scalars, those it is tied to, and the right side, above the
    diagonal: the sum over its factors and over what remains of its children.
    """
    first, later, later_first, parent, factor_of_node, factor_first = tree
    node, begin, size, key_first = tied
    count, data, data_first = rows
    roots, roots_first, ties, ties_first, right = out
    m = len(parent)
    front = np.zeros((sizes[0], sizes[0]))
    top = int(np.int64(0))  # a plain 0 has a type of its own, for which callees compile again
    stack = np.empty(sizes[1])
    of_rows, squares = np.empty((sizes[2], sizes[3])), np.empty(sizes[3])
    at, column = np.zeros(m, dtype=np.int64), np.empty(sizes[3], dtype=np.int64)
    children = np.zeros(m, dtype=np.int64)
    waiting, n_waiting = np.empty(m, dtype=np.int64), 0
    for j in range(m):
        d = first[j + 1] - first[j]
        at[j] = 0
        width = d
        for e in range(later_first[j], later_first[j + 1]):
            k = later[e]
            at[k] = width
            width += first[k + 1] - first[k]
        for a in range(width + 1):
            front[a, a : width + 1] = 0.0
        for e in range(factor_first[j], factor_first[j + 1]):
            _add_factor(
                factor_of_node[e],
                node,
                begin,
                size,
                key_first,
                count,
                data,
                data_first,
                first,
                at,
                width,
                of_rows,
                column,
                squares,
                front,
            )
        for _ in range(children[j]):
            n_waiting -= 1
            child = waiting[n_waiting]
            top = _take_up(stack, top, child, first, later, later_first, at, width, front)
        if _factorise(front, d, width):
            return True
        for e in range(first[j], first[j + 1]):
            i = e - first[j]
            right[e] = front[i, width]
            for b in range(i, d):
                roots[roots_first[j] + i * d + b] = front[i, b]
            for b in range(d, width):
                ties[ties_first[j] + i * (width - d) + b - d] = front[i, b]
        if parent[j] >= 0:
            for a in range(d, width + 1):
                row = top + (a - d) * (width + 1 - d) - d
                for b in range(a, width + 1):  # a slice would take numba seconds to compile
                    stack[row + b] = front[a, b]
            top += (width + 1 - d) ** 2
            waiting[n_waiting] = j
            n_waiting += 1
            children[parent[j]] += 1
    return False


@compiled
def _add_factor(
    f: int,
    node: Indices,
    begin: Indices,
    size: Indices,
    key_first: Indices,
    count: Indices,
    data: Floats,
    data_first: Indices,
    first: Indices,
    at: Indices,
    width: int,
    of_rows: Floats,
    column: Indices,
    squares: Floats,
    front: Floats,
) -> None:
    """Add the information of a factor to the front."""
    n, columns = count[f], 0
    for e in range(key_first[f], key_first[f + 1]):
        start = at[node[e]] + begin[e] - first[node[e]]
        for c in range(size[e]):
            column[columns] = start + c
            columns += 1
    column[columns] = width
    columns += 1
    part = data[data_first[f] : data_first[f + 1]]
    for c in range(columns):
        for r in range(n):
            of_rows[r, c] = part[c * n + r]
    for a in range(columns):
        total = squares[: columns - a]
        total[:] = 0.0
        for r in range(n):
            if of_rows[r, a] != 0.0:
                _add(total, of_rows[r, a], of_rows[r, a:columns])
        for b in range(len(total)):
            front[min(column[a], column[a + b]), max(column[a], column[a + b])] += total[b]


@compiled
def _take_up(
    stack: Floats,
    top: int,
    child: int,
    first: Indices,
    later: Indices,
    later_first: Indices,
    at: Indices,
    width: int,
    front: Floats,
) -> int:
    """Add what remains of a child to the front, and return the top of the stack below it."""
    total = 1
    for e in range(later_first[child], later_first[child + 1]):
        total += first[later[e] + 1] - first[later[e]]
    top -= total * total
    row = 0
    for p in range(later_first[child], later_first[child + 1]):
        for a in range(at[later[p]], at[later[p]] + first[later[p] + 1] - first[later[p]]):
            source = top + row * total + row
            size = first[later[p] + 1] - first[later[p]] - (a - at[later[p]])
            _add(front[a, a : a + size], 1.0, stack[source : source + size])
            source += size
            for q in range(p + 1, later_first[child + 1]):
                size = first[later[q] + 1] - first[later[q]]
                target = at[later[q]]
                _add(front[a, target : target + size], 1.0, stack[source : source + size])
                source += size
            front[a, width] += stack[source]
            row += 1
    return top


@compiled
def _factorise(front: Floats, d: int, width: int) -> bool:
    """Replace the first d rows of a front by those of its Cholesky factor, and subtract their squares from the rest.

    Returns whether the first d scalars are not determined.
    """
    for i in range(d):
        row = front[i, i : width + 1]
        for k in range(i):
            _subtract(row, front[k, i], front[k, i : width + 1])
        pivot = row[0]
        if not pivot > 0.0:
            return True
        scale = 1.0 / np.sqrt(pivot)
        for b in range(len(row)):
            row[b] *= scale
    for a in range(d, width):
        row = front[a, a : width + 1]
        k = 0
        while k + 3 <= d:
            u, v, w = front[k, a], front[k + 1, a], front[k + 2, a]
            one, two, three = front[k, a : width + 1], front[k + 1, a : width + 1], front[k + 2, a : width + 1]
            for b in range(len(row)):
                row[b] -= u * one[b] + v * two[b] + w * three[b]
            k += 3
        while k < d:
            _subtract(row, front[k, a], front[k, a : width + 1])
            k += 1
    return False


@compiled
def _subtract(row: Floats, factor: float, other: Floats) -> None:
    """Subtract a multiple of another row."""
    for b in range(len(row)):
        row[b] -= factor * other[b]


@compiled
def _add(row: Floats, factor: float, other: Floats) -> None:
    """Add a multiple of another row."""
    for b in range(len(row)):
        row[b] += factor * other[b]


@compiled_entry
def _forward(
    first: Indices,
    later: Indices,
    later_first: Indices,
    roots: Floats,
    roots_first: Indices,
    ties: Floats,
    ties_first: Indices,
    x: Floats,
) -> None:
    """Replace columns x (D, k) by R^-T x."""
    m, width = len(first) - 1, x.shape[1]
    for j in range(m):
        n, tie = first[j + 1] - first[j], ties_first[j]
        for i in range(n):
            for k in range(i):
                r = roots[roots_first[j] + k * n + i]
                for c in range(width):
                    x[first[j] + i, c] -= r * x[first[j] + k, c]
            for c in range(width):
                x[first[j] + i, c] /= roots[roots_first[j] + i * n + i]
            for e in range(later_first[j], later_first[j + 1]):
                for row in range(first[later[e]], first[later[e] + 1]):
                    for c in range(width):
                        x[row, c] -= ties[tie] * x[first[j] + i, c]
                    tie += 1


@compiled_entry
def _substitute(
    first: Indices,
    later: Indices,
    later_first: Indices,
    roots: Floats,
    roots_first: Indices,
    ties: Floats,
    ties_first: Indices,
    x: Floats,
) -> None:
    """Replace columns x (D, k) by R^-1 x, with all of R."""
    m, width = len(first) - 1, x.shape[1]
    for j in range(m - 1, -1, -1):
        n, tie = first[j + 1] - first[j], ties_first[j]
        for i in range(n):
            for e in range(later_first[j], later_first[j + 1]):
                for row in range(first[later[e]], first[later[e] + 1]):
                    for c in range(width):
                        x[first[j] + i, c] -= ties[tie] * x[row, c]
                    tie += 1
        for i in range(n - 1, -1, -1):
            for k in range(i + 1, n):
                r = roots[roots_first[j] + i * n + k]
                for c in range(width):
                    x[first[j] + i, c] -= r * x[first[j] + k, c]
            for c in range(width):
                x[first[j] + i, c] /= roots[roots_first[j] + i * n + i]
