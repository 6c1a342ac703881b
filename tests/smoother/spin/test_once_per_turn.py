"""What turns with the shaft: gravity only where both accelerometers show the same of it, else a vibration."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from stillpoint.datasets import SpinGeometry
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.simulate import spin as simulated
from stillpoint.datasets.simulate.spin_sensor import CONSTANT, make_white_noise
from stillpoint.filters import estimate
from stillpoint.smoother import reference
from stillpoint.smoother.spin.once_per_turn import judge_line
from stillpoint.smoother.spin.params import HarmonicParams, SpinCalibration, SpinGraphParams
from stillpoint.studies.papers.spin.study import CONSTANT as CONSTANT_SPEED
from stillpoint.studies.papers.spin.study import VARIABLE as VARIABLE_SPEED
from stillpoint.studies.papers.spin.study import make_settings

KNOWN = SpinGraphParams(
    calibration=SpinCalibration(accel_bias_sd_mps2=1e-6, accel_bias_walk=1e-7, lever_arm_sd=1e-7)
)  # the simulated sensor has neither bias nor wrong arms: what is left is noise and vibration
QUIET = make_white_noise("quiet", 0.06, 0.06, 0.06)
K_S, K_A = -10 + 0j, 2 + 0j  # of the bench: -1/d1, 1/d2
RATE = np.deg2rad(2020.0)


def shaken(seed, radial=0.0, tangential=0.0, tilt_deg=0.0, white=CONSTANT["white"], seconds=30.0):
    """The constant bench with vibrations once per turn, rms in m/s^2, each with a phase of its own."""
    sensor = replace(
        white,
        name="shaken",
        tilt_deg=float(tilt_deg),
        radial=replace(white.radial, vibration_1x_mps2=radial),
        tangential=replace(white.tangential, vibration_1x_mps2=tangential),
    )
    return simulated.simulate_trial("shaken", simulated.CONSTANT, sensor, seed, seconds / 60, 250.0)


def rate_errors(made, recording):
    """RMSE in deg/s, and the mean normalised error squared."""
    truth = recording.roll_truth
    error = made.rate_radps - truth.rate_radps
    return float(np.rad2deg(np.sqrt(np.mean(error**2)))), float(np.mean((error / made.rate_sd_radps) ** 2))


def explained(gravity, ripple, n_s=0j, n_a=0j, rate=RATE):
    """L_s and L_a of the docstring's equations."""
    return 2 * rate * ripple + gravity * K_S + n_s, 1j * rate * ripple + gravity * K_A + n_a


def verdict(squared, accel, k_s=K_S, k_a=K_A, **settings):
    return judge_line(squared, accel, k_s, k_a, 0.015, 100.0, HarmonicParams(**settings))[0]


@pytest.mark.slow
@pytest.mark.parametrize("scenario", [CONSTANT_SPEED, VARIABLE_SPEED], ids=lambda one: one.name)
def test_vibration_of_one_accelerometer_is_not_taken_for_gravity(scenario):
    """Preset vibration: no angle is claimed, the rate is better than the EKF's, and its sd is right."""
    errors, ekf = [], []
    for seed in range(2):
        recording = simulate(scenario.name, seed=seed, sensor="vibration")
        made = reference(recording, params=KNOWN)
        assert made.diagnostics["once_per_turn"] == "vibration"
        assert "the angle drifts" in made.diagnostics["angle"]
        assert "gravity_mps2" not in made.diagnostics
        drift = made.angle_rad - recording.roll_truth.angle_rad
        assert abs(drift[-1]) < 4 * made.angle_sd_rad[-1]
        errors.append(rate_errors(made, recording))
        filtered = estimate(recording, "roll-ekf", make_settings(scenario, "EKF", printed=False), "double")
        ekf.append(np.rad2deg(np.sqrt(np.mean((filtered.rate_radps - recording.roll_truth.rate_radps) ** 2))))
    rmse, nees = np.mean(errors, axis=0)
    assert rmse < 0.8 * np.mean(ekf)
    assert 0.4 < nees < 1.2  # the true ripple is 1 deg/s; the default's sd of both its parts together 1.01


@pytest.mark.slow
@pytest.mark.parametrize(("radial", "tangential"), [(1.0, 0.0), (0.0, 0.1), (3.0, 0.3)])
def test_vibration_of_any_size_does_not_pull_the_rate(radial, tangential):
    """The rate is as good as without the line: all that is lost is the true ripple, an RMS of 0.71 deg/s."""
    for seed in range(2):
        recording = shaken(seed, radial, tangential, white=QUIET)
        made = reference(recording, params=KNOWN)
        assert made.diagnostics["once_per_turn"] == "vibration"
        rmse, nees = rate_errors(made, recording)
        assert rmse < 0.9
        assert nees < 1.2


@pytest.mark.slow
@pytest.mark.parametrize("tilt_deg", [0.0, 3.0, 12.0, 30.0, 90.0])
def test_gravity_is_believed_from_the_tilt_that_shows_against_a_ripple(tilt_deg):
    """A ripple of 1 deg/s is 0.33 m/s^2 between both channels, a fifth of gravity at 10 deg of tilt."""
    found = reference(shaken(1, tilt_deg=tilt_deg)).diagnostics
    assert found["once_per_turn"] == {0.0: "ripple", 3.0: "vibration"}.get(tilt_deg, "gravity")
    if tilt_deg != 3.0:
        assert found["ripple_radps"] == pytest.approx(np.deg2rad(1.0), rel=0.3)  # the motor's: what is left by both
    if found["once_per_turn"] == "gravity":
        amplitude, sd = found["gravity_mps2"]
        assert amplitude == pytest.approx(9.80665 * np.sin(np.deg2rad(tilt_deg)), abs=4 * sd)


