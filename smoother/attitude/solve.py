"""The optimum of the graph by Gauss-Newton, with the magnetometer linearised anew in every iteration."""

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import H, L, X
from numpy.typing import NDArray

from stillpoint.datasets.errors import Unobservable
from stillpoint.datasets.recording import Floats
from stillpoint.smoother.attitude.magnetometer import (
    FIRST_SCALE,
    FieldMeasurements,
    compute_residuals,
    linearise_measurements,
    measure_widening,
    shrink_scale,
)
from stillpoint.smoother.attitude.params import GraphParams
from stillpoint.smoother.connectivity import require_connected

_UNKNOWNS_IN_WORDS = {
    "x": "the pose of state",
    "v": "the velocity of state",
    "c": "the effective bias of interval",
    "b": "the bias of step",
    "m": "the calibration",
    "h": "the magnetic field",
    "l": "the common rest pose",
}
_STEP_LIMIT_RAD = 1.0  # an iteration that would turn a state by more is shortened
_REST_SHARE = 0.25  # of the limit: the turns of all further iterations, by the rate at which they shrink, may reach it
_ALIKE, _SLOWEST = (
    0.95,
    0.98,
)  # cosine between steps in the same direction; largest ratio of their lengths to extrapolate


class NoOptimum(Unobservable):
    """The iterations did not converge."""


@dataclass(frozen=True, eq=False)
class Solution:
    """The optimum: values of all unknowns, and the linear system there, whose covariance is that of the optimum."""

    values: gtsam.Values
    system: gtsam.GaussianFactorGraph
    ordering: gtsam.Ordering  # elimination order of its unknowns
    field_scale_ut: float  # scale of the magnetometer's robust weights
    field_widening: float  # factor on its sd in ``system``: its errors last from reading to reading
    q_steps_rad: tuple[float, ...]  # largest turn of a state in each iteration
    field_residual_ut: Floats | None  # (K, 3)
    cost: float  # of gtsam's own factors


@dataclass(frozen=True, eq=False)
class Approach:
    """Where the iterations have come to."""

    values: gtsam.Values
    ordering: gtsam.Ordering | None  # elimination order of the unknowns, None before the first iteration
    field_scale_ut: float  # scale of the magnetometer's robust weights
    q_steps_rad: tuple[float, ...] = ()  # largest turn of a state in each iteration


def begin(values: gtsam.Values, params: GraphParams) -> Approach:
    """Return the beginning of the iterations: start values, and FIRST_SCALE times the magnetometer's sd as scale."""
    return Approach(values, None, FIRST_SCALE * params.magnetic.sd_ut)


def iterate(
    graph: gtsam.NonlinearFactorGraph,
    approach: Approach,
    states: range,
    measured: FieldMeasurements | None,
    name: str,
    params: GraphParams,
) -> Approach:
    """Iterate until the scale of the weights has settled and no state turns by more than ``turn_limit_rad``.

    An iteration that would turn them by much less than that is spared.

    Raises :class:`Unobservable` when the system is singular, :class:`NoOptimum` when the iterations do not converge.
    """
    values, scale_ut, ordering = approach.values, approach.field_scale_ut, approach.ordering
    steps: list[float] = []
    final = measured is None
    before: Floats | None = None  # turns of the last step
    while len(steps) < params.iterations:
        system, residual = linearise(graph, values, measured, scale_ut, params)
        ordering = ordering or _order_unknowns(system, states, name)
        step = _solve_linear(system, ordering, name)
        turns = _turns_of(step, len(states))
        turn = float(np.abs(turns).max())
        if not np.isfinite(turn):
            raise make_unobservable(name)
        longer = 1.0 if not final or before is None else _extrapolate(turns, before)
        before = turns if longer == 1.0 else None  # after a longer step the next one does not show the rate of decay
        if turn * longer > _STEP_LIMIT_RAD:
            longer = _STEP_LIMIT_RAD / turn
        values = values.retract(step if longer == 1.0 else step.scale(longer))
        rest = _expect_rest(turn, steps[-1]) if steps and longer == 1.0 else np.inf
        steps.append(turn)
        if residual is not None:
            smaller = shrink_scale(scale_ut, residual, params.magnetic)
            final, scale_ut = smaller == scale_ut, smaller
        if final and (turn < params.turn_limit_rad or rest < _REST_SHARE * params.turn_limit_rad):
            return Approach(values, ordering, scale_ut, tuple(steps))
    raise NoOptimum(
        f"{name}: no optimum in {len(steps)} iterations (the last turned a state by {np.rad2deg(steps[-1]):.2g} deg); "
        "the sensors contradict each other, or the motion is not what the preset says: run the doctor"
    )


