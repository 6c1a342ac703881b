"""Errors, alignment and scores: identities, planted differences, calibrated covariances, and BROAD's own figures."""

import dataclasses

import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from stillpoint.datasets import BadParameter, BadRecording, Estimate, Reference, Truth, Unobservable
from stillpoint.datasets.frames import heading_rotation, quaternion, rotation, slerp
from stillpoint.datasets.importers.table import IMPORTERS
from stillpoint.datasets.recording import rate_hz
from stillpoint.filters import estimate as run_estimator
from stillpoint.scoring import ALIGN_KINDS, compare, score
from stillpoint.scoring.errors import attitude_error, euler_error, heading_offset, rotation_error_b

angles = st.floats(-np.pi, np.pi)
attitudes = st.builds(lambda a, b, c: quaternion(Rotation.from_euler("ZYX", [[a, b, c]])), angles, angles, angles)


def swing(n=3000, rate_hz=100.0, late_s=0.0):
    """Stamps and an attitude that turns about all axes, with its exact value at ``t - late_s``."""
    t_ns = np.round(np.arange(n) / rate_hz * 1e9).astype(np.int64)
    t_s = t_ns / 1e9 - late_s
    zyx = np.stack([1.5 * np.sin(0.9 * t_s), 0.8 * np.sin(2.1 * t_s + 1), 1.2 * np.cos(1.7 * t_s)], axis=1)
    return t_ns, quaternion(Rotation.from_euler("ZYX", zyx))


def as_truth(t_ns, q_nb, moving=None):
    return Truth(t_ns, q_nb, np.ones(len(t_ns), dtype=bool) if moving is None else moving)


def as_reference(t_ns, q_nb, sd_rad=0.01, **more):
    cov = np.tile(np.eye(3) * sd_rad**2, (len(t_ns), 1, 1))
    return Reference(t_ns, q_nb, cov, np.zeros((len(t_ns), 3)), "redistribution", name="run", **more)


# --- errors


@given(attitudes)
def test_error_with_itself_is_zero(q):
    error = attitude_error(q, -q)
    for name in ("total_rad", "heading_rad", "inclination_rad"):
        assert getattr(error, name) < 1e-14
    assert np.abs(rotation_error_b(q, q)).max() < 1e-14


@given(attitudes, st.floats(-3.1, 3.1))
def test_pure_yaw_is_all_heading(q, yaw):
    turned = quaternion(heading_rotation(yaw) * rotation(q))
    error = attitude_error(turned, q)
    assert error.heading_rad == pytest.approx(abs(yaw), abs=1e-12)
    assert error.total_rad == pytest.approx(abs(yaw), abs=1e-12)
    assert error.inclination_rad < 1e-12
    assert heading_offset(turned, q) == pytest.approx(yaw, abs=1e-12)


@given(attitudes, st.floats(-np.pi, np.pi), st.floats(0, 3.1))
def test_pure_tilt_is_all_inclination(q, azimuth, tilt):
    axis = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    error = attitude_error(quaternion(Rotation.from_rotvec(axis * tilt) * rotation(q)), q)
    assert error.inclination_rad == pytest.approx(tilt, abs=1e-12)
    assert error.heading_rad < 1e-12


@given(attitudes, attitudes)
def test_split_is_a_right_spherical_triangle(p, q):
    """cos(total / 2) = cos(heading / 2) cos(inclination / 2): the two parts make up the whole."""
    error = attitude_error(p, q)
    parts = np.cos(error.heading_rad / 2) * np.cos(error.inclination_rad / 2)
    assert np.cos(error.total_rad / 2) == pytest.approx(parts, abs=1e-12)


def test_small_errors_keep_their_digits():
    """2 acos|w| would give 0 or 2e-8 for 1e-9 rad."""
    q = quaternion(Rotation.from_euler("ZYX", [[0.3, -0.7, 2.0]]))
    turned = quaternion(Rotation.from_rotvec([0.0, 3e-10, 4e-10]) * rotation(q))
    error = attitude_error(turned, q)
    assert error.total_rad == pytest.approx(5e-10, rel=1e-5)
    assert error.heading_rad == pytest.approx(4e-10, rel=1e-5)
    assert error.inclination_rad == pytest.approx(3e-10, rel=1e-5)


