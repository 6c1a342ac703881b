"""The calibrating graph on simulated phones: what it must give whatever the axes, the time and the sensor."""

import json
from dataclasses import astuple, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from known_motion import later, rotated_body
from scipy.spatial.transform import Rotation

from stillpoint.datasets.frames import quaternion, rotation
from stillpoint.datasets.simulate import PERFECT, PHONE, simulate
from stillpoint.datasets.trajectory import CONVENTION
from stillpoint.scoring import score
from stillpoint.smoother import reference
from stillpoint.smoother.attitude.covariance import Factors, choose_factors, compute_bending, scale_covariances
from stillpoint.smoother.attitude.keys import Keys
from stillpoint.smoother.attitude.params import HANDHELD

SHORT = 1.6  # minutes: a rest of a minute, one swing and the return


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["phone-2", "phone-3"])
def test_a_perfect_sensor_gives_the_truth(kind):
    """Within 0.1 deg: the simulated hand finds the base pose to 0.2 deg, and the graph believes in it to 0.4 deg."""
    recording = simulate(kind, seed=1, minutes=SHORT, sensor=PERFECT)
    found = score(reference(recording), recording.truth, "none")
    assert found.total_max_deg < 0.2
    assert found.total_rmse_deg < 0.1


@pytest.mark.slow
@settings(max_examples=4, deadline=None)
@given(vector=st.tuples(*[st.floats(-3.0, 3.0)] * 3))
def test_turned_sensor_axes_turn_the_answer(hand, of_hand, vector):
    """No axis is special; what is left is where the iterations stop (0.02 deg a step, quadratic)."""
    turn = Rotation.from_rotvec(vector)
    turned = reference(rotated_body(hand, turn))
    difference = (rotation(of_hand.q_nb).inv() * rotation(turned.q_nb) * turn).magnitude()
    assert np.rad2deg(difference.max()) < 1e-3
    axes = turn.as_matrix()
    np.testing.assert_allclose(axes @ of_hand.cov_b_rad2 @ axes.T, turned.cov_b_rad2, rtol=1e-3, atol=1e-9)


@pytest.mark.slow
def test_another_time_gives_the_same_bits(hand, of_hand):
    shifted = reference(later(hand, 86_400_000_000_001))
    np.testing.assert_array_equal(shifted.q_nb, of_hand.q_nb)
    np.testing.assert_array_equal(shifted.cov_b_rad2, of_hand.cov_b_rad2)


@pytest.mark.slow
def test_recovered_calibration_is_the_drawn_one_within_its_sd():
    """4 sd over 18 elements, and 1.5 in the mean; without g-sensitivity, which the graph does not model."""
    sensor = replace(PHONE, gyro=replace(PHONE.gyro, g_sensitivity_degps_g=0.0))
    recording = simulate("phone-3", seed=4, minutes=2.2, sensor=sensor)
    found = reference(recording).calibration
    drawn = json.loads(recording.info.extra["sensor_drawn"])
    for name in ("gyro", "accel"):
        matrix, sd = getattr(found, f"{name}_matrix"), getattr(found, f"{name}_matrix_sd")
        off_sd = (matrix - np.linalg.inv(drawn[name]["response"])) / sd
        assert np.abs(off_sd).max() < 4, name
        assert np.sqrt(np.mean(off_sd**2)) < 1.5, name


def test_the_graph_recovers_bias_and_hard_iron(hand, of_hand):
    """The bias to what a phone's wanders by (10 deg/h) and its g-sensitivity adds (0.01 deg/s); the iron to 1 uT."""
    drawn = json.loads(hand.info.extra["sensor_drawn"])
    off_degps = np.rad2deg(of_hand.gyro_bias_b_radps - drawn["gyro"]["bias"])
    assert np.abs(off_degps).max() < 0.06
    assert np.abs(drawn["gyro"]["bias"]).max() > np.deg2rad(0.05)
    assert np.abs(of_hand.calibration.hard_iron_b_ut - drawn["mag"]["bias"]).max() < 1.5


@pytest.mark.slow
def test_soft_iron_is_found(hand):
    """A field bent by 6 %, and a prior that allows it: the matrix that is found takes most of it off again.

    In 1.6 minutes of a hand some of it stays with the hard iron; with the wrong sign it would be more than all.
    """
    bent = np.eye(3) + np.array([[0.06, 0.04, 0.0], [0.04, -0.06, 0.0], [0.0, 0.0, 0.0]])
    spoiled = replace(hand, mag=replace(hand.mag, mag_b_ut=hand.mag.mag_b_ut @ bent.T))
    loose = {"magnetic.matrix_sd": 0.1}
    before, found = (reference(each, params=loose).calibration.mag_matrix for each in (hand, spoiled))
    left = np.linalg.norm(found @ bent - before)
    assert left < 0.5 * np.linalg.norm(bent - np.eye(3))


@pytest.mark.slow
def test_a_late_accelerometer_is_found_with_its_sign():
    """30 ms early and late, within 2.5 of the sd that is said.

    A late accelerometer moves every swing of gravity a little, which the same motion a little later explains too: half
    a minute in the hand tells it to some 15 ms, and between that and the prior's 20 ms the answer lies.
    """
    offsets = []
    for lag_s in (-0.03, 0.03):
        sensor = replace(PHONE, accel=replace(PHONE.accel, lag_s=lag_s))
        made = reference(simulate("phone-3", seed=1, minutes=SHORT, sensor=sensor))
        offsets.append(made.calibration.clock_offset_s["accel"])
        assert abs(offsets[-1] - lag_s) < 2.5 * made.diagnostics["accel_late_sd_s"]
        assert 0.005 < made.diagnostics["accel_late_sd_s"] < 0.025
    assert offsets[0] < 0 < offsets[1]
    assert 0.01 < offsets[1] - offsets[0] < 0.08


