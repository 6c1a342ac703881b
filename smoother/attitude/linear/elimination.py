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
    diagonal: the sum over its factors and over what remains of its children. Fronts end at the same row, so that what
    remains of a node can stay where it is if its parent is eliminated next: of a chain, only the next state moves.
    """
    first, later, later_first, parent, factor_of_node, factor_first = tree
    node, begin, size, key_first = tied
    count, data, data_first = rows
    roots, roots_first, ties, ties_first, right = out
    m = len(parent)
    front = np.zeros((sizes[0], sizes[0]))
    last = sizes[0] - 1
    top = int(np.int64(0))  # a plain 0 has a type of its own, for which callees compile again
    stack = np.empty(sizes[1])
    room, column = np.empty(sizes[2] * sizes[3]), np.empty(sizes[3] + 1, dtype=np.int64)
    at, entries = np.zeros(m, dtype=np.int64), np.empty(sizes[3], dtype=np.int64)
    children = np.zeros(m, dtype=np.int64)
    waiting, n_waiting = np.empty(m, dtype=np.int64), 0
    stays = False
    for j in range(m):
        d = first[j + 1] - first[j]
        if not stays:
            base = _place(j, first, later, later_first, last, at)
            for a in range(base, last + 1):
                for b in range(a, last + 1):
                    front[a, b] = 0.0
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
                room,
                column,
                entries,
                front,
            )
        for _ in range(children[j]):
            n_waiting -= 1
            child = waiting[n_waiting]
            top = _take_up(stack, top, child, first, later, later_first, at, front)
        inner = base + d
        if _factorise(front, base, inner):
            return True
        for i in range(d):
            right[first[j] + i] = front[base + i, last]
            root, tie = roots_first[j] + i * d - base, ties_first[j] + i * (last - inner) - inner
            for b in range(base + i, inner):
                roots[root + b] = front[base + i, b]
            for b in range(inner, last):
                ties[tie + b] = front[base + i, b]
        stays = False
        if parent[j] == j + 1:
            base = _place(j + 1, first, later, later_first, last, at)
            stays = _stays(j, first, later, later_first, inner, at)
            if stays:
                _move_up(front, inner, base, first[j + 2] - first[j + 1])
        if parent[j] >= 0 and not stays:
            for a in range(inner, last + 1):
                row = top + (a - inner) * (last + 1 - inner) - inner
                for b in range(a, last + 1):  # a slice would take numba seconds to compile
                    stack[row + b] = front[a, b]
            top += (last + 1 - inner) ** 2
            waiting[n_waiting] = j
            n_waiting += 1
            children[parent[j]] += 1
    return False


@compiled
def _place(j: int, first: Indices, later: Indices, later_first: Indices, last: int, at: Indices) -> int:
    """Write where the nodes of a front stand, its last scalar before row ``last``, and return where it begins."""
    row = last
    for e in range(later_first[j + 1] - 1, later_first[j] - 1, -1):
        row -= first[later[e] + 1] - first[later[e]]
        at[later[e]] = row
    at[j] = row - (first[j + 1] - first[j])
    return int(at[j])


@compiled
def _stays(j: int, first: Indices, later: Indices, later_first: Indices, inner: int, at: Indices) -> bool:
    """Return whether all nodes that node j is tied to but the first stand in the next front where they stood.

    ``inner`` is the row at which the first one stood, ``at`` where they stand next.
    """
    row = inner
    for e in range(later_first[j], later_first[j + 1]):
        if e > later_first[j] and at[later[e]] != row:
            return False
        row += first[later[e] + 1] - first[later[e]]
    return True


@compiled
def _move_up(front: Floats, source: int, target: int, d: int) -> None:
    """Move the first d rows of what remains to the beginning of the next front, and clear the rows in between."""
    if source == target:
        return
    last = len(front) - 1
    for a in range(d):
        for b in range(a, d):
            front[target + a, target + b] = front[source + a, source + b]
        for b in range(target + d, source + d):
            front[target + a, b] = 0.0
        for b in range(source + d, last + 1):
            front[target + a, b] = front[source + a, b]
    for a in range(target + d, source + d):
        for b in range(a, last + 1):
            front[a, b] = 0.0


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
    room: Floats,
    column: Indices,
    entries: Indices,
    front: Floats,
) -> None:
    """Add the information of a factor to the front."""
    n, n_keys, in_order = count[f], key_first[f + 1] - key_first[f], True
    for k in range(n_keys):  # keys in the order in which they stand in the front
        to = k
        while to > 0 and begin[entries[to - 1]] > begin[key_first[f] + k]:
            entries[to] = entries[to - 1]
            to -= 1
            in_order = False
        entries[to] = key_first[f] + k
    columns = 0
    for k in range(n_keys):
        e = entries[k]
        start = at[node[e]] + begin[e] - first[node[e]]
        for c in range(size[e]):
            column[columns] = start + c
            columns += 1
    column[columns] = len(front) - 1
    columns += 1
    of_rows = data[data_first[f] : data_first[f + 1]].reshape((n, columns))
    if not in_order:
        sorted_rows, to = room[: n * columns].reshape((n, columns)), 0
        for k in range(n_keys):
            e, source = entries[k], 0
            for other in range(key_first[f], e):
                source += size[other]
            for r in range(n):
                for c in range(size[e]):
                    sorted_rows[r, to + c] = of_rows[r, source + c]
            to += size[e]
        for r in range(n):
            sorted_rows[r, to] = of_rows[r, to]
        of_rows = sorted_rows
    run = 0
    while run < columns:  # of columns that follow each other in the front
        end = run + 1
        while end < columns and column[end] == column[end - 1] + 1:
            end += 1
        for a in range(end):
            begins = max(a, run)
            row = front[column[a], column[begins] : column[begins] + end - begins]
            r = 0
            while r + 3 <= n:
                u, v, w = of_rows[r, a], of_rows[r + 1, a], of_rows[r + 2, a]
                if u != 0.0 or v != 0.0 or w != 0.0:
                    _add_three(
                        row, u, v, w, of_rows[r, begins:end], of_rows[r + 1, begins:end], of_rows[r + 2, begins:end]
                    )
                r += 3
            while r < n:
                _add(row, of_rows[r, a], of_rows[r, begins:end])
                r += 1
        run = end


@compiled
def _take_up(
    stack: Floats,
    top: int,
    child: int,
    first: Indices,
    later: Indices,
    later_first: Indices,
    at: Indices,
    front: Floats,
) -> int:
    """Add what remains of a child to the front, and return the top of the stack below it."""
    total, last = 1, len(front) - 1
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
            front[a, last] += stack[source]
            row += 1
    return top


@compiled
def _factorise(front: Floats, base: int, inner: int) -> bool:
    """Replace rows of a front by those of its Cholesky factor, and subtract their squares from the rest.

    Its rows are those from ``base`` to ``inner``. Returns whether their scalars are not determined.
    """
    width = len(front)
    for a in range(base, width):
        row = front[a, a:width]
        end = min(a, inner)
        k = base
        while k + 3 <= end:
            _add_three(
                row,
                -front[k, a],
                -front[k + 1, a],
                -front[k + 2, a],
                front[k, a:width],
                front[k + 1, a:width],
                front[k + 2, a:width],
            )
            k += 3
        while k < end:
            _add(row, -front[k, a], front[k, a:width])
            k += 1
        if a < inner:
            pivot = row[0]
            if not pivot > 0.0:
                return True
            scale = 1.0 / np.sqrt(pivot)
            for b in range(len(row)):
                row[b] *= scale
    return False


@compiled
def _add_three(row: Floats, u: float, v: float, w: float, one: Floats, two: Floats, three: Floats) -> None:
    """Add multiples of three other rows."""
    for b in range(len(row)):
        row[b] += u * one[b] + v * two[b] + w * three[b]


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
    m, later_x = len(first) - 1, np.empty(len(x))
    for j in range(m - 1, -1, -1):
        n = first[j + 1] - first[j]
        for c in range(x.shape[1]):
            width = 0
            for e in range(later_first[j], later_first[j + 1]):
                for row in range(first[later[e]], first[later[e] + 1]):
                    later_x[width] = x[row, c]
                    width += 1
            i = 0
            while i + 3 <= n:  # three sums at once, since each waits for its last addition
                tie = ties_first[j] + i * width
                u, v, w = x[first[j] + i, c], x[first[j] + i + 1, c], x[first[j] + i + 2, c]
                for b in range(width):
                    u -= ties[tie + b] * later_x[b]
                    v -= ties[tie + width + b] * later_x[b]
                    w -= ties[tie + 2 * width + b] * later_x[b]
                x[first[j] + i, c], x[first[j] + i + 1, c], x[first[j] + i + 2, c] = u, v, w
                i += 3
            while i < n:
                u = x[first[j] + i, c]
                for b in range(width):
                    u -= ties[ties_first[j] + i * width + b] * later_x[b]
                x[first[j] + i, c] = u
                i += 1
            for i in range(n - 1, -1, -1):
                root = roots_first[j] + i * n
                for k in range(i + 1, n):
                    x[first[j] + i, c] -= roots[root + k] * x[first[j] + k, c]
                x[first[j] + i, c] /= roots[root + i]
