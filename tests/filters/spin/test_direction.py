"""The sense of a spin: by gyros, by further accelerometers, or assumed and said; and through zero."""

import numpy as np
import pytest
from spins import CONSTANT, exact

from stillpoint.datasets import Recording
from stillpoint.datasets.recording import Spin, SpinGeometry
from stillpoint.datasets.spin import BENCH, FIVE_ACCELEROMETERS, channels, compute_specific_force
from stillpoint.filters import estimate
from stillpoint.filters.table import SPINS
from stillpoint.smoother import reference


def with_gyro(sense: float) -> Recording:
    """The bench with a gyro about the axis that saturates at 17 rad/s, spinning at 30 rad/s."""
    geometry = SpinGeometry(BENCH.accel_r_b_m, BENCH.accel_axis_b, np.array([[1.0, 0, 0]]), fixed_axis=True)
    return exact(
        lambda t: np.full(len(t), 30 * sense),
        np.zeros_like,
        geometry=geometry,
        gyro=lambda t: np.full(len(t), 17 * sense),
    )


@pytest.mark.parametrize("name", SPINS)
@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_saturated_gyro_still_tells_the_sense(name, sense):
    found = estimate(with_gyro(sense), name, CONSTANT)
    assert found.rate_radps == pytest.approx(30 * sense, rel=1e-9)
    assert found.angle_rad[-1] == pytest.approx(sense * 30 * 0.004 * 999, rel=1e-6)
    assert "gyro" in found.diagnostics["direction"]


@pytest.mark.parametrize("name", SPINS)
def test_without_it_the_sense_is_assumed_and_said(name):
    recording = exact(lambda t: np.full(len(t), -30.0), np.zeros_like)
    assert estimate(recording, name, CONSTANT).rate_radps[-1] == pytest.approx(30)
    assert estimate(recording, name, CONSTANT).diagnostics["direction"].startswith("assumed positive")
    assert estimate(recording, name, {"direction": "negative"}).rate_radps[-1] == pytest.approx(-30)


ARMS = np.vstack([FIVE_ACCELEROMETERS.accel_r_b_m, [0.2, 0, 0], [-0.2, 0, 0], [0, 0.2, 0]])
AXES = np.vstack([FIVE_ACCELEROMETERS.accel_axis_b, [0, 1.0, 0], [0, 0, 1.0], [1.0, 0, 0]])
WIDE = SpinGeometry(ARMS, AXES, FIVE_ACCELEROMETERS.gyro_axis_b)


def wide(sense: float, across_radps: float = 0.5, noise_mps2: float = 0.0) -> Recording:
    """At 30 rad/s, turning about y and z besides, with an accelerometer along y at r_x = 0.2 m."""
    t_s = np.arange(0, 2, 0.004)
    still = np.ones(len(t_s))
    rate = np.column_stack([30 * sense * still, across_radps * still, 0.6 * across_radps * still])
    felt = [
        compute_specific_force(arm, np.zeros(3), rate, np.zeros(3)) @ axis for arm, axis in zip(ARMS, AXES, strict=True)
    ]
    noise = np.random.default_rng(0).normal(0, noise_mps2, (len(t_s), len(ARMS)))
    t_ns = np.round(t_s * 1e9).astype(np.int64)
    return Recording("wide", spin=Spin(t_ns, np.column_stack(felt) + noise, rate[:, 1:], WIDE))


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_the_sense_is_seen_by_an_accelerometer_off_the_plane(sense):
    """An accelerometer along y at r_x = 0.2 m reads r_x w_x w_y + r_x w_z' - ...; beside w_y it has the sign of w_x."""
    assert channels(WIDE).omega_xy is not None or channels(WIDE).omega_xz is not None
    found = estimate(wide(sense), "roll-ekf", CONSTANT)
    assert found.rate_radps[-1] == pytest.approx(30 * sense, rel=1e-3)
    assert "products" in found.diagnostics["direction"]


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_the_reference_sees_it_too(sense):
    made = reference(wide(sense, noise_mps2=0.05))
    assert made.rate_radps == pytest.approx(30 * sense, rel=1e-3)
    assert made.diagnostics["direction"] == "as a sensor shows it"


def test_the_reference_takes_no_bias_for_the_sense():
    """w_x w_y is 30 * 0.05 = 1.5 rad^2/s^2, and a bias of 0.4 m/s^2 at 0.2 m makes 2."""
    made = reference(wide(-1.0, across_radps=0.05, noise_mps2=0.05))
    assert made.diagnostics["direction"] == "taken as positive"
    assert made.rate_radps[-1] > 0


def test_a_filter_goes_through_zero_by_the_angular_acceleration_and_says_so():
    """From 12 to -12 rad/s: the EKF's gain vanishes with the rate, so it comes out on the right side; the observation
    cannot. Within sqrt(sqrt(R)) = 3 rad/s, half a second of two, the square tells nothing."""
    recording = exact(lambda t: 12 - 12 * t, lambda t: np.full(len(t), -12.0), seconds=2)
    ekf = estimate(recording, "roll-ekf", CONSTANT)
    assert ekf.rate_radps == pytest.approx(recording.roll_truth.rate_radps, abs=1e-6)
    assert ekf.diagnostics["n_near_zero"] == pytest.approx(0.5 * 250, abs=3)
    raw = estimate(recording, "roll-obs", CONSTANT)
    assert raw.rate_radps == pytest.approx(np.abs(recording.roll_truth.rate_radps), abs=1e-6)
