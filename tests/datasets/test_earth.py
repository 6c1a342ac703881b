"""The Earth: NOAA's and NIMA's published values, and refusals instead of extrapolation."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stillpoint.datasets.earth import (
    compute_magnetic_field_n_ut,
    declination_rad,
    enu_m,
    normal_gravity_mps2,
    to_decimal_year,
    to_geodetic,
)
from stillpoint.datasets.errors import BadParameter

# date, height km, latitude, longitude, X (north), Y (east), Z (down) in nT: the test values that NOAA publishes with
# the models (WMM2015v2testvalues.pdf, WMM2020testvalues.pdf, WMM2025_TEST_VALUES.txt).
NOAA = [
    ("2015-01-01", 0, 80, 0, 6636.6, -451.9, 54408.9),
    ("2015-01-01", 0, 0, 120, 39521.1, 377.7, -11228.8),
    ("2017-07-02T12:00", 100, -80, 240, 5674.9, 14793.1, -50179.5),
    ("2020-01-01", 0, 80, 0, 6570.4, -146.3, 54606.0),
    ("2020-01-01", 0, 0, 120, 39624.3, 109.9, -10932.5),
    ("2020-01-01", 0, -80, 240, 5940.6, 15772.1, -52480.8),
    ("2020-01-01", 100, 80, 0, 6261.8, -185.5, 52429.1),
    ("2020-01-01", 100, 0, 120, 37636.7, 104.9, -10474.8),
    ("2020-01-01", 100, -80, 240, 5744.9, 14799.5, -49969.4),
    ("2022-07-02T12:00", 0, 80, 0, 6529.9, 1.1, 54713.4),
    ("2022-07-02T12:00", 0, 0, 120, 39684.7, -42.2, -10809.5),
    ("2022-07-02T12:00", 0, -80, 240, 6016.5, 15776.7, -52251.6),
    ("2022-07-02T12:00", 100, 80, 0, 6224.0, -44.5, 52527.0),
    ("2022-07-02T12:00", 100, 0, 120, 37694.0, -35.3, -10362.0),
    ("2022-07-02T12:00", 100, -80, 240, 5815.0, 14803.0, -49755.3),
    ("2025-01-01", 0, 80, 0, 6521.6, 145.9, 54791.5),
    ("2025-01-01", 0, 0, 120, 39677.8, -109.6, -10580.2),
    ("2025-01-01", 0, -80, 240, 6117.5, 15751.9, -52022.5),
    ("2025-01-01", 100, 80, 0, 6216.0, 92.4, 52598.8),
    ("2027-07-02T12:00", 0, 80, 0, 6500.8, 294.5, 54869.4),
    ("2027-07-02T12:00", 0, 0, 120, 39701.6, -167.4, -10381.8),
]


@pytest.mark.parametrize(("date", "height_km", "lat", "lon", "north", "east", "down"), NOAA)
def test_the_field_equals_the_values_of_noaa(date, height_km, lat, lon, north, east, down):
    place = (lat, lon, height_km * 1000.0)
    # 0.05 nT is the rounding of the published values.
    np.testing.assert_allclose(
        compute_magnetic_field_n_ut(place, date) * 1000, [east, north, -down], rtol=0, atol=0.051
    )
    assert declination_rad(place, date) == pytest.approx(np.arctan2(east, north), abs=2e-5)


def test_declination_is_east_positive():
    assert np.rad2deg(declination_rad((47.6205, -122.3493, 0.0), "2025-04-02")) == pytest.approx(15.07, abs=0.01)


@pytest.mark.parametrize("date", ["2009-12-31T23:59:59", "2030-01-01", "2030-01-01T00:30:00+00:00", "1999-05-05"])
def test_dates_outside_the_models_are_refused(date):
    with pytest.raises(BadParameter, match=date[:4]):
        compute_magnetic_field_n_ut((50.0, 8.0, 100.0), date)


def test_the_first_and_last_moment_of_the_models_are_served():
    compute_magnetic_field_n_ut((50.0, 8.0, 100.0), "2010-01-01")
    compute_magnetic_field_n_ut((50.0, 8.0, 100.0), "2029-12-31T23:59:59")


@pytest.mark.parametrize(
    "place", [(91.0, 0.0, 0.0), (0.0, 400.0, 0.0), (50.0, 8.0, -2000.0), (50.0, 8.0, 900e3), (np.nan, 8.0, 0.0)]
)
def test_places_outside_the_model_are_refused(place):
    with pytest.raises(BadParameter):
        compute_magnetic_field_n_ut(place, "2021-06-12")


def test_the_magnetic_pole_has_no_declination():
    # The WMM2020 north dip pole in 2021: 86.4 N, 156.8 E. The field itself is still known there.
    place = (86.4, 156.8, 0.0)
    assert np.linalg.norm(compute_magnetic_field_n_ut(place, "2021-01-01")) > 50
    with pytest.raises(BadParameter, match="magnetic pole"):
        declination_rad(place, "2021-01-01")


@pytest.mark.parametrize("date", ["yesterday", "", "12.06.2021", "2021-13-01"])
def test_dates_that_do_not_exist_are_refused(date):
    with pytest.raises(BadParameter, match="ISO 8601"):
        to_decimal_year(date)


def test_decimal_year_counts_in_utc_and_knows_leap_years():
    assert to_decimal_year("2020-07-02") == 2020.5  # 183 of 366 days
    assert to_decimal_year("2021-01-01T01:00:00+02:00") < 2021.0
    assert to_decimal_year("2021-12-31T23:00:00-02:00") > 2022.0


@pytest.mark.parametrize(
    ("lat_deg", "height_m", "gravity", "within"),
    [
        (0.0, 0.0, 9.7803253359, 1e-12),  # NIMA TR8350.2, table 3.4
        (90.0, 0.0, 9.8321849378, 1e-9),  # the same; k has 12 digits
        (-90.0, 0.0, 9.8321849378, 1e-9),
        (55.0, 5000.0, 9.7997, 5e-5),  # example of MATLAB's gravitywgs84, Taylor series
    ],
)
def test_normal_gravity_is_the_published(lat_deg, height_m, gravity, within):
    assert normal_gravity_mps2(lat_deg, height_m) == pytest.approx(gravity, abs=within)


def test_gravity_falls_with_height_by_the_free_air_gradient():
    gradient = (normal_gravity_mps2(45.0, 100.0) - normal_gravity_mps2(45.0, 0.0)) / 100
    assert gradient == pytest.approx(-3.086e-6, abs=2e-9)  # 0.3086 mGal/m, any textbook


def test_gravity_falls_less_and_less():
    """As Newton's g a^2 / (a + h)^2 does, whose second derivative is 6 g / a^2."""
    at_m = [normal_gravity_mps2(45.0, h) for h in (0.0, 10_000.0, 20_000.0)]
    curvature = (at_m[0] - 2 * at_m[1] + at_m[2]) / 1e8
    assert curvature == pytest.approx(6 * 9.806 / 6.371e6**2, rel=0.01, abs=0)


