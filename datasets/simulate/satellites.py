"""Simulate a satellite receiver: position, course and speed, and no fix under water."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.earth import Place, to_geodetic
from stillpoint.datasets.recording import Floats, Gps
from stillpoint.datasets.simulate.generators import make_generator
from stillpoint.datasets.simulate.measure import Samples, draw_gauss_markov
from stillpoint.datasets.simulate.path import Motion


@dataclass(frozen=True)
class GpsModel:
    """A receiver and its antenna. Course and speed come from the measured velocity, so a slow course is inaccurate."""

    position_sd_m: float = 0.0  # of each component; wanders (first-order Gauss-Markov)
    position_time_s: float = 60.0  # its correlation time
    velocity_sd_mps: float = 0.0  # of each component of the horizontal velocity, white
    covered_below_m: float = 1.0  # the antenna receives nothing while the body is deeper
    first_fix_s: float = 0.0  # from surfacing to the next fix


def measure_gps(path: Motion, gps: GpsModel, at: Samples, origin: Place, seed: int) -> Gps:
    """Return the fixes of a path whose n has its zero at ``origin``; under water they are not valid and hold NaN."""
    place_n, velocity_n = path.position(at.t_s), velocity_n_mps(path, at.t_s)
    rng = make_generator(seed, "gps/velocity")
    velocity_n[:, :2] += rng.standard_normal((len(place_n), 2)) * gps.velocity_sd_mps
    wander = draw_gauss_markov(gps.position_sd_m, gps.position_time_s, at.step_s, len(place_n), seed, "gps")
    valid = receives(place_n[:, 2], gps, at.step_s)
    lat_deg, lon_deg, alt_m = (np.where(valid, column, np.nan) for column in to_geodetic(place_n + wander, origin))
    course = np.mod(np.arctan2(velocity_n[:, 0], velocity_n[:, 1]), 2 * np.pi)
    speed = np.hypot(velocity_n[:, 0], velocity_n[:, 1])
    course, speed = np.where(valid, course, np.nan), np.where(valid, speed, np.nan)
    return Gps(at.stamp_ns, lat_deg, lon_deg, alt_m, course, speed, valid)


def velocity_n_mps(path: Motion, t_s: Floats) -> Floats:
    """Return the velocity (N, 3): the central difference of the position over 2 ms, exact to 1e-6 m/s."""
    half_s = 1e-3
    return (path.position(t_s + half_s) - path.position(t_s - half_s)) / (2 * half_s)


def receives(up_m: Floats, gps: GpsModel, step_s: float) -> NDArray[np.bool_]:
    """Return whether there is a fix at each of the times (N,): above water, and for long enough since surfacing."""
    covered = up_m < -gps.covered_below_m
    row = np.arange(len(up_m))
    last_covered = np.maximum.accumulate(np.where(covered, row, -1))
    waited_s = (row - last_covered) * step_s
    return ~covered & ((last_covered < 0) | (waited_s >= gps.first_fix_s))
