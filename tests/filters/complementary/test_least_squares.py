"""``cf-lse`` and ``cf-lse-literal``: the tautology of Zia's eq (22), the regression, and what it finds."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stillpoint.datasets import BadParameter, Imu, Info, Mag, Recording
from stillpoint.datasets.frames import rotation
from stillpoint.datasets.simulate import simulate
from stillpoint.filters import Stream, estimate
from stillpoint.filters.complementary.gains import gains

STEP_S = 0.02


@pytest.fixture(scope="module")
def mission():
    """The whole mission of the vehicle, in waves."""
    return simulate("auv-dolphin", seed=0)


def about_x(measured_rad, turned_rad, step_s=STEP_S):
    """An accelerometer that says ``measured_rad`` (N,) about x and a gyro that says ``turned_rad`` (N,) per step."""
    n = len(measured_rad)
    t_ns = np.round(np.arange(n) * step_s * 1e9).astype(np.int64)
    gyro = np.column_stack([turned_rad / step_s, np.zeros(n), np.zeros(n)])
    accel = 9.81 * np.column_stack([np.zeros(n), np.sin(measured_rad), np.cos(measured_rad)])
    return Recording("about x", Imu(t_ns, gyro, accel), info=Info(units_unchecked=True))


def noisy(seed, n, turn_sd_rad, measured_sd_rad):
    """A body at rest: white noise in both sensors."""
    draw = np.random.default_rng(seed)
    return draw.normal(0, measured_sd_rad, n), draw.normal(0, turn_sd_rad, n)


@pytest.mark.slow
@pytest.mark.parametrize(("kp", "ki"), [(1.0, 0.05), (0.3, 0.01), (4.0, 1.0)])
def test_eq_22_as_printed_keeps_its_gains(mission, kp, ki):
    """B-1: S = H K0 holds exactly, so (H^T H)^-1 H^T S is K0 whatever the sea does."""
    found = gains(mission, "cf-lse-literal", {"kp_per_s": kp, "ki_per_s2": ki})
    assert len(found.t_ns) > 45_000
    assert np.abs(found.kp_per_s - kp).max() < 1e-6
    assert np.abs(found.ki_per_s2 - ki).max() < 1e-6
    assert (found.kp_per_s[1000:] != kp).any()  # it is computed, not kept


def test_eq_22_as_printed_is_the_filter_with_fixed_gains(mission):
    same = {"kp_per_s": 0.5, "ki_per_s2": 0.02}
    literal, fixed = (rotation(estimate(mission, name, same).q_nb) for name in ("cf-lse-literal", "cf-fixed"))
    # The integral is kept as it is and not as a bias: the two differ by rounding and by turns within one step.
    assert np.rad2deg((literal * fixed.inv()).magnitude()).max() < 1e-3


def test_in_single_precision_eq_22_keeps_its_gains_to_single_precision(mission):
    found = gains(mission, "cf-lse-literal", precision="single")
    assert np.abs(found.kp_per_s - 1.0).max() < 1e-4
    assert np.abs(found.ki_per_s2 - 0.05).max() < 1e-5


def test_the_gains_are_the_least_squares_of_the_one_step_prediction():
    """Against numpy's lstsq on the rows of (21), written from an independent filter about one axis."""
    n, memory_s, fixed = 400, 3.0, 50
    measured, turned = noisy(1, n, 0.002, 0.02)
    measured[0] = 0.3  # a start that is wrong: error and integral are large and differ
    params = {"fixed_samples": fixed, "memory_s": memory_s, "kp_low_per_s": 0.0, "kp_high_per_s": 50.0}
    found = gains(about_x(measured, turned), "cf-lse", params)
    x, integral, kp, ki = measured[0], 0.0, 1.0, 0.05
    rows, wanted, pair = [], [], (0.0, 0.0, 0.0)  # e T, its integral, what kp turned
    for k in range(1, n):
        error_before, integral_before, turned_before = pair
        x += turned[k] + STEP_S * ki * integral
        error = measured[k] - x
        rows.append([error_before, integral_before * STEP_S])
        wanted.append(turned_before + ki * integral_before * STEP_S + error)
        if k >= fixed:
            weight = np.sqrt(np.exp(-(k - 1 - np.arange(k)) * STEP_S / memory_s))
            best, *_ = np.linalg.lstsq(np.array(rows) * weight[:, None], np.array(wanted) * weight)
            kp = min(max(best[0], 0.0), 50.0)
            ki = min(max(best[1], 1e-5), kp * kp / 4)
        assert found.kp_per_s[k, 0] == pytest.approx(kp, rel=1e-5)
        assert found.ki_per_s2[k, 0] == pytest.approx(ki, rel=1e-5)
        pair = error * STEP_S, integral + error * STEP_S, STEP_S * kp * error
        x, integral = x + STEP_S * kp * error, integral + STEP_S * error


