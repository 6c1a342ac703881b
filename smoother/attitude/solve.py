"""The optimum of the graph by Gauss-Newton, with the magnetometer linearised anew in every iteration."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import H, V, X
from numpy.typing import NDArray

from stillpoint.datasets.errors import Unobservable
from stillpoint.datasets.recording import Floats
from stillpoint.smoother.attitude.build import Graph
from stillpoint.smoother.attitude.chain import (
    Place,
    StepPlaces,
    find_change,
    find_step_places,
    linearise_chain,
    move_place,
    poses_of,
    read_place,
    split_squares,
    step_effective,
)
from stillpoint.smoother.attitude.factors import CALIBRATION
from stillpoint.smoother.attitude.linear.elimination import SingularSystem, eliminate, optimise
from stillpoint.smoother.attitude.linear.rows import Rows, flatten, join_rows
from stillpoint.smoother.attitude.linear.structure import Structure, find_structure
from stillpoint.smoother.attitude.magnetometer import (
    FIRST_SCALE,
    UNKNOWNS,
    FieldErrors,
    FieldMeasurements,
    compute_residuals,
    linearise_measurements,
    measure_errors,
    shrink_scale,
    widen_by_errors,
    widen_for_covariance,
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
# Scalars of each kind of unknown, by the letter of its symbol.
SIZES = {ord("x"): 6, ord("v"): 3, ord("c"): 6, ord("b"): 6, ord("m"): CALIBRATION, ord("h"): UNKNOWNS, ord("l"): 6}
_STEP_LIMIT_RAD = 1.0  # an iteration that would turn a state by more is shortened
_REST_SHARE = 0.25  # of the limit: the turns of all further iterations, by the rate at which they shrink, may reach it
_ALIKE = 0.95  # cosine between two steps from which on they have the same direction
_ROUNDS = 3  # in which the sd of the magnetometer is adapted to the errors of the field, at the most
_SD_SETTLED = 0.1  # relative change of these sd that ends the rounds
_LITTLE = 0.5  # logarithm of a widening of these sd that is applied before the optimum is found
_EARLY = 3  # iterations that do so
_SLOWEST = 0.98  # largest ratio of their lengths that is extrapolated


class NoOptimum(Unobservable):
    """The iterations did not converge."""


@dataclass(frozen=True, eq=False)
class Solution:
    """The optimum: values of all unknowns, and the linear factors there, whose covariance is that of the optimum."""

    values: gtsam.Values  # of all unknowns but the effective biases
    effective: Floats  # (m, 6) effective bias of each interval of the chain
    rows: Rows
    structure: Structure
    field_scale_ut: float  # scale of the magnetometer's robust weights
    measured: FieldMeasurements | None  # with the sd that ``rows`` has, for the covariance
    field_sd_ut: float | None  # median sd with which the estimate counts a measurement
    field_widening: float  # factor on the magnetometer's sd as its errors last from reading to reading
    q_steps_rad: tuple[float, ...]  # largest turn of a state in each iteration
    field_residual_ut: Floats | None  # (K, 3)
    cost: float  # of all factors but those of magnetometer and calibration


@dataclass(frozen=True, eq=False)
class Layout:
    """The structure of the linear factors, and where the parts of a step (D,) stand.

    To find them takes longer than to read them.
    """

    structure: Structure
    of_chain: StepPlaces
    of_few: list[tuple[int, slice]]  # of each of the few values that gtsam needs


@dataclass(frozen=True, eq=False)
class Reached:
    """Where the iterations have come to. To add a step to arrays takes less time than to values of gtsam."""

    place: Place  # of the chain's unknowns
    few: gtsam.Values  # of all unknowns but the states that only the chain has
    layout: Layout


@dataclass(frozen=True, eq=False)
class Approach:
    """Start values and where the iterations have come to from them."""

    values: gtsam.Values  # of all unknowns, at the beginning
    effective: Floats  # (m, 6) at the beginning
    reached: Reached | None  # None before the first iteration
    field_scale_ut: float  # scale of the magnetometer's robust weights
    counted: FieldMeasurements | None = None  # with the sd of the last iteration
    q_steps_rad: tuple[float, ...] = ()  # largest turn of a state in each iteration


def begin(values: gtsam.Values, effective: Floats, params: GraphParams) -> Approach:
    """Return the beginning of the iterations at start values with effective biases (m, 6).

    The scale of the magnetometer is FIRST_SCALE times its sd.
    """
    return Approach(values, effective, None, FIRST_SCALE * params.magnetic.sd_ut)


def iterate(
    graph: Graph,
    approach: Approach,
    states: range,
    measured: FieldMeasurements | None,
    name: str,
    params: GraphParams,
    adapts: bool = False,
) -> Approach:
    """Iterate until the scale of the weights has settled and no state turns by more than ``turn_limit_rad``.

    An iteration that would turn them by much less than that is spared. Where it ``adapts``, the first iterations widen
    the sd of a field whose errors are a little large (:func:`_widen_little`), which spares one at the optimum.

    Raises :class:`Unobservable` when the system is singular, :class:`NoOptimum` when the iterations do not converge.
    """
    reached, scale_ut = approach.reached, approach.field_scale_ut
    if reached is None:
        place, few = read_place(graph.chain, approach.values, approach.effective, states), approach.values
    else:
        place, few = reached.place, reached.few
    layout = None if reached is None else reached.layout
    steps: list[float] = []
    final, counted = measured is None, measured
    before: Floats | None = None  # turns of the last step
    while len(steps) < params.iterations:
        used = counted
        rows, residual = _linearise_at(graph, few, place, used, scale_ut, params)
        if layout is None:
            layout = _find_layout(graph, rows, few, place, states, name)
            few = _select_values(few, [key for key, _ in layout.of_few])
        step = _solve_linear(rows, layout.structure, name)
        turns = step[layout.of_chain.poses[:, :3]]
        turn = float(np.abs(turns).max())
        if not np.isfinite(turn):
            raise make_unobservable(name)
        longer = 1.0 if not final or before is None else _extrapolate(turns, before)
        before = turns if longer == 1.0 else None  # after a longer step the next one does not show the rate of decay
        if turn * longer > _STEP_LIMIT_RAD:
            longer = _STEP_LIMIT_RAD / turn
        change = step_effective(graph.chain, place, rows.data, step, layout.of_chain)
        step = step if longer == 1.0 else longer * step
        place = move_place(place, step, layout.of_chain)
        place = replace(place, effective=place.effective + longer * change)
        few = few.retract(_as_vectors(step, layout.of_few))
        rest = _expect_rest(turn, steps[-1]) if steps and longer == 1.0 else np.inf
        steps.append(turn)
        if residual is not None:
            smaller = shrink_scale(scale_ut, residual, params.magnetic)
            final, scale_ut = smaller == scale_ut, smaller
        if adapts and final and measured is not None and used is not None and len(steps) <= _EARLY:
            counted = _widen_little(Reached(place, few, layout), measured, params)
            final = _has_settled(counted, used)
        if final and (turn < params.turn_limit_rad or rest < _REST_SHARE * params.turn_limit_rad):
            there = Reached(place, few, layout)
            return Approach(approach.values, approach.effective, there, scale_ut, used, tuple(steps))
    raise NoOptimum(
        f"{name}: no optimum in {len(steps)} iterations (the last turned a state by {np.rad2deg(steps[-1]):.2g} deg); "
        "the sensors contradict each other, or the motion is not what the preset says: run the doctor"
    )


def solve(
    graph: Graph,
    approach: Approach,
    states: range,
    measured: FieldMeasurements | None,
    name: str,
    params: GraphParams,
) -> Solution:
    """Return the optimum of the graph and the magnetometer's measurements; raises errors as :func:`iterate`."""
    there = iterate(graph, approach, states, measured, name, params, adapts=approach.reached is not None)
    residual: Floats | None = None
    sd_ut, lasting = None, 1.0
    if measured is not None:
        there, counted = _adapt_to_field(graph, there, states, measured, name, params)
        assert there.reached is not None
        residual, errors = _find_field_errors(there.reached, counted, params)
        sd_ut, lasting = params.magnetic.sd_ut * float(np.median(counted.widening)), errors.lasting
        measured = widen_for_covariance(counted, errors, params.magnetic)
    assert there.reached is not None
    place, few, scale_ut = there.reached.place, there.reached.few, there.field_scale_ut
    rows, _ = _linearise_at(graph, few, place, measured, scale_ut, params)
    squares = split_squares(graph.chain, rows.data)
    of_chain = sum(float(part.sum()) for part in (squares.imu, squares.speed, squares.place))
    cost = float(graph.others.error(few)) + of_chain / 2
    field = scale_ut, measured, sd_ut, lasting
    structure = there.reached.layout.structure
    values = _join_values(graph, there.values, place, few, states)
    return Solution(values, place.effective, rows, structure, *field, there.q_steps_rad, residual, cost)


