"""The disc flight: spin by accelerometers against its gyro."""

import numpy as np

from stillpoint.scripts.disc_flight import disc_flight


def test_the_disc_spins_as_its_gyro_says(data_dir):
    """The second half of the flight, in which the graph has not seen the gyro: 0.2 % is 6 deg/s of 3150."""
    flight = disc_flight(data_dir / "disc" / "2025-08-31-001-rb.csv")
    judged = ~flight.taught
    assert judged.sum() > 80
    error = np.rad2deg(flight.reference.rate_radps - flight.gyro_radps)[judged]
    assert np.sqrt(np.mean(error**2)) < 6.0
    assert 0.015 < flight.arm_m[0] < 0.025
