"""The magnetometer's factor: its residual, its Jacobian against differences, its weights."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import H, X
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from stillpoint.datasets.frames import quaternion
from stillpoint.smoother.attitude.magnetometer import (
    FieldMeasurements,
    compute_residuals,
    compute_weights,
    field_matrix,
    field_prior,
    linearise_measurements,
    measure_errors,
    shrink_scale,
    start_field,
    widen_by_errors,
    widen_for_covariance,
)
from stillpoint.smoother.attitude.params import FieldParams

PARAMS = FieldParams()
MATRIX = np.array([[0.02, -0.01, 0.005], [0.015, -0.03, 0.01], [0.0, 0.02, 0.01]])
UNIT_MATRIX = (np.eye(3) + MATRIX) / np.cbrt(np.linalg.det(np.eye(3) + MATRIX))
FIELD = np.array([2.0, 20.0, -40.0, 5.0, -3.0, 8.0, 0.05, *MATRIX.ravel()])  # place's in n, hard iron, delay, matrix
RATE = np.array([[2.0, -1.0, 0.5], [0.0, 4.0, 0.0], [-3.0, 0.0, 1.0], [0.3, 0.2, -0.1]])  # rad/s


@pytest.fixture
def attitude():
    return Rotation.random(4, rng=np.random.default_rng(3))


@pytest.fixture
def measured(attitude):
    """Taken by a body that turns, of the attitude 50 ms ago."""
    return FieldMeasurements(np.arange(4), seen(attitude) + FIELD[3:6], RATE, np.ones(4))


def seen(attitude, rate=RATE):
    """What the magnetometer reads without its hard iron, (K, 3): the field 50 ms ago, by axes that are off."""
    then = attitude * Rotation.from_rotvec(-FIELD[6] * rate)
    return then.inv().apply(FIELD[:3]) @ (np.eye(3) + MATRIX).T


def test_nothing_is_left_at_the_truth(attitude, measured):
    assert np.abs(compute_residuals(measured, attitude.as_matrix(), FIELD)).max() < 1e-12


def test_a_tilted_attitude_leaves_what_the_model_has_too_much(attitude, measured):
    tilted = attitude * Rotation.from_rotvec([0.01, 0.0, 0.0])
    wanted = seen(tilted) + FIELD[3:6] - measured.field_b_ut
    np.testing.assert_allclose(compute_residuals(measured, tilted.as_matrix(), FIELD), wanted, atol=1e-12)


def linearise(measured, attitude, field):
    """Return the linear factors of the measurements as gtsam's."""
    rows = linearise_measurements(measured, attitude.as_matrix(), field, PARAMS.sd_ut, PARAMS)
    unit = gtsam.noiseModel.Unit.Create(3)
    return [
        gtsam.JacobianFactor(int(x), part[:, :6], int(h), part[:, 6:22], part[:, 22], unit)
        for (x, h), part in zip(rows.keys.reshape(-1, 2), rows.data.reshape(-1, 3, 23), strict=True)
    ]


def test_jacobians_agree_with_central_differences(attitude, measured):
    """Near the truth the weights are 1, so the whitened Jacobian is the residual's over the scale."""
    made = linearise(measured, attitude, FIELD)
    h = 1e-6
    for k, factor in enumerate(made):
        assert list(factor.keys()) == [X(k), H(0)]
        matrix, target = factor.jacobian()
        np.testing.assert_allclose(target, 0.0, atol=1e-12)
        for axis in range(3):
            d = np.eye(3)[axis] * h
            moved = [
                compute_residuals(measured, (attitude * Rotation.from_rotvec(s * d)).as_matrix(), FIELD)
                for s in (1, -1)
            ]
            np.testing.assert_allclose(matrix[:, axis], (moved[0] - moved[1])[k] / (2 * h) / PARAMS.sd_ut, atol=1e-6)
        np.testing.assert_allclose(matrix[:, 3:6], 0.0)
        for axis in range(len(FIELD)):
            d = np.eye(len(FIELD))[axis] * h
            moved = [compute_residuals(measured, attitude.as_matrix(), FIELD + s * d) for s in (1, -1)]
            numeric = (moved[0] - moved[1])[k] / (2 * h) / PARAMS.sd_ut
            np.testing.assert_allclose(matrix[:, 6 + axis], numeric, atol=1e-6)


