"""Preintegrate IMU measurements between states and linearise their residuals, as gtsam's ImuFactor does.

A graph holds one interval for each tenth of a second. An object of gtsam for each takes longer to make and to read out
than all of them take to linearise here. The equations are those of gtsam, which the tests compare: the preintegration
in the tangent space, zeta = (turn, place, velocity) with covariance and derivatives by the bias (Forster et al. (2017);
Lupton and Sukkarieh (2012)), and its error against the states at both ends.
"""

import numpy as np

from stillpoint.datasets.compiled import compiled, compiled_entry
from stillpoint.datasets.recording import Floats

_SMALL = 1e-4  # square of an angle, rad^2, below which series replace the quotients of the Jacobians


@compiled_entry
def preintegrate(
    force: Floats, rate: Floats, length_s: Floats, accel_var: Floats, gyro_var: Floats, place_var: float
) -> tuple[Floats, Floats, Floats]:
    """Return zeta (m, 9), its derivative by the biases (m, 9, 6), and the whitening matrix (m, 9, 9) of m intervals.

    ``force`` and ``rate`` (m, k, 3) less their biases hold over ``length_s`` (m, k); variances (m, 3) are of white
    noise per second, ``place_var`` of the place.
    """
    n = len(force)
    zeta, by_bias, whitening = np.zeros((n, 9)), np.zeros((n, 9, 6)), np.zeros((n, 9, 9))
    turn, jacobian, inverse, slope = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    step, product, cov, other = np.empty((9, 9)), np.empty((9, 9)), np.empty((9, 9)), np.empty((9, 6))
    pushed, rolled, crossed = np.empty(3), np.empty(3), np.empty((3, 3))
    for i in range(n):
        cov[:, :] = 0.0
        for part in range(force.shape[1]):
            dt = length_s[i, part]
            if not dt > 0.0:
                continue
            _rotation_and_jacobians(zeta[i], turn, jacobian, inverse)
            for a in range(3):
                rolled[a] = pushed[a] = 0.0
                for b in range(3):
                    rolled[a] += inverse[a, b] * rate[i, part, b]
                    pushed[a] += turn[a, b] * force[i, part, b]
            _slope_of_inverse(zeta[i], rolled, inverse, slope)
            _cross_matrix(force[i, part], crossed)
            step[:, :] = 0.0
            for a in range(9):
                step[a, a] = 1.0
            for a in range(3):
                step[3 + a, 6 + a] = dt
                for b in range(3):
                    step[a, b] += slope[a, b] * dt
                    tilted = 0.0  # - R [a]x J: derivative of the pushed force by the turn
                    for c in range(3):
                        for e in range(3):
                            tilted -= turn[a, c] * crossed[c, e] * jacobian[e, b]
                    step[3 + a, b], step[6 + a, b] = 0.5 * tilted * dt * dt, tilted * dt
            _multiply_left(step, cov, product)
            for a in range(9):
                for b in range(9):
                    total = 0.0
                    for c in range(9):
                        total += product[a, c] * step[b, c]
                    cov[a, b] = total
            for a in range(3):
                cov[3 + a, 3 + a] += place_var * dt
                for b in range(3):
                    by_gyro = by_accel = 0.0
                    for c in range(3):
                        by_gyro += inverse[a, c] * inverse[b, c] * gyro_var[i, c]
                        by_accel += turn[a, c] * turn[b, c] * accel_var[i, c]
                    cov[a, b] += by_gyro * dt
                    cov[3 + a, 3 + b] += 0.25 * by_accel * dt * dt * dt
                    cov[3 + a, 6 + b] += 0.5 * by_accel * dt * dt
                    cov[6 + a, 3 + b] += 0.5 * by_accel * dt * dt
                    cov[6 + a, 6 + b] += by_accel * dt
            _multiply_left(step, by_bias[i], other)
            for a in range(9):  # assigning an array to a slice would take numba seconds to compile
                for b in range(6):
                    by_bias[i, a, b] = other[a, b]
            for a in range(3):
                for b in range(3):
                    by_bias[i, a, 3 + b] -= inverse[a, b] * dt
                    by_bias[i, 3 + a, b] -= 0.5 * turn[a, b] * dt * dt
                    by_bias[i, 6 + a, b] -= turn[a, b] * dt
            for a in range(3):
                zeta[i, 3 + a] += (zeta[i, 6 + a] + 0.5 * pushed[a] * dt) * dt
                zeta[i, 6 + a] += pushed[a] * dt
                zeta[i, a] += rolled[a] * dt
        invert_root(cov, whitening[i])
    return zeta, by_bias, whitening


