"""The recording in which tests of the doctor plant their faults."""

import pytest
from resting import cut

from stillpoint.datasets import Recording
from stillpoint.datasets.simulate import simulate


@pytest.fixture(scope="package")
def phone() -> Recording:
    """10 s of rest and 30 s of violent motion at 50 Hz, without a fault."""
    return cut(simulate("phone-3", seed=0, minutes=1.9, rate_hz=50.0), 50, 90)
