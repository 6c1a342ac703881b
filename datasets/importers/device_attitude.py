"""The attitude that a device computed itself: which way its quaternion turns, and which way up its world is.

Manuals of devices and apps contradict each other, and firmware changes. The samples tell: turns of the attitude must be
those of the gyro, and gravity must point up.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from stillpoint.datasets.frames import local_from_enu, quaternion, rotation
from stillpoint.datasets.importers.imported import LEAST_NORM, make_device_estimate
from stillpoint.datasets.importers.series import Log, Series
from stillpoint.datasets.recording import Floats, Imu, Times
from stillpoint.datasets.trajectory import Estimate

_LEAST_TURN_RAD = 0.5  # of the gyro over the recording: less does not tell a turn from its inverse
_CLEARLY = 0.5  # the better reading must leave less than half of the other's error
_UP_CLEARLY = 0.7  # mean of the vertical component of gravity's direction: within some 45 deg of up or down
_STEP_NS = 50_000_000  # turns are compared over at least this long


def read_device_attitude(
    attitude: Series, imu: Imu, inverse: bool, recording: str, source: str, sha256: dict[str, str], log: Log
) -> tuple[Estimate, ...]:
    """Return the device's attitude (N, 4) wxyz as an estimate that takes the body to a frame with z up, or nothing.

    ``inverse`` is what the documentation says: the quaternion takes the world to the body. Where the gyro contradicts
    it clearly, the gyro decides; where gravity fits neither up nor down, the attitude is left out. Both are noted.
    """
    norm = np.linalg.norm(attitude.values, axis=1)
    keep = np.isfinite(norm) & (norm > LEAST_NORM)
    t_ns, q = attitude.t_ns[keep], attitude.values[keep]
    inside = (t_ns >= imu.t_ns[0]) & (t_ns <= imu.t_ns[-1])
    if inside.sum() < 3:
        log.add_note(f"{source}: no attitude within the recording; not imported")
        return ()
    turned = rotation(q[inside])
    if (found := _find_inverse(t_ns[inside], turned, imu)) is not None and found != inverse:
        log.add_note(f"{source}: the gyro turns the other way than documented; taken as {_name_direction(found)}")
        inverse = found
    body_to_world = rotation(q).inv() if inverse else rotation(q)
    log.add_conversion(f"{source}: quaternion taken as {_name_direction(inverse)}")
    up = _find_up(t_ns[inside], body_to_world[np.flatnonzero(inside)], imu)
    if abs(up) < _UP_CLEARLY:
        log.add_note(f"{source}: contradicts gravity (mean vertical component {up:+.2f}); not imported")
        return ()
    if up < 0:
        log.add_conversion(f"{source}: its world has z down (North-East-Down) -> East-North-Up")
        body_to_world = local_from_enu("ned").inv() * body_to_world
    return make_device_estimate(t_ns, quaternion(body_to_world), recording, source, sha256, log)


def _name_direction(inverse: bool) -> str:
    return "world -> body, inverted" if inverse else "body -> world"


def _find_inverse(t_ns: Times, turned: Rotation, imu: Imu) -> bool | None:
    """Return whether the quaternions turn against the gyro; None where the gyro hardly turns, or fits neither."""
    stride = max(1, int(np.ceil(_STEP_NS / max(float(np.median(np.diff(t_ns))), 1.0))))
    at = np.arange(0, len(t_ns), stride)
    if len(at) < 3:
        return None
    # The integral of the gyro over each step; right to second order of the turn within a step.
    sums = np.vstack([np.zeros(3), np.cumsum(imu.gyro_b_radps[1:] * np.diff(imu.t_ns)[:, None] / 1e9, axis=0)])
    angle = np.column_stack([np.interp(t_ns[at], imu.t_ns, sums[:, axis]) for axis in range(3)])
    measured = np.diff(angle, axis=0)
    if np.linalg.norm(measured, axis=1).sum() < _LEAST_TURN_RAD:
        return None
    direct = (turned[at[:-1]].inv() * turned[at[1:]]).as_rotvec()
    opposed = (turned[at[:-1]] * turned[at[1:]].inv()).as_rotvec()
    errors = [float(np.linalg.norm(one - measured, axis=1).sum()) for one in (direct, opposed)]
    if min(errors) > _CLEARLY * max(errors):
        return None
    return errors[1] < errors[0]


def _find_up(t_ns: Times, body_to_world: Rotation, imu: Imu) -> float:
    """Return the mean vertical component of the direction of the specific force in the attitude's world."""
    force: Floats = imu.accel_b_mps2[np.clip(np.searchsorted(imu.t_ns, t_ns), 0, len(imu.t_ns) - 1)]
    size = np.linalg.norm(force, axis=1, keepdims=True)
    return float(np.mean(body_to_world.apply(force / np.where(size > 0, size, 1.0))[:, 2]))