def test_one_step_goes_to_the_truth(attitude, measured):
    """The sign of the right side: from a field that is 0.01 uT off, a solve with the attitudes held leaves nothing.

    Four attitudes make 12 equations for 16 unknowns, so the field itself is theirs but for what a prior adds.
    """
    off = FIELD + np.array([0.01, 0.0, -0.01, 0.0, 0.01, 0.0, -1e-5, *np.full(9, 1e-5)])
    system = gtsam.GaussianFactorGraph()
    for factor in linearise(measured, attitude, off):
        system.push_back(factor)
    for k in range(4):
        system.push_back(gtsam.JacobianFactor(X(k), 1e6 * np.eye(6), np.zeros(6), gtsam.noiseModel.Unit.Create(6)))
    system.push_back(gtsam.JacobianFactor(H(0), 1e-3 * np.eye(16), np.zeros(16), gtsam.noiseModel.Unit.Create(16)))
    found = off + system.optimize().at(H(0))
    before, after = (np.abs(compute_residuals(measured, attitude.as_matrix(), field)).max() for field in (off, found))
    assert after < 1e-3 * before


def test_the_matrix_is_found_but_for_the_size_of_the_field():
    """From 60 known attitudes, in a few iterations; a common scale of all axes and the field's size are one thing."""
    attitudes = Rotation.random(60, rng=np.random.default_rng(5))
    measured = FieldMeasurements(
        np.arange(60), seen(attitudes, 0.0 * RATE[:1]) + FIELD[3:6], np.zeros((60, 3)), np.ones(60)
    )
    field = start_field(measured, quaternion(attitudes), np.zeros(3))
    for _ in range(6):
        system = gtsam.GaussianFactorGraph()
        for factor in linearise(measured, attitudes, field):
            system.push_back(factor)
        for k in range(60):
            held = gtsam.JacobianFactor(X(k), 1e6 * np.eye(6), np.zeros(6), gtsam.noiseModel.Unit.Create(6))
            system.push_back(held)
        prior = np.diag([1e-3] * 3 + [1e-3] * 3 + [1.0] + [1e-2] * 9)
        system.push_back(gtsam.JacobianFactor(H(0), prior, np.zeros(16), gtsam.noiseModel.Unit.Create(16)))
        field = field + system.optimize().at(H(0))
    found = field_matrix(field)
    np.testing.assert_allclose(found / np.cbrt(np.linalg.det(found)), UNIT_MATRIX, atol=1e-5)
    np.testing.assert_allclose(field[3:6], FIELD[3:6], atol=1e-4)


def test_a_magnet_loses_its_weight():
    """Geman-McClure: a half (of the root) where the residual is robust * scale, next to nothing at ten times that."""
    size = PARAMS.robust * PARAMS.sd_ut
    root = compute_weights(np.array([[0.0, 0.0, 0.0], [size, 0.0, 0.0], [0.0, 10 * size, 0.0]]), PARAMS.sd_ut, PARAMS)
    np.testing.assert_allclose(root, [1.0, 0.5, 1 / 101])


def test_the_scale_shrinks_to_its_end_and_stays():
    scale, small = 8 * PARAMS.sd_ut, np.zeros((5, 3))
    for _ in range(10):
        scale, before = shrink_scale(scale, small, PARAMS), scale
        assert scale <= before
    assert scale == PARAMS.sd_ut


def test_between_returns_a_measurement_counts_less_and_its_robust_weight_stays(attitude, measured):
    """Two rests hold the heading between them: there the sd is wider by the setting, elsewhere as before."""
    beside = measured.with_returns([1, 2], PARAMS)
    np.testing.assert_allclose(beside.widening, [1, PARAMS.widening_with_returns, PARAMS.widening_with_returns, 1])
    assert (measured.with_returns([1], PARAMS).widening == 1).all()
    made, wide = (
        linearise_measurements(some, attitude.as_matrix(), FIELD + 1.0, PARAMS.sd_ut, PARAMS)
        for some in (measured, beside)
    )
    rows = made.data.reshape(len(beside.widening), -1)
    np.testing.assert_allclose(wide.data.reshape(rows.shape), rows / beside.widening[:, None], rtol=1e-12)


def test_the_start_is_the_median_field_without_the_iron(attitude):
    """With neither delay nor matrix: these are for the graph to find."""
    at_rest = FieldMeasurements(np.arange(4), attitude.inv().apply(FIELD[:3]) + FIELD[3:6], 0 * RATE, np.ones(4))
    found = start_field(at_rest, quaternion(attitude), FIELD[3:6])
    np.testing.assert_allclose(found, [*FIELD[:6], *np.zeros(10)], atol=1e-9)


