"""The optimum of the graph, its covariances, and in words what the data does not fix."""

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import H, M, X
from numpy.typing import NDArray

from stillpoint.datasets.errors import Unobservable
from stillpoint.datasets.recording import Floats
from stillpoint.smoother.attitude.factors import RETURN_LOSS
from stillpoint.smoother.attitude.magnetometer import (
    FIRST_SCALE,
    FieldMeasurements,
    linear_factors,
    next_scale,
    residuals,
)
from stillpoint.smoother.attitude.params import GraphParams

RETURNS_COUNTED = 6  # at the most, in the factor on the covariances
STEP_LIMIT_RAD = 1.0  # an iteration that turns a state by more is cut short
ALIKE, SLOWEST = 0.95, 0.98  # cosine between steps that go the same way; ratio of their lengths that is still trusted


class NoOptimum(Unobservable):
    """The iterations did not come to rest."""


@dataclass(frozen=True, eq=False)
class Solution:
    """The optimum: values of all states, and the linear system next to it (within ``turn_limit_rad``)."""

    values: gtsam.Values
    system: gtsam.GaussianFactorGraph  # of the last iteration
    last_step: gtsam.VectorValues  # that solves it
    ordering: gtsam.Ordering  # in which its unknowns are eliminated
    field_scale_ut: float  # of the magnetometer's robust weights
    q_steps_rad: tuple[float, ...]  # the largest turn of a state, per iteration
    field_residual_ut: Floats | None  # (K, 3)
    cost: float  # of gtsam's own factors


def solve(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    states: range,
    measured: FieldMeasurements | None,
    name: str,
    params: GraphParams,
) -> Solution:
    """Gauss-Newton; the magnetometer is linearised anew in every iteration.

    Raises :class:`Unobservable` when the system is singular, :class:`NoOptimum` when no optimum is found.
    """
    steps: list[float] = []
    scale_ut = FIRST_SCALE * params.magnetic.sd_ut
    final = measured is None
    # Nested dissection: the way from any state to the root is short, which is what covariances cost.
    ordering: gtsam.Ordering | None = None
    before: Floats | None = None  # turns of the last step
    while len(steps) < params.iterations:
        system, residual = linearised(graph, values, measured, scale_ut, params)
        ordering = ordering or gtsam.Ordering.MetisGaussianFactorGraph(system)
        step = _step(system, ordering, name)
        turns = np.array([step.at(X(i))[:3] for i in states])
        turn = float(np.abs(turns).max())
        if not np.isfinite(turn):
            raise _unobservable(name)
        farther = 1.0 if not final or before is None else _extrapolation(turns, before)
        before = turns if farther == 1.0 else None  # after a longer step the next one tells nothing of the rate
        if turn * farther > STEP_LIMIT_RAD:
            farther = STEP_LIMIT_RAD / turn
        values = values.retract(step if farther == 1.0 else step.scale(farther))
        steps.append(turn)
        if residual is not None:
            smaller = next_scale(scale_ut, residual, params.magnetic)
            final, scale_ut = smaller == scale_ut, smaller
        if final and turn < params.turn_limit_rad:
            cost = float(graph.error(values))
            return Solution(values, system, step, ordering, scale_ut, tuple(steps), residual, cost)
    raise NoOptimum(
        f"{name}: no optimum in {len(steps)} iterations (the last turned a state by {np.rad2deg(steps[-1]):.2g} deg); "
        "the sensors contradict each other, or the motion is not what the preset says: run the doctor"
    )


def _extrapolation(turns: Floats, before: Floats) -> float:
    """How many times as far to go when two steps (n, 3) in a row go the same way and shrink slowly (Aitken).

    So they do along what the data hardly fix, as the heading's drift without magnetometer and rest.
    """
    along, size = float(np.vdot(turns, before)), float(np.vdot(before, before))
    ratio, alike = along / size, along / np.sqrt(size * np.vdot(turns, turns))
    return 1 / (1 - ratio) if alike > ALIKE and ratio < SLOWEST else 1.0


def linearised(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    measured: FieldMeasurements | None,
    scale_ut: float,
    params: GraphParams,
) -> tuple[gtsam.GaussianFactorGraph, Floats | None]:
    """The linear system at some values, and the residuals of the magnetometer (K, 3)."""
    system = graph.linearize(values)
    if measured is None:
        return system, None
    rotations = rotations_of(values, measured.state)
    field = values.atVector(H(0))
    for factor in linear_factors(measured, rotations, field, scale_ut, params.magnetic):
        system.push_back(factor)
    return system, residuals(measured, rotations, field)


def _step(system: gtsam.GaussianFactorGraph, ordering: gtsam.Ordering, name: str) -> gtsam.VectorValues:
    try:
        return system.eliminateMultifrontal(ordering).optimize()
    except RuntimeError as error:
        raise _unobservable(name) from error


def _unobservable(name: str) -> Unobservable:
    return Unobservable(
        f"{name}: the data does not fix the attitude; it needs seconds of motion, and for the heading a magnetometer, "
        "a satellite course or returns to a base pose"
    )


