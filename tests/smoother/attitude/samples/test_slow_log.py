"""Motion between the samples of a slow log is restored, and the covariance allows for the remaining error."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stillpoint.datasets import Imu
from stillpoint.datasets.importers.table import IMPORTERS
from stillpoint.datasets.simulate import simulate
from stillpoint.scoring import score
from stillpoint.smoother import attitude_reference
from stillpoint.smoother.attitude.samples.slow_log import estimate_sampling_error, integrate_slow_log

FINE_HZ, SLOW_HZ, SECONDS = 2400, 24, 20
GRAVITY_N = np.array([0.0, 0.0, 9.81])


def swinging_body():
    """Return stamps, mean rates and mean forces of a slow log, and the true attitudes at its stamps.

    Three axes swing at 1.1 to 2.3 times a second, up to 5 rad/s; the force is gravity alone.
    """
    t_s = np.arange(SECONDS * FINE_HZ) / FINE_HZ
    rate = np.stack([3 * np.sin(7 * t_s), 5 * np.cos(11 * t_s), 2 + 2 * np.sin(14.3 * t_s)], axis=1)
    turns = Rotation.from_rotvec(rate / FINE_HZ)
    attitude = np.empty((len(t_s) + 1, 3, 3))
    attitude[0] = np.eye(3)
    for k, turn in enumerate(turns.as_matrix()):
        attitude[k + 1] = attitude[k] @ turn
    force = GRAVITY_N @ attitude[1:]
    per = FINE_HZ // SLOW_HZ
    means = [each.reshape(-1, per, 3).mean(axis=1) for each in (rate, force)]
    return np.arange(1, len(means[0]) + 1) / SLOW_HZ, *means, attitude[per::per]


def end_attitudes(rate, start):
    """Return the attitudes that constant rates turn a body to, from interval to interval."""
    found = [start]
    for turn in Rotation.from_rotvec(rate / SLOW_HZ).as_matrix():
        found.append(found[-1] @ turn)
    return np.array(found)


def angle_deg(a, b):
    return np.rad2deg(Rotation.from_matrix(a.transpose(0, 2, 1) @ b).magnitude())


def test_the_rotation_between_samples_is_restored():
    """Constant rates lose the order of turns, tens of degrees in 20 s; splines through the sums keep it."""
    t_s, rate, force, attitude = swinging_body()
    bias = np.array([0.1, -0.05, 0.02])
    found, _ = integrate_slow_log(t_s, rate + bias, force, bias)
    restored = angle_deg(end_attitudes(found[1:] - bias, attitude[0]), attitude).max()
    constant = angle_deg(end_attitudes(rate[1:], attitude[0]), attitude).max()
    assert constant > 3.0
    assert restored < constant / 40


def test_a_force_acts_in_the_axes_at_the_beginning_of_its_interval():
    """Gravity alone: turned by the attitude at which an interval begins, each force must be gravity."""
    t_s, rate, force, attitude = swinging_body()
    _, found = integrate_slow_log(t_s, rate, force, np.zeros(3))
    off = np.einsum("nij,nj->ni", attitude[:-1], found[1:]) - GRAVITY_N
    as_read = np.einsum("nij,nj->ni", attitude[:-1], force[1:]) - GRAVITY_N
    assert np.abs(as_read).max() > 0.5
    assert np.abs(off[5:-5]).max() < 0.02  # the simulated force is half of a fine step late: 0.01


def test_a_steady_turn_is_left_as_it_is():
    t_s = np.arange(100) / SLOW_HZ
    rate, force = np.tile([0.0, 0.0, 3.0], (100, 1)), np.tile([0.0, 0.0, 9.81], (100, 1))
    found = integrate_slow_log(t_s, rate, force, np.zeros(3))
    np.testing.assert_allclose(found[0], rate, atol=1e-9)
    np.testing.assert_allclose(found[1], force, atol=1e-9)


def test_splines_end_at_gaps():
    """What is on the other side of a gap has no influence, and a stretch of a few samples stays as it is."""
    t_s, rate, force, _ = swinging_body()
    kept = np.r_[0:100, 150:156, 200:300]
    found, _ = integrate_slow_log(t_s[kept], rate[kept], force[kept], np.zeros(3))
    alone, _ = integrate_slow_log(t_s[:100], rate[:100], force[:100], np.zeros(3))
    np.testing.assert_allclose(found[:100], alone, atol=1e-12)
    np.testing.assert_array_equal(found[100:106], rate[150:156])
    np.testing.assert_array_equal(found[106], rate[200])


def test_slow_sampling_of_a_cone_is_noticed_and_fast_sampling_is_not():
    """An axis that swings by 0.5 rad three times a second hides motion at 24 Hz, and none at 286 Hz."""
    for rate_hz, noticed in ((24, True), (286, False)):
        t_s = np.arange(20 * rate_hz) / rate_hz
        swing = 2 * np.pi * 3 * t_s
        gyro = 2 * np.pi * 3 * 0.5 * np.stack([np.cos(swing), np.sin(swing), 0 * t_s], axis=1)
        at_rest = np.zeros(len(t_s), dtype=bool)
        found = estimate_sampling_error(gyro, np.full(len(t_s), 1 / rate_hz), at_rest)
        assert found.any() == noticed
        if noticed:
            assert found[1:-1, 2] == pytest.approx(0.5 * np.sin(2 * np.pi * 3 / 24) * (3 * np.pi) ** 2 / 24 / 12)
    assert not estimate_sampling_error(gyro, np.full(len(t_s), 1 / 24), ~at_rest).any()


def slowed(recording, averaged):
    """Return the recording at about SLOW_HZ, with means of the readings or with one of each block."""
    fine = recording.require_imu()
    per = round(1e9 / SLOW_HZ / float(np.median(np.diff(fine.t_ns))))
    n = len(fine.t_ns) // per * per
    blocks = [each[:n].reshape(-1, per, 3) for each in (fine.gyro_b_radps, fine.accel_b_mps2)]
    kept = [block.mean(axis=1) if averaged else block[:, -1] for block in blocks]
    return replace(recording, imu=Imu(fine.t_ns[:n].reshape(-1, per)[:, -1], *kept))


@pytest.mark.slow
@pytest.mark.parametrize("averaged", [True, False])
def test_a_slow_log_of_a_smooth_hand_is_restored(averaged):
    """The simulated hand has next to nothing above 12 Hz, so that dropped samples do not hide anything."""
    hand = simulate("phone-3", seed=2, minutes=1.4)
    made = attitude_reference(slowed(hand, averaged))
    assert "is restored" in made.diagnostics["slow_log"]
    assert score(made, hand.truth, "heading+mounting+time").coverage95 > 0.85


@pytest.mark.slow
def test_dropped_samples_of_a_violent_hand_are_not_restored_and_the_covariance_says_so(data_dir):
    """At 24 Hz trial 08 turns by up to 20 deg from reading to reading: 0.5 deg as means, 1.6 with samples dropped."""
    fast = next(iter(IMPORTERS["broad"](data_dir / "broad" / "08_undisturbed_fast_rotation_with_breaks_A.mat")))
    means, moments = (attitude_reference(slowed(fast, averaged)) for averaged in (True, False))
    assert "is restored" in means.diagnostics["slow_log"]
    assert "not restored" in moments.diagnostics["slow_log"]
    assert score(means, fast.truth, "heading+mounting+time").total_rmse_deg < 0.7
    assert score(moments, fast.truth, "heading+mounting+time").coverage95 > 0.85