def _adapt_to_field(
    graph: Graph,
    there: Approach,
    states: range,
    measured: FieldMeasurements,
    name: str,
    params: GraphParams,
) -> tuple[Approach, FieldMeasurements]:
    """Return the optimum where each measurement of the field counts as its errors deserve, and the measurements.

    ``there`` is an optimum, by default with the sd of ordinary rooms. It stays where the errors of the field are not
    larger than its sd allows for.
    """
    counted = there.counted or measured
    for _ in range(_ROUNDS):
        assert there.reached is not None
        _, errors = _find_field_errors(there.reached, counted, params)
        wider = widen_by_errors(measured, errors, params.magnetic)
        if _has_settled(wider, counted):
            break
        counted, before = wider, there
        there = iterate(graph, before, states, counted, name, params)
        there = replace(there, q_steps_rad=before.q_steps_rad + there.q_steps_rad)
    return there, counted


def _widen_little(reached: Reached, measured: FieldMeasurements, params: GraphParams) -> FieldMeasurements:
    """Return measurements that count as their errors near the optimum deserve, where these are a little large.

    Such an sd hardly changes the errors that it is taken from, so that it is right at the optimum too. Other
    measurements are returned as they are.
    """
    _, errors = _find_field_errors(reached, measured, params)
    wider = widen_by_errors(measured, errors, params.magnetic)
    little = float(np.log(wider.widening / measured.widening).max()) < _LITTLE
    return wider if little and not _has_settled(wider, measured) else measured