@pytest.mark.parametrize("azimuth_deg", [0.0, 4.0, -20.0])
def test_a_known_declination_fixes_the_horizontal_direction_only(azimuth_deg):
    """One sd along the field is 30 uT, across it is north by definition: a thousandth."""
    azimuth = np.deg2rad(azimuth_deg)
    prior = field_prior(FIELD, azimuth, True, PARAMS)
    level = np.hypot(FIELD[0], FIELD[1])
    values = gtsam.Values()
    pointing = np.array([np.sin(azimuth), np.cos(azimuth), 0.0])
    at = np.concatenate([level * pointing + [0, 0, FIELD[2]], FIELD[3:]])
    values.insert(H(0), at)
    assert prior.error(values) == pytest.approx(0.0, abs=1e-9)
    values.update(H(0), at + np.concatenate([PARAMS.field_sd_ut * pointing, np.zeros(len(FIELD) - 3)]))
    assert prior.error(values) == pytest.approx(0.5, rel=1e-6)
    across = np.array([pointing[1], -pointing[0], 0.0])
    values.update(H(0), at + np.concatenate([across, np.zeros(len(FIELD) - 3)]))
    assert prior.error(values) > 1e5


def draw_errors(sd_ut, time_s, count, seed=0):
    """Errors (count, 3) of the field, 0.5 s apart, that last for a correlation time."""
    share = np.exp(-PARAMS.step_s / time_s)
    noise = np.random.default_rng(seed).normal(0.0, sd_ut, (count, 3))
    return lfilter([np.sqrt(1 - share**2)], [1, -share], noise, axis=0)


def test_the_errors_that_are_measured_are_those_that_were_drawn():
    """A mean of many errors that last 2 s counts like one of errors with sqrt(2 x 2 s / 0.5 s) times their sd."""
    error_n = draw_errors(2.0, 2.0, 5000)
    attitude = Rotation.random(5000, rng=np.random.default_rng(1))
    found = measure_errors(attitude.as_matrix(), attitude.inv().apply(error_n), PARAMS)
    weight = 1 / (1 + np.sum(error_n**2, axis=1) / (PARAMS.robust * PARAMS.sd_ut) ** 2)
    assert found.size_ut.mean() == pytest.approx(np.sqrt(np.mean((weight[:, None] * error_n) ** 2)), rel=0.05)
    assert found.lasting == pytest.approx(np.sqrt(2 * 2.0 / PARAMS.step_s), rel=0.1)


def measure_drawn(sd_ut, time_s):
    """Return measurements, and what their errors are found to be."""
    error_n = draw_errors(sd_ut, time_s, 600)
    still = np.broadcast_to(np.eye(3), (600, 3, 3))
    given = FieldMeasurements(np.arange(600), error_n, error_n, np.ones(600))
    return given, measure_errors(still, error_n, PARAMS)


def test_errors_of_ordinary_rooms_change_nothing_of_the_estimate():
    """Real phones and BROAD trials, but for attached magnets, have errors of 1 to 2 uT that last for a second."""
    given, errors = measure_drawn(1.5, 1.0)
    counted = widen_by_errors(given, errors, PARAMS)
    np.testing.assert_array_equal(counted.widening, 1.0)
    hidden = errors.typical_ut * errors.lasting**2 / PARAMS.sd_ut
    np.testing.assert_array_equal(widen_for_covariance(counted, errors, PARAMS).widening, np.maximum(1.0, hidden))


def test_the_covariance_takes_errors_of_the_field_as_large_as_they_are():
    """Robust weights make errors of 5 uT a third smaller; in a mean of many they count with 5 sqrt(2 x 2 s / 0.5 s)."""
    given, errors = measure_drawn(5.0, 2.0)
    assert errors.size_ut.mean() < 4.0
    assert errors.typical_ut.mean() == pytest.approx(5.0, rel=0.1)
    counted = widen_for_covariance(widen_by_errors(given, errors, PARAMS), errors, PARAMS)
    assert np.median(counted.widening) * PARAMS.sd_ut > 5.0 * np.sqrt(2 * 2.0 / PARAMS.step_s)


def test_large_errors_that_last_take_weight_from_the_magnetometer():
    given, errors = measure_drawn(8.0, 4.0)
    counted = widen_by_errors(given, errors, PARAMS)
    assert np.median(counted.widening) * PARAMS.sd_ut > 8.0 * errors.lasting / 2
    assert (widen_for_covariance(counted, errors, PARAMS).widening >= 2 * counted.widening).all()


def test_errors_in_one_part_of_a_recording_leave_the_other_parts_as_they_are():
    error_n = draw_errors(8.0, 4.0, 600)
    error_n[200:] *= 0.05
    errors = measure_errors(np.broadcast_to(np.eye(3), (600, 3, 3)), error_n, PARAMS)
    given = FieldMeasurements(np.arange(600), error_n, error_n, np.ones(600))
    widening = widen_by_errors(given, errors, PARAMS).widening
    assert (widening[:180] > 1.0).all()
    np.testing.assert_array_equal(widening[221:], 1.0)