@pytest.mark.parametrize(("lat_deg", "height_m"), [(95.0, 0.0), (45.0, 30_000.0), (45.0, np.nan)])
def test_gravity_outside_its_formula_is_refused(lat_deg, height_m):
    with pytest.raises(BadParameter):
        normal_gravity_mps2(lat_deg, height_m)


@given(
    lat=st.floats(-89, 89),
    lon=st.floats(-179, 179),
    offset=st.tuples(*[st.floats(-5000, 5000)] * 3),
)
def test_local_positions_convert_there_and_back(lat, lon, offset):
    origin = (lat, lon, 300.0)
    back = enu_m(*to_geodetic([offset], origin), origin)
    np.testing.assert_allclose(back, [offset], atol=1e-6)


def test_local_axes_are_east_north_up():
    metres = enu_m([45.0, 45.001, 45.0], [9.001, 9.0, 9.0], [0.0, 0.0, 7.0], (45.0, 9.0, 0.0))
    # A thousandth of a degree at 45 deg: 78.8 m along the parallel, 111.1 m along the meridian.
    np.testing.assert_allclose(metres, [[78.85, 0, 0], [0, 111.13, 0], [0, 0, 7]], atol=0.02)


def test_positions_that_are_not_known_stay_unknown():
    assert np.isnan(enu_m([np.nan], [9.0], [0.0], (45.0, 9.0, 0.0))).any()