def solve(
    graph: gtsam.NonlinearFactorGraph,
    approach: Approach,
    states: range,
    measured: FieldMeasurements | None,
    name: str,
    params: GraphParams,
) -> Solution:
    """Return the optimum of the graph and the magnetometer's measurements; raises errors as :func:`iterate`."""
    there = iterate(graph, approach, states, measured, name, params)
    assert there.ordering is not None
    values, scale_ut, widening = there.values, there.field_scale_ut, 1.0
    residual: Floats | None = None
    if measured is not None:
        rotations = rotations_of(values, measured.state)
        residual = compute_residuals(measured, rotations, values.atVector(H(0)))
        widening = measure_widening(rotations, residual, scale_ut, params.magnetic)
    system, _ = linearise(graph, values, measured, scale_ut, params, widening)
    cost = float(graph.error(values))
    return Solution(values, system, there.ordering, scale_ut, widening, there.q_steps_rad, residual, cost)


def linearise(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    measured: FieldMeasurements | None,
    scale_ut: float,
    params: GraphParams,
    widening: float = 1.0,
) -> tuple[gtsam.GaussianFactorGraph, Floats | None]:
    """Return the linear system at ``values``, and the residuals of the magnetometer (K, 3).

    ``widening`` is a factor on the magnetometer's sd beside that of its robust weights.
    """
    system = graph.linearize(values)
    if measured is None:
        return system, None
    rotations = rotations_of(values, measured.state)
    field = values.atVector(H(0))
    for factor in linearise_measurements(measured, rotations, field, scale_ut, params.magnetic, widening):
        system.push_back(factor)
    return system, compute_residuals(measured, rotations, field)


def rotations_of(values: gtsam.Values, states: Sequence[int] | NDArray[np.int64]) -> Floats:
    """Return the rotation matrices (K, 3, 3) of states."""
    return poses_of(values, states)[:, :9].reshape(-1, 3, 3)


def poses_of(values: gtsam.Values, states: Sequence[int] | NDArray[np.int64]) -> Floats:
    """Return the poses (K, 12) of states: rotation matrix by rows, and place."""
    poses = gtsam.utilities.extractPose3(values)  # in the order of their keys: a common pose L comes before all X
    count = len(poses) - values.exists(L(0))
    last = gtsam.Symbol(values.keys()[-1]).index()  # the states follow each other, and no letter comes after X
    return np.asarray(poses[len(poses) - count :][np.asarray(states) - (last - count + 1)])


def _turns_of(step: gtsam.VectorValues, count: int) -> Floats:
    """Return the turns (count, 3) of the states in a step, whose vectors stand last."""
    return np.asarray(step.vector()[-6 * count :].reshape(count, 6)[:, :3])


def make_unobservable(name: str) -> Unobservable:
    """Return the error of a system that is singular."""
    return Unobservable(
        f"{name}: the data does not fix the attitude; it needs seconds of motion, and for the heading a magnetometer, "
        "a satellite course or returns to a base pose"
    )


def _solve_linear(system: gtsam.GaussianFactorGraph, ordering: gtsam.Ordering, name: str) -> gtsam.VectorValues:
    try:
        return system.eliminateSequential(ordering).optimize()
    except RuntimeError as error:
        raise make_unobservable(name) from error


def _order_unknowns(system: gtsam.GaussianFactorGraph, states: range, name: str) -> gtsam.Ordering:
    """Return the order of elimination; raises :class:`Unobservable` where nothing ties a state to the others."""
    keys = [system.at(i).keys() for i in range(system.size())]
    require_connected(keys, [X(i) for i in states], _describe_unknown, name, may_stand_alone=(H(0),))
    return gtsam.Ordering.ColamdGaussianFactorGraph(system)


def _describe_unknown(key: int) -> str:
    """Return in words which unknown of the graph a key stands for."""
    symbol = gtsam.Symbol(key)
    kind = _UNKNOWNS_IN_WORDS.get(chr(symbol.chr()))
    return f"{kind} {symbol.index()}" if kind else symbol.string()


def _expect_rest(turn_rad: float, before_rad: float) -> float:
    """Return the sum of all further turns if they go on to shrink as from the last but one to the last."""
    ratio = turn_rad / before_rad if before_rad > 0 else 0.0
    return turn_rad * ratio / (1 - ratio) if ratio < 1 else np.inf


def _extrapolate(turns: Floats, before: Floats) -> float:
    """Return the factor on a step after two steps (n, 3) that have the same direction and shrink slowly (Aitken).

    Steps do so along a direction that the data hardly determine, such as the drift of the heading without magnetometer
    and rests.
    """
    along, size = float(np.vdot(turns, before)), float(np.vdot(before, before))
    ratio, alike = along / size, along / np.sqrt(size * np.vdot(turns, turns))
    return 1 / (1 - ratio) if alike > _ALIKE and ratio < _SLOWEST else 1.0