@pytest.mark.slow
def test_turning_about_the_vertical_only_leaves_the_field_its_size():
    """There hard iron and field are one in the vertical: without a word on the earth's field it became 166 uT."""
    field_n_ut = reference(simulate("phone-1", seed=1, minutes=SHORT)).calibration.field_n_ut
    assert 35 < np.linalg.norm(field_n_ut) < 60


def test_diagnostics_report_what_was_found(of_hand):
    said = of_hand.diagnostics
    json.dumps(said)
    assert said["convention"] == CONVENTION
    assert {"imu", "imu at rest", "bias walk", "rests, returns and gaps"} <= set(said["residuals"])
    assert 0 < said["residuals"]["imu"] < 0.01
    assert said["field_inlier_share"] > 0.95
    assert said["iterations"] >= 1
    assert said["cost"] > 0
    assert len(of_hand.rests_ns) >= 2
    assert [each.accepted for each in of_hand.returns] == [True] * len(of_hand.returns) != []


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["phone-1", "phone-2", "phone-3"])
def test_the_covariance_is_neither_boast_nor_excuse(kind):
    """Mean NEES/3 of two seeds; over 30 seeds it is 0.96, 0.96 and 0.92, single seeds lie between 0.1 and 3."""
    recordings = [simulate(kind, seed=seed, minutes=2.0) for seed in (0, 1)]
    scores = [score(reference(each), each.truth, "heading") for each in recordings]
    assert 0.1 < np.mean([each.nees_per_dof for each in scores]) < 3.0
    assert np.mean([each.coverage95 for each in scores]) > 0.75


def test_many_returns_count_as_six() -> None:
    """Over hours the returns would scale the heading's variance to nothing, while repeated errors stay."""
    many, six = choose_factors([0.06] * 900, True, 0.0, HANDHELD), choose_factors([0.06] * 6, True, 0.0, HANDHELD)
    assert many.heading == pytest.approx(six.heading)
    usual = HANDHELD.heading_variance_factor
    assert choose_factors([], True, 0.0, HANDHELD).heading == HANDHELD.variance_factor  # the field needs no factor
    assert (
        choose_factors([4.0] * 3, True, 0.0, HANDHELD).heading
        > usual
        > choose_factors([0.01] * 3, True, 0.0, HANDHELD).heading
    )
    for count in (1, 3, 50):  # returns that close as usual confirm the usual factor
        assert choose_factors([usual] * count, True, 0.0, HANDHELD).heading == pytest.approx(usual)
    assert choose_factors([], False, 0.0, HANDHELD).tilt == HANDHELD.variance_factor
    assert min(astuple(choose_factors([0.01] * 3, True, 1.0, HANDHELD))) == 1.0  # as in recordings with gaps


def test_scaled_covariances_scale_tilt_and_heading_by_themselves() -> None:
    """Upright and upside down, on its side: the variance about up by one factor, about level axes by the other."""
    attitudes = Rotation.from_euler("ZYX", [[0.3, 0, 0], [1.0, np.pi, 0], [2.0, 0.4, np.pi / 2]])
    up_b = attitudes.as_matrix()[:, 2]
    scaled = scale_covariances(np.tile(np.eye(3), (3, 1, 1)), quaternion(attitudes), Factors(0.5, 0.2, 1.0))
    np.testing.assert_allclose(np.einsum("ni,nij,nj->n", up_b, scaled, up_b), 0.2, atol=1e-12)
    np.testing.assert_allclose(np.trace(scaled, axis1=1, axis2=2), 1.2, atol=1e-12)


def test_a_body_that_turns_over_bends_and_one_that_stays_upright_does_not() -> None:
    """Gravity on one side, then on the other: g times the setting about the axes across it, none about itself."""
    g, rows = 9.81, np.arange(5)
    still = Keys(
        row=rows,
        t_s=rows.astype(float),
        at_rest=np.zeros(4, dtype=bool),
        gap=np.zeros(4, dtype=bool),
        gyro_clipped_rad=np.zeros((4, 3)),
        accel_clipped_mps=np.zeros((4, 3)),
        gyro_sampling_rad=np.zeros((4, 3)),
        gyro_b_radps=np.zeros((4, 3)),
        accel_b_mps2=np.tile([0.0, 0.0, g], (4, 1)),
        jerk_b_mps3=np.zeros((4, 3)),
        rate_rms_radps=np.zeros(4),
    )
    expected = (HANDHELD.bending_rad_per_mps2 * g) ** 2 * np.diag([1.0, 1.0, 0.0])
    each, mean = compute_bending(still, HANDHELD)
    np.testing.assert_allclose(each, 0.0, atol=1e-20)
    np.testing.assert_allclose(mean, expected, atol=1e-18)
    turned = replace(still, accel_b_mps2=np.array([[0, 0, g], [0, 0, -g]] * 2))
    each, mean = compute_bending(turned, HANDHELD)
    np.testing.assert_allclose(each, np.tile(expected, (4, 1, 1)), atol=1e-18)
    np.testing.assert_allclose(mean, 0.0, atol=1e-20)
