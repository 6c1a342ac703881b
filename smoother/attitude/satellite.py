"""Satellite fixes in the graph: where the sensor is and how fast, and through that which way it heads."""

from collections.abc import Iterator
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import V, X
from numpy.typing import NDArray

from stillpoint.datasets.earth import enu_m
from stillpoint.datasets.frames import rotation
from stillpoint.datasets.recording import Floats, Gps, Times
from stillpoint.smoother.attitude.keys import Keys, Motion
from stillpoint.smoother.attitude.params import GpsParams, MotionPriors

FIX_LOSS_SD = 3.0  # a fix that is so far off has half its weight
FIX_LOSS = gtsam.noiseModel.mEstimator.Cauchy.Create(FIX_LOSS_SD)
VERTICAL = 3.0  # a fix is so many times worse in height
FEWEST_FIXES = 2  # that tell a velocity
NEAR_S = 0.15  # a fix belongs to a state that is so close in time
UNDER_WAY_MPS = 0.5  # a receiver at rest shows less


@dataclass(frozen=True, eq=False)
class Fixes:
    """Valid fixes at K states; NaN velocity where the course says nothing."""

    state: NDArray[np.int64]  # (K,)
    t_s: Floats  # (K,)
    position_n_m: Floats  # (K, 3) from the first fix
    velocity_n_mps: Floats  # (K, 3)

    def at(self, states: range) -> "Fixes":
        """Those at some of the states."""
        there = (self.state >= states.start) & (self.state < states.stop)
        return Fixes(self.state[there], self.t_s[there], self.position_n_m[there], self.velocity_n_mps[there])


def not_under_way(rests_ns: Times, gps: Gps | None) -> Times:
    """The rests (R, 2) without those of a body under way: one that sails evenly looks to an IMU like one at rest.

    A rest goes when the satellites saw the body move by every fix within it, or, where there is none, by the last fix
    before and the first after.
    """
    if gps is None:
        return rests_ns
    known = gps.valid & np.isfinite(gps.speed_mps)
    t_ns, moves = gps.t_ns[known], gps.speed_mps[known] > UNDER_WAY_MPS
    keep = np.ones(len(rests_ns), dtype=np.bool_)
    for k, (first, end) in enumerate(np.searchsorted(t_ns, rests_ns)):
        seen = moves[first:end] if end > first else moves[max(first - 1, 0) : first + 1]
        keep[k] = len(seen) == 0 or not seen.all()
    return rests_ns[keep]


def fixes_at(keys: Keys, gps: Gps, t0_ns: int, params: GpsParams) -> Fixes | None:
    """The valid fixes that have a state within NEAR_S; None where there are fewer than two."""
    t_s = (gps.t_ns - t0_ns) / 1e9
    after = np.clip(np.searchsorted(keys.t_s, t_s), 1, len(keys.t_s) - 1)
    state = np.where(t_s - keys.t_s[after - 1] < keys.t_s[after] - t_s, after - 1, after)
    use = gps.valid & (np.abs(keys.t_s[state] - t_s) <= NEAR_S)
    if use.sum() < 2:
        return None
    known_height = np.isfinite(gps.alt_m[use])
    height_m = np.where(known_height, gps.alt_m[use], np.nanmean(gps.alt_m[use]) if known_height.any() else 0.0)
    level = np.stack([np.sin(gps.course_rad), np.cos(gps.course_rad), np.zeros(len(t_s))], axis=1)
    velocity = level * gps.speed_mps[:, None]
    velocity[~(gps.speed_mps >= params.course_speed_mps)] = np.nan
    lat_deg, lon_deg = gps.lat_deg[use], gps.lon_deg[use]
    position = enu_m(lat_deg, lon_deg, height_m, (float(lat_deg[0]), float(lon_deg[0]), float(height_m[0])))
    return Fixes(state[use].astype(np.int64), t_s[use], position, velocity[use])