@pytest.mark.parametrize(("frame", "sign"), [("enu", 1), ("nwu", -1), ("ned", -1)])
def test_euler_yaw_error_wraps_and_has_its_frame_s_sign(frame, sign):
    """From 179 to -179 deg of counter-clockwise heading are 2 deg, not 358; nwu and ned count clockwise."""
    level = np.array([[1.0, 0, 0, 0]]) if frame != "ned" else quaternion(Rotation.from_euler("x", [[np.pi]]))
    before = quaternion(heading_rotation(np.deg2rad(179)) * rotation(level))
    after = quaternion(heading_rotation(np.deg2rad(181)) * rotation(level))
    assert np.rad2deg(euler_error(after, before, frame))[0] == pytest.approx([0, 0, 2 * sign], abs=1e-9)


# --- alignment

planted = st.tuples(
    st.floats(-3.14, 3.14),
    st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)),
    st.floats(-0.45, 0.45),
)


@settings(max_examples=12)
@given(planted)
def test_alignment_finds_what_was_planted(differences):
    """Any heading, mountings up to 30 deg, any clock within +-0.45 s: as far as slerp at 100 Hz follows the path."""
    heading, mounting, late_s = differences
    t_ns, q_true = swing()
    _, q_late = swing(late_s=late_s)
    q_est = quaternion(heading_rotation(heading) * rotation(q_late) * Rotation.from_rotvec(mounting))
    found = score(Estimate(t_ns, "planted", q_nb=q_est), as_truth(t_ns, q_true), "heading+mounting+time")
    assert found.alignment.time_offset_s == pytest.approx(late_s, abs=1e-5)
    assert found.alignment.heading_rad == pytest.approx(heading, abs=1e-4)
    assert found.alignment.mounting_rotvec_rad == pytest.approx(np.array(mounting), abs=1e-4)
    assert found.total_max_deg < 0.02


@given(st.floats(-3.14, 3.14), attitudes)
def test_any_mounting_at_all_is_found(heading, mounting):
    """The optimum is global: a sensor mounted upside down is no harder than one mounted straight."""
    t_ns, q_true = swing(600)
    q_est = quaternion(heading_rotation(heading) * rotation(q_true) * rotation(mounting))
    found = score(Estimate(t_ns, "planted", q_nb=q_est), as_truth(t_ns, q_true), "heading+mounting")
    assert found.total_max_deg < 1e-5


@given(planted)
@settings(max_examples=10)
def test_score_does_not_change_under_the_group_that_is_aligned(differences):
    heading, mounting, _ = differences
    t_ns, q_true = swing(1500)
    noise = np.random.default_rng(0).normal(scale=0.03, size=(len(t_ns), 3))
    q_est = rotation(q_true) * Rotation.from_rotvec(noise)
    turned = heading_rotation(heading) * q_est
    mounted = turned * Rotation.from_rotvec(mounting)
    for kind, other in (("heading", turned), ("heading+mounting", mounted)):
        plain = score(Estimate(t_ns, "a", q_nb=quaternion(q_est)), as_truth(t_ns, q_true), kind)
        moved = score(Estimate(t_ns, "b", q_nb=quaternion(other)), as_truth(t_ns, q_true), kind)
        for name in ("total_rmse_deg", "heading_rmse_deg", "inclination_max_deg"):
            assert getattr(moved, name) == pytest.approx(getattr(plain, name), rel=1e-6)


def test_noise_does_not_draw_the_clock_to_half_a_sample():
    """Interpolation averages noise, so the smallest misfit lies 5 ms aside; the offset must not."""
    t_ns, q_true = swing(6000)
    noise = np.random.default_rng(1).normal(scale=0.01, size=(len(t_ns), 3))
    estimate = Estimate(t_ns, "noisy", q_nb=quaternion(rotation(q_true) * Rotation.from_rotvec(noise)))
    found = score(estimate, as_truth(t_ns, q_true), "heading+mounting+time")
    assert abs(found.alignment.time_offset_s) < 1e-3


def test_drift_does_not_pull_the_clock():
    """A heading that runs away by 5 deg/s hides every attitude, but not when the sensor turned."""
    t_ns, q_true = swing(6000)
    _, q_late = swing(6000, late_s=0.0217)
    drift = Rotation.from_rotvec(np.deg2rad(5.0) * (t_ns / 1e9)[:, None] * [0.0, 0.0, 1.0])
    estimate = Estimate(t_ns, "drifting", q_nb=quaternion(drift * rotation(q_late)))
    found = score(estimate, as_truth(t_ns, q_true), "heading+mounting+time")
    assert found.alignment.time_offset_s == pytest.approx(0.0217, abs=5e-4)
    assert found.total_rmse_deg > 50