@pytest.mark.slow
def test_scales_of_a_part_as_it_comes_count_in_the_angle():
    """Each accelerometer sees gravity by its own scale, off by 0.5 %: one draw per trial, chi-squared of eight.

    Errors are 0.15 deg; as if both had the same scale the sd would be 0.03.
    """
    squares = []
    for tilt_deg in (30.0, 90.0):
        sensor = replace(CONSTANT["adxl345"], tilt_deg=tilt_deg)
        for seed in range(4):
            recording = simulated.simulate_trial("adxl345", simulated.CONSTANT, sensor, seed, 0.5, 250.0)
            made, truth = reference(recording), recording.roll_truth
            error = made.angle_rad - np.interp(made.t_ns, truth.t_ns, truth.angle_rad)
            error -= 2 * np.pi * np.round(np.median(error) / (2 * np.pi))
            squares.append(np.mean((error / made.angle_sd_rad) ** 2))
    assert chi2.ppf(0.005, 8) < np.sum(squares) < chi2.ppf(0.999, 8)


@pytest.mark.slow
def test_a_tilt_that_is_known_can_be_told():
    """Small tilts are not believed by themselves; told so, the angle is absolute again."""
    recording = shaken(1, tilt_deg=4.0)
    assert "drifts" in reference(recording).diagnostics["angle"]
    made = reference(recording, params={"harmonic.search": "gravity"})
    assert made.diagnostics["angle"].startswith("from gravity")
    error = made.angle_rad - recording.roll_truth.angle_rad
    error -= 2 * np.pi * np.round(np.median(error) / (2 * np.pi))
    assert np.abs(error).max() < 4 * made.angle_sd_rad.max()


@pytest.mark.slow
def test_a_vibration_that_mimics_gravity_in_both_cannot_be_told():
    """The same in both accelerometers, as gravity at 20 deg of tilt would be: stated, so that nobody relies on it."""
    recording = shaken(1)
    same = 3.35 * np.cos(recording.roll_truth.angle_rad + 1.0)[:, None]
    spin = recording.spin
    mimicked = replace(recording, spin=replace(spin, accel_mps2=spin.accel_mps2 + same))
    found = reference(mimicked).diagnostics
    assert found["once_per_turn"] == "gravity"
    assert found["gravity_mps2"][0] == pytest.approx(3.35, abs=0.1)


@pytest.mark.slow
def test_where_one_channel_feels_gravity_it_is_not_tested():
    """Two opposite tangential accelerometers take gravity out of the acceleration: nothing to compare."""
    y, z = np.eye(3)[1:]
    arms, axes = np.array([0.1 * y, 0.5 * y, -0.5 * y]), np.array([y, z, -z])
    scenario = replace(simulated.CONSTANT, geometry=SpinGeometry(arms, axes, np.empty((0, 3)), None, fixed_axis=True))
    sensor = replace(QUIET, name="level", tilt_deg=90.0)
    recording = simulated.simulate_trial("level", scenario, sensor, 1, 0.5, 250.0)
    found = reference(recording).diagnostics
    assert "cannot be tested" in found["once_per_turn_why"]
    assert "the angle drifts" in found["angle"]
    assert found["gravity_by_accel_mps2"] is None
    assert found["gravity_by_squared_mps2"] == pytest.approx(9.8, abs=0.5)
    made = reference(recording, params={"harmonic.search": "gravity"})
    error = made.angle_rad - recording.roll_truth.angle_rad
    error -= 2 * np.pi * np.round(np.median(error) / (2 * np.pi))
    assert np.abs(error).max() < 4 * made.angle_sd_rad.max()


@pytest.mark.slow
def test_in_flight_a_vibration_is_nothing_else():
    """The accelerometers at the centre take gravity out of both channels."""
    made = reference(simulate("spin-flight", seed=0, sensor="vibration"))
    assert made.diagnostics["once_per_turn_why"] == "neither channel feels gravity"
    assert "gravity_mps2" not in made.diagnostics


def test_each_verdict_follows_from_the_stated_equations():
    """Each verdict from the numbers that the docstring's equations give."""
    ripple = 5e-4 * RATE * np.exp(0.7j)
    for phase in np.exp(1j * np.linspace(0, 6, 7)):
        assert verdict(*explained(9.8 * phase, ripple)) == "gravity"
        assert verdict(*explained(0, ripple, n_a=1.0 * phase)) == "vibration"
        assert verdict(*explained(0, ripple, n_s=20.0 * phase)) == "vibration"
        assert verdict(*explained(11.0 * phase, ripple)) == "vibration"  # more than g
    assert judge_line(*explained(0, ripple), K_S, K_A, 0.015, 2.0, HarmonicParams())[0] == "ripple"
    squared, accel = explained(9.8, ripple)
    assert verdict(squared, accel * np.exp(0.3j)) == "vibration"  # 17 deg out of phase
    assert verdict(squared, accel * 0.7) == "vibration"
    assert verdict(squared, accel * 0.7, agreement=0.5) == "gravity"
    assert verdict(squared, 1j * ripple * RATE, k_a=0j) == "vibration"
    assert verdict(squared, 1j * ripple * RATE, k_a=0j, search="gravity") == "gravity"
    assert verdict(squared, accel, k_s=0j, k_a=0j, search="gravity") == "vibration"
    # Gravity that a ripple would look like: k_s = -2i k_a.
    assert verdict(1.0 + 0j, 0.1 + 0j, k_s=-2j, k_a=1 + 0j, search="gravity") == "vibration"
