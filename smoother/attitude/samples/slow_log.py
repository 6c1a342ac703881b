"""Integrate slowly sampled readings: what rate and force did between two samples, and how wrong that may be.

A graph takes rate and force as constant from sample to sample. At 24 Hz a hand turns by 20 deg in between, and the
mean rate of an interval is not the rotation over it: that depends on the order of turns (coning; Bortz 1971), and the
change of velocity on the attitude at which a force acts (sculling). Splines through the sums of the readings show both.

A reading is taken for the mean over the interval that ends at its stamp, as of a sensor that filters before it
decimates. In a log from which samples were dropped it is of one moment, and what happened above half of the rate is
lost: the error that is stated is that of the second kind, as long as the graph's residuals do not show the first
(graph.py).
"""

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from stillpoint.datasets.recording import Floats
from stillpoint.datasets.times import GAP_STEPS

_SAMPLING_SHARE = 0.5  # of curvature and coning: what remains as an error of a slowly sampled rate, measured on BROAD
RESTORED_SHARE = 0.1  # of that error: what remains of it where splines restore the motion
_SAMPLING_INTERVAL_S = 0.1  # over which that error is compared with the gyro's noise
_SAMPLING_NOTICED = 0.3  # share of the gyro's noise that is noticed
_GYRO_DENSITY_RADPS_RTHZ = 0.003  # of the gyro's noise in motion, as in InertialNoise
_DEGREE = 5  # of the spline: at 24 Hz its error of a rotation is a 40th of that of constant rates, cubic a 20th
_SUBSTEPS = 8  # in an interval
_AT_ONCE = 1 << 17  # samples
_SHORTEST = 12  # samples in a stretch without a gap; a shorter one is left as it is


def estimate_sampling_error(gyro_b_radps: Floats, dt_s: Floats, at_rest: NDArray[np.bool_]) -> Floats:
    """Return by how much (N, 3) a rate may differ from the mean rate of its interval because it is sampled slowly.

    Half of the curvature |w+ - 2 w + w-| / 12 and of the coning term |w- x w| dt / 12 (both vanish with the square of
    the interval). Zero in the whole recording where the gyro's noise covers it.
    """
    if at_rest.all():
        return np.zeros(gyro_b_radps.shape)
    error = np.empty(gyro_b_radps.shape)
    for begin in range(0, len(error), _AT_ONCE):
        rows = slice(begin, begin + _AT_ONCE)
        error[rows] = _estimate_error(gyro_b_radps, dt_s, at_rest, rows)
    step_s = float(np.median(dt_s))
    in_interval_rad = error[~at_rest]
    in_interval_rad *= step_s
    in_interval_rad *= max(1, round(_SAMPLING_INTERVAL_S / step_s))
    noticed_rad = _SAMPLING_NOTICED * _GYRO_DENSITY_RADPS_RTHZ * np.sqrt(_SAMPLING_INTERVAL_S)
    np.square(in_interval_rad, out=in_interval_rad)
    return error if np.sqrt(np.mean(in_interval_rad)) > noticed_rad else np.zeros(error.shape)


def _estimate_error(gyro_b_radps: Floats, dt_s: Floats, at_rest: NDArray[np.bool_], rows: slice) -> Floats:
    """Return the error of :func:`estimate_sampling_error` at some of the samples."""
    index = np.arange(rows.start, min(rows.stop, len(gyro_b_radps)))
    before = gyro_b_radps[np.maximum(index - 1, 0)]
    here, after = gyro_b_radps[rows], gyro_b_radps[np.minimum(index + 1, len(gyro_b_radps) - 1)]
    curvature = np.abs(after - 2 * here + before) / 12
    coning = np.abs(np.cross(before, here)) * dt_s[rows, None] / 12
    return np.asarray(_SAMPLING_SHARE * (curvature + coning) * ~at_rest[rows, None])


def integrate_slow_log(
    t_s: Floats, gyro_b_radps: Floats, accel_b_mps2: Floats, bias_b_radps: Floats
) -> tuple[Floats, Floats]:
    """Return constant rates and forces (N, 3) that turn and push a body in each interval as the real ones did.

    ``t_s`` (N,) rises; readings (N, 3) in body axes, means over the interval that ends at the stamp; ``bias_b_radps``
    (3,) is about that of the gyro. A returned force acts in the axes at the beginning of its interval. The first
    reading behind a gap, and stretches of fewer than SHORTEST samples between gaps, stay as they are.
    """
    gyro, accel = gyro_b_radps.copy(), accel_b_mps2.copy()
    step_s = np.diff(t_s)
    breaks = np.flatnonzero(step_s > GAP_STEPS * np.median(step_s)) + 1
    for here in np.split(np.arange(len(t_s)), breaks):
        if len(here) >= _SHORTEST:
            turned, pushed = _integrate_stretch(t_s[here], gyro[here] - bias_b_radps, accel[here])
            gyro[here[1:]], accel[here[1:]] = turned + bias_b_radps, pushed
    return gyro, accel


def _integrate_stretch(t_s: Floats, gyro: Floats, accel: Floats) -> tuple[Floats, Floats]:
    """Return constant rates and forces (n - 1, 3) of the intervals of a stretch without gaps."""
    dt_s = np.diff(t_s)[:, None]
    sums = np.concatenate([np.zeros((1, 6)), np.cumsum(np.hstack([gyro, accel])[1:] * dt_s, axis=0)])
    edges_s = t_s[:-1, None] + dt_s * np.arange(_SUBSTEPS + 1) / _SUBSTEPS
    steps = np.diff(make_interp_spline(t_s, sums, k=_DEGREE)(edges_s), axis=1)  # (n - 1, SUBSTEPS, 6)
    attitude, velocity = np.broadcast_to(np.eye(3), (len(dt_s), 3, 3)), np.zeros((len(dt_s), 3))
    for k in range(_SUBSTEPS):
        half = Rotation.from_rotvec(steps[:, k, :3] / 2).as_matrix()
        velocity += np.einsum("nij,nj->ni", attitude @ half, steps[:, k, 3:])
        attitude = attitude @ half @ half
    return Rotation.from_matrix(attitude).as_rotvec() / dt_s, velocity / dt_s
