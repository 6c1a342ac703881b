"""The covariance of an error state: small dense matrices that stay symmetric and positive definite, also in float32.

A covariance P is an (n, n) array that is changed in place. It is positive definite by its form: the prediction is a
congruence A P A' + Q, an update is Joseph's form, and both compute one triangle and mirror it. :func:`round_up`
restores what rounding may take from the smallest eigenvalue.
"""

from math import pi, sqrt
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.compiled import compiled, compiled_apart
from stillpoint.filters.rotation import Quaternion, Vector, dot

Matrix: TypeAlias = NDArray[Any]  # float64 or float32
Axes: TypeAlias = tuple[Vector, Vector, Vector]
Six: TypeAlias = tuple[float, float, float, float, float, float]
Nine: TypeAlias = tuple[float, float, float, float, float, float, float, float, float]

# The variance of an angle of which nothing is known: even over a whole turn.
ANY_ANGLE_RAD2 = pi * pi / 3
# So many units of rounding are added to each variance at a prediction: more than products of this size lose.
_ROUNDINGS = 16.0


@compiled
def identity_like(p: Matrix) -> Matrix:
    """Return the identity matrix in the size and precision of P."""
    a = np.zeros_like(p)
    for i in range(len(p)):
        a[i, i] = 1.0
    return a


@compiled_apart
def apply_congruence(a: Matrix, p: Matrix) -> None:
    """Replace P by A P A'."""
    n = len(p)
    ap = np.empty_like(p)
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += a[i, k] * p[k, j]
            ap[i, j] = total
    for i in range(n):
        for j in range(i, n):
            total = 0.0
            for k in range(n):
                total += ap[i, k] * a[j, k]
            p[i, j] = total
            p[j, i] = total


@compiled
def round_up(p: Matrix) -> None:
    """Enlarge each variance by a few units of its rounding: 4e-15 of it in double precision, 2e-6 in single."""
    larger = 1.0 + _ROUNDINGS * (1.2e-7 if p.itemsize == 4 else 2.3e-16)
    for i in range(len(p)):
        p[i, i] *= larger


@compiled_apart
def times_row(p: Matrix, h: Matrix) -> Matrix:
    """Return P h' for a row h."""
    ph = np.empty_like(h)
    for i in range(len(h)):
        total = 0.0
        for k in range(len(h)):
            total += p[i, k] * h[k]
        ph[i] = total
    return ph


@compiled_apart
def update_joseph(p: Matrix, h: Matrix, gain: Matrix, r: float) -> None:
    """Replace P by (I - K h) P (I - K h)' + K r K', which holds for any gain K of a scalar measurement with row h."""
    n = len(p)
    ph = times_row(p, h)
    for i in range(n):
        for j in range(n):
            p[i, j] -= gain[i] * ph[j]
    left = times_row(p, h)
    for i in range(n):
        for j in range(i, n):
            value = p[i, j] - left[i] * gain[j] + gain[i] * r * gain[j]
            p[i, j] = value
            p[j, i] = value


@compiled_apart
def forget_state(p: Matrix, i: int, variance: float) -> None:
    """Make state i unknown: give it this variance, and no correlation with the others."""
    for j in range(len(p)):
        p[i, j] = 0.0
        p[j, i] = 0.0
    p[i, i] = variance


@compiled_apart
def add_sd(variance: float, sd: float) -> float:
    """Return a variance after an error of this sd that persists: standard deviations add, not variances."""
    root = sqrt(max(variance, 0.0)) + sd
    return root * root


@compiled_apart
def add_sd_along(cov: Nine, sd: Vector) -> Nine:
    """Inflate a 3 x 3 covariance by such errors along its axes."""
    xx, xy, xz, _, yy, yz, _, _, zz = cov
    return add_sd(xx, sd[0]), xy, xz, xy, add_sd(yy, sd[1]), yz, xz, yz, add_sd(zz, sd[2])


@compiled_apart
def scale_variance(p: Matrix, i: int, factor: float) -> None:
    """Multiply the variance of state i by ``factor``; its correlations stay."""
    root = sqrt(factor)
    for j in range(len(p)):
        p[i, j] *= root
        p[j, i] *= root


@compiled
def _times_six(p: Matrix, u: Six) -> Six:
    """Return P of the first six states, times u."""
    a, b, c, d, e, f = u
    return (
        p[0, 0] * a + p[0, 1] * b + p[0, 2] * c + p[0, 3] * d + p[0, 4] * e + p[0, 5] * f,
        p[1, 0] * a + p[1, 1] * b + p[1, 2] * c + p[1, 3] * d + p[1, 4] * e + p[1, 5] * f,
        p[2, 0] * a + p[2, 1] * b + p[2, 2] * c + p[2, 3] * d + p[2, 4] * e + p[2, 5] * f,
        p[3, 0] * a + p[3, 1] * b + p[3, 2] * c + p[3, 3] * d + p[3, 4] * e + p[3, 5] * f,
        p[4, 0] * a + p[4, 1] * b + p[4, 2] * c + p[4, 3] * d + p[4, 4] * e + p[4, 5] * f,
        p[5, 0] * a + p[5, 1] * b + p[5, 2] * c + p[5, 3] * d + p[5, 4] * e + p[5, 5] * f,
    )


@compiled
def _dot_six(u: Six, v: Six) -> float:
    """Return the scalar product."""
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2] + u[3] * v[3] + u[4] * v[4] + u[5] * v[5]


@compiled
def _project_error(axis: Vector, spread_s: Axes) -> Six:
    """Return the weights of the six errors in the attitude error about this axis of n, a little after P."""
    x, y, z = axis
    return x, y, z, -dot(spread_s[0], axis), -dot(spread_s[1], axis), -dot(spread_s[2], axis)


@compiled
def covariance_in_body(p: Matrix, spread_s: Axes, variance: float, q_nb: Quaternion) -> Nine:
    """Return R' (P_ee - S P_be - P_eb S' + S P_bb S' + variance I) R: the attitude's covariance in body axes.

    ``spread_s`` (columns) is S, by which errors 3 .. 5, a gyro's bias, have entered errors 0 .. 2, the attitude's in n.
    """
    first, second, third = body_axes_in_n(q_nb)
    u, v, w = _project_error(first, spread_s), _project_error(second, spread_s), _project_error(third, spread_s)
    pu, pv, pw = _times_six(p, u), _times_six(p, v), _times_six(p, w)
    uv, uw, vw = _dot_six(u, pv), _dot_six(u, pw), _dot_six(v, pw)
    uu, vv, ww = _dot_six(u, pu) + variance, _dot_six(v, pv) + variance, _dot_six(w, pw) + variance
    return uu, uv, uw, uv, vv, vw, uw, vw, ww


@compiled
def body_axes_in_n(q_nb: Quaternion) -> Axes:
    """Return the body's three axes in n: the columns of the rotation matrix."""
    w, x, y, z = q_nb
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        (2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        (2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    )
