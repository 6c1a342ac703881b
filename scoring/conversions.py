"""Explain an absurd error by a fixed conversion: inverse, order of components, world or body axes, handedness.

Trajectories come in many conventions. When one fixed conversion turns an error of 120 deg into one of 2 deg, the
estimator is right and the file is not. Aligning cannot remove these differences, and must not do so silently.
"""

import itertools
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stillpoint.datasets.frames import from_xyzw, quaternion, rotation, to_xyzw
from stillpoint.datasets.recording import Floats

ABSURD_DEG = 20.0  # RMSE above which a conversion is looked for: no estimator that works is so far off all the time
_EXPLAINED = 0.25  # share of the RMSE that may remain
_MOST_SAMPLES = 1000  # evenly spread; a conversion holds for all of them or for none

Change = Callable[[Floats], Floats]  # quaternions wxyz (N, 4) to the same

_SWAP_NE = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # East-North-Up <-> NED
_FLIP_YZ = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))  # forward-left-up <-> forward-right-down
_Y_UP = Rotation.from_matrix([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # y up -> z up


def _keep_order(q: Floats) -> Floats:
    return q


_ORDERS: dict[str, Change] = {
    "": _keep_order,
    "its components are x, y, z, w where w, x, y, z was read": from_xyzw,
    "its components are w, x, y, z where x, y, z, w was read": to_xyzw,
}
_DIRECTIONS: dict[str, Change] = {
    "": _keep_order,
    "it is the inverse (it takes world vectors to the body)": lambda q: q * [1.0, -1.0, -1.0, -1.0],
}
_AXES: dict[str, Change] = {
    "": _keep_order,
    "its world is North-East-Down": lambda q: quaternion(_SWAP_NE * rotation(q)),
    "its world is North-East-Down and its body forward-right-down": lambda q: quaternion(
        _SWAP_NE * rotation(q) * _FLIP_YZ
    ),
    "its body is forward-right-down": lambda q: quaternion(rotation(q) * _FLIP_YZ),
    "its world has y up": lambda q: quaternion(_Y_UP * rotation(q)),
    "it is left-handed (y mirrored)": lambda q: q * [1.0, -1.0, 1.0, -1.0],
    "it is left-handed (x mirrored)": lambda q: q * [1.0, 1.0, -1.0, -1.0],
    "it is left-handed (z mirrored)": lambda q: q * [1.0, -1.0, -1.0, 1.0],
}


def choose_rows(count: int) -> NDArray[np.intp]:
    """Return which of so many samples are tried: at most :data:`_MOST_SAMPLES`, evenly spread."""
    return np.unique(np.linspace(0, count - 1, _MOST_SAMPLES).astype(np.intp))


def find_conversion(q_est: Floats, q_true: Floats, rmse_after: Callable[[Floats, Floats], float]) -> str | None:
    """Return the simplest conversion of an estimate (N, 4) that explains its error, in words; None when there is none.

    ``rmse_after(q_est, q_true)`` aligns as the score did and returns the RMSE in deg. Nothing is looked for below
    :data:`ABSURD_DEG`.
    """
    rows = choose_rows(len(q_est))
    q_est, q_true = q_est[rows], q_true[rows]
    before = rmse_after(q_est, q_true)
    if before < ABSURD_DEG:
        return None
    tried = []
    for parts in itertools.product(_ORDERS.items(), _DIRECTIONS.items(), _AXES.items()):
        words = [text for text, _ in parts if text]
        q = q_est
        for _, change in parts:
            q = change(q)
        tried.append((rmse_after(q, q_true), len(words), " and ".join(words)))
    best = min(tried)[0]
    if best > _EXPLAINED * before:
        return None
    after, _, text = min((one for one in tried if one[0] <= 1.5 * best + 0.1), key=lambda one: one[1])
    return f"{text}: converted, its error would be {after:.3g} deg instead of {before:.3g} deg"
