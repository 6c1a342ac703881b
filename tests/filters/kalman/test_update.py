"""One scalar update of the error state: the textbook's within the gate, and what becomes of what lies beyond it."""

import numpy as np
import pytest
from from_python import from_python

from stillpoint.filters.kalman import update as error_updates
from stillpoint.filters.kalman.model import HEADING, SIZE, Measurement

update = from_python(error_updates.update)
GATE = 9.0  # three standard deviations
VARIANCE = 0.5


def prior():
    root = np.random.default_rng(3).normal(size=(SIZE, SIZE))
    return np.linspace(-0.2, 0.3, SIZE), root @ root.T


def measured(sds):
    """A row that sees attitude, bias and velocity, and a residual of so many standard deviations."""
    x, p = prior()
    row = np.linspace(1.0, -0.5, SIZE)
    total = row @ p @ row + VARIANCE
    return x, p, row, Measurement(True, row, row @ x + sds * np.sqrt(total), VARIANCE), total


def textbook(x, p, row, residual, total):
    """Gain P h' / S, and Joseph's form with the noise that makes S the innovation's variance."""
    gain = p @ row / total
    left = np.eye(SIZE) - np.outer(gain, row)
    return x + gain * residual, left @ p @ left.T + (total - row @ p @ row) * np.outer(gain, gain)


@pytest.mark.parametrize("sds", [0.5, -2.9])
def test_within_the_gate_it_is_the_textbooks(sds):
    x, p, row, seen, total = measured(sds)
    x_new, p_new = textbook(x, p, row, sds * np.sqrt(total), total)
    assert not update(x, p, seen, True, 1.0, GATE)
    np.testing.assert_allclose(x, x_new, rtol=1e-12)
    np.testing.assert_allclose(p, p_new, rtol=1e-10)


@pytest.mark.parametrize("sds", [3.1, -30.0])
def test_beyond_the_gate_an_innovation_is_taken_for_one_at_the_gate(sds):
    """Its variance is taken so much larger that its square over it is the gate: it moves x less the farther it is."""
    x, p, row, seen, total = measured(sds)
    residual = sds * np.sqrt(total)
    x_new, p_new = textbook(x, p, row, residual, residual**2 / GATE)
    assert update(x, p, seen, True, 1.0, GATE)
    np.testing.assert_allclose(x, x_new, rtol=1e-10)
    np.testing.assert_allclose(p, p_new, rtol=1e-10)


def test_a_factor_on_the_variance_moves_the_gate_along():
    """aekf's alpha: 4 sd of the model are 2 sd of an innovation that is four times as large."""
    x, p, row, seen, total = measured(4.0)
    x_new, _ = textbook(x, p, row, 4.0 * np.sqrt(total), 4.0 * total)
    assert not update(x, p, seen, True, 4.0, GATE)
    np.testing.assert_allclose(x, x_new, rtol=1e-12)


def test_what_must_not_move_the_tilt_leaves_it_and_its_covariance_is_still_one():
    x, p, row, seen, total = measured(1.0)
    before, x_new = x.copy(), textbook(x, p, row, np.sqrt(total), total)[0]
    p_before = p.copy()
    assert not update(x, p, seen, False, 1.0, GATE)
    np.testing.assert_array_equal(x[:HEADING], before[:HEADING])
    np.testing.assert_allclose(x[HEADING:], x_new[HEADING:], rtol=1e-12)
    np.testing.assert_allclose(p[:HEADING, :HEADING], p_before[:HEADING, :HEADING], rtol=1e-12)
    assert np.linalg.eigvalsh(p).min() > 0
