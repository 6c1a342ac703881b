"""Satellite fixes in the graph: where the sensor is and how fast it moves, and through that its heading.

A fix belongs to the state nearest to its instant, and is moved there by its own velocity. It is the antenna's position:
``lever_*_m`` says where the antenna is in the body. Its sd is the one that the receiver states, at least
``position_sd_m``. A fix that its neighbours contradict by more than a vehicle can accelerate is left out before the
graph is built; smaller errors, as of reflected signals, lose their weight in the graph.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import V, X
from numpy.typing import NDArray

from stillpoint.datasets.earth import Place, enu_m
from stillpoint.datasets.frames import heading_rotation, quaternion, rotation, wrap
from stillpoint.datasets.recording import Floats, Gps, Times
from stillpoint.smoother.attitude.keys import Keys, Motion
from stillpoint.smoother.attitude.params import GpsParams, MotionPriors

_FIX_LOSS_SD = 3.0  # a fix that is so far off has half its weight
_FIX_LOSS = gtsam.noiseModel.mEstimator.Cauchy.Create(_FIX_LOSS_SD)
VERTICAL = 3.0  # a fix is so many times worse in height
_FEWEST_FIXES = 2  # that tell a velocity
_NEAR_S = 0.15  # a fix belongs to a state that is so close in time
UNDER_WAY_MPS = 0.5  # a receiver at rest shows less
_JUMP_SD = 10.0  # a fix that is farther from the line between its neighbours is left out,
_JUMP_M, _JUMP_MPS2 = 50.0, 15.0  # if it is also farther than this, and than such an acceleration explains
_FEWEST_STOPS, _FEWEST_COURSES = 3, 10  # pairs of fixes that show the gyro's bias
_JUMP_NEIGHBOURS = 3  # on either side
OUTAGE_S = 10.0  # a longer time between two fixes is an outage
_LEAST_CORRELATION = 0.3  # between changes of velocity by satellites and by the accelerometer, for a heading
_CLEAR_CORRELATION = 0.8  # for a delay
_DELAYS_S = np.arange(-1.0, 2.01, 0.1)  # of fixes, that are tried


@dataclass(frozen=True, eq=False)
class Fixes:
    """Valid fixes at K states; NaN velocity where the course is not usable."""

    state: NDArray[np.int64]  # (K,)
    t_s: Floats  # (K,)
    position_n_m: Floats  # (K, 3) of the antenna, from the origin, at the instant of the state
    velocity_n_mps: Floats  # (K, 3)
    sd_m: Floats  # (K,) horizontally
    origin: Place
    jumps: int = 0  # fixes left out because their neighbours contradict them
    without_state: int = 0  # valid fixes in gaps of the IMU

    def at(self, states: range) -> "Fixes":
        """Return those at some of the states."""
        return self.among((self.state >= states.start) & (self.state < states.stop))

    def among(self, there: NDArray[np.bool_]) -> "Fixes":
        """Return those at which ``there`` (K,) is true."""
        columns = ("state", "t_s", "position_n_m", "velocity_n_mps", "sd_m")
        return replace(self, **{name: getattr(self, name)[there] for name in columns})


def drop_rests_under_way(rests_ns: Times, gps: Gps | None) -> Times:
    """Return the rests (R, 2) without those of a body under way: sailing evenly looks like resting to an IMU.

    A rest is dropped when the satellites saw the body move by every fix within it, or, where there is none, by the last
    fix before and the first after.
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


