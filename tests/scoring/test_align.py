"""What two trajectories may differ in is found as it was planted: heading, mounting and clock."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation
from swings import as_truth, attitudes, broad, offline_vqf, swing

from stillpoint.datasets import Estimate, Unobservable
from stillpoint.datasets.frames import heading_rotation, quaternion, rotation
from stillpoint.datasets.importers.table import IMPORTERS
from stillpoint.datasets.recording import rate_hz
from stillpoint.filters import estimate as run_estimator
from stillpoint.scoring import ALIGN_KINDS, score

planted = st.tuples(
    st.floats(-3.14, 3.14),
    st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)),
    st.floats(-0.45, 0.45),
)


@pytest.mark.slow
@settings(max_examples=8)  # each searches the clock
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


@pytest.mark.slow
@given(st.floats(-3.14, 3.14), attitudes)
def test_any_mounting_at_all_is_found(heading, mounting):
    """The optimum is global: a sensor mounted upside down is no harder than one mounted straight."""
    t_ns, q_true = swing(600)
    q_est = quaternion(heading_rotation(heading) * rotation(q_true) * rotation(mounting))
    found = score(Estimate(t_ns, "planted", q_nb=q_est), as_truth(t_ns, q_true), "heading+mounting")
    assert found.total_max_deg < 1e-5


@pytest.mark.slow
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


@pytest.mark.slow
def test_noise_does_not_draw_the_clock_to_half_a_sample():
    """Interpolation averages noise, so the smallest misfit lies 5 ms aside; the offset must not."""
    t_ns, q_true = swing(6000)
    noise = np.random.default_rng(1).normal(scale=0.01, size=(len(t_ns), 3))
    estimate = Estimate(t_ns, "noisy", q_nb=quaternion(rotation(q_true) * Rotation.from_rotvec(noise)))
    found = score(estimate, as_truth(t_ns, q_true), "heading+mounting+time")
    assert abs(found.alignment.time_offset_s) < 1e-3


@pytest.mark.slow
def test_drift_does_not_pull_the_clock():
    """A heading that runs away by 5 deg/s hides every attitude, but not when the sensor turned."""
    t_ns, q_true = swing(6000)
    _, q_late = swing(6000, late_s=0.0217)
    drift = Rotation.from_rotvec(np.deg2rad(5.0) * (t_ns / 1e9)[:, None] * [0.0, 0.0, 1.0])
    estimate = Estimate(t_ns, "drifting", q_nb=quaternion(drift * rotation(q_late)))
    found = score(estimate, as_truth(t_ns, q_true), "heading+mounting+time")
    assert found.alignment.time_offset_s == pytest.approx(0.0217, abs=5e-4)
    assert found.total_rmse_deg > 50


@pytest.mark.slow
def test_gaps_in_the_truth_do_not_pull_the_clock():
    t_ns, q_true = swing(6000)
    _, q_late = swing(6000, late_s=-0.0083)
    keep = np.ones(6000, dtype=bool)
    for start in np.random.default_rng(4).integers(0, 5900, 25):
        keep[start : start + 60] = False
    found = score(Estimate(t_ns, "e", q_nb=q_late), as_truth(t_ns[keep], q_true[keep]), "heading+mounting+time")
    assert found.alignment.time_offset_s == pytest.approx(-0.0083, abs=2e-5)


@pytest.mark.slow
@pytest.mark.parametrize("late_s", [0.7, -3.0, 12.0])
def test_an_offset_beyond_half_a_second_is_found(late_s):
    """No local minimum within half a second stands for it: the turns agree at one offset of the whole overlap."""
    t_ns, q_true = swing(4000)
    _, q_late = swing(4000, late_s=late_s)
    found = score(Estimate(t_ns, "e", q_nb=q_late), as_truth(t_ns, q_true), "heading+mounting+time")
    assert found.alignment.time_offset_s == pytest.approx(late_s, abs=1e-4)
    assert found.total_max_deg < 0.1


@pytest.mark.slow
def test_clocks_with_different_zeros_are_aligned():
    """A trajectory that counts from 1970 against one that counts from its first sample."""
    t_ns, q_true = swing(4000)
    estimate = Estimate(t_ns + 1_700_000_000 * 10**9, "e", q_nb=q_true)
    found = score(estimate, as_truth(t_ns, q_true), "heading+mounting+time")
    assert found.alignment.time_offset_ns == pytest.approx(1_700_000_000 * 10**9, abs=1000)
    assert found.samples > 3900


@pytest.mark.slow
@pytest.mark.parametrize("other", [7, 8])
def test_two_motions_that_have_nothing_in_common_have_no_offset(other):
    """Random turns of two seeds: some offset always fits best, none fits well, and none is returned."""
    t_ns = np.arange(4000) * 10_000_000
    walks = [np.random.default_rng(seed).normal(size=(4000, 3)).cumsum(axis=0) * 0.02 for seed in (1, other)]
    q_est, q_true = (quaternion(Rotation.from_rotvec(gaussian_filter1d(walk, 10, axis=0))) for walk in walks)
    with pytest.raises(Unobservable, match="no clock offset fits clearly better"):
        score(Estimate(t_ns, "e", q_nb=q_est), as_truth(t_ns, q_true), "heading+mounting+time")


@pytest.mark.slow
def test_a_periodic_motion_far_away_is_refused_rather_than_guessed():
    """A swing of 2 s fits at every whole period; when the nearest is a second away, nothing says which is right."""
    t_s = np.arange(6000) / 100.0
    t_ns = np.round(t_s * 1e9).astype(np.int64)

    def swung(late_s):
        phase = np.pi * (t_s - late_s)
        return quaternion(Rotation.from_euler("x", (np.sin(phase) + 0.5 * np.sin(2 * phase))[:, None]))

    with pytest.raises(Unobservable, match="no clock offset"):
        score(Estimate(t_ns, "e", q_nb=swung(1.0)), as_truth(t_ns, swung(0.0)), "heading+mounting+time")
    near = score(Estimate(t_ns, "e", q_nb=swung(0.1)), as_truth(t_ns, swung(0.0)), "heading+mounting+time")
    assert near.alignment.time_offset_s == pytest.approx(0.1, abs=1e-3)


def test_more_freedom_never_fits_worse():
    t_ns, q_true = swing(2000)
    rng = np.random.default_rng(2)
    drift = np.cumsum(rng.normal(scale=2e-3, size=(len(t_ns), 3)), axis=0)
    q_est = heading_rotation(0.4) * rotation(q_true) * Rotation.from_rotvec(drift) * Rotation.from_rotvec([0.1, 0, 0.2])
    estimate = Estimate(t_ns, "drifting", q_nb=quaternion(q_est))
    errors = [score(estimate, as_truth(t_ns, q_true), kind).total_rmse_deg for kind in ALIGN_KINDS[:3]]
    assert errors[0] > errors[1] > errors[2]


@pytest.mark.parametrize("tilt", [[0.0, 0.0, 0.0], [0.4, -1.1, 0.0], [np.pi, 0.0, 0.0]])
@pytest.mark.parametrize("noise_rad", [0.0, 1e-13, 1e-6])
def test_level_turns_leave_heading_and_mounting_as_one_angle(tilt, noise_rad):
    """Rotation about the vertical alone cannot tell them apart: the mounting stays 0 and the heading takes it all."""
    t_ns = np.arange(500) * 10_000_000
    noise = np.random.default_rng(5).normal(scale=noise_rad, size=(500, 3))
    turns = Rotation.from_euler("z", np.linspace(0, 9, 500)[:, None]) * Rotation.from_rotvec(tilt)
    q_true = quaternion(turns * Rotation.from_rotvec(noise))
    q_est = quaternion(heading_rotation(0.7) * rotation(q_true))
    found = score(Estimate(t_ns, "level", q_nb=q_est), as_truth(t_ns, q_true), "heading+mounting")
    assert found.total_max_deg < (1e-5 if noise_rad < 1e-7 else 1e-3)
    assert np.abs(found.alignment.mounting_rotvec_rad).max() < 1e-4
    assert found.alignment.heading_rad == pytest.approx(0.7, abs=1e-4)


def test_level_turns_with_a_tilted_mounting_return_the_smallest_mounting():
    """The mounting keeps its tilt of 0.3 rad and gives its turn about the vertical to the heading."""
    t_ns = np.arange(500) * 10_000_000
    q_true = quaternion(Rotation.from_euler("z", np.linspace(0, 9, 500)[:, None]))
    mounting = Rotation.from_rotvec([0.0, 0.0, 0.5]) * Rotation.from_rotvec([0.3, 0.0, 0.0])
    q_est = quaternion(heading_rotation(0.2) * rotation(q_true) * mounting)
    found = score(Estimate(t_ns, "level", q_nb=q_est), as_truth(t_ns, q_true), "heading+mounting")
    assert found.total_max_deg < 1e-5
    assert np.abs(found.alignment.mounting_rotvec_rad - [0.3, 0.0, 0.0]).max() < 1e-7
    assert found.alignment.heading_rad == pytest.approx(0.7, abs=1e-7)


@pytest.mark.parametrize("trial", ["04", "07", "21"])
def test_broad_gyro_is_found_late(data_dir, trial):
    """The gyro reads 4.2 ms late and stands for the 3.5 ms before its stamp: the estimate is 4.2 - 1.75 ms late."""
    found = score(*broad(data_dir, trial, offline_vqf), "heading+mounting+time")
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
