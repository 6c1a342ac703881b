"""Seconds in which little changes, told without any unit: a gyro in deg/s or an accelerometer in g is calm as well."""

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.recording import Floats, Imu, Times

CALM_SPREAD = 0.01  # of the force's size: the smoothed force of a calm second varies by less
SMOOTH_S = 0.1


def calm_seconds(imu: Imu) -> Times:
    """First and last stamps of whole seconds in which the smoothed specific force keeps still, (S, 2)."""
    tenth = _bins(imu.t_ns, SMOOTH_S)
    first, mean = _means(tenth, imu.accel_b_mps2)
    second = tenth[first] // round(1 / SMOOTH_S)
    starts, middle = _means(second, mean)
    _, square = _means(second, mean**2)
    spread = np.sqrt(np.maximum((square - middle**2).sum(axis=1), 0.0))
    whole = np.diff(starts, append=len(second)) == round(1 / SMOOTH_S)
    calm = np.flatnonzero(whole & (spread < CALM_SPREAD * np.linalg.norm(middle, axis=1)))
    ends = np.append(first[starts[1:]], len(imu.t_ns)) - 1
    return np.stack([imu.t_ns[first[starts[calm]]], imu.t_ns[ends[calm]]], axis=1)


def _bins(t_ns: Times, width_s: float) -> Times:
    return np.asarray((t_ns - t_ns[0]) // int(width_s * 1e9))


def _means(bins: Times, values: Floats) -> tuple[NDArray[np.intp], Floats]:
    """Start of each run of equal bins, and the mean over it."""
    starts = np.flatnonzero(np.diff(bins, prepend=bins[0] - 1))
    counts = np.diff(starts, append=len(bins))
    return starts, np.add.reduceat(values, starts, axis=0) / counts[:, None]