def fix_factors(fixes: Fixes, params: GpsParams) -> Iterator[gtsam.NonlinearFactor]:
    """The place of each fix, robustly, for a reflected signal is off by far; and the velocity of each with a course."""
    place = gtsam.noiseModel.Diagonal.Sigmas(params.position_sd_m * np.array([1.0, 1.0, VERTICAL]))
    robust = gtsam.noiseModel.Robust.Create(FIX_LOSS, place)
    speed = gtsam.noiseModel.Isotropic.Sigma(3, params.velocity_sd_mps)
    for state, position, velocity in zip(fixes.state, fixes.position_n_m, fixes.velocity_n_mps, strict=True):
        yield gtsam.GPSFactor(X(int(state)), position, robust)
        if np.isfinite(velocity).all():
            yield gtsam.PriorFactorVector(V(int(state)), velocity, speed)


def lone_stretch_factors(keys: Keys, fixes: Fixes, params: MotionPriors) -> Iterator[gtsam.NonlinearFactor]:
    """Yield a bound on the speed of each stretch between gaps that has fewer than two fixes: nothing else tells it."""
    stretch = np.concatenate([[0], np.cumsum(keys.gap)])
    fixed = np.bincount(stretch[fixes.state], minlength=stretch[-1] + 1)
    own = np.array(keys.states)
    for first in own[np.flatnonzero(np.diff(stretch[own], prepend=-1))]:
        if fixed[stretch[first]] < FEWEST_FIXES:
            yield gtsam.PriorFactorVector(
                V(int(first)), np.zeros(3), gtsam.noiseModel.Isotropic.Sigma(3, params.velocity_sd_mps)
            )


def believed_share(fixes: Fixes, values: gtsam.Values, params: GpsParams) -> float:
    """Return the share of the fixes that keep more than half of their weight; 1 where there is no fix."""
    if not len(fixes.state):
        return 1.0
    sd_m = params.position_sd_m * np.array([1.0, 1.0, VERTICAL])
    at = np.array([values.atPose3(X(int(state))).translation() for state in fixes.state])
    return float(np.mean(np.linalg.norm((at - fixes.position_n_m) / sd_m, axis=1) < FIX_LOSS_SD))


def path_of_fixes(fixes: Fixes, keys: Keys) -> tuple[Floats, Floats]:
    """Places and velocities (n, 3) of the states to start from: straight lines from fix to fix."""
    place = np.stack([np.interp(keys.t_s, fixes.t_s, axis) for axis in fixes.position_n_m.T], axis=1)
    return place, np.gradient(place, keys.t_s, axis=0)


def standing(keys: Keys) -> tuple[Floats, Floats]:
    """The same where nothing is known: at the origin, at a standstill."""
    return np.zeros((len(keys.t_s), 3)), np.zeros((len(keys.t_s), 3))


def heading_of_fixes(fixes: Fixes, motion: Motion, q_nb: Floats) -> float | None:
    """The angle about up that turns level attitudes ``q_nb`` (N, 4) to true north; None where nothing accelerates.

    Between fixes with a velocity the mean level force, turned by that angle, is the change of velocity.
    """
    force = rotation(q_nb).apply(motion.accel_b_mps2.copy())
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(force * motion.dt_s[:, None], axis=0)])
    moving = np.isfinite(fixes.velocity_n_mps).all(axis=1)
    t_s, velocity = fixes.t_s[moving], fixes.velocity_n_mps[moving]
    if len(t_s) < 3:
        return None
    gained = total[np.searchsorted(motion.t_s, t_s)]
    measured, known = np.diff(gained[:, :2], axis=0), np.diff(velocity[:, :2], axis=0)
    product = np.sum((known[:, 0] + 1j * known[:, 1]) * (measured[:, 0] - 1j * measured[:, 1]))
    strength = np.sqrt(np.sum(measured**2) * np.sum(known**2))
    return float(np.angle(product)) if strength > 0 and abs(product) > 0.3 * strength else None