@compiled_entry
def linearise_intervals(
    zeta: Floats,
    by_bias: Floats,
    whitening: Floats,
    length_s: Floats,
    bias: Floats,
    g_mps2: Floats,
    poses: tuple[Floats, Floats],
    velocities: tuple[Floats, Floats],
) -> Floats:
    """Return the whitened [A b] (m, 9, 25) of m intervals.

    The columns are those of pose (turn and place in body axes) and velocity at the beginning, at the end, and of the
    bias (accelerometer, gyro). ``bias`` (m, 6) is relative to that of the preintegration; ``poses`` (m, 12) are
    rotation matrices by rows and places at both ends, ``velocities`` (m, 3).
    """
    n = len(zeta)
    rows, by_rows = np.zeros((n, 9, 25)), np.empty((9, 25))
    error, after, slope = np.empty(9), np.empty(9), np.zeros((24, 9))
    turn, jacobian, inverse = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    back, whole, of_end, crossed = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    by_turn, unused, apart, opposite = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3)
    for i in range(n):
        dt = length_s[i]
        begin, end = poses[0][i, :9].reshape((3, 3)), poses[1][i, :9].reshape((3, 3))
        for a in range(9):
            after[a] = zeta[i, a]
            for b in range(6):
                after[a] += by_bias[i, a, b] * bias[i, b]
        _rotation_and_jacobians(after, turn, jacobian, unused)
        for a in range(3):
            for b in range(3):
                back[a, b] = 0.0  # R_j' R_i
                for c in range(3):
                    back[a, b] += end[c, a] * begin[c, b]
        for a in range(3):
            for b in range(3):
                whole[a, b] = 0.0  # R_j' of the predicted attitude
                for c in range(3):
                    whole[a, b] += back[a, c] * turn[c, b]
        _rotation_vector(whole, error)
        _rotation_and_jacobians(error, unused, of_end, inverse)
        slope[:, :] = 0.0
        # Turn: J^-1 (exp(r)' phi_i + J(r) dr - E' phi_j)
        for a in range(3):
            for b in range(3):
                for c in range(3):
                    slope[b, a] += inverse[a, c] * turn[b, c]
                    slope[9 + b, a] -= inverse[a, c] * whole[b, c]
        for a in range(3):
            for b in range(3):
                by_turn[a, b] = 0.0
                for c in range(3):
                    by_turn[a, b] += inverse[a, c] * jacobian[c, b]
        for b in range(6):
            for a in range(3):
                for c in range(3):
                    slope[18 + b, a] += by_turn[a, c] * by_bias[i, c, b]
        # Place and velocity in the axes of the end
        for part in range(2):
            row = 3 + 3 * part
            for a in range(3):
                if part == 0:
                    moved = poses[0][i, 9 + a] + velocities[0][i, a] * dt - poses[1][i, 9 + a]
                    moved -= 0.5 * g_mps2[i] * dt * dt if a == 2 else 0.0
                else:
                    moved = velocities[0][i, a] - velocities[1][i, a]
                    moved -= g_mps2[i] * dt if a == 2 else 0.0
                apart[a] = moved
            for a in range(3):
                error[row + a] = 0.0
                for c in range(3):
                    error[row + a] += end[c, a] * apart[c] + back[a, c] * after[row + c]
            _cross_matrix(after[row : row + 3], crossed)
            for a in range(3):
                for b in range(3):
                    for c in range(3):
                        slope[b, row + a] -= back[a, c] * crossed[c, b]
                    if part == 0:
                        slope[3 + b, row + a] = back[a, b]
                        slope[6 + b, row + a] = end[b, a] * dt
                    else:
                        slope[6 + b, row + a] = end[b, a]
                        slope[15 + b, row + a] = -end[b, a]
                for b in range(6):
                    for c in range(3):
                        slope[18 + b, row + a] += back[a, c] * by_bias[i, row + c, b]
                if part == 0:
                    slope[12 + a, row + a] = -1.0
            _cross_matrix(error[row : row + 3], crossed)
            for a in range(3):
                for b in range(3):
                    slope[9 + b, row + a] += crossed[a, b]
        _make_error_a_logarithm(error, slope, inverse, opposite, by_turn, unused)
        for a in range(9):
            for column in range(24):
                by_rows[a, column] = slope[column, a]
            by_rows[a, 24] = -error[a]
        for a in range(9):
            for c in range(a + 1):
                for column in range(25):  # of a fixed number, which makes fast machine code
                    rows[i, a, column] += whitening[i, a, c] * by_rows[c, column]
    return rows


