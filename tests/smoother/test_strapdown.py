"""The gyro integrated, and how far it drifts: against finite changes, and against what a gap can hide."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from protocols import BASE, protocol, walk_of
from scipy.spatial.transform import Rotation

from stillpoint.datasets import Imu
from stillpoint.datasets.frames import quaternion, rotation
from stillpoint.smoother import strapdown
from stillpoint.smoother.strapdown import GyroErrors, drift_matrices, integrate, swing, walk_steps


@given(st.integers(0, 2**32 - 1))
def test_integration_is_the_product_of_the_steps(seed):
    rng = np.random.default_rng(seed)
    rate, dt_s = rng.normal(0, 10, (20, 3)), rng.uniform(0.001, 0.1, 20)
    q = Rotation.random(random_state=rng)
    expected = q
    for step in rate * dt_s[:, None]:
        expected = expected * Rotation.from_rotvec(step)
    got = rotation(integrate(quaternion(q), rate, dt_s)[-1])
    assert (got.inv() * expected).magnitude() < 1e-12


def test_integrating_back_undoes_integrating_forth():
    imu = protocol().imu
    there = swing(imu, np.zeros(3), 0, 4000, quaternion(BASE), walk_of(imu))
    back = swing(imu, np.zeros(3), 4000, 0, there.q_nb[-1], walk_of(imu))
    assert back.rows[-1] == 0
    assert (rotation(back.q_nb[-1]).inv() * BASE).magnitude() < 1e-12


@pytest.mark.parametrize("element", range(12))
def test_drift_matrix_is_the_derivative_of_the_integral(element):
    """Against a finite change of each of the nine elements of the gyro matrix and of the three of the bias."""
    imu = protocol(jitter=0.0).imu
    size = 1e-6
    change = np.zeros(12)
    change[element] = size
    wrong = imu.gyro_b_radps @ change[:9].reshape(3, 3) + change[9:]
    path = swing(imu, np.zeros(3), 1000, 2000, quaternion(BASE), walk_of(imu))
    true = swing(
        Imu(imu.t_ns, imu.gyro_b_radps + wrong, imu.accel_b_mps2),
        np.zeros(3),
        1000,
        2000,
        quaternion(BASE),
        walk_of(imu),
    )
    error_n = (rotation(true.q_nb) * rotation(path.q_nb).inv()).as_rotvec() / size
    got = np.concatenate([matrix[:, :, element] for _, matrix in drift_matrices(path)])
    assert np.abs(error_n).max() > 0.1
    np.testing.assert_allclose(got, error_n, atol=0.02 * np.abs(error_n).max())


def test_a_gap_hides_a_turn_at_the_rate_that_is_allowed_for_it():
    """Between samples the walk grows by its density; over 2 s of nothing by all that 60 deg/s could have turned."""
    errors = GyroErrors()
    t_ns = np.concatenate([np.arange(100), 300 + np.arange(100)]) * 10_000_000
    grown = walk_steps(t_ns, errors)
    step_s = np.diff(t_ns) / 1e9
    assert step_s[99] == 2.01
    expected = errors.walk_rad_rts**2 * step_s
    expected[99] += (np.deg2rad(60.0) * 2.01) ** 2
    np.testing.assert_allclose(grown, expected, rtol=1e-9)


def test_drift_matrices_do_not_depend_on_how_many_are_held_at_once(monkeypatch):
    imu = protocol().imu
    path = swing(imu, np.zeros(3), 1000, 2000, quaternion(BASE), walk_of(imu))
    ((_, whole),) = drift_matrices(path)
    monkeypatch.setattr(strapdown, "CHUNK", 64)
    parts = [part for _, part in drift_matrices(path)]
    assert len(parts) == 16
    np.testing.assert_allclose(np.concatenate(parts), whole, rtol=0, atol=1e-12)
