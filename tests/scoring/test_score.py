"""Scores: what is counted, calibrated covariances, what cannot be scored, and figures of BROAD."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mahony import mahony
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from swings import as_reference, as_truth, broad, offline_vqf, swing

from stillpoint.datasets import BadParameter, BadRecording, Estimate, Unobservable
from stillpoint.datasets.frames import heading_rotation, quaternion, rotation, slerp
from stillpoint.scoring import compare, score
from stillpoint.scoring.score import CHI2_3_95


def test_every_moving_sample_is_scored_or_counted_as_left_out():
    t_ns, q_true = swing(3000)
    keep = np.ones(3000, dtype=bool)
    keep[:200] = keep[1000:1100] = keep[2900:] = False
    ready = np.arange(3000)[keep] >= 300
    estimate = Estimate(t_ns[keep], "gappy", q_nb=q_true[keep], ready=ready)
    moving = np.arange(3000) < 1500  # all that is left out but the last 100 lies there
    found = score(estimate, as_truth(t_ns, q_true, moving))
    assert (found.samples_outside, found.samples_in_gap, found.samples_unready) == (200, 100, 100)
    assert found.samples + 400 == moving.sum()
    assert found.moving_share == 0.5
    assert found.total_max_deg < 1e-10


def test_a_sample_counts_only_between_two_that_are_ready():
    """Also before an estimator that starts again: what lies between ready and unready is half a guess."""
    t_ns, q_true = swing(100)
    ready = np.arange(100) % 50 < 40
    between_ns = t_ns[:-1] + 3_000_000
    truth = as_truth(between_ns, slerp(t_ns, q_true, between_ns))
    found = score(Estimate(t_ns, "restarts", q_nb=q_true, ready=ready), truth)
    assert found.samples_unready == 21  # steps with an end in 40-49 or in 90-99


def test_a_covariance_is_read_between_its_neighbours_by_time():
    t_ns, q_nb = swing(200)
    at_ns = t_ns[:-1] + 2_500_000
    cov = (1.0 + np.arange(200.0))[:, None, None] * np.diag([1e-4, 2e-4, 3e-4])
    estimate = Estimate(t_ns, "e", q_nb=q_nb, cov_b_rad2=cov)
    series = compare(estimate, as_truth(at_ns, slerp(t_ns, q_nb, at_ns)), "none")
    np.testing.assert_allclose(series.cov_b_rad2[:, 1, 1], 2e-4 * (1.25 + np.arange(199)), rtol=1e-12)


def test_estimate_is_interpolated_along_the_great_circle():
    t_ns, q_nb = swing(300)
    mid_ns = t_ns[:-1] + 5_000_000
    found = score(Estimate(t_ns, "e", q_nb=q_nb), as_truth(mid_ns, slerp(t_ns, q_nb, mid_ns)), "none")
    assert found.samples == 299
    assert found.total_max_deg < 1e-10


def test_rests_of_a_reference_do_not_count_and_its_sd_is_said():
    t_ns, q_nb = swing(1000)
    sd_rad = np.where(np.arange(1000) < 600, 0.1, 0.01)[:, None, None]  # the larger one at rest, where it is not asked
    rests_ns = np.array([[t_ns[0], t_ns[599]], [t_ns[900], t_ns[999]]])
    reference = as_reference(t_ns, q_nb, sd_rad, rests_ns=rests_ns)
    found = score(Estimate(t_ns, "e", q_nb=q_nb, recording="run"), reference)
    assert found.samples == 300
    assert found.reference_sd_deg == pytest.approx(np.rad2deg(np.sqrt(3) * 0.01))
    assert found.against == "reference (redistribution)"
    assert score(reference, as_truth(t_ns, q_nb)).reference_sd_deg is None


def test_figures_are_those_of_a_constant_error():
    """A tilt of 3 deg about the body's roll axis, level: every figure is known."""
    t_ns = np.arange(100) * 10_000_000
    q_true = quaternion(Rotation.from_euler("z", np.linspace(0, 1, 100)[:, None]))
    q_est = quaternion(rotation(q_true) * Rotation.from_euler("x", np.full((100, 1), 3.0), degrees=True))
    found = score(Estimate(t_ns, "e", q_nb=q_est), as_truth(t_ns, q_true), "none", "enu")
    for name in ("rmse", "max", "mean", "p50", "p95", "p99"):
        assert getattr(found, f"total_{name}_deg") == pytest.approx(3.0)
        assert getattr(found, f"inclination_{name}_deg") == pytest.approx(3.0)
        assert getattr(found, f"heading_{name}_deg") == pytest.approx(0.0, abs=1e-9)
    assert found.roll_mean_deg == pytest.approx(3.0)
    assert found.roll_maxae_deg == pytest.approx(3.0)
    assert found.total_variance_deg2 == pytest.approx(0.0, abs=1e-9)
    assert found.yaw_maxae_deg == pytest.approx(0.0, abs=1e-9)