def select_fixes(keys: Keys, gps: Gps, t0_ns: int, params: GpsParams) -> Fixes | None:
    """Return the valid fixes that have a state within NEAR_S; None where there are fewer than two."""
    t_s = (gps.t_ns - t0_ns) / 1e9 - params.late_s
    after = np.clip(np.searchsorted(keys.t_s, t_s), 1, len(keys.t_s) - 1)
    state = np.where(t_s - keys.t_s[after - 1] < keys.t_s[after] - t_s, after - 1, after)
    near = np.abs(keys.t_s[state] - t_s) <= _NEAR_S
    use = gps.valid & near
    if use.sum() < _FEWEST_FIXES:
        return None
    known_height = np.isfinite(gps.alt_m[use])
    height_m = np.where(known_height, gps.alt_m[use], np.nanmean(gps.alt_m[use]) if known_height.any() else 0.0)
    lat_deg, lon_deg = gps.lat_deg[use], gps.lon_deg[use]
    origin = (float(lat_deg[0]), float(lon_deg[0]), float(height_m[0]))
    velocity = _velocities(gps, params)[use]
    to_state_s = (keys.t_s[state] - t_s)[use, None]
    position = enu_m(lat_deg, lon_deg, height_m, origin) + np.nan_to_num(velocity) * to_state_s
    stated = np.full(len(t_s), np.nan) if gps.position_sd_m is None else gps.position_sd_m
    sd_m = np.fmax(stated[use], params.position_sd_m)
    whole = Fixes(state[use].astype(np.int64), t_s[use], position, velocity, sd_m, origin)
    good = ~find_jumps(whole.t_s, position, sd_m)
    if good.sum() < _FEWEST_FIXES:
        return None
    without = int((gps.valid & ~near).sum())
    return replace(whole.among(good), jumps=int((~good).sum()), without_state=without)


def _velocities(gps: Gps, params: GpsParams) -> Floats:
    """Return the level velocities (N, 3) from course and speed; NaN below ``course_speed_mps``."""
    level = np.stack([np.sin(gps.course_rad), np.cos(gps.course_rad), np.zeros(len(gps.t_ns))], axis=1)
    velocity = level * gps.speed_mps[:, None]
    velocity[~(gps.speed_mps >= params.course_speed_mps)] = np.nan
    return np.asarray(velocity)


def find_jumps(t_s: Floats, position_n_m: Floats, sd_m: Floats) -> NDArray[np.bool_]:
    """Return which fixes (K,) no vehicle can have visited between the fixes around; the worst is removed first.

    A fix is compared with the lines between its neighbours, those next to them, and so on: one of them is right where
    no more than two wrong fixes follow each other.
    """
    left = np.arange(len(t_s))
    while len(left) >= 3:
        t, place, sd = t_s[left], position_n_m[left, :2], sd_m[left]
        excess = np.full(len(left), np.inf)
        for k in range(1, _JUMP_NEIGHBOURS + 1):
            middle = np.arange(k, len(left) - k)
            share = ((t[middle] - t[middle - k]) / (t[middle + k] - t[middle - k]))[:, None]
            line = (1 - share) * place[middle - k] + share * place[middle + k]
            allowed_m = np.maximum(_JUMP_M, _JUMP_SD * sd[middle])
            allowed_m += _JUMP_MPS2 * (t[middle + k] - t[middle - k]) ** 2 / 8
            off_m = np.linalg.norm(place[middle] - line, axis=1)
            excess[middle] = np.minimum(excess[middle], off_m / allowed_m)
        excess[[0, -1]] = 0.0
        worst = int(excess.argmax())
        if excess[worst] <= 1.0:
            break
        left = np.delete(left, worst)
    jumps = np.ones(len(t_s), dtype=np.bool_)
    jumps[left] = False
    return jumps


def fix_factors(fixes: Fixes, params: GpsParams) -> Iterator[gtsam.NonlinearFactor]:
    """Yield the position of each fix, robustly, and the velocity of each that has a course.

    The velocity is that of the antenna too; what it differs by in a turn is small beside its sd. A course says nothing
    of the climb, which is taken for zero with a larger sd.
    """
    arm = np.array([params.lever_x_m, params.lever_y_m, params.lever_z_m])
    speed = gtsam.noiseModel.Diagonal.Sigmas(params.velocity_sd_mps * np.array([1.0, 1.0, VERTICAL]))
    rows = zip(fixes.state.tolist(), fixes.position_n_m, fixes.velocity_n_mps, fixes.sd_m, strict=True)
    for state, position, velocity, sd_m in rows:
        place = gtsam.noiseModel.Diagonal.Sigmas(sd_m * np.array([1.0, 1.0, VERTICAL]))
        robust = gtsam.noiseModel.Robust.Create(_FIX_LOSS, place)
        yield (
            gtsam.GPSFactorArm(X(state), position, arm, robust)
            if arm.any()
            else gtsam.GPSFactor(X(state), position, robust)
        )
        if np.isfinite(velocity).all():
            yield gtsam.PriorFactorVector(V(state), velocity, speed)