@pytest.mark.slow
@pytest.mark.parametrize(("turn_sd", "measured_sd"), [(1e-3, 0.02), (1e-3, 0.005), (2e-3, 0.02)])
def test_for_white_noise_it_finds_the_gain_of_the_kalman_filter(turn_sd, measured_sd):
    """Its fixed point: the next error is uncorrelated with this one. So are the innovations of the optimal filter.

    With P- = P+ + q^2 and K = P- / (P- + r^2): K = (sqrt(s^2 + 4 s) - s) / 2, s = (q / r)^2, and kp T = K.
    """
    n = 800_000
    recording = about_x(*noisy(0, n, turn_sd, measured_sd))
    found = gains(recording, "cf-lse", {"memory_s": 1e6, "kp_high_per_s": 50.0})
    s = (turn_sd / measured_sd) ** 2
    kalman = (np.sqrt(s * s + 4 * s) - s) / 2
    # A regression of noise on noise of the same size knows its coefficient to 1 / sqrt(n).
    assert found.kp_per_s[-1, 0] * STEP_S == pytest.approx(kalman, abs=3 / np.sqrt(n))
    assert found.ki_per_s2[-1, 0] < 1e-3  # there is no bias to find


def test_for_a_correlated_error_of_the_accelerometer_the_gain_goes_up():
    """The failure: 0.02 rad of white noise, or as much again as a wave of 0.25 Hz, both with a good gyro.

    Kalman's gain is 0.05 1/s; 10 000 samples of memory know kp T to 0.01, hence kp to 0.5.
    """
    n = 30_000
    white, turned = noisy(2, n, 2e-5, 0.02)
    wave = 0.02 * np.sqrt(2) * np.sin(2 * np.pi * 0.25 * STEP_S * np.arange(n)) + 0.02 * white
    by_noise, by_wave = (gains(about_x(angle, turned), "cf-lse").kp_per_s[-1, 0] for angle in (white, wave))
    assert by_noise < 1.5
    assert by_wave > 3.0


def test_bounds_hold_and_what_they_stop_is_counted(mission):
    bounds = {"kp_low_per_s": 0.2, "kp_high_per_s": 0.6, "ki_low_per_s2": 1e-3}
    found = gains(mission, "cf-lse", bounds | {"kp_per_s": 0.3, "ki_per_s2": 0.01})
    assert found.kp_per_s.min() >= 0.2
    assert found.kp_per_s.max() <= 0.6
    assert (found.ki_per_s2 <= np.maximum(found.kp_per_s**2 / 4, 0.01) + 1e-15).all()
    assert found.ki_per_s2.min() >= 1e-3
    assert estimate(mission, "cf-lse", bounds).diagnostics["n_clipped"] > 10_000
    assert estimate(mission, "cf-lse-literal").diagnostics["n_clipped"] == 0


def test_bounds_the_wrong_way_round_are_refused(mission):
    with pytest.raises(BadParameter, match="kp_low_per_s = 6 is above kp_high_per_s = 5"):
        estimate(mission, "cf-lse", {"kp_low_per_s": 6.0})
    assert gains(mission, "cf-lse", {"kp_low_per_s": 6.0, "kp_high_per_s": 8.0}).kp_per_s[-1, 0] >= 6.0