def test_figures_are_those_of_an_error_that_grows_evenly():
    """A heading that runs off clockwise to 10 deg: mean, percentiles and variance of an even spread, with its sign."""
    t_ns = np.arange(1001) * 10_000_000
    off_deg = -np.linspace(0, 10, 1001)
    q_true = np.tile([1.0, 0, 0, 0], (1001, 1))
    q_est = quaternion(Rotation.from_euler("z", off_deg[:, None], degrees=True))
    found = score(Estimate(t_ns, "e", q_nb=q_est), as_truth(t_ns, q_true), "none", "enu")
    for part in ("total", "heading"):
        figures = [getattr(found, f"{part}_{name}_deg") for name in ("p50", "mean", "p95", "p99", "max")]
        assert figures == pytest.approx([5.0, 5.0, 9.5, 9.9, 10.0])
        assert getattr(found, f"{part}_variance_deg2") == pytest.approx(100 / 12 * 1002 / 1000)
    assert (found.yaw_mean_deg, found.yaw_maxae_deg) == pytest.approx((-5.0, 10.0))
    assert found.yaw_variance_deg2 == pytest.approx(100 / 12 * 1002 / 1000)
    assert found.yaw_rmse_deg == pytest.approx(np.sqrt(np.mean(off_deg**2)))


def test_what_pitches_beyond_80_deg_is_the_truth_and_not_the_estimate():
    t_ns = np.arange(100) * 10_000_000
    pitch_deg = np.where(np.arange(100) < 30, 85.0, 20.0)
    q_true = quaternion(Rotation.from_euler("y", pitch_deg[:, None], degrees=True))
    upright = np.tile([1.0, 0, 0, 0], (100, 1))
    found = score(Estimate(t_ns, "e", q_nb=upright), as_truth(t_ns, q_true), "none", "enu")
    assert found.near_gimbal_share == 0.3


@pytest.mark.parametrize(("scale", "calibrated"), [(1.0, True), (2.0, False), (0.5, False)])
def test_nees_and_coverage_judge_a_covariance(scale, calibrated):
    """Errors drawn from the stated covariance, seen through a mounting of 60 deg: in the chi-square band, else out."""
    rng = np.random.default_rng(3)
    t_ns, q_true = swing(4000)
    root = np.array([[0.02, 0, 0], [0.005, 0.004, 0], [0.0, 0.003, 0.01]])
    d_rad = scale * rng.normal(size=(len(t_ns), 3)) @ root.T
    mounting = Rotation.from_rotvec([0.0, 0.6, -0.9])
    # q_true * M = q_est * exp(d), d in the estimate's body
    q_est = quaternion(rotation(q_true) * mounting * Rotation.from_rotvec(d_rad).inv())
    cov = np.tile(root @ root.T, (len(t_ns), 1, 1))
    found = score(Estimate(t_ns, "e", q_nb=q_est, cov_b_rad2=cov), as_truth(t_ns, q_true), "heading+mounting")
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 3 * 4000) / (3 * 4000)
    assert (low < found.nees_per_dof < high) == calibrated
    assert (0.94 < found.coverage95 < 0.96) == calibrated


def test_coverage_counts_up_to_the_95_percent_point_of_chi_square():
    assert pytest.approx(chi2.ppf(0.95, 3), rel=1e-14) == CHI2_3_95


def test_an_invalid_covariance_is_reported_and_not_judged():
    """Correlated by more than 1: d' C^-1 d could be negative, and would count as covered."""
    t_ns, q_nb = swing(100)
    cov = np.tile(np.eye(3), (100, 1, 1))
    cov[70:, 0, 1] = cov[70:, 1, 0] = 1.5
    estimate = Estimate(t_ns, "mine", q_nb=q_nb, cov_b_rad2=cov, recording="run7")
    with pytest.raises(
        BadRecording, match="mine of run7: its covariance is not positive definite at 30 of 100 samples"
    ):
        score(estimate, as_truth(t_ns, q_nb))


def test_an_estimate_without_covariance_has_no_consistency():
    t_ns, q_nb = swing(100)
    found = score(Estimate(t_ns, "e", q_nb=q_nb), as_truth(t_ns, q_nb))
    assert found.nees_per_dof is None
    assert found.coverage95 is None


def test_comparison_carries_the_series_of_the_score():
    t_ns, q_true = swing(500)
    q_est = quaternion(heading_rotation(0.5) * rotation(q_true))
    series = compare(Estimate(t_ns, "e", q_nb=q_est), as_truth(t_ns, q_true))
    assert series.alignment.heading_rad == pytest.approx(0.5)
    assert np.abs(series.q_est - series.q_true).max() < 1e-12
    with pytest.raises(dataclasses.FrozenInstanceError):
        series.recording = "other"


def test_shared_heading_error_counts_where_heading_was_not_aligned():
    """An error of one sd about up, and nothing else: d' C^-1 d = 1. Aligned away, nothing is left of it to count."""
    t_ns, q_true = swing()
    turned = quaternion(heading_rotation(0.05) * rotation(q_true))
    made = as_reference(t_ns, turned, sd_rad=1e-5, heading_sd_rad=0.05)
    assert score(made, as_truth(t_ns, q_true), align="none").nees_per_dof == pytest.approx(1 / 3, rel=1e-6)
    aligned = compare(made, as_truth(t_ns, q_true), align="heading")
    assert np.abs(aligned.cov_b_rad2 - made.cov_b_rad2).max() < 1e-20


