"""The parts of the doctor against what is known exactly: turning, axes, displacements, lags, noise, calm."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from resting import RNG, stamps
from scipy.spatial.transform import Rotation

from stillpoint.datasets import Imu
from stillpoint.datasets.doctor.lag import find_lag
from stillpoint.datasets.doctor.noise import find_calm_seconds, measure_white_noise
from stillpoint.datasets.doctor.turning import (
    MODES,
    Grid,
    make_displacement_modes,
    make_gyro_series,
    make_vector_series,
)
from stillpoint.datasets.doctor.witness import CANDIDATES, choose, describe
from stillpoint.datasets.simulate import simulate


@pytest.mark.slow
@given(st.integers(0, 47), st.integers(0, 1000))
def test_a_vector_fixed_in_the_world_changes_as_the_true_rate_says(k, seed):
    """With the gyro's axes wrong by a candidate, that candidate's inverse predicts the change, exactly."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(1001) / 100
    rate = np.stack([np.sin(2 * np.pi * f * t_s + p) for f, p in rng.uniform(0.2, 1.0, (3, 2))], axis=1)
    steps = Rotation.from_rotvec(rate[1:] * 0.01)
    attitude = [Rotation.identity()]
    for step in steps:
        attitude.append(attitude[-1] * step)
    offset = np.array([1.0, 2.0, 3.0])
    vector = Rotation.concatenate(attitude).inv().apply(rng.normal(size=3)) + offset
    imu = Imu(stamps(1001), rate @ CANDIDATES[k], np.ones((1001, 3)))
    at = Grid(make_gyro_series(imu, 0), make_vector_series(imu.t_ns, vector, 0), 0.0).make_windows(0.0)
    predicted = at.predict_change(CANDIDATES[k], offset)
    assert np.abs(predicted - at.change).max() < 1e-3 * np.abs(at.change).max()


def test_the_candidates_are_all_signed_permutations():
    assert len({matrix.tobytes() for matrix in CANDIDATES + 0.0}) == 48
    assert np.array_equal(CANDIDATES[0], np.eye(3))
    assert np.allclose(CANDIDATES @ CANDIDATES.transpose(0, 2, 1), np.eye(3))


@pytest.mark.parametrize("matrix", CANDIDATES)
def test_a_description_says_what_the_matrix_does(matrix):
    values = dict(zip("xyz", (2.0, 3.0, 5.0), strict=True))
    changed = dict(values)
    for part in filter(None, describe("gyro", matrix).split(", ")):
        target, source = part.removeprefix("gyro ").split(" -> ")
        changed[target] = -values[source[1:]] if source.startswith("-") else values[source]
    assert np.allclose(list(changed.values()), matrix @ [2.0, 3.0, 5.0])


def test_nothing_is_chosen_where_the_gyro_explains_nothing():
    noise = RNG.normal(0, 1, (48, 200))
    assert choose(noise, noise.mean(axis=0), 1.0) is None


def test_the_displacement_of_a_force_is_that_of_its_path():
    length, step_s = 200, 0.01
    t_s = step_s * np.arange(1, length + 1)
    force = np.cos(3 * t_s)
    of_force, of_path = make_displacement_modes(length, step_s)
    twice = np.cumsum(np.cumsum(force)) * step_s**2
    assert of_force.shape == of_path.shape == (MODES, length)
    assert np.allclose(of_force @ force, of_path @ twice, atol=1e-12)
    assert np.allclose(of_path @ (3.0 - 2 * t_s + 7 * t_s**2), 0, atol=1e-9)  # a steady tilt is no displacement


@given(st.floats(-0.2, 0.2))
def test_a_lag_is_found_to_a_tenth_of_a_millisecond(lag_s):
    t_s = np.arange(0.5, 30, 0.02)
    lag = find_lag(lambda shift_s: (np.sin(3 * (t_s + shift_s - lag_s)) - np.sin(3 * t_s)) ** 2)
    assert lag is not None
    assert abs(lag.lag_s - lag_s) < 1e-4


def test_no_lag_is_claimed_where_the_loss_hardly_depends_on_it():
    assert find_lag(lambda shift_s: np.full(100, 1.0 + 0.01 * shift_s)) is None


@given(st.floats(1e-4, 10.0), st.integers(0, 100))
def test_white_noise_is_told_from_drift_and_jolts(sd, seed):
    rng = np.random.default_rng(seed)
    values = rng.normal(0, sd, (5000, 3)) + 50 * sd * np.linspace(0, 1, 5000)[:, None] ** 2
    values[::500] += 100 * sd
    assert measure_white_noise(values, np.ones(5000, dtype=bool)) == pytest.approx([sd] * 3, rel=0.1)


@pytest.fixture(scope="module")
def table():
    return simulate("phone-1", seed=0, minutes=0.6)


@given(factor=st.floats(1e-3, 1e3))
def test_calm_seconds_do_not_depend_on_the_unit(table, factor):
    scaled = replace(table.imu, accel_b_mps2=factor * table.imu.accel_b_mps2)
    assert np.array_equal(find_calm_seconds(scaled), find_calm_seconds(table.imu))
    assert len(find_calm_seconds(table.imu)) >= 8  # of the ten seconds of rest
