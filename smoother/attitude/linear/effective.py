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
from stillpoint.smoother.attitude.linear.preintegration import invert_root

_OF_STATES, _OF_BIAS = 18, 24  # where the columns of the states and of the bias end


@compiled_entry
def eliminate_effective(
    intervals: Floats, by_calibration: Floats, excess: Floats, variance: Floats, out: Floats
) -> None:
    """Write [A b] (m, 9, 25 + k) of m intervals on velocity and pose of both states, bias (6) and calibration (k).

    ``intervals`` (m, 9, 25) are [A F b] with pose before velocity, ``by_calibration`` (m, 6, k) is M, ``excess`` (m, 6)
    is e, ``variance`` (6,) the diagonal of S. In ``out`` the unknowns stand in the order of their elimination.
    """
    m, k = len(intervals), by_calibration.shape[2]
    root, inverse, whole = np.empty((9, 9)), np.zeros((9, 9)), np.empty((9, _OF_BIAS + 1))
    for i in range(m):
        for a in range(9):
            for b in range(a + 1):
                total = 1.0 if a == b else 0.0
                for c in range(_OF_STATES, _OF_BIAS):
                    total += intervals[i, a, c] * variance[c - _OF_STATES] * intervals[i, b, c]
                root[a, b] = total
        invert_root(root, inverse)
        for a in range(9):
            for column in range(_OF_BIAS + 1):
                whole[a, column] = 0.0
            for c in range(a + 1):
                for column in range(_OF_BIAS + 1):  # of a fixed number, which makes fast machine code
                    whole[a, column] += inverse[a, c] * intervals[i, c, column]
        for a in range(9):
            for column in range(_OF_STATES):
                out[i, a, column // 9 * 9 + (column + 3) % 9] = whole[a, column]
            for c in range(6):
                out[i, a, _OF_STATES + c] = whole[a, _OF_STATES + c]
            for column in range(k):
                out[i, a, _OF_BIAS + column] = 0.0
            out[i, a, _OF_BIAS + k] = whole[a, _OF_BIAS]
        for c in range(6):
            for column in range(k + 1):
                factor = by_calibration[i, c, column] if column < k else excess[i, c]
                if factor != 0.0:
                    for a in range(9):
                        out[i, a, _OF_BIAS + column] += factor * whole[a, _OF_STATES + c]


def find_noise(rows: Floats, step: Floats, variance: Floats) -> Floats:
    """Return n (m, 6) for factors (m, 9, c + 1) of :func:`eliminate_effective` and a step (m, c) of their unknowns."""
    residual = (rows[:, :, :-1] @ step[:, :, None])[:, :, 0] - rows[:, :, -1]
    return np.asarray(-variance * _by_bias(rows, residual))


def split_residuals(rows: Floats, variance: Floats) -> tuple[Floats, Floats]:
    """Return the squared residuals (m,) of IMU and calibration with the best C for the values of the others."""
    residual = -rows[:, :, -1]
    calibration = (variance * _by_bias(rows, residual) ** 2).sum(axis=1)
    return (residual**2).sum(axis=1) - calibration, calibration


def _by_bias(rows: Floats, residual: Floats) -> Floats:
    """Return (L^-1 F)' r, (m, 6)."""
    return np.asarray((residual[:, None] @ rows[:, :, _OF_STATES:_OF_BIAS])[:, 0])
