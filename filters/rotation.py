"""The few functions on rotations that the hot loops need, compiled, on plain floats in tuples.

Quaternions are Hamilton, ``(w, x, y, z)``, of length 1 unless said otherwise; vectors are ``(x, y, z)``. Everything
works in the precision of its arguments. Whole columns belong to scipy's ``Rotation``
(:mod:`stillpoint.datasets.frames`): one product takes nanoseconds here and microseconds there.
"""

from math import cos, sin, sqrt

from stillpoint.datasets.compiled import compiled
from stillpoint.datasets.quaternion import Quaternion, Vector, conjugate, exp, log, multiply

__all__ = [
    "Quaternion",
    "Vector",
    "add",
    "blend",
    "conjugate",
    "cross",
    "dot",
    "exp",
    "log",
    "multiply",
    "norm",
    "normalise",
    "quaternion_from_rows",
    "rotate",
    "rotation_about_up",
    "rotation_between",
    "scale",
]

# Vectors closer than that (sine of the angle, squared) to opposite, or parallel, fix no axis.
_PARALLEL_BELOW = 1e-12


@compiled
def dot(u: Vector, v: Vector) -> float:
    """Return the scalar product."""
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@compiled
def cross(u: Vector, v: Vector) -> Vector:
    """Return the vector product."""
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


@compiled
def scale(v: Vector, factor: float) -> Vector:
    """Return ``factor * v``."""
    return v[0] * factor, v[1] * factor, v[2] * factor


@compiled
def add(u: Vector, v: Vector) -> Vector:
    """Return ``u + v``."""
    return u[0] + v[0], u[1] + v[1], u[2] + v[2]


@compiled
def blend(u: Vector, v: Vector, share: float) -> Vector:
    """Return ``share * u + (1 - share) * v``."""
    rest = 1.0 - share
    return u[0] * share + v[0] * rest, u[1] * share + v[1] * rest, u[2] * share + v[2] * rest


@compiled
def norm(v: Vector) -> float:
    """Return the length of a vector."""
    return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


@compiled
def normalise(q: Quaternion) -> Quaternion:
    """Return the quaternion of length 1 in the direction of ``q``, which may have any length but 0."""
    size = 1.0 / sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return q[0] * size, q[1] * size, q[2] * size, q[3] * size


@compiled
def rotate(q: Quaternion, v: Vector) -> Vector:
    """Return ``v`` rotated by ``q``: with ``q_nb``, body axes in, n axes out."""
    x, y, z = q[2] * v[2] - q[3] * v[1], q[3] * v[0] - q[1] * v[2], q[1] * v[1] - q[2] * v[0]
    x, y, z = x + x, y + y, z + z
    return (
        v[0] + q[0] * x + q[2] * z - q[3] * y,
        v[1] + q[0] * y + q[3] * x - q[1] * z,
        v[2] + q[0] * z + q[1] * y - q[2] * x,
    )


@compiled
def rotation_about_up(angle: float) -> Quaternion:
    """Return the rotation by ``angle`` rad about the third axis, counter-clockwise seen from its tip."""
    half = angle * 0.5
    return cos(half), 0.0, 0.0, sin(half)


@compiled
def rotation_between(u: Vector, v: Vector) -> Quaternion:
    """Return the smallest rotation that takes the direction of ``u`` to that of ``v``; neither may be 0.

    Opposite directions have many: one about an axis at right angles to ``u`` is chosen.
    """
    size = sqrt(dot(u, u) * dot(v, v))
    w = size + dot(u, v)
    x, y, z = cross(u, v)
    if w < size * 0.5 * _PARALLEL_BELOW:
        w = 0.0
        if abs(u[0]) < abs(u[2]):
            x, y, z = w, u[2], -u[1]
        else:
            x, y, z = u[1], -u[0], w
    return normalise((w, x, y, z))


@compiled
def quaternion_from_rows(first: Vector, second: Vector, third: Vector) -> Quaternion:
    """Return the quaternion of the matrix with these orthonormal rows: the axes of n, written in b, give ``q_nb``.

    Divides by the largest of the four components (Shepperd 1978), so that no rotation is singular.
    """
    a, b, c = first[0], second[1], third[2]
    if a + b + c > 0:
        q = 1.0 + a + b + c, third[1] - second[2], first[2] - third[0], second[0] - first[1]
    elif a >= b and a >= c:
        q = third[1] - second[2], 1.0 + a - b - c, second[0] + first[1], first[2] + third[0]
    elif b >= c:
        q = first[2] - third[0], second[0] + first[1], 1.0 - a + b - c, third[1] + second[2]
    else:
        q = second[0] - first[1], first[2] + third[0], third[1] + second[2], 1.0 - a - b + c
    return normalise(q)