def rotations_of(values: gtsam.Values, states: Sequence[int] | NDArray[np.int64]) -> Floats:
    """Rotation matrices (K, 3, 3) of states."""
    return np.array([values.atPose3(X(int(i))).rotation().matrix() for i in states])


@dataclass(frozen=True, eq=False)
class Accuracy:
    """Covariances at the optimum, as the noise sizes promise them: :func:`scale_of` says how far to trust these."""

    attitude_b_rad2: Floats  # (m, 3, 3) of the states asked for, body axes, relative to the mean heading
    heading_rad2: float  # of the mean heading: an error that all states share
    calibration: Floats  # (19, 19)
    field: Floats | None  # (16, 16) of the field's unknowns
    closing_squares: tuple[float, ...]  # of each return: its heading error, squared, over what was expected


def accuracy_of(
    solution: Solution,
    states: NDArray[np.int64],
    counted: NDArray[np.int64],
    base: int | None,
    returns: tuple[int, ...],
    name: str,
    params: GraphParams,
) -> Accuracy:
    """Covariances of ``states`` relative to the mean heading of the states ``counted``, and how the returns close.

    Raises :class:`Unobservable` when there are none: a converged solve is not an answer until they exist.
    """
    up_b = rotations_of(solution.values, counted)[:, 2]
    try:
        tree = _pushed(solution, counted, up_b).eliminateMultifrontal(solution.ordering)
        attitude = np.array([tree.marginalCovariance(X(int(i)))[:3, :3] for i in states])
        calibration = tree.marginalCovariance(M(0))
        field = tree.marginalCovariance(H(0)) if solution.values.exists(H(0)) else None
        closing = [_closing_square(tree, solution.values, base, state, params) for state in returns]
    except RuntimeError as error:
        raise _unobservable(name) from error
    if not (np.diagonal(attitude, axis1=1, axis2=2) > 0).all():
        raise _unobservable(name)
    moved = tree.optimize()

    def with_mean_heading(which: NDArray[np.int64]) -> Floats:
        return np.array([moved.at(X(int(i)))[:3] - solution.last_step.at(X(int(i)))[:3] for i in which])

    variance = float(np.mean(np.sum(with_mean_heading(counted) * up_b, axis=1)))
    up_b, shared = rotations_of(solution.values, states)[:, 2], with_mean_heading(states)
    cross = shared[:, :, None] * up_b[:, None, :]
    relative = attitude - cross - cross.transpose(0, 2, 1) + variance * up_b[:, :, None] * up_b[:, None, :]
    return Accuracy(relative, variance, calibration, field, tuple(closing))


def scale_of(closing_squares: Sequence[float], params: GraphParams) -> float:
    """Factor on all covariances, from what the returns show.

    A sensor whose heading closes better than its noise promises is better than its noise. However many returns there
    are, they count as RETURNS_COUNTED at the most: what errs in the same way each time does not show in them.
    """
    trust, count = params.prior_returns, min(len(closing_squares), RETURNS_COUNTED)
    mean = float(np.mean(closing_squares)) if count else 0.0
    return params.variance_factor * (trust + count * mean) / (trust + count)


def _closing_square(
    tree: gtsam.GaussianBayesTree, values: gtsam.Values, base: int | None, state: int, params: GraphParams
) -> float:
    """Normalised square of the heading's closing error at a return, as if the return had not been used.

    With e what is left of it and C its covariance in the solution, and R the variance that the return has there (its
    robust weight widens it), the error without the return is R/(R - C) e with variance R^2/(R - C): its normalised
    square is e^2 / (R - C).
    """
    assert base is not None
    closing = values.atPose3(X(base)).between(values.atPose3(X(state)))
    between = closing.rotation()
    keys = gtsam.KeyVector([X(base), X(state)])
    joint = tree.jointMarginalCovariance(keys)
    up_b = values.atPose3(X(state)).rotation().matrix()[2]
    both = [joint.at(X(i), X(j))[:3, :3] for i in (base, state) for j in (base, state)]
    left = float(up_b @ gtsam.Rot3.Logmap(between))
    covariance = float(up_b @ (both[0] - both[1] - both[2] + both[3]) @ up_b)
    turn, place = params.returns.repeat_sd_rad, params.motion.return_position_sd_m
    distance = np.linalg.norm(gtsam.Pose3.Logmap(closing) / np.repeat([turn, place], 3))
    variance = turn**2 / RETURN_LOSS.weight(float(distance))
    return left**2 / max(variance - covariance, 1e-3 * variance)


def _pushed(solution: Solution, counted: NDArray[np.int64], up_b: Floats) -> gtsam.GaussianFactorGraph:
    """The system with another right side, by which its solution moves by the covariance with the mean heading s.

    s = b' d with b = up / K at the K states that count: with b added to the right side the solution moves by P b, which
    is cov(d, s). Covariances do not change.
    """
    pushed = solution.system.clone()
    nothing = np.zeros((6, 6))
    for i, up in zip(counted, up_b, strict=True):
        gradient = np.concatenate([up / len(counted), np.zeros(3)])
        pushed.push_back(gtsam.HessianFactor(X(int(i)), nothing, gradient, 0.0))
    return pushed