def test_the_first_samples_have_the_gains_that_were_given(mission):
    for fixed in (50, 500):
        found = gains(mission, "cf-lse", {"kp_per_s": 0.7, "ki_per_s2": 0.03, "fixed_samples": fixed})
        for part in range(3):
            changed = np.flatnonzero(found.kp_per_s[:, part] != 0.7)
            assert fixed <= changed[0] <= 1.1 * fixed + 3  # 97 in 100 samples bring a field


def test_without_errors_nothing_is_determined_and_the_gains_stay():
    recording = about_x(np.zeros(300), np.zeros(300))
    found = gains(recording, "cf-lse")
    assert (found.kp_per_s == 1.0).all()
    assert estimate(recording, "cf-lse").diagnostics["n_undetermined"] == 2 * (299 - 49)  # roll and pitch


def test_roll_has_its_gain_in_any_heading_and_pitch_another():
    """Noise about the body's x axis only; on another heading it is about another axis of n."""
    measured, turned = noisy(4, 3000, 1e-3, 0.02)
    imu = about_x(measured, turned).imu
    by_heading = []
    for azimuth in (0.0, 1.0, 2.5):
        field_n = Rotation.from_rotvec([0, 0, azimuth]).inv().apply([0, 20.0, -44.0])
        mag = Mag(imu.t_ns, Rotation.from_rotvec(np.outer(measured, [1, 0, 0])).inv().apply(field_n))
        found = gains(Recording("x", imu, mag=mag, info=Info(units_unchecked=True)), "cf-lse")
        by_heading.append(found.kp_per_s[:, 0])
    assert np.ptp(by_heading[0]) > 1.0
    for other in by_heading[1:]:
        np.testing.assert_allclose(other, by_heading[0], rtol=1e-3)
    # Turned by 90 deg in the body, roll is pitch.
    quarter = Rotation.from_rotvec([0, 0, np.pi / 2])
    sideways = Imu(imu.t_ns, quarter.apply(imu.gyro_b_radps.copy()), quarter.apply(imu.accel_b_mps2.copy()))
    found = gains(Recording("y", sideways, info=Info(units_unchecked=True)), "cf-lse")
    np.testing.assert_allclose(found.kp_per_s[:, 1], gains(about_x(measured, turned), "cf-lse").kp_per_s[:, 0])


def test_with_x_straight_up_the_filter_still_levels():
    """There is no direction of travel; the parts are about east and north, and the error is removed all the same."""
    stream = Stream("cf-lse")
    for k in range(1500):
        tilted = (9.81 * np.cos(0.3), 9.81 * np.sin(0.3), 0.0) if k == 0 else (9.81, 0.0, 0.0)
        out = stream.update(k * 20_000_000, (0.0, 0.0, 0.0), tilted)
        assert np.isfinite(out.q_nb).all()
    assert rotation(out.q_nb).apply([1.0, 0.0, 0.0]) == pytest.approx([0, 0, 1], abs=1e-3)


def test_between_equal_bounds_it_is_the_filter_with_fixed_gains(mission):
    params = {"kp_low_per_s": 0.4, "kp_high_per_s": 0.4, "ki_low_per_s2": 0.04}  # kI = kp^2 / 4
    pinned = estimate(mission, "cf-lse", params | {"kp_per_s": 0.4, "ki_per_s2": 0.04})
    fixed = estimate(mission, "cf-fixed", {"kp_per_s": 0.4, "ki_per_s2": 0.04})
    assert np.rad2deg((rotation(pinned.q_nb) * rotation(fixed.q_nb).inv()).magnitude()).max() < 1e-3


@pytest.mark.parametrize("name", ["cf", "cf-fixed", "vqf", "no such"])
def test_other_estimators_have_no_gains_to_show(mission, name):
    with pytest.raises(BadParameter, match="cf-lse and cf-lse-literal"):
        gains(mission, name)