def _has_settled(one: FieldMeasurements, other: FieldMeasurements) -> bool:
    """Return whether the sd of measurements are about the same."""
    return float(np.abs(np.log(one.widening / other.widening)).max()) < _SD_SETTLED


def _find_field_errors(
    reached: Reached, measured: FieldMeasurements, params: GraphParams
) -> tuple[Floats, FieldErrors]:
    """Return the residuals (K, 3) of the magnetometer in uT, and the errors of the field that they show."""
    rotations = _rotations_at(reached.place, measured)
    residual = compute_residuals(measured, rotations, reached.few.atVector(H(0)))
    return residual, measure_errors(rotations, residual, params.magnetic)


def linearise(
    graph: Graph,
    values: gtsam.Values,
    effective: Floats,
    states: range,
    measured: FieldMeasurements | None,
    scale_ut: float,
    params: GraphParams,
) -> tuple[Rows, Floats | None]:
    """Return the linear factors, those of the chain first, and the residuals of the magnetometer (K, 3).

    They are linearised at ``values`` of the ``states`` and what is common to them, and ``effective`` biases (m, 6).
    """
    place = read_place(graph.chain, values, effective, states)
    return _linearise_at(graph, values, place, measured, scale_ut, params)


def _linearise_at(
    graph: Graph,
    few: gtsam.Values,
    place: Place,
    measured: FieldMeasurements | None,
    scale_ut: float,
    params: GraphParams,
) -> tuple[Rows, Floats | None]:
    """Return :func:`linearise` for the place of the chain's unknowns, and the values that gtsam's factors need."""
    parts = [flatten(graph.others.linearize(few))]
    residual: Floats | None = None
    if graph.inherited is not None:
        parts.append(graph.inherited.at(few))
    if measured is not None:
        rotations, field = _rotations_at(place, measured), few.atVector(H(0))
        parts.append(linearise_measurements(measured, rotations, field, scale_ut, params.magnetic))
        residual = compute_residuals(measured, rotations, field)
    others = np.concatenate([part.data for part in parts])
    data = linearise_chain(graph.chain, place, more=len(others))  # a copy of the whole would take as long as this
    data[len(data) - len(others) :] = others
    return join_rows([graph.chain.keys(), *parts], data), residual