@compiled
def _make_error_a_logarithm(
    error: Floats, slope: Floats, inverse: Floats, opposite: Floats, left: Floats, by_turn: Floats
) -> None:
    """Replace errors u of place and velocity by K u with K = J(-r)^-1, r the error of the turn, and their slopes too.

    gtsam takes the error for the logarithm in the group of attitude, place and velocity. ``inverse`` is J(r)^-1; the
    last three are room for numbers on the way.
    """
    for a in range(3):
        opposite[a] = -error[a]
        for b in range(3):
            left[a, b] = inverse[b, a]  # J(-r) = J(r)'
    first = np.empty(3)
    for row in (3, 6):
        for a in range(3):
            first[a] = left[a, 0] * error[row] + left[a, 1] * error[row + 1] + left[a, 2] * error[row + 2]
        _slope_of_inverse(opposite, first, left, by_turn)
        for a in range(3):
            error[row + a] = first[a]
        for column in range(24):
            u, v, w = slope[column, row], slope[column, row + 1], slope[column, row + 2]
            x, y, z = slope[column, 0], slope[column, 1], slope[column, 2]
            for a in range(3):
                moved = left[a, 0] * u + left[a, 1] * v + left[a, 2] * w
                slope[column, row + a] = moved - (by_turn[a, 0] * x + by_turn[a, 1] * y + by_turn[a, 2] * z)


@compiled
def _rotation_and_jacobians(r: Floats, turn: Floats, jacobian: Floats, inverse: Floats) -> None:
    """Write exp(r), the right Jacobian of r and its inverse (3, 3)."""
    x, y, z = r[0], r[1], r[2]
    square = x * x + y * y + z * z
    if square < _SMALL:
        sine, once, twice = 1.0 - square / 6.0, 0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0
        back = 1.0 / 12.0 + square / 720.0
    else:
        angle = np.sqrt(square)
        sine, once = np.sin(angle) / angle, (1.0 - np.cos(angle)) / square
        twice = (1.0 - sine) / square
        back = (1.0 - 0.5 * sine / once) / square
    for a in range(3):
        for b in range(3):
            outer = r[a] * r[b] - (square if a == b else 0.0)
            same = 1.0 if a == b else 0.0
            turn[a, b] = same + once * outer
            jacobian[a, b] = same + twice * outer
            inverse[a, b] = same + back * outer
    _add_cross(turn, x, y, z, sine)
    _add_cross(jacobian, x, y, z, -once)
    _add_cross(inverse, x, y, z, 0.5)


@compiled
def _add_cross(matrix: Floats, x: float, y: float, z: float, factor: float) -> None:
    matrix[0, 1] -= factor * z
    matrix[1, 0] += factor * z
    matrix[0, 2] += factor * y
    matrix[2, 0] -= factor * y
    matrix[1, 2] -= factor * x
    matrix[2, 1] += factor * x


@compiled
def _cross_matrix(v: Floats, out: Floats) -> None:
    """Write the cross-product matrix of a vector."""
    out[:, :] = 0.0
    _add_cross(out, v[0], v[1], v[2], 1.0)