@given(st.floats(-0.3, 0.3), st.floats(0, 0.2))
def test_shared_heading_variance_is_about_up_alone(tilt, sd_rad):
    t_ns, q_true = swing(200)
    q_nb = quaternion(Rotation.from_rotvec([tilt, 0, 0]) * rotation(q_true))
    made = as_reference(t_ns, q_nb, heading_sd_rad=sd_rad)
    more_b = compare(made, as_truth(t_ns, q_true), align="none").cov_b_rad2 - made.cov_b_rad2
    turn = rotation(q_nb).as_matrix()
    more_n = turn @ more_b @ turn.transpose(0, 2, 1)
    np.testing.assert_allclose(more_n, np.tile(np.diag([0, 0, sd_rad**2]), (200, 1, 1)), atol=1e-15)


# --- what cannot be scored


def test_no_overlap_is_said_with_its_reason():
    t_ns, q_nb = swing(100)
    estimate = Estimate(t_ns + 10**12, "vqf", q_nb=q_nb, recording="run7")
    with pytest.raises(Unobservable, match=r"vqf of run7.*none of the 100 moving samples.*100 outside its span"):
        score(estimate, as_truth(t_ns, q_nb))


def test_a_truth_without_motion_is_refused():
    t_ns, q_nb = swing(100)
    with pytest.raises(Unobservable, match="no sample of it moves"):
        score(Estimate(t_ns, "e", q_nb=q_nb), as_truth(t_ns, q_nb, np.zeros(100, dtype=bool)))


def test_too_little_overlap_for_the_clock_is_said():
    t_ns, q_nb = swing(15)
    with pytest.raises(Unobservable, match="too little to align the clocks"):
        score(Estimate(t_ns, "e", q_nb=q_nb), as_truth(t_ns, q_nb), "heading+mounting+time")


def test_wrong_options_are_named():
    t_ns, q_nb = swing(100)
    estimate, truth = Estimate(t_ns, "e", q_nb=q_nb), as_truth(t_ns, q_nb)
    with pytest.raises(BadParameter, match="heading\\+mounting\\+time"):
        score(estimate, truth, "yaw")
    with pytest.raises(BadParameter, match="nwu"):
        score(estimate, truth, frame="xyz")
    with pytest.raises(BadParameter, match="moving"):
        score(estimate, truth, moving=np.ones(3, dtype=bool))
    with pytest.raises(BadRecording, match="angle about one axis"):
        score(Estimate(t_ns, "roll", angle_rad=np.zeros(100)), truth)


def test_input_arrays_are_left_alone():
    t_ns, q_nb = swing(400)
    before = q_nb.copy()
    score(Estimate(t_ns, "e", q_nb=q_nb), as_truth(t_ns, q_nb), "heading+mounting+time")
    assert (q_nb == before).all()


# --- BROAD


@pytest.mark.parametrize(
    ("trial", "total", "heading", "inclination"),
    [("02", 0.441, 0.312, 0.312), ("10", 0.440, 0.363, 0.249), ("33", 1.280, 1.219, 0.392)],
)
def test_scores_of_offline_vqf_equal_an_independent_program(data_dir, trial, total, heading, inclination):
    """The figures of BROAD's own definition with one heading removed, by an independent program."""
    found = score(*broad(data_dir, trial, offline_vqf))
    assert found.total_rmse_deg == pytest.approx(total, abs=1e-3)
    assert found.heading_rmse_deg == pytest.approx(heading, abs=1e-3)
    assert found.inclination_rmse_deg == pytest.approx(inclination, abs=1e-3)


@pytest.mark.parametrize(
    ("trial", "total", "heading", "inclination"),
    [
        ("02", 2.9662, 2.8909, 0.6642),
        ("04", 5.3655, 5.1415, 1.5347),
        ("10", 2.7642, 1.4962, 2.3243),
        ("21", 12.4438, 9.6489, 7.8675),
    ],
)
def test_scores_of_mahony_equal_those_that_broad_publishes(data_dir, trial, total, heading, inclination):
    """Mahony's filter with the gains of their TAGP (results_mahony_average_rmse.json); nothing is aligned."""

    def tagp(gyro_b_radps, accel_b_mps2, mag_b_ut, rate_hz):
        return mahony(gyro_b_radps, accel_b_mps2, mag_b_ut, rate_hz, kp_per_s=0.74, ki_per_s2=0.0012)

    found = score(*broad(data_dir, trial, tagp), align="none")
    assert found.total_rmse_deg == pytest.approx(total, abs=3e-4)
    assert found.heading_rmse_deg == pytest.approx(heading, abs=3e-4)
    assert found.inclination_rmse_deg == pytest.approx(inclination, abs=3e-4)