def lone_stretch_factors(keys: Keys, fixes: Fixes, params: MotionPriors) -> Iterator[gtsam.NonlinearFactor]:
    """Yield a bound on the speed of each stretch between gaps that has fewer than two fixes and so no other bound."""
    stretch = np.concatenate([[0], np.cumsum(keys.gap)])
    fixed = np.bincount(stretch[fixes.state], minlength=stretch[-1] + 1)
    own = np.array(keys.states)
    for first in own[np.flatnonzero(np.diff(stretch[own], prepend=-1))]:
        if fixed[stretch[first]] < _FEWEST_FIXES:
            yield gtsam.PriorFactorVector(
                V(int(first)), np.zeros(3), gtsam.noiseModel.Isotropic.Sigma(3, params.velocity_sd_mps)
            )


def find_believed_fixes(fixes: Fixes, values: gtsam.Values, params: GpsParams) -> NDArray[np.bool_]:
    """Return which fixes (K,) keep more than half of their weight in the solution."""
    if not len(fixes.state):
        return np.zeros(0, dtype=np.bool_)
    arm = np.array([params.lever_x_m, params.lever_y_m, params.lever_z_m])
    at = np.array([values.atPose3(X(int(state))).transformFrom(arm) for state in fixes.state])
    off_sd = (at - fixes.position_n_m) / (fixes.sd_m[:, None] * np.array([1.0, 1.0, VERTICAL]))
    return np.asarray(np.linalg.norm(off_sd, axis=1) < _FIX_LOSS_SD)


def outages(fixes: Fixes) -> Floats:
    """Return the lengths (s) of the times between fixes that are longer than OUTAGE_S."""
    between_s = np.diff(fixes.t_s)
    return np.asarray(between_s[between_s > OUTAGE_S])


def path_of_fixes(fixes: Fixes, keys: Keys) -> tuple[Floats, Floats]:
    """Return positions and velocities (n, 3) of the states to start from: straight lines from fix to fix."""
    place = np.stack([np.interp(keys.t_s, fixes.t_s, axis) for axis in fixes.position_n_m.T], axis=1)
    return place, np.gradient(place, keys.t_s, axis=0)


def start_at_standstill(keys: Keys) -> tuple[Floats, Floats]:
    """Return the same where nothing is known: at the origin, at a standstill."""
    return np.zeros((len(keys.t_s), 3)), np.zeros((len(keys.t_s), 3))


def align_headings(fixes: Fixes, motion: Motion, q_nb: Floats, keys: Keys) -> Floats:
    """Return level attitudes (n, 4) of the states turned to true north.

    Each stretch between gaps has a heading of its own in ``q_nb`` (N, 4) and is turned by the angle that makes its
    level force the change of the satellites' velocity; where it accelerates too little, by that of the stretch before.
    """
    stretch = np.concatenate([[0], np.cumsum(keys.gap)])
    q_key = q_nb[keys.row]
    gained = _sum_force(motion, q_nb)
    turned = np.empty_like(q_key)
    angle = 0.0
    for number in range(int(stretch[-1]) + 1):
        own = fixes.among(np.asarray(stretch[fixes.state] == number))
        product, parallel = _compare_velocities(own, motion.t_s, gained, 0.0)
        if parallel > 0 and abs(product) > _LEAST_CORRELATION * parallel:
            angle = float(np.angle(product))
        there = stretch == number
        turned[there] = quaternion(heading_rotation(angle) * rotation(q_key[there]))
    return turned


