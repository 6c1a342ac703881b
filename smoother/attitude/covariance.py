"""Covariances at the optimum of the graph, and how far the returns to the base pose confirm them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from gtsam.symbol_shorthand import L, M, V, X
from numpy.typing import NDArray

from stillpoint.datasets.compiled import compiled
from stillpoint.datasets.frames import rotation
from stillpoint.datasets.recording import Floats
from stillpoint.smoother.attitude.keys import Keys
from stillpoint.smoother.attitude.linear.elimination import SingularSystem, eliminate, multiply_covariance
from stillpoint.smoother.attitude.linear.inverse import compute_covariances
from stillpoint.smoother.attitude.params import GraphParams
from stillpoint.smoother.attitude.returns import closing_error, closing_square
from stillpoint.smoother.attitude.solve import Solution, make_unobservable, rotations_of

_MOST_RETURNS = 6  # that count in the covariance factor
_LEAST_EIGENVALUE = 1e-6  # of the trace of the wider covariance: below it, rounding decides
_LEAST_SHARE = 1e-3  # of the largest eigenvalue: heading and mounting are not told apart where attitudes hardly change


@dataclass(frozen=True, eq=False)
class Accuracy:
    """Covariances at the optimum, before :func:`choose_factors`."""

    attitude_b_rad2: Floats  # (m, 3, 3) of the chosen states, body axes, relative to mean heading and mounting
    heading_rad2: float  # of the mean heading, an error that all states share
    mounting_b_rad2: Floats  # (3, 3) of the mean mounting, an error that all states share in body axes
    calibration: Floats  # (19, 19)
    position_n_m2: Floats  # (m, 3, 3) of the chosen states; of use only where there are satellites
    velocity_n_m2ps2: Floats | None  # (m, 3, 3), None where it was not asked for
    closing_squares: tuple[float, ...]  # of each return: squared heading error over its variance


def compute_accuracy(
    solution: Solution,
    states: NDArray[np.int64],
    counted: NDArray[np.int64],
    returns: tuple[int, ...],
    name: str,
    params: GraphParams,
    with_velocity: bool,
) -> Accuracy:
    """Return the covariances of ``states`` relative to mean heading and mounting of the states ``counted``.

    An error d (3,) of a state in body axes is A t + what it does not share with the others: A = [up, 1] (3, 4) and t a
    heading and a mounting, fitted to all counted states. Raises :class:`Unobservable` when there are no covariances:
    the iterations also converge where the graph does not determine all unknowns.
    """
    values = solution.values
    shared = _shared_errors(rotations_of(values, counted))  # (K, 3, 4)
    poses = [X(int(i)) for i in states]
    velocities = [V(int(i)) for i in states] if with_velocity else []
    with_common = [(X(i), L(0)) for i in returns]
    pairs = [(key, key) for key in (*poses, *velocities, M(0), *(X(i) for i in returns), *(L(0) for _ in returns[:1]))]
    try:
        eliminated = eliminate(solution.structure, solution.rows)
    except SingularSystem as error:
        raise make_unobservable(name) from error
    covariances = compute_covariances(eliminated, [*pairs, *with_common])
    of_pair = dict(zip([*pairs, *with_common], covariances, strict=True))
    calibration = of_pair[M(0), M(0)]
    pose = np.array([of_pair[key, key] for key in poses])
    attitude = pose[:, :3, :3]
    if not (np.diagonal(attitude, axis1=1, axis2=2) > 0).all():
        raise make_unobservable(name)

    def turns(which: Sequence[int] | NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the scalars (n, 3) of the turns of states."""
        return eliminated.structure.scalars(X(0) + np.asarray(which), 3)

    # The product of the covariance with a column b is the covariance with b' d: here with the means of A' d.
    columns = np.zeros((len(eliminated.right), shared.shape[2]))
    columns[turns(counted)] = shared / len(counted)
    products = multiply_covariance(eliminated, columns)
    closing = []
    for state in returns:
        error_rad, up_b = closing_error(values, state)
        cross = of_pair[X(state), L(0)]
        apart = of_pair[X(state), X(state)] - cross - cross.T + of_pair[L(0), L(0)]
        closing.append(closing_square(error_rad, float(up_b @ apart[:3, :3] @ up_b), params))

    def covariance_with_means(which: NDArray[np.int64]) -> Floats:
        """Return cov(d, mean of A' d), (n, 3, 4)."""
        return np.asarray(products[turns(which)])

    of_means = np.mean(shared.transpose(0, 2, 1) @ covariance_with_means(counted), axis=0)  # cov of the means, (4, 4)
    with_means, here = covariance_with_means(states), _shared_errors(rotations_of(values, states))
    of_heading = _subtract_shared(attitude, with_means[:, :, :1], of_means[:1, :1], here[:, :, :1])
    fit = np.linalg.pinv(np.mean(shared.transpose(0, 2, 1) @ shared, axis=0), rcond=_LEAST_SHARE, hermitian=True)
    relative = _subtract_shared(attitude, with_means @ fit, fit @ of_means @ fit, here)
    relative = _replace_indefinite(_replace_indefinite(relative, of_heading), attitude)
    mounting = _nearest_covariance(np.mean(of_heading - relative, axis=0))
    turn = rotations_of(values, states)
    position = turn @ pose[:, 3:, 3:] @ turn.transpose(0, 2, 1)
    heading_rad2 = float(of_means[0, 0])
    velocity = np.array([of_pair[key, key] for key in velocities]) if with_velocity else None
    return Accuracy(relative, heading_rad2, mounting, calibration, position, velocity, tuple(closing))


