"""Integrate slowly sampled readings: what rate and force did between two samples.

A graph takes rate and force as constant from sample to sample. At 24 Hz a hand turns by 20 deg in between, and the mean
rate of an interval is not the rotation over it: the rotation also depends on the order of turns (coning; Bortz 1971),
and the change of velocity on the attitude at which a force acts (sculling). Here both signals are splines, integrated
in substeps. There are two kinds of slow logs, which only the data tell apart:

- ``mean``: a reading is the mean over the interval that ends at its stamp, as of a sensor that filters before it
  decimates. The spline goes through the sums of the readings, and keeps them.
- ``instant``: a reading is of the moment of its stamp, as in a log from which samples were dropped. The spline goes
  through the readings. What happened above half of the sampling rate is lost.
"""

from typing import Literal

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.spatial.transform import Rotation

from stillpoint.datasets.recording import Floats
from stillpoint.datasets.times import GAP_STEPS

Sampling = Literal["mean", "instant"]
DEGREE = 5  # of the spline of the integrals: an error per interval 40 times below that of constant rates, at 24 Hz
SUBSTEPS = 8  # in an interval
SHORTEST = 12  # samples in a stretch without a gap; a shorter one is left as it is


def integrate_slow_log(
    t_s: Floats, gyro_b_radps: Floats, accel_b_mps2: Floats, bias_b_radps: Floats, sampling: Sampling
) -> tuple[Floats, Floats]:
    """Return constant rates and forces (N, 3) that turn and push a body in each interval as the real ones did.

    ``t_s`` (N,) rises; readings (N, 3) in body axes; ``bias_b_radps`` (3,) is about that of the gyro. A rate acts over
    the interval that ends at its stamp, a force with the attitude at the beginning of the interval. Readings around
    gaps stay as they are.
    """
    gyro, accel = gyro_b_radps.copy(), accel_b_mps2.copy()
    step_s = np.diff(t_s)
    breaks = np.flatnonzero(step_s > GAP_STEPS * np.median(step_s)) + 1
    for here in np.split(np.arange(len(t_s)), breaks):
        if len(here) >= SHORTEST:
            inner = here[1:]
            turned, pushed = _integrate_stretch(t_s[here], gyro[here] - bias_b_radps, accel[here], sampling)
            gyro[inner], accel[inner] = turned + bias_b_radps, pushed
    return gyro, accel


def _integrate_stretch(t_s: Floats, gyro: Floats, accel: Floats, sampling: Sampling) -> tuple[Floats, Floats]:
    """Return constant rates and forces (n - 1, 3) of the intervals of a stretch without gaps."""
    dt_s = np.diff(t_s)[:, None]
    edges_s = t_s[:-1, None] + dt_s * np.arange(SUBSTEPS + 1) / SUBSTEPS
    turn = np.diff(_make_integral(t_s, gyro, sampling)(edges_s), axis=1)  # (n - 1, SUBSTEPS, 3)
    push = np.diff(_make_integral(t_s, accel, sampling)(edges_s), axis=1)
    attitude = np.broadcast_to(np.eye(3), (len(dt_s), 3, 3))
    velocity = np.zeros((len(dt_s), 3))
    for k in range(SUBSTEPS):
        half = Rotation.from_rotvec(turn[:, k] / 2).as_matrix()
        velocity += np.einsum("nij,njk,nk->ni", attitude, half, push[:, k])
        attitude = attitude @ half @ half
    return Rotation.from_matrix(attitude).as_rotvec() / dt_s, velocity / dt_s


def _make_integral(t_s: Floats, readings: Floats, sampling: Sampling) -> BSpline:
    """Return the spline of the integral of readings (n, 3) from the first stamp on."""
    if sampling == "instant":
        return make_interp_spline(t_s, readings, k=DEGREE - 2, axis=0).antiderivative()
    steps = readings[1:] * np.diff(t_s)[:, None]
    return make_interp_spline(t_s, np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)]), k=DEGREE, axis=0)
