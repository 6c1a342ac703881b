"""Covariances from one elimination against the inverse of the information matrix."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import M, V, X

from stillpoint.smoother.attitude.marginals import compute_covariances, eliminate, multiply_covariance

SIZES = {M(0): 5} | {X(i): 6 for i in range(8)} | {V(i): 3 for i in range(8)}


@pytest.fixture(scope="module")
def system() -> gtsam.GaussianFactorGraph:
    """A chain of poses and velocities that all depend on M, with one tie across it."""
    random = np.random.default_rng(3)
    made = gtsam.GaussianFactorGraph()

    def tie(*keys: int, rows: int) -> None:
        blocks = [part for key in keys for part in (key, random.normal(size=(rows, SIZES[key])))]
        made.push_back(gtsam.JacobianFactor(*blocks, random.normal(size=rows), gtsam.noiseModel.Unit.Create(rows)))

    for i in range(7):
        tie(X(i), V(i), M(0), rows=9)
        tie(X(i), X(i + 1), V(i), rows=9)
        tie(V(i), V(i + 1), rows=3)
    tie(X(1), X(6), rows=6)
    tie(X(7), V(7), rows=9)
    tie(M(0), rows=5)
    return made


def invert(system: gtsam.GaussianFactorGraph, keys: list[int]) -> tuple[np.ndarray, dict[int, slice]]:
    """Return the covariance of all unknowns in the order of ``keys``, and where each stands."""
    order = gtsam.Ordering()
    for key in keys:
        order.push_back(key)
    edges = np.concatenate([[0], np.cumsum([SIZES[key] for key in keys])])
    where = {key: slice(edges[k], edges[k + 1]) for k, key in enumerate(keys)}
    return np.linalg.inv(system.hessian(order)[0]), where


@pytest.mark.parametrize("order", ["colamd", "metis", "by key"])
def test_covariances_are_blocks_of_the_inverse(system, order):
    keys = sorted(SIZES)
    ordering = {
        "colamd": gtsam.Ordering.ColamdGaussianFactorGraph,
        "metis": gtsam.Ordering.MetisGaussianFactorGraph,
        "by key": lambda _: _ordering_of(keys),
    }[order](system)
    whole, where = invert(system, keys)
    wanted = [X(0), X(3), X(7), V(2), M(0)]
    for key, found in zip(wanted, compute_covariances(eliminate(system, ordering, wanted), wanted), strict=True):
        np.testing.assert_allclose(found, whole[where[key], where[key]], rtol=1e-8, atol=1e-12)


def test_products_with_the_covariance_equal_the_dense_ones(system):
    keys = sorted(SIZES)
    eliminated = eliminate(system, _ordering_of(keys), keys)
    whole, where = invert(system, keys)
    columns = np.random.default_rng(1).normal(size=(len(whole), 3))
    at = np.concatenate([np.arange(where[key].start, where[key].stop) for key in eliminated.number])
    np.testing.assert_allclose(multiply_covariance(eliminated, columns[at]), (whole @ columns)[at], rtol=1e-8)


def test_a_singular_system_has_no_covariance(system):
    loose = gtsam.GaussianFactorGraph()
    for i in range(system.size()):
        if M(0) in system.at(i).keys() and system.at(i).size() == 3:  # noqa: SIM118 - not a dict
            loose.push_back(system.at(i))
    with pytest.raises(RuntimeError):
        eliminate(loose, gtsam.Ordering.ColamdGaussianFactorGraph(loose), [M(0)])


def _ordering_of(keys: list[int]) -> gtsam.Ordering:
    ordering = gtsam.Ordering()
    for key in keys:
        ordering.push_back(key)
    return ordering