def estimate_delay(fixes: Fixes, motion: Motion, q_nb: Floats) -> float | None:
    """Return by how much the stamps of the fixes are late (s), None where the accelerometer does not show it.

    At that delay the changes of velocity by satellites and by the accelerometer, at attitudes ``q_nb`` (N, 4), differ
    least; between the values that are tried, a parabola tells it.
    """
    gained = _sum_force(motion, q_nb)
    pairs = [_compare_velocities(fixes, motion.t_s, gained, delay_s) for delay_s in _DELAYS_S]
    share = np.array([product.real / parallel if parallel > 0 else 0.0 for product, parallel in pairs])
    best = int(share.argmax())
    if share[best] < _CLEAR_CORRELATION or best in (0, len(_DELAYS_S) - 1):
        return None
    before, there, after = share[best - 1 : best + 2]
    bend = before - 2 * there + after
    shift = 0.0 if bend == 0 else 0.5 * (before - after) / bend
    return float(_DELAYS_S[best] + shift * (_DELAYS_S[1] - _DELAYS_S[0]))


def _sum_force(motion: Motion, q_nb: Floats) -> Floats:
    """Return the velocity (N + 1, 3) in n that the specific force adds up to before each sample, and after the last."""
    force = rotation(q_nb).apply(motion.accel_b_mps2.copy())
    return np.concatenate([np.zeros((1, 3)), np.cumsum(force * motion.dt_s[:, None], axis=0)])


def _compare_velocities(fixes: Fixes, t_s: Floats, gained: Floats, delay_s: float) -> tuple[complex, float]:
    """Return the sum of products of both changes of level velocity from fix to fix, and what it is if all agree.

    ``gained`` (N + 1, 3) is the sum of the force at samples ``t_s`` (N,). The argument of the sum is the angle about up
    from the accelerometer's changes to those of the satellites.
    """
    moving = fixes.among(np.asarray(np.isfinite(fixes.velocity_n_mps).all(axis=1)))
    if len(moving.state) < 3:
        return 0j, 0.0
    at = gained[np.clip(np.searchsorted(t_s, moving.t_s - delay_s), 0, len(gained) - 1)]
    near = np.diff(moving.t_s) < OUTAGE_S
    measured, known = np.diff(at[:, :2], axis=0)[near], np.diff(moving.velocity_n_mps[:, :2], axis=0)[near]
    product = np.sum((known[:, 0] + 1j * known[:, 1]) * (measured[:, 0] - 1j * measured[:, 1]))
    return complex(product), float(np.sqrt(np.sum(measured**2) * np.sum(known**2)))


def bias_by_satellites(gps: Gps, motion: Motion, t0_ns: int, params: GpsParams) -> Floats | None:
    """Return the gyro bias (3,) of a vehicle: its mean rate while it stands, or the rate minus that of its courses.

    A vehicle stays level on the mean, so that its mean rate across up is bias; about up, the change of course is known.
    None where it neither stands nor has a course for long.
    """
    t_s = (gps.t_ns - t0_ns) / 1e9
    between_s = np.diff(t_s)
    near = gps.valid[:-1] & gps.valid[1:] & (between_s < OUTAGE_S)
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(motion.gyro_b_radps * motion.dt_s[:, None], axis=0)])
    at = np.searchsorted(motion.t_s, t_s)
    turned, inside = np.diff(total[at], axis=0), np.diff(np.concatenate([[0.0], np.cumsum(motion.dt_s)])[at])
    whole = near & (inside > 0.9 * between_s)
    slow = gps.speed_mps < UNDER_WAY_MPS
    stands = whole & slow[:-1] & slow[1:]
    if stands.sum() >= _FEWEST_STOPS:
        return np.asarray(np.median(turned[stands] / inside[stands, None], axis=0))
    fast = gps.speed_mps >= params.course_speed_mps
    courses = whole & fast[:-1] & fast[1:]
    if courses.sum() < _FEWEST_COURSES:
        return None
    up_b = np.median(motion.accel_b_mps2, axis=0)
    up_b = up_b / np.linalg.norm(up_b)
    by_course = -wrap(np.diff(gps.course_rad))[courses] / inside[courses]
    about_up = float(np.median(turned[courses] @ up_b / inside[courses] - by_course))
    mean = total[-1] / motion.dt_s.sum()
    return np.asarray(mean - (mean @ up_b) * up_b + about_up * up_b)
