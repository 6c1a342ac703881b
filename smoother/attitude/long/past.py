"""Define what a window hands over to the next one: a Gaussian on the unknowns that both share."""

from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, H, L, M, V, X
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stillpoint.datasets.frames import heading_rotation, quaternion, rotation
from stillpoint.datasets.recording import Floats
from stillpoint.smoother.attitude.build import Graph
from stillpoint.smoother.attitude.evidence import Evidence
from stillpoint.smoother.attitude.factors import bias_steps
from stillpoint.smoother.attitude.keys import Keys
from stillpoint.smoother.attitude.linear.elimination import SingularSystem, eliminate
from stillpoint.smoother.attitude.linear.inherited import Inherited, remaining_rows
from stillpoint.smoother.attitude.linear.structure import find_structure
from stillpoint.smoother.attitude.params import GraphParams
from stillpoint.smoother.attitude.solve import SIZES, Solution, linearise, make_unobservable

_LETTER_SHIFT = 56  # bits of a key of gtsam below the letter of its symbol
_POSES, _OF_STATE, _BIAS, _EFFECTIVE = tuple(b"xl"), tuple(b"xv"), ord("b"), ord("c")
_POSE_SIZE = 12


@dataclass(frozen=True, eq=False)
class Past:
    """The information that a window hands over to the next one."""

    inherited: Inherited  # factors on the unknowns that both share, and values of these but the effective biases
    interval: NDArray[np.int64]  # (m,) the intervals of the window in the overlap
    effective: Floats  # (m, 6) and their effective biases
    held: range  # its states there
    gyro_bias_b_radps: Floats  # (3,) at the first state of the next window


def hand_over(
    graph: Graph,
    closed: Evidence,
    held: range,
    interval: NDArray[np.int64],
    solution: Solution,
    name: str,
    params: GraphParams,
) -> Past:
    """Reduce the factors of a window's past to the unknowns that it shares with the next window.

    ``graph`` holds the factors of ``closed``, the part of the window before the next one; ``held`` are all states
    and ``interval`` (m,) all intervals of the window.
    """
    keys, values = closed.keys, solution.values
    until = keys.states.stop
    effective = solution.effective[np.isin(interval, graph.chain.interval)]
    measured = solution.measured and solution.measured.at(keys.states)
    rows, _ = linearise(graph, values, effective, held, measured, solution.field_scale_ut, params)
    step = int(bias_steps(keys, params)[until])
    common = [X(until), V(until), B(step), M(0), H(0), L(0)]
    try:
        rest = remaining_rows(eliminate(find_structure(rows, SIZES, last=common), rows), common)
    except SingularSystem as error:
        raise make_unobservable(name) from error
    return Past(
        inherited=Inherited(rest, unpack_values(*pack_values(values, until))),
        interval=interval[interval >= until],
        effective=solution.effective[interval >= until],
        held=range(until, held.stop),
        gyro_bias_b_radps=values.atConstantBias(B(step)).gyroscope(),
    )


def pack_values(values: gtsam.Values, first: int = 0) -> tuple[NDArray[np.int64], Floats]:
    """Return the keys (K,) of the states from ``first`` on and of what all states share, and their values, joined.

    Effective biases are left out. A pose is its rotation matrix by rows and its place.
    """
    keys = np.array(values.keys(), dtype=np.int64)
    letter, number = keys >> _LETTER_SHIFT, keys & ((1 << _LETTER_SHIFT) - 1)
    shared = ~np.isin(letter, _OF_STATE) | (number >= first)
    keys = keys[shared & (letter != _EFFECTIVE)]
    return keys, np.concatenate([_read_value(values, key) for key in keys.tolist()])


def unpack_values(keys: NDArray[np.int64], data: Floats) -> gtsam.Values:
    """Return the values that :func:`pack_values` joined, bit for bit."""
    values, begin = gtsam.Values(), 0
    for key in keys.tolist():
        letter = key >> _LETTER_SHIFT
        end = begin + (_POSE_SIZE if letter in _POSES else SIZES[letter])
        part = data[begin:end]
        if letter in _POSES:
            values.insert(j=key, pose3=gtsam.Pose3(gtsam.Rot3(part[:9].reshape(3, 3)), part[9:]))
        elif letter == _BIAS:
            values.insert(j=key, constant_bias=gtsam.imuBias.ConstantBias(part[:3], part[3:]))
        else:
            values.insert(key, part)
        begin = end
    return values


def _read_value(values: gtsam.Values, key: int) -> Floats:
    """Return a value as numbers."""
    letter = key >> _LETTER_SHIFT
    if letter in _POSES:
        pose = values.atPose3(key)
        return np.concatenate([pose.rotation().matrix().ravel(), pose.translation()])
    return np.asarray(values.atConstantBias(key).vector() if letter == _BIAS else values.atVector(key))


def continue_attitudes(past: Past, window: Evidence) -> Floats:
    """Return the start attitudes (n, 4), rotated to the heading of the past if no magnetometer shows the heading."""
    if window.measured is not None:
        return window.q_nb
    last = past.held[-1]
    turn = rotation(window.q_nb[last]).inv()
    difference = quaternion(Rotation.from_matrix(past.inherited.values.atPose3(X(last)).rotation().matrix()) * turn)
    angle_rad = float(2 * np.arctan2(difference[3], difference[0]))
    return quaternion(heading_rotation(angle_rad) * rotation(window.q_nb))


def resume_values(values: gtsam.Values, past: Past, keys: Keys, params: GraphParams) -> None:
    """Overwrite start values with the optimum of the window before, for all unknowns that both windows have."""
    before = past.inherited.values
    for i in past.held:
        values.update(X(i), before.atPose3(X(i)))
        values.update(V(i), before.atVector(V(i)))
    step = bias_steps(keys, params)[past.held]
    for k in range(step[0], step[-1] + 1):
        values.update(B(k), before.atConstantBias(B(k)))
    values.update(M(0), before.atVector(M(0)))
    if values.exists(H(0)):
        values.update(H(0), before.atVector(H(0)))
    if before.exists(L(0)):
        values.insert_or_assign(L(0), before.atPose3(L(0)))
