"""The graph of a spinning body against the same least squares written out in full."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import solveh_banded
from spins import GIVEN, known

from stillpoint.datasets import Encoder, Spin
from stillpoint.datasets.simulate import simulate
from stillpoint.smoother import reference
from stillpoint.smoother.spin.chain import build_chain, integrate_angles
from stillpoint.smoother.spin.encoder import select_readings
from stillpoint.smoother.spin.factors import compute_accuracy, eliminate, make_prior, solve_step
from stillpoint.smoother.spin.once_per_turn import Line
from stillpoint.smoother.spin.params import SpinGraphParams
from stillpoint.smoother.spin.rows import compute_roots, estimate_sizes, fit, mean_weight
from stillpoint.smoother.spin.samples import measure_samples
from stillpoint.smoother.spin.state import CONSTANTS, COS_A, COS_S, SIN_A, SIN_S, SpinState, split_blocks


def small(seconds=1.0, seed=1, **sensor):
    """A second of a horizontal bench with everything: gravity, an encoder on its own clock, a gap, bad samples."""
    recording = simulate("spin-constant", seed=seed, minutes=seconds / 60, sensor="white", **sensor)
    spin = recording.spin
    kept = np.delete(np.arange(len(spin.t_ns)), [90, 91, 92])
    accel = spin.accel_mps2[kept].copy()
    accel[30, 0] = np.nan
    accel[60, 1] = np.nan
    accel += 5.0 * np.cos(recording.roll_truth.angle_rad[kept])[:, None]
    encoder = Encoder(recording.encoder.t_ns + 1_700_000, recording.encoder.angle_rad, recording.encoder.rate_radps)
    return replace(recording, spin=Spin(spin.t_ns[kept], accel, spin.gyro_radps[kept], spin.geometry), encoder=encoder)


@pytest.fixture(scope="module")
def problem():
    """Chain, a state near the truth, and the prior, with all unknowns in play."""
    recording, params = small(), SpinGraphParams()
    samples = measure_samples(recording, params.noise)
    readings = select_readings(recording.encoder, samples.t_ns, params.encoder)
    chain = build_chain(samples, readings, 16, 0.5, params.noise)
    rng = np.random.default_rng(3)
    n = len(samples)
    truth = np.interp(samples.t_ns, recording.roll_truth.t_ns, recording.roll_truth.angle_rad)
    rates = np.diff(truth, prepend=truth[0] - 0.141) / samples.step_s
    constants = np.tile(
        [0.3, -0.1, 1e-3, -2e-3, 5.0, 0.02, 6e-4, 1.0, -0.5, 0.2, 0.3], (int(chain.constants_of[-1]) + 1, 1)
    )
    constants += 1e-4 * rng.standard_normal(constants.shape)
    state = SpinState(-0.14, np.append(rates, rates[-1]) + 0.05 * rng.standard_normal(n + 1), constants)
    line = Line("gravity", "", 0j, 0j, 100.0, 5.0, 5.0, 5.0, 0.0, 35.0, np.zeros(n))
    prior = make_prior(samples, line, True, 0.01, params)
    # A vibration beside gravity, along an angle of its own: all columns of the Jacobian are in use.
    shaken = [COS_S, SIN_S, COS_A, SIN_A]
    free = np.zeros(len(CONSTANTS))
    free[shaken] = [2.0, 2.0, 0.5, 0.5]
    prior = replace(prior, cov=prior.cov + np.diag(free**2), walk_cov=prior.walk_cov + np.diag((0.3 * free) ** 2))
    slow = np.linspace(0.0, 30.0, n)
    chain = replace(chain, shaken=np.stack([split_blocks(part, 16, 0.0) for part in (np.cos(slow), np.sin(slow))]))
    return chain, state, prior, params


def as_vector(state):
    return np.concatenate([[state.start_angle_rad], state.mean_rate_radps, state.constants.ravel()])


def as_state(z, chain):
    n = len(chain.samples)
    return SpinState(float(z[0]), z[1 : n + 2], z[n + 2 :].reshape(-1, len(CONSTANTS)))


def whitened(z, chain, prior, roots):
    """All residuals of the problem, predicted less measured, with weights held: nothing of gtsam, nothing of blocks."""
    state = as_state(z, chain)
    at = fit(chain, state)
    n = len(chain.samples)
    walk = np.linalg.inv(np.linalg.cholesky(prior.walk_cov))
    return -np.concatenate(
        [
            (roots.accel * at.accel_residual).ravel()[:n],
            (roots.squared * at.squared_residual).ravel()[:n],
            roots.encoder * at.encoder_residual,
            [(prior.angle_rad - integrate_angles(chain, state)[0]) / prior.angle_sd_rad],
            np.linalg.inv(np.linalg.cholesky(prior.cov)) @ (prior.mean - state.constants[0]),
            *(-walk @ change for change in np.diff(state.constants, axis=0)),
        ]
    )


def differences(z, function, size=1e-6):
    columns = []
    for k in range(len(z)):
        step = np.zeros_like(z)
        step[k] = size
        columns.append((function(z + step) - function(z - step)) / (2 * size))
    return np.column_stack(columns)


def test_step_and_covariance_are_those_of_the_full_problem(problem):
    """Gauss-Newton's step and all standard deviations, against a dense system whose Jacobian is made by differences."""
    chain, state, prior, params = problem
    at = fit(chain, state)
    roots = compute_roots(chain, at, estimate_sizes(chain, at, params.noise))
    z = as_vector(state)
    jacobian_full = differences(z, lambda one: whitened(one, chain, prior, roots))
    step, *_ = np.linalg.lstsq(jacobian_full, -whitened(z, chain, prior, roots), rcond=None)
    cov = np.linalg.inv(jacobian_full.T @ jacobian_full)

    linear = eliminate(chain, at, roots, prior, "test")
    found = as_vector(solve_step(chain, linear, len(state.constants)))
    sd = np.sqrt(np.diag(cov))
    assert np.abs((found - step) / sd).max() < 1e-3

    n = len(chain.samples)
    by_rates = np.tril(np.ones((n, n))) * chain.step_s[:-1]
    of_angle = np.hstack([np.ones((n, 1)), by_rates, np.zeros((n, len(z) - n - 1))])
    accuracy = compute_accuracy(chain, linear, "test")
    expected = np.sqrt(np.einsum("ij,jk,ik->i", of_angle, cov, of_angle))
    np.testing.assert_allclose(accuracy.angle_sd_rad, expected, rtol=1e-3)
    p = chain.before.ravel()[:n]
    of_rate = np.zeros((n, len(z)))
    of_rate[np.arange(n), 1 + np.arange(n)], of_rate[np.arange(n), 2 + np.arange(n)] = p, 1 - p
    expected = np.sqrt(np.einsum("ij,jk,ik->i", of_rate, cov, of_rate))
    np.testing.assert_allclose(accuracy.rate_sd_radps, expected, rtol=1e-3)
    np.testing.assert_allclose(accuracy.constants_sd, sd[n + 2 : n + 2 + len(CONSTANTS)], rtol=1e-3)