def _rotations_at(place: Place, measured: FieldMeasurements) -> Floats:
    """Return the rotation matrices (K, 3, 3) of the states that have a measurement."""
    return place.poses[measured.state - place.first, :9].reshape(-1, 3, 3)


def rotations_of(values: gtsam.Values, states: Sequence[int] | NDArray[np.int64]) -> Floats:
    """Return the rotation matrices (K, 3, 3) of states."""
    return poses_of(values, states)[:, :9].reshape(-1, 3, 3)


def make_unobservable(name: str) -> Unobservable:
    """Return the error of a system that is singular."""
    return Unobservable(
        f"{name}: the data does not fix the attitude; it needs seconds of motion, and for the heading a magnetometer, "
        "a satellite course or returns to a base pose"
    )


def _solve_linear(rows: Rows, structure: Structure, name: str) -> Floats:
    """Return the step (D,) that solves the linear factors in the least-squares sense."""
    try:
        return optimise(eliminate(structure, rows))
    except SingularSystem as error:
        raise make_unobservable(name) from error


def _find_layout(graph: Graph, rows: Rows, values: gtsam.Values, place: Place, states: range, name: str) -> Layout:
    """Return the layout of linear factors; raises :class:`Unobservable` where nothing ties a state to the others.

    Of the states, those are among the few values that gtsam's factors or those of the windows before have.
    """
    structure = _find_structure(rows, states, name)
    inherited = np.empty(0, dtype=np.int64) if graph.inherited is None else graph.inherited.rows.keys
    needed = np.concatenate([np.array(graph.others.keyVector(), dtype=np.int64), inherited])
    keys = np.array(values.keys(), dtype=np.int64)
    of_state = np.isin(keys, V(0) + np.array(states)) | np.isin(keys, X(0) + np.array(states))
    keys = keys[structure.has(keys) & (~of_state | np.isin(keys, needed))]
    numbers = structure.numbers(keys)
    begins, sizes = structure.key_begin[numbers], structure.key_size[numbers]
    return Layout(
        structure=structure,
        of_chain=find_step_places(graph.chain, place, structure),
        of_few=list(zip(keys.tolist(), map(slice, begins.tolist(), (begins + sizes).tolist()), strict=True)),
    )


def _select_values(values: gtsam.Values, keys: Sequence[int]) -> gtsam.Values:
    """Return the values of some keys."""
    few = gtsam.Values(values)
    for key in np.setdiff1d(np.array(values.keys(), dtype=np.int64), keys).tolist():
        few.erase(key)
    return few


def _join_values(graph: Graph, start: gtsam.Values, place: Place, few: gtsam.Values, states: range) -> gtsam.Values:
    """Return the values of all unknowns: the start values, moved to a place, and the few that gtsam has moved."""
    poses, velocities = find_change(read_place(graph.chain, start, place.effective, states), place)
    vectors = gtsam.VectorValues()
    for i, pose, velocity in zip(states, poses, velocities, strict=True):
        vectors.insert(X(i), pose)
        vectors.insert(V(i), velocity)
    values = start.retract(vectors)
    values.update(few)
    return values


def _as_vectors(step: Floats, of_few: Sequence[tuple[int, slice]]) -> gtsam.VectorValues:
    """Return the few parts of a step (D,) in the form in which gtsam adds them to values."""
    vectors = gtsam.VectorValues()
    for key, rows in of_few:
        vectors.insert(key, step[rows])
    return vectors


def _find_structure(rows: Rows, states: range, name: str) -> Structure:
    """Return the structure of the system; raises :class:`Unobservable` where nothing ties a state to the others."""
    wanted = X(0) + np.array(states)
    require_connected(rows.keys, np.diff(rows.key_first), wanted, _describe_unknown, name, may_stand_alone=(H(0),))
    return find_structure(rows, SIZES)


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