def test_gaps_in_the_truth_do_not_pull_the_clock():
    t_ns, q_true = swing(6000)
    _, q_late = swing(6000, late_s=-0.0083)
    keep = np.ones(6000, dtype=bool)
    for start in np.random.default_rng(4).integers(0, 5900, 25):
        keep[start : start + 60] = False
    found = score(Estimate(t_ns, "e", q_nb=q_late), as_truth(t_ns[keep], q_true[keep]), "heading+mounting+time")
    assert found.alignment.time_offset_s == pytest.approx(-0.0083, abs=2e-5)


def test_clock_beyond_the_range_is_marked():
    t_ns, q_true = swing(3000)
    _, q_late = swing(3000, late_s=0.7)
    found = score(Estimate(t_ns, "e", q_nb=q_late), as_truth(t_ns, q_true), "heading+mounting+time").alignment
    assert found.time_at_limit
    assert not score(Estimate(t_ns, "e", q_nb=q_true), as_truth(t_ns, q_true)).alignment.time_at_limit


def test_more_freedom_never_fits_worse():
    t_ns, q_true = swing(2000)
    rng = np.random.default_rng(2)
    drift = np.cumsum(rng.normal(scale=2e-3, size=(len(t_ns), 3)), axis=0)
    q_est = heading_rotation(0.4) * rotation(q_true) * Rotation.from_rotvec(drift) * Rotation.from_rotvec([0.1, 0, 0.2])
    estimate = Estimate(t_ns, "drifting", q_nb=quaternion(q_est))
    errors = [score(estimate, as_truth(t_ns, q_true), kind).total_rmse_deg for kind in ALIGN_KINDS[:3]]
    assert errors[0] > errors[1] > errors[2]


def test_level_turns_leave_heading_and_mounting_as_one_angle():
    """Rotation about the vertical alone cannot tell them apart: the mounting stays 0 and the heading takes it all."""
    t_ns = np.arange(500) * 10_000_000
    q_true = quaternion(Rotation.from_euler("z", np.linspace(0, 9, 500)[:, None]))
    q_est = quaternion(heading_rotation(0.7) * rotation(q_true))
    found = score(Estimate(t_ns, "level", q_nb=q_est), as_truth(t_ns, q_true), "heading+mounting")
    assert found.total_max_deg < 1e-5
    assert np.abs(found.alignment.mounting_rotvec_rad).max() < 1e-4
    assert found.alignment.heading_rad == pytest.approx(0.7, abs=1e-4)


# --- what is counted


def test_every_moving_sample_is_scored_or_counted_as_left_out():
    t_ns, q_true = swing(3000)
    keep = np.ones(3000, dtype=bool)
    keep[:200] = keep[1000:1100] = keep[2900:] = False
    ready = np.arange(3000)[keep] >= 300
    estimate = Estimate(t_ns[keep], "gappy", q_nb=q_true[keep], ready=ready)
    moving = np.arange(3000) % 2 == 0
    found = score(estimate, as_truth(t_ns, q_true, moving))
    assert (found.samples_outside, found.samples_in_gap, found.samples_unready) == (150, 50, 50)
    assert found.samples + 250 == moving.sum()
    assert found.moving_share == 0.5
    assert found.total_max_deg < 1e-10


def test_estimate_is_interpolated_along_the_great_circle():
    t_ns, q_nb = swing(300)
    mid_ns = t_ns[:-1] + 5_000_000
    found = score(Estimate(t_ns, "e", q_nb=q_nb), as_truth(mid_ns, slerp(t_ns, q_nb, mid_ns)), "none")
    assert found.samples == 299
    assert found.total_max_deg < 1e-10


def test_rests_of_a_reference_do_not_count_and_its_sd_is_said():
    t_ns, q_nb = swing(1000)
    reference = as_reference(t_ns, q_nb, sd_rad=0.01, rests_ns=np.array([[t_ns[0], t_ns[99]], [t_ns[900], t_ns[999]]]))
    found = score(Estimate(t_ns, "e", q_nb=q_nb, recording="run"), reference)
    assert found.samples == 800
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