@dataclass(frozen=True)
class Factors:
    """Factors on the variances of tilt and heading around the mean heading, and of the mean heading."""

    tilt: float
    heading: float
    mean_heading: float


def choose_factors(closing_squares: Sequence[float], has_rest: bool, least: float, params: GraphParams) -> Factors:
    """Return the factors on the covariances: calibrated ones, that of the heading updated by the closing squares.

    With returns, the expectation of a closing square is the factor of the heading. The calibrated factor counts as
    ``prior_returns`` of them, and any number of returns as MOST_RETURNS at most: an error that is the same each time
    does not show. Without returns the errors of the field decide, which need no factor. No factor is below ``least``.
    """
    heading, count = params.variance_factor, min(len(closing_squares), _MOST_RETURNS)
    if count:
        trusted = params.prior_returns * params.heading_variance_factor
        heading = (trusted + count * float(np.mean(closing_squares))) / (params.prior_returns + count)
    tilt = params.rest_variance_factor if has_rest else params.variance_factor
    return Factors(max(tilt, least), max(heading, least), max(params.variance_factor, least))


def scale_covariances(cov_b_rad2: Floats, q_nb: Floats, factors: Factors) -> Floats:
    """Return covariances (N, 3, 3) in body axes at attitudes (N, 4), with tilt and heading scaled by their factors."""
    up_b = rotation(q_nb).as_matrix()[:, 2]
    return _scale_along(cov_b_rad2, up_b, np.sqrt(factors.tilt), np.sqrt(factors.heading) - np.sqrt(factors.tilt))


def compute_bending(keys: Keys, params: GraphParams) -> tuple[Floats, Floats]:
    """Return how far a body may bend against its sensor: covariances (n - 1, 3, 3) of each interval and (3, 3) of all.

    In body axes: what differs from the mean over the motion, and that mean, which is a part of the mounting. The
    specific force f turns the body by r x f, where nothing is known of the direction of r.
    """
    counted = ~keys.at_rest if not keys.at_rest.all() else np.ones(len(keys.at_rest), dtype=np.bool_)
    mean = np.average(keys.accel_b_mps2[counted], axis=0, weights=keys.span_s[counted])
    return _bend(keys.accel_b_mps2 - mean, params), _bend(mean[None], params)[0]


def _bend(force_b_mps2: Floats, params: GraphParams) -> Floats:
    """Return the covariances (n, 3, 3) of r x f for forces (n, 3) and r with an sd of ``bending_rad_per_mps2``."""
    along = force_b_mps2[:, :, None] * force_b_mps2[:, None, :]
    square = np.trace(along, axis1=1, axis2=2)
    return np.asarray(params.bending_rad_per_mps2**2 * (square[:, None, None] * np.eye(3) - along))


@compiled
def _scale_along(covariance: Floats, along: Floats, root: float, more: float) -> Floats:
    """Return S C S (N, 3, 3) with S = root 1 + more a a', for directions ``along`` (N, 3) of length 1."""
    scaled, product = np.empty_like(covariance), np.empty(3)
    for k in range(len(along)):
        twice = 0.0
        for i in range(3):
            product[i] = 0.0
            for j in range(3):
                product[i] += covariance[k, i, j] * along[k, j]
            twice += along[k, i] * product[i]
        for i in range(3):
            for j in range(3):
                both = along[k, i] * product[j] + product[i] * along[k, j]
                scaled[k, i, j] = root * root * covariance[k, i, j] + root * more * both
                scaled[k, i, j] += more * more * twice * along[k, i] * along[k, j]
    return scaled


def _shared_errors(rotations: Floats) -> Floats:
    """Return A = [up, 1], (K, 3, 4): what a heading and a mounting that all states share do to states (K, 3, 3)."""
    identity = np.broadcast_to(np.eye(3), rotations.shape)
    return np.concatenate([rotations[:, 2, :, None], identity], axis=2)


def _subtract_shared(covariance: Floats, with_shared: Floats, of_shared: Floats, by_shared: Floats) -> Floats:
    """Return the covariance (n, 3, 3) of d - A t, given cov(d, t) (n, 3, k), cov(t) (k, k) and A (n, 3, k)."""
    back = by_shared.transpose(0, 2, 1)
    cross = with_shared @ back
    return np.asarray(covariance - cross - cross.transpose(0, 2, 1) + by_shared @ of_shared @ back)


def _replace_indefinite(covariance: Floats, wider: Floats) -> Floats:
    """Return covariances (n, 3, 3), with the wider one where rounding has left one that is not positive definite.

    What is left after the shared part is subtracted can be a small difference of large numbers.
    """
    least = np.linalg.eigvalsh((covariance + covariance.transpose(0, 2, 1)) / 2)[:, 0]
    sound = least > _LEAST_EIGENVALUE * np.trace(wider, axis1=1, axis2=2)
    return np.where(sound[:, None, None], covariance, wider)


def _nearest_covariance(matrix: Floats) -> Floats:
    """Return a symmetric matrix (3, 3) without its negative eigenvalues."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)
