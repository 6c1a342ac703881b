"""Graphs that would end in native code are found before: a variable without a factor, parts that nothing ties."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stillpoint.datasets import Unobservable
from stillpoint.smoother.connectivity import require_connected


def check(factors, variables, alone=()):
    keys, lengths = np.array([key for each in factors for key in each]), np.array([len(each) for each in factors])
    return require_connected(keys, lengths, variables, lambda key: f"state {key}", "run", may_stand_alone=alone)


@given(st.permutations(range(12)))
def test_a_chain_is_connected_in_whatever_order(order):
    assert check([[k, k + 1] for k in order], range(13)) is False


@given(st.integers(0, 10))
def test_a_chain_that_lacks_one_link_is_refused_and_the_smaller_part_named(missing):
    with pytest.raises(Unobservable, match=r"nothing connects state \d+"):
        check([[k, k + 1] for k in range(12) if k != missing] + [[0]], range(13))


def test_a_variable_without_a_factor_is_named():
    with pytest.raises(Unobservable, match="no measurement determines state 7"):
        check([[0, 1], [1, 2]], [0, 1, 2, 7])


def test_a_variable_with_its_own_prior_may_stand_alone():
    assert check([[0, 1], [9]], [0, 1], alone=(9,)) is True
    assert check([[0, 1], [9, 1]], [0, 1], alone=(9,)) is False
