"""Integrate the gyro to an attitude (Elmi Aziz and Mohseni Araste (2021), eq. 10), and model its drift.

A gyro sample at t_k describes the interval (t_{k-1}, t_k], so that q_k = q_{k-1} exp(w_k (t_k - t_{k-1})) is exact for
a rate that is constant in it. The drift model: the earth-frame error e of q_true = exp(e) q grows by the gyro's bias
error, by its scale and misalignment error times the rate, and by a random walk,

    de/dt = R_nb (db + M w) + white,    so    e(t) = A(t) c + walk(t),    c = (the 9 elements of M, db).

A is the integral of R_nb [w_x 1, w_y 1, w_z 1, 1]. Unlike a drift model in seconds it knows that a scale error cancels
when a rotation is reversed.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from stillpoint.datasets.compiled import compiled
from stillpoint.datasets.frames import rotation
from stillpoint.datasets.quaternion import exp, multiply
from stillpoint.datasets.recording import Floats, Imu, Times
from stillpoint.datasets.settings import Settings, degrees, number
from stillpoint.datasets.times import find_gaps

CHUNK = 16_384  # samples whose drift matrices (3 x 12) are held at once


@dataclass(frozen=True)
class GyroErrors(Settings):
    """Errors of a gyro whose bias was measured at rest, one standard deviation: default, lowest, highest."""

    scale_sd: float = number(0.005, 0.0001, 0.2, "scale and misalignment, relative; 0.002 calibrated, 0.03 raw")
    bias_sd_radps: float = degrees(0.03, 0.0001, 5.0, "change of the bias since the rest")
    walk_rad_rts: float = degrees(0.05, 0.0005, 5.0, "angle random walk per sqrt(s), with all that is new each second")
    gap_rate_sd_radps: float = degrees(60.0, 0.0, 3000.0, "rate that a gap in the stamps may hide")


@dataclass(frozen=True, eq=False)
class Swing:
    """The gyro integrated from a known attitude over M samples, uncorrected."""

    rows: Times  # (M,) the samples of the stream whose attitudes follow, in the order of integration
    q_nb: Floats  # (M, 4)
    rate_b_radps: Floats  # (M, 3) of the interval before, minus the bias
    dt_s: Floats  # (M,) that interval; negative when integrating back in time
    walk_rad2: Floats  # (M,) variance of the random walk, per axis, since the start


def walk_steps(t_ns: Times, errors: GyroErrors) -> Floats:
    """Return the variance (N - 1,) that each interval between stamps adds to the random walk; gaps add more."""
    step_s = np.diff(t_ns) / 1e9
    hidden = np.where(find_gaps(t_ns), (errors.gap_rate_sd_radps * step_s) ** 2, 0.0)
    return np.asarray(errors.walk_rad_rts**2 * step_s + hidden)


def swing(imu: Imu, bias_b_radps: Floats, start: int, stop: int, q_start_nb: Floats, walk_rad2: Floats) -> Swing:
    """Integrate from the attitude ``q_start_nb`` (4,) at sample ``start`` to sample ``stop``, forwards or backwards.

    A gap is crossed at the rate of its end; ``walk_rad2`` are the stream's :func:`walk_steps`.
    """
    forwards = stop >= start
    intervals = np.arange(start + 1, stop + 1) if forwards else np.arange(start, stop, -1)
    step_s = (imu.t_ns[intervals] - imu.t_ns[intervals - 1]) / 1e9
    rate = imu.gyro_b_radps[intervals] - bias_b_radps
    dt_s = step_s if forwards else -step_s
    return Swing(
        rows=intervals if forwards else intervals - 1,
        q_nb=integrate(np.asarray(q_start_nb, dtype=np.float64), rate, dt_s),
        rate_b_radps=rate,
        dt_s=dt_s,
        walk_rad2=np.cumsum(walk_rad2[intervals - 1]),
    )


@compiled
def integrate(q_start_nb: Floats, rate_b_radps: Floats, dt_s: Floats) -> Floats:
    """Return the attitude (N, 4) after each of N rates (N, 3) held for ``dt_s`` (N,): q_k = q_{k-1} exp(w_k dt_k)."""
    q_nb = np.empty((len(dt_s), 4))
    q = (q_start_nb[0], q_start_nb[1], q_start_nb[2], q_start_nb[3])
    for k in range(len(dt_s)):
        step = (rate_b_radps[k, 0] * dt_s[k], rate_b_radps[k, 1] * dt_s[k], rate_b_radps[k, 2] * dt_s[k])
        w, x, y, z = multiply(q, exp(step))
        norm = np.sqrt(w * w + x * x + y * y + z * z)
        q = (w / norm, x / norm, y / norm, z / norm)
        q_nb[k, 0], q_nb[k, 1], q_nb[k, 2], q_nb[k, 3] = q
    return q_nb


def drift_matrices(path: Swing) -> Iterator[tuple[slice, Floats]]:
    """Yield A(t) of the drift model after each sample, (n, 3, 12), in chunks with their rows."""
    carry = np.zeros((3, 12))
    for first in range(0, len(path.dt_s), CHUNK):
        rows = slice(first, first + CHUNK)
        turn = rotation(path.q_nb[rows]).as_matrix() * path.dt_s[rows, None, None]
        by_rate = turn[:, :, None, :] * path.rate_b_radps[rows, None, :, None]
        steps = np.concatenate([by_rate.reshape(-1, 3, 9), turn], axis=2)
        chunk = carry + np.cumsum(steps, axis=0)
        carry = chunk[-1]
        yield rows, chunk


def last_drift_matrix(path: Swing) -> Floats:
    """Return A at the end, (3, 12)."""
    turn = rotation(path.q_nb).as_matrix() * path.dt_s[:, None, None]
    by_rate = np.tensordot(turn, path.rate_b_radps, axes=(0, 0)).transpose(0, 2, 1)  # as in drift_matrices
    return np.concatenate([by_rate.reshape(3, 9), turn.sum(axis=0)], axis=1)


def unknowns_variance(errors: GyroErrors) -> Floats:
    """Return the variance of c, (12,): 9 of the gyro matrix, 3 of the bias."""
    return np.concatenate([np.full(9, errors.scale_sd**2), np.full(3, errors.bias_sd_radps**2)])


def drift_covariance(path: Swing, errors: GyroErrors) -> Floats:
    """Return the covariance (3, 3) of the earth-frame error at the end."""
    a = last_drift_matrix(path)
    return (a * unknowns_variance(errors)) @ a.T + path.walk_rad2[-1] * np.eye(3)