@compiled
def _slope_of_inverse(r: Floats, c: Floats, inverse: Floats, out: Floats) -> None:
    """Write the derivative of J(r)^-1 v by r, with c = J(r)^-1 v: -J(r)^-1 d(J(r) c)/dr."""
    square = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
    if square < _SMALL:
        once, twice = 0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0
        by_once, by_twice = -1.0 / 12.0 + square / 180.0, -1.0 / 60.0 + square / 1260.0
    else:
        angle = np.sqrt(square)
        sine, cosine = np.sin(angle), np.cos(angle)
        once, twice = (1.0 - cosine) / square, (angle - sine) / (square * angle)
        by_once = (sine / angle - 2.0 * once) / square
        by_twice = (once - 3.0 * twice) / square
    along = r[0] * c[0] + r[1] * c[1] + r[2] * c[2]
    first = np.array((r[1] * c[2] - r[2] * c[1], r[2] * c[0] - r[0] * c[2], r[0] * c[1] - r[1] * c[0]))
    slope = np.zeros((3, 3))
    _add_cross(slope, c[0], c[1], c[2], once)
    for a in range(3):
        second = r[a] * along - c[a] * square
        slope[a, a] += twice * along
        for b in range(3):
            slope[a, b] += twice * (r[a] * c[b] - 2.0 * c[a] * r[b])
            slope[a, b] += (by_twice * second - by_once * first[a]) * r[b]
    for a in range(3):
        for b in range(3):
            out[a, b] = 0.0
            for k in range(3):
                out[a, b] -= inverse[a, k] * slope[k, b]


@compiled
def _rotation_vector(turn: Floats, out: Floats) -> None:
    """Write the rotation vector of a rotation matrix to ``out``, by way of the largest part of its quaternion."""
    trace = turn[0, 0] + turn[1, 1] + turn[2, 2]
    if trace > 0.0:
        w = 1.0 + trace
        x, y, z = turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]
    elif turn[0, 0] >= turn[1, 1] and turn[0, 0] >= turn[2, 2]:
        w, x = turn[2, 1] - turn[1, 2], 1.0 + turn[0, 0] - turn[1, 1] - turn[2, 2]
        y, z = turn[0, 1] + turn[1, 0], turn[0, 2] + turn[2, 0]
    elif turn[1, 1] >= turn[2, 2]:
        w, y = turn[0, 2] - turn[2, 0], 1.0 + turn[1, 1] - turn[0, 0] - turn[2, 2]
        x, z = turn[0, 1] + turn[1, 0], turn[1, 2] + turn[2, 1]
    else:
        w, z = turn[1, 0] - turn[0, 1], 1.0 + turn[2, 2] - turn[0, 0] - turn[1, 1]
        x, y = turn[0, 2] + turn[2, 0], turn[1, 2] + turn[2, 1]
    size = np.sqrt(x * x + y * y + z * z)
    if w < 0.0:
        w, size = -w, -size
    scale = 2.0 / w if size == 0.0 else 2.0 * np.arctan2(abs(size), w) / size
    out[0], out[1], out[2] = scale * x, scale * y, scale * z


@compiled
def _multiply_left(left: Floats, right: Floats, out: Floats) -> None:
    """Write the product of a sparse (9, 9) and a dense (9, k) matrix."""
    for a in range(9):
        out[a, :] = 0.0
        for c in range(9):
            w = left[a, c]
            if w != 0.0:
                for b in range(right.shape[1]):
                    out[a, b] += w * right[c, b]


@compiled
def invert_root(covariance: Floats, out: Floats) -> None:
    """Write L^-1 for a covariance L L' (9, 9), which is replaced by L."""
    for a in range(9):
        for b in range(a + 1):
            total = covariance[a, b]
            for c in range(b):
                total -= covariance[a, c] * covariance[b, c]
            covariance[a, b] = np.sqrt(total) if a == b else total / covariance[b, b]
    for b in range(9):
        for a in range(b, 9):
            total = 1.0 if a == b else 0.0
            for c in range(b, a):
                total -= covariance[a, c] * out[c, b]
            out[a, b] = total / covariance[a, a]
