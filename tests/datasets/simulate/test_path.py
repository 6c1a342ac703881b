"""The true motion: its derivatives are exact, its rests are still."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from stillpoint.datasets.frames import rotation
from stillpoint.datasets.simulate.path import Path, join_strokes
from stillpoint.datasets.simulate.phone import IN_HAND, SLIDING, TRIPOD, draw_path

HANDS = {"phone-1": SLIDING, "phone-2": TRIPOD, "phone-3": IN_HAND}


@pytest.fixture(params=HANDS)
def path(request):
    return draw_path(HANDS[request.param], 100.0, seed=5, kind=request.param)


@pytest.mark.slow
def test_acceleration_integrates_back_to_the_position(path):
    # Gauss-Legendre with three points is exact for the polynomials of degree 3 between the ends of the strokes; a lever
    # arm that turns is none, and twelve points are exact to rounding.
    knots = np.unique(np.concatenate([path.turn_b_rad.x, *(chain.x for chain in path.place_n_m)]))
    nodes, weights = np.polynomial.legendre.leggauss(12 if any(path.arm_b_m) else 3)
    velocity, position = np.zeros(3), path.position(knots[:1])[0]
    for start, end in pairwise(knots):
        times = start + (nodes + 1) / 2 * (end - start)
        acceleration = path.acceleration_n_mps2(times)
        moments = (weights * (end - times)) @ acceleration, weights @ acceleration
        position = position + velocity * (end - start) + moments[0] * (end - start) / 2
        velocity = velocity + moments[1] * (end - start) / 2
        np.testing.assert_allclose(position, path.position([end])[0], atol=1e-9)
        if not path.moving([end]).any():
            np.testing.assert_allclose(velocity, 0, atol=1e-9)


def test_angular_acceleration_is_the_derivative_of_the_rate(path):
    """Central differences over 2 us inside the strokes; both formulas of the shares, for small turns and large ones."""
    inside = np.convolve(path.turn_b_rad.x, [0.5, 0.5], "valid")
    inside = np.concatenate([inside, path.turn_b_rad.x[:-1] + 1e-3 * np.diff(path.turn_b_rad.x)])
    differences = (path.rate_b_radps(inside + 1e-6) - path.rate_b_radps(inside - 1e-6)) / 2e-6
    np.testing.assert_allclose(path.angular_acceleration_b_radps2(inside), differences, atol=2e-6, rtol=1e-6)


@pytest.mark.slow
def test_rate_integrates_back_to_the_attitude(path):
    start, end = path.rests_s[0, 1], path.rests_s[1, 0]
    knots = path.turn_b_rad.x
    knots = knots[(knots >= start) & (knots <= end)]
    q = path.attitude(knots[:1]).as_quat(scalar_first=True)[0]

    def derivative(t, q):
        x, y, z = path.rate_b_radps([t])[0]
        w_matrix = np.array([[0, -x, -y, -z], [x, 0, z, -y], [y, -z, 0, x], [z, y, -x, 0]])
        return 0.5 * w_matrix @ q

    for first, last in pairwise(knots[:9]):  # the rate is smooth within a stroke
        q = solve_ivp(derivative, (first, last), q, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
        difference = rotation(q).inv() * path.attitude([last])
        assert difference.magnitude().max() < 1e-9


def test_still_exactly_at_rest_and_nowhere_else(path):
    for start, end in path.rests_s:
        t = np.linspace(start, end, 50)[1:-1]
        assert not path.moving(t).any()
        assert (path.rate_b_radps(t) == 0).all()
        # The second derivative of equal coefficients is zero but for the last bit.
        np.testing.assert_allclose(path.acceleration_n_mps2(t), 0, atol=1e-12)
        assert np.ptp(path.position(t), axis=0).max() < 1e-15
    between = (path.rests_s[:-1, 1] + path.rests_s[1:, 0]) / 2
    assert path.moving(between).all()


def test_before_and_after_the_path_rests(path):
    t = np.array([-3.0, -1e-9, path.duration_s, path.duration_s + 5])
    assert not path.moving(t).any()
    assert (path.rate_b_radps(t) == 0).all()
    assert (path.attitude(t[:2]) * path.attitude([0.0]).inv()).magnitude().max() == 0


@pytest.mark.slow
def test_neither_rate_nor_acceleration_jumps(path):
    """Sampled ten times finer, the largest step of both must fall about tenfold."""
    t = np.arange(path.rests_s[0, 1], path.rests_s[1, 0], 0.002)
    for signal in (path.rate_b_radps, path.acceleration_n_mps2):
        coarse = np.abs(np.diff(signal(t), axis=0)).max()
        fine = np.abs(np.diff(signal(np.arange(t[0], t[-1], 0.0002)), axis=0)).max()
        assert fine < 0.2 * coarse


@given(
    turn=st.tuples(*[st.floats(-3, 3)] * 3),
    further=st.tuples(*[st.floats(-3, 3)] * 3),
    share=st.floats(0.05, 0.95),
)
def test_rate_is_the_derivative_of_any_turn(turn, further, share):
    times = [0.0, 1.0, 2.0, 3.0]
    turns = join_strokes(times, [np.zeros(3), turn, further, further])
    path = Path(np.array([1.0, 0, 0, 0]), turns, (), np.array([[0.0, 0.0], [2.0, 3.0]]))
    t, h = 1 + share, 1e-4
    step = path.steps_b_rad(np.array([t - h, t + h]))[0] / (2 * h)
    # The central difference is wrong by h^2/6 times the second derivative of the rate, under 100 rad/s^3 here.
    np.testing.assert_allclose(path.rate_b_radps([t])[0], step, atol=1e-5)


def test_a_stroke_is_the_minimum_jerk_polynomial():
    stroke = join_strokes([2.0, 4.0], [[1.0], [3.0]])
    tau = np.linspace(0, 1, 11)
    expected = 1 + 2 * (10 * tau**3 - 15 * tau**4 + 6 * tau**5)
    np.testing.assert_allclose(stroke(2 + 2 * tau)[:, 0], expected, atol=1e-14)


def test_steps_keep_coning():
    """A cone: the body axis circles, and the mean rate differs from the rate at the middle; the product closes."""
    path = draw_path(IN_HAND, 90.0, seed=1, kind="phone-3")
    t = np.arange(60.0, 62.0, 0.01)
    product = Rotation.identity()
    for step in path.steps_b_rad(t):
        product = product * Rotation.from_rotvec(step)
    assert (product.inv() * path.attitude(t[:1]).inv() * path.attitude(t[-1:])).magnitude().max() < 1e-12
    middle = path.rate_b_radps((t[1:] + t[:-1]) / 2) * 0.01
    assert np.abs(middle - path.steps_b_rad(t)).max() > 1e-6
