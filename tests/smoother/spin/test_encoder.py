"""A shaft encoder in the graph of a spinning body."""

from dataclasses import replace

import numpy as np
import pytest

from stillpoint.datasets.simulate import simulate
from stillpoint.smoother import reference
from stillpoint.smoother.spin.encoder import find_resolution_rad


@pytest.mark.slow
def test_an_encoder_fixes_angle_arm_and_latency():
    """It is used only when asked for; its steps, its delay and its zero are found."""
    recording = simulate("spin-variable", seed=3, sensor="white")
    without, made = reference(recording), reference(recording, params={"encoder.use": True})
    np.testing.assert_array_equal(without.angle_rad, reference(replace(recording, encoder=None)).angle_rad)
    found = made.diagnostics
    assert found["encoder_resolution_rad"] == pytest.approx(2 * np.pi / 4096, rel=1e-6)
    latency_s, sd_s = found["encoder_latency_s"]
    assert latency_s == pytest.approx(0.5e-3, abs=4 * sd_s)
    assert found["arm_squared"][1] < 0.5 * without.diagnostics["arm_squared"][1]
    error = made.angle_rad - recording.roll_truth.angle_rad
    assert np.abs(error).max() < 4 * np.median(made.angle_sd_rad)
    assert made.angle_sd_rad[-1] < 0.1 * without.angle_sd_rad[-1]


@pytest.mark.parametrize("counts", [4096, 360, 1000])
def test_the_resolution_is_that_of_the_counts(counts):
    angle = np.arange(5000) * 0.141 + 1e-3 * np.sin(np.arange(5000))
    step = 2 * np.pi / counts
    assert find_resolution_rad(np.floor(angle / step) * step) == pytest.approx(step, rel=1e-9)
    assert find_resolution_rad(angle) == 0.0
