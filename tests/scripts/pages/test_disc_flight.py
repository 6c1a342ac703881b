"""The disc flight: spin by accelerometers against its gyro."""

import numpy as np
import pytest

from stillpoint.scripts.pages.disc_flight import DiscFlight, read_disc_flight


@pytest.fixture(scope="module")
def flight(data_dir) -> DiscFlight:
    return read_disc_flight(data_dir / "disc" / "2025-08-31-001-rb.csv")


def amplitude_degps(flight, per_turn: float) -> float:
    """Of what the rate's error holds so many times per turn."""
    error = np.rad2deg(flight.reference.rate_radps - flight.gyro_radps)
    error -= np.polyval(np.polyfit(flight.t_s, error, 2), flight.t_s)
    turned = np.concatenate([[0.0], np.cumsum(flight.gyro_radps[1:] * np.diff(flight.t_s))])
    window = np.hanning(len(error))
    return float(2 * np.abs(np.sum(error * window * np.exp(-1j * per_turn * turned))) / window.sum())


def test_the_disc_spins_as_its_gyro_says(flight):
    """The second half of the flight, in which the graph has not seen the gyro: 0.1 % is 3 deg/s of 3150."""
    judged = ~flight.taught
    assert judged.sum() > 80
    error = (flight.reference.rate_radps - flight.gyro_radps)[judged]
    assert np.rad2deg(np.sqrt(np.mean(error**2))) < 3.0
    assert 0.8 < np.mean((error / flight.sd_radps[judged]) ** 2) < 1.25
    assert flight.arm_m[0] == pytest.approx(0.0205, abs=3e-4)


def test_what_is_left_is_a_wobble_between_once_and_twice_per_turn(flight):
    """No gravity and no ripple, which would be at 1; the graph's own sd is too small by it."""
    orders = np.arange(0.5, 4.0, 0.01)
    amplitudes = [amplitude_degps(flight, order) for order in orders]
    assert orders[int(np.argmax(amplitudes))] == pytest.approx(1.22, abs=0.02)
    assert max(amplitude_degps(flight, 1.0), amplitude_degps(flight, 2.0)) < 0.05 * max(amplitudes)