def test_no_covariance_no_consistency():
    t_ns, q_nb = swing(100)
    found = score(Estimate(t_ns, "e", q_nb=q_nb), as_truth(t_ns, q_nb))
    assert found.nees_per_dof is None
    assert found.coverage95 is None


# --- what cannot be scored


def test_no_overlap_is_said_with_its_reason():
    t_ns, q_nb = swing(100)
    estimate = Estimate(t_ns + 10**12, "vqf", q_nb=q_nb, recording="run7")
    with pytest.raises(Unobservable, match=r"vqf of run7.*none of the 100 moving samples.*100 outside its span"):
        score(estimate, as_truth(t_ns, q_nb))


def test_nothing_moving_is_said():
    t_ns, q_nb = swing(100)
    with pytest.raises(Unobservable, match="no sample of it moves"):
        score(Estimate(t_ns, "e", q_nb=q_nb), as_truth(t_ns, q_nb, np.zeros(100, dtype=bool)))


def test_too_little_overlap_for_the_clock_is_said():
    t_ns, q_nb = swing(90)
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


def broad(data_dir, trial):
    """One trial's truth, and the estimate of offlineVQF 9D, by the independent reader of this test."""
    vqf = pytest.importorskip("vqf", reason="the peer package vqf is not installed")
    (path,) = (data_dir / "broad").glob(f"{trial}_*.mat")
    raw = scipy.io.loadmat(path, squeeze_me=True)
    gyro, accel, mag = (np.ascontiguousarray(raw[name]) for name in ("imu_gyr", "imu_acc", "imu_mag"))
    rate_hz = float(raw["sampling_rate"])
    t_ns = np.round(np.arange(len(gyro)) / rate_hz * 1e9).astype(np.int64)
    known = np.isfinite(raw["opt_quat"]).all(axis=1)
    q_true = raw["opt_quat"][known]
    q_true = q_true / np.linalg.norm(q_true, axis=1, keepdims=True)
    truth = Truth(t_ns[known], q_true, raw["movement"].astype(bool)[known])
    q_est = vqf.offlineVQF(gyro, accel, mag, 1 / rate_hz)["quat9D"]
    return Estimate(t_ns, "offline-vqf", q_nb=q_est, recording=path.stem), truth


@pytest.mark.parametrize(
    ("trial", "total", "heading", "inclination"),
    [("02", 0.441, 0.312, 0.312), ("10", 0.440, 0.363, 0.249), ("33", 1.280, 1.219, 0.392)],
)
def test_broad_figures_of_offline_vqf(data_dir, trial, total, heading, inclination):
    """The figures of BROAD's own definition with one heading removed, by an independent program."""
    found = score(*broad(data_dir, trial))
    assert found.total_rmse_deg == pytest.approx(total, abs=1e-3)
    assert found.heading_rmse_deg == pytest.approx(heading, abs=1e-3)
    assert found.inclination_rmse_deg == pytest.approx(inclination, abs=1e-3)


@pytest.mark.parametrize("trial", ["04", "07", "21"])
def test_broad_gyro_is_found_late(data_dir, trial):
    """The gyro reads 4.2 ms late and stands for the 3.5 ms before its stamp: the estimate is 4.2 - 1.75 ms late."""
    found = score(*broad(data_dir, trial), "heading+mounting+time")
    assert found.alignment.time_offset_s == pytest.approx(0.0042 - 0.00175, abs=2e-4)
    if trial == "07":
        assert found.total_rmse_deg == pytest.approx(1.02, abs=0.01)


@pytest.mark.parametrize(
    ("trial", "late_s"),
    [("Nexus5_NoDist_Swinging", 0.0237), ("iPhone5_NoDist_Texting", 0.030), ("iPhone4S_NoDist_AR", 0.0091)],
)
def test_phones_are_found_late(data_dir, trial, late_s):
    """What the gyro's rate alone gives, less half a sample, from an estimate that drifts by degrees per second."""
    (folder,) = (path for path in (data_dir / "tyrex").rglob(f"*{trial}") if path.is_dir())
    recording = next(IMPORTERS["tyrex"](folder))
    half_s = 0.5 / rate_hz(recording.require_imu().t_ns)
    found = score(run_estimator(recording, "gyro"), recording.truth, "heading+mounting+time")
    assert found.alignment.time_offset_s == pytest.approx(late_s - half_s, abs=1.5e-3)


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