@pytest.mark.slow
def test_the_scalar_chain_is_that_of_a_banded_solver():
    """Without biases, gravity and encoder only rates are left: Gauss-Newton on the tridiagonal system, by LAPACK."""
    recording, params = simulate("spin-constant", seed=4, sensor="white"), known(GIVEN)
    samples = measure_samples(recording, params.noise)
    y, u, step = samples.squared_rad2ps2, samples.accel_radps2, 0.004
    x = np.full(len(y) + 1, np.sqrt(np.median(y)))
    for _ in range(40):
        squared, accel = y - ((x[1:] + x[:-1]) / 2) ** 2, u - np.diff(x) / step
        w_s, w_a = (weight(squared, params, GIVEN.squared_sd_rad2ps2), weight(accel, params, GIVEN.accel_sd_radps2))
        slope = (x[1:] + x[:-1]) / 2  # d rate^2 / dx, by either neighbour
        banded = np.zeros((2, len(x)))
        banded[1, :-1] = w_s * slope**2 + w_a / step**2
        banded[1, 1:] += w_s * slope**2 + w_a / step**2
        banded[0, 1:] = w_s * slope**2 - w_a / step**2
        right = np.zeros(len(x))
        right[:-1] = w_s * slope * squared - w_a * accel / step
        right[1:] += w_s * slope * squared + w_a * accel / step
        x = x + solveh_banded(banded, right)
    made = reference(recording, params=params)
    # The step that is left when it stops, 1e-9 rad/s, and constants that are held within 1e-6: nothing else.
    np.testing.assert_allclose(made.rate_radps, (x[1:] + x[:-1]) / 2, rtol=0, atol=1e-5)


def weight(residual, params, sd):
    """Geman-McClure's, of mean 1 over normal noise, by the variance."""
    robust = params.noise.robust
    return 1 / (1 + (residual / (robust * sd)) ** 2) ** 2 / mean_weight(robust) / sd**2


@pytest.mark.parametrize("block", [4, 17, 40])
def test_the_result_does_not_depend_on_the_blocks(block):
    """Rates between keys are taken out exactly, so where the keys are says nothing."""
    recording = small(2.0)
    one, other = (reference(recording, params={"block": b, "rate_limit_radps": 1e-10}) for b in (24, block))
    np.testing.assert_allclose(other.rate_radps, one.rate_radps, rtol=0, atol=1e-6)
    np.testing.assert_allclose(other.angle_rad, one.angle_rad, rtol=0, atol=1e-6)
    np.testing.assert_allclose(other.angle_sd_rad, one.angle_sd_rad, rtol=1e-3)
    np.testing.assert_allclose(other.rate_sd_radps, one.rate_sd_radps, rtol=1e-3)
