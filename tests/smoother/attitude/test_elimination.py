"""Elimination and covariances of a linear system against gtsam's and the inverse of the information matrix."""

from collections.abc import Sequence

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, C, M, V, X

from stillpoint.smoother.attitude.linear.elimination import (
    Eliminated,
    SingularSystem,
    eliminate,
    multiply_covariance,
    optimise,
)
from stillpoint.smoother.attitude.linear.inherited import remaining_rows
from stillpoint.smoother.attitude.linear.inverse import compute_covariances
from stillpoint.smoother.attitude.linear.rows import Rows, flatten, join_rows, starts
from stillpoint.smoother.attitude.linear.structure import Structure, find_structure

LETTERS = {ord("m"): 5, ord("x"): 6, ord("v"): 3, ord("b"): 2, ord("c"): 4}
KEYS = [*(X(i) for i in range(8)), *(V(i) for i in range(8)), *(C(i) for i in range(7)), B(0), B(1), B(2), M(0)]


@pytest.fixture(scope="module")
def rows() -> Rows:
    """A chain of states with biases that all depend on M, one tie across it, and a gap between states 4 and 5.

    No state has the bias B(1), as in a gap that is longer than the step of a bias.
    """
    random = np.random.default_rng(3)
    keys: list[tuple[int, ...]] = []
    counts: list[int] = []

    def tie(*of: int, rows: int) -> None:
        keys.append(of)
        counts.append(rows)

    for i in range(7):
        tie(C(i), B(2 * (i // 5)), M(0), rows=4)
        if i != 4:
            tie(X(i), V(i), X(i + 1), V(i + 1), C(i), rows=9)
        tie(V(i), rows=3)
    tie(B(0), B(1), rows=2)
    tie(B(1), B(2), rows=2)
    tie(B(0), rows=2)
    tie(X(1), X(6), rows=6)
    for i in (0, 4, 5, 7):
        tie(X(i), V(i), rows=9)
    tie(M(0), rows=5)
    size = sum(count * (1 + sum(LETTERS[key >> 56] for key in of)) for of, count in zip(keys, counts, strict=True))
    flat = np.array([key for of in keys for key in of])
    return Rows(flat, starts([len(of) for of in keys]), np.array(counts), random.normal(size=size))


def whole_of(rows: Rows, structure: Structure) -> tuple[np.ndarray, np.ndarray]:
    """Return solution and covariance of all unknowns in the order of their elimination, by a dense inverse."""
    d = structure.first[-1]
    information, right, begin = np.zeros((d, d)), np.zeros(d), 0
    for f, count in enumerate(rows.count.tolist()):
        keys = rows.keys[rows.key_first[f] : rows.key_first[f + 1]].tolist()
        at = np.concatenate([structure.scalars([key], LETTERS[key >> 56])[0] for key in keys])
        part = rows.data[begin : begin + count * (len(at) + 1)].reshape(count, len(at) + 1)
        information[np.ix_(at, at)] += part[:, :-1].T @ part[:, :-1]
        right[at] += part[:, :-1].T @ part[:, -1]
        begin += part.size
    covariance = np.linalg.inv(information)
    return covariance @ right, covariance


def solve(rows: Rows, last: Sequence[int] = ()) -> Eliminated:
    return eliminate(find_structure(rows, LETTERS, last=last), rows)


def test_the_solution_is_that_of_the_dense_system(rows):
    eliminated = solve(rows)
    np.testing.assert_allclose(optimise(eliminated), whole_of(rows, eliminated.structure)[0], rtol=1e-7, atol=1e-9)


def test_covariances_are_blocks_of_the_inverse(rows):
    eliminated = solve(rows)
    s = eliminated.structure
    _, whole = whole_of(rows, s)
    pairs = [(key, key) for key in KEYS] + [(X(2), M(0)), (M(0), X(2)), (X(3), V(3)), (X(3), V(4)), (X(1), X(6))]
    for (one, other), found in zip(pairs, compute_covariances(eliminated, pairs), strict=True):
        at = [s.scalars([key], LETTERS[key >> 56])[0] for key in (one, other)]
        np.testing.assert_allclose(found, whole[np.ix_(*at)], rtol=1e-7, atol=1e-10)


def test_products_with_the_covariance(rows):
    eliminated = solve(rows)
    _, whole = whole_of(rows, eliminated.structure)
    columns = np.random.default_rng(1).normal(size=(len(whole), 3))
    np.testing.assert_allclose(multiply_covariance(eliminated, columns), whole @ columns, rtol=1e-7, atol=1e-10)


def test_the_last_unknowns_keep_what_is_known_of_them(rows):
    """The factors that remain for the last unknowns have the covariance and the optimum of the whole system."""
    last = [X(7), V(7), B(2), M(0)]
    eliminated = solve(rows, last)
    solution, whole = whole_of(rows, eliminated.structure)
    rest = remaining_rows(eliminated, last)
    assert set(rest.keys.tolist()) == set(last)
    small = solve(rest)
    few, covariance = whole_of(rest, small.structure)
    for key in last:
        size = LETTERS[key >> 56]
        there, here = (each.structure.scalars([key], size)[0] for each in (eliminated, small))
        np.testing.assert_allclose(few[here], solution[there], rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(covariance[np.ix_(here, here)], whole[np.ix_(there, there)], rtol=1e-7, atol=1e-10)


def test_a_singular_system_is_refused():
    """Two unknowns that only their difference is known of."""
    with pytest.raises(SingularSystem):
        solve(
            Rows(np.array([B(0), B(1)]), np.array([0, 2]), np.array([2]), np.array([1.0, 0, -1, 0, 0, 0, 1, 0, -1, 0]))
        )


def test_gtsam_solves_its_own_factors_to_the_same(rows):
    """The linear factors of a graph of gtsam, read out and eliminated here and by gtsam."""
    random, system = np.random.default_rng(5), gtsam.GaussianFactorGraph()
    for k in range(6):
        unit = gtsam.noiseModel.Diagonal.Sigmas(np.full(6, 0.5))
        a, b, target = random.normal(size=(6, 6)), random.normal(size=(6, 6)), random.normal(size=6)
        system.push_back(gtsam.JacobianFactor(X(k), a, X(k + 1), b, target, unit))
        system.push_back(gtsam.JacobianFactor(X(k), np.eye(6), random.normal(size=6), unit))
    eliminated = solve(flatten(system))
    found, wanted = optimise(eliminated), system.optimize()
    for k in range(7):
        at = eliminated.structure.scalars([X(k)], 6)[0]
        np.testing.assert_allclose(found[at], wanted.at(X(k)), rtol=1e-8, atol=1e-10)


def test_rows_without_noise_are_met():
    """A constrained factor of gtsam is taken for one of 1e-5."""
    system = gtsam.GaussianFactorGraph()
    exact = gtsam.noiseModel.Constrained.All(6)
    system.push_back(gtsam.JacobianFactor(X(0), np.eye(6), np.arange(6.0), exact))
    system.push_back(gtsam.JacobianFactor(X(0), np.eye(6), np.zeros(6), gtsam.noiseModel.Unit.Create(6)))
    np.testing.assert_allclose(optimise(solve(flatten(system))), np.arange(6.0), atol=1e-8)


def test_a_system_without_factors_adds_nothing(rows):
    """A short window in a gap has factors of the chain only."""
    both = join_rows([rows, flatten(gtsam.GaussianFactorGraph())])
    for name in ("keys", "key_first", "count", "data"):
        np.testing.assert_array_equal(getattr(both, name), getattr(rows, name))
