"""Covariances at the optimum of the graph, and how far the returns to the base pose confirm them."""

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import M, V, X
from numpy.typing import NDArray

from stillpoint.datasets.recording import Floats
from stillpoint.smoother.attitude.factors import RETURN_LOSS
from stillpoint.smoother.attitude.params import GraphParams
from stillpoint.smoother.attitude.solve import Solution, make_unobservable, rotations_of

MOST_RETURNS = 6  # that count in the covariance factor


@dataclass(frozen=True, eq=False)
class Accuracy:
    """Covariances at the optimum, before :func:`covariance_factor`."""

    attitude_b_rad2: Floats  # (m, 3, 3) of the chosen states, body axes, relative to the mean heading
    heading_rad2: float  # of the mean heading, an error that all states share
    calibration: Floats  # (19, 19)
    position_n_m2: Floats  # (m, 3, 3) of the chosen states; of use only where there are satellites
    velocity_n_m2ps2: Floats | None  # (m, 3, 3), None where it was not asked for
    closing_squares: tuple[float, ...]  # of each return: squared heading error over its variance


def compute_accuracy(
    solution: Solution,
    states: NDArray[np.int64],
    counted: NDArray[np.int64],
    base: int | None,
    returns: tuple[int, ...],
    name: str,
    params: GraphParams,
    with_velocity: bool,
) -> Accuracy:
    """Return the covariances of ``states`` relative to the mean heading of the states ``counted``, and the closings.

    Raises :class:`Unobservable` when there are none: the iterations also converge where the graph does not determine
    all unknowns.
    """
    up_b = rotations_of(solution.values, counted)[:, 2]
    try:
        tree = _push_by_mean_heading(solution, counted, up_b).eliminateMultifrontal(solution.ordering)
        pose = np.array([tree.marginalCovariance(X(int(i))) for i in states])
        velocity = np.array([_velocity_covariance(tree, int(i)) for i in states]) if with_velocity else None
        calibration = tree.marginalCovariance(M(0))
        closing = [_closing_square(tree, solution.values, base, state, params) for state in returns]
    except RuntimeError as error:
        raise make_unobservable(name) from error
    attitude = pose[:, :3, :3]
    if not (np.diagonal(attitude, axis1=1, axis2=2) > 0).all():
        raise make_unobservable(name)
    moved = tree.optimize()

    def covariance_with_heading(which: NDArray[np.int64]) -> Floats:
        return np.array([moved.at(X(int(i)))[:3] - solution.last_step.at(X(int(i)))[:3] for i in which])

    variance = float(np.mean(np.sum(covariance_with_heading(counted) * up_b, axis=1)))
    turn = rotations_of(solution.values, states)
    up_b, shared = turn[:, 2], covariance_with_heading(states)
    cross = shared[:, :, None] * up_b[:, None, :]
    relative = attitude - cross - cross.transpose(0, 2, 1) + variance * up_b[:, :, None] * up_b[:, None, :]
    position = turn @ pose[:, 3:, 3:] @ turn.transpose(0, 2, 1)
    return Accuracy(relative, variance, calibration, position, velocity, tuple(closing))


def _velocity_covariance(tree: gtsam.GaussianBayesTree, state: int) -> Floats:
    """Return the covariance (3, 3) of a velocity.

    Where a velocity is hardly known, gtsam takes the last pivot of its own marginal for zero; together with the pose it
    does not.
    """
    try:
        return np.asarray(tree.marginalCovariance(V(state)))
    except RuntimeError:
        joint = tree.jointMarginalCovariance(gtsam.KeyVector([X(state), V(state)]))
        return np.asarray(joint.at(V(state), V(state)))


def covariance_factor(closing_squares: Sequence[float], params: GraphParams) -> float:
    """Return the factor on all covariances, from the closing squares of the returns.

    A sensor whose heading closes better than its noise promises is better than its noise. Any number of returns counts
    as MOST_RETURNS at most: an error that is the same each time does not show in them.
    """
    trust, count = params.prior_returns, min(len(closing_squares), MOST_RETURNS)
    mean = float(np.mean(closing_squares)) if count else 0.0
    return params.variance_factor * (trust + count * mean) / (trust + count)


def _closing_square(
    tree: gtsam.GaussianBayesTree, values: gtsam.Values, base: int | None, state: int, params: GraphParams
) -> float:
    """Return the normalised square of the heading's closing error at a return, as if the return had not been used.

    Let e be the closing error in the solution, C its covariance there, and R the variance of the return (widened by its
    robust weight). Without the return the error is R/(R - C) e with variance R^2/(R - C): its normalised square is
    e^2 / (R - C).
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


def _push_by_mean_heading(solution: Solution, counted: NDArray[np.int64], up_b: Floats) -> gtsam.GaussianFactorGraph:
    """Return the system with another right side, which moves its solution by the covariance with the mean heading s.

    s = b' d with b = up / K at the K states that count: with b added to the right side the solution moves by P b, which
    is cov(d, s). Covariances do not change.
    """
    pushed = solution.system.clone()
    nothing = np.zeros((6, 6))
    for i, up in zip(counted, up_b, strict=True):
        gradient = np.concatenate([up / len(counted), np.zeros(3)])
        pushed.push_back(gtsam.HessianFactor(X(int(i)), nothing, gradient, 0.0))
    return pushed
