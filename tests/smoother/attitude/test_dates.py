"""A date or place that the World Magnetic Models do not cover gives magnetic north, no dip test, and the reason."""

from dataclasses import replace

import pytest

from stillpoint.datasets.earth import local_field_n_ut
from stillpoint.datasets.simulate import simulate
from stillpoint.smoother import reference


@pytest.mark.parametrize("date", ["2033-05-01", pytest.param("1999-12-31", marks=pytest.mark.slow)])
def test_a_date_outside_the_model_gives_magnetic_north_and_no_dip_test(date):
    recording = simulate("phone-3", seed=1, minutes=1.5, rate_hz=50)
    later = replace(recording, base_pose=None, info=replace(recording.info, date=date))
    made = reference(later)
    assert made.diagnostics["heading"].startswith("magnetic north")
    assert made.diagnostics["sign_of_gravity"].startswith("not tested: date")
    assert local_field_n_ut(later.info) == (None, made.diagnostics["sign_of_gravity"].removeprefix("not tested: "))
