"""Eliminate the effective bias C of an interval, which only its IMU factor and its calibration have, by a formula.

The factors A x + F c = b and c = u + M z - e + n, for steps x, u, z, c of the states at both ends, of the bias, of the
calibration and of C, and noise n with variances S, are together

    L^-1 (A x + F u + F M z) = L^-1 (b + F e),    L L' = 1 + F S F',

a factor on states, bias and calibration with residual r. The step of C follows from it: n = -S (L^-1 F)' r. As an
unknown of its own, C would take as long to eliminate as the state beside it.
"""

import numpy as np

from stillpoint.datasets.compiled import compiled_entry
from stillpoint.datasets.recording import Floats

_OF_STATES, _OF_BIAS = 18, 24  # where the columns of the states and of the bias end


@compiled_entry
def eliminate_effective(
    intervals: Floats, by_calibration: Floats, excess: Floats, variance: Floats, out: Floats
) -> None:
    """Write [A b] (m, 25 + k, 9) of m intervals on states (18), bias (6) and calibration (k), column by column.

    ``intervals`` (m, 25, 9) are [A F b], ``by_calibration`` (m, 6, k) is M, ``excess`` (m, 6) is e, ``variance`` (6,)
    the diagonal of S.
    """
    m, k = len(intervals), by_calibration.shape[2]
    root, inverse = np.empty((9, 9)), np.zeros((9, 9))
    for i in range(m):
        for a in range(9):
            for b in range(a + 1):
                total = 1.0 if a == b else 0.0
                for c in range(6):
                    total += intervals[i, _OF_STATES + c, a] * variance[c] * intervals[i, _OF_STATES + c, b]
                for c in range(b):
                    total -= root[a, c] * root[b, c]
                root[a, b] = np.sqrt(total) if a == b else total / root[b, b]
        for a in range(9):  # L^-1 by columns
            for b in range(a, 9):
                total = 1.0 if a == b else 0.0
                for c in range(a, b):
                    total -= root[b, c] * inverse[a, c]
                inverse[a, b] = total / root[b, b]
        for column in range(_OF_BIAS + k + 1):
            for a in range(9):
                out[i, column, a] = 0.0
        for column in range(_OF_BIAS + 1):
            to = column if column < _OF_BIAS else _OF_BIAS + k
            for c in range(9):
                factor = intervals[i, column, c]
                for a in range(9):  # of a fixed number, which makes machine code without a loop
                    out[i, to, a] += factor * inverse[c, a]
        for c in range(6):
            for column in range(k + 1):
                factor = by_calibration[i, c, column] if column < k else excess[i, c]
                if factor != 0.0:
                    for a in range(9):
                        out[i, _OF_BIAS + column, a] += factor * out[i, _OF_STATES + c, a]


def find_noise(rows: Floats, step: Floats, variance: Floats) -> Floats:
    """Return n (m, 6) for factors (m, c + 1, 9) of :func:`eliminate_effective` and a step (m, c) of their unknowns."""
    residual = (step[:, None] @ rows[:, :-1])[:, 0] - rows[:, -1]
    return np.asarray(-variance * _by_bias(rows, residual))


def split_residuals(rows: Floats, variance: Floats) -> tuple[Floats, Floats]:
    """Return the squared residuals (m,) of IMU and calibration with the best C for the values of the others."""
    residual = -rows[:, -1]
    calibration = (variance * _by_bias(rows, residual) ** 2).sum(axis=1)
    return (residual**2).sum(axis=1) - calibration, calibration


def _by_bias(rows: Floats, residual: Floats) -> Floats:
    """Return (L^-1 F)' r, (m, 6)."""
    return np.asarray((rows[:, _OF_STATES:_OF_BIAS] @ residual[:, :, None])[:, :, 0])
