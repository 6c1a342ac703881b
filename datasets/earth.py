"""Model the Earth at a recording's place: magnetic field, normal gravity, and local East-North-Up positions.

A place is geodetic (WGS 84): latitude and longitude in deg, height above the ellipsoid in m. Dates are ISO 8601 in UTC.
"""

from datetime import UTC, datetime
from functools import lru_cache

import numpy as np
import pymap3d
from numpy.typing import ArrayLike
from pygeomag import GeoMag

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.recording import Floats, Info

Place = tuple[float, float, float]

FIELD_YEARS = (2010.0, 2030.0)  # the World Magnetic Models of 2010, 2015v2, 2020 and 2025, five years each
_FIELD_HEIGHT_M = (-1000.0, 850_000.0)  # WMM technical report, section 1.2
_BLACKOUT_UT = 2.0  # a smaller horizontal field gives no usable declination (WMM technical report, section 1.9)


def to_decimal_year(date: str) -> float:
    """Return an ISO date as a decimal year: 2022.5 for ``"2022-07-02T12:00"``; a date without a zone is UTC. Raises
    :class:`BadParameter`.
    """
    try:
        when = datetime.fromisoformat(date)
    except ValueError as error:
        raise BadParameter(f"date {date!r}: is not an ISO 8601 date; write it like 2021-06-12") from error
    when = when.replace(tzinfo=UTC) if when.tzinfo is None else when.astimezone(UTC)
    first, following = datetime(when.year, 1, 1, tzinfo=UTC), datetime(when.year + 1, 1, 1, tzinfo=UTC)
    return when.year + (when - first) / (following - first)


def compute_magnetic_field_n_ut(place: Place, date: str) -> Floats:
    """Return the field of the World Magnetic Model in East-North-Up, (3,) in uT.

    Raises :class:`BadParameter` for a date or place outside the models: the field is never extrapolated.
    """
    lat_deg, lon_deg, height_m = _check_place(place)
    year = to_decimal_year(date)
    if not FIELD_YEARS[0] <= year < FIELD_YEARS[1]:
        raise BadParameter(
            f"date {date}: the World Magnetic Models at hand hold from {FIELD_YEARS[0]:.0f} to the end of "
            f"{FIELD_YEARS[1] - 1:.0f}; give a date within, or leave the declination out"
        )
    if not _FIELD_HEIGHT_M[0] <= height_m <= _FIELD_HEIGHT_M[1]:
        raise BadParameter(
            f"height {height_m:g} m: the World Magnetic Model holds from -1 to 850 km; give the height in metres"
        )
    field = _load_model(int(year)).calculate(glat=lat_deg, glon=lon_deg, alt=height_m / 1000, time=year)
    return np.array([field.y, field.x, -field.z]) / 1000.0


def declination_rad(place: Place, date: str) -> float:
    """Return the angle from true to magnetic north, east positive.

    Raises :class:`BadParameter` as :func:`compute_magnetic_field_n_ut` does, and near the magnetic poles.
    """
    east, north, _ = compute_magnetic_field_n_ut(place, date)
    if np.hypot(east, north) < _BLACKOUT_UT:
        raise BadParameter(
            f"place {place[0]:g}, {place[1]:g}: the horizontal field is under {_BLACKOUT_UT:g} uT, close to a "
            "magnetic pole; there is no usable declination"
        )
    return float(np.arctan2(east, north))


def local_declination(info: Info) -> tuple[float, str]:
    """Return the declination (rad) where and when a recording was made, and which north that gives.

    0, and the reason, where place or date is not known or the model does not hold.
    """
    if info.place_lat_lon_alt is None or not info.date:
        return 0.0, "magnetic north: the date or place is not known"
    try:
        declination = declination_rad(info.place_lat_lon_alt, info.date)
    except BadParameter as error:
        return 0.0, f"magnetic north: {error}"
    lat_deg, lon_deg, _ = info.place_lat_lon_alt
    return declination, f"true north: World Magnetic Model at {lat_deg:g}, {lon_deg:g} deg on {info.date}"


def local_field_n_ut(info: Info) -> tuple[Floats | None, str]:
    """Return the field (3,) in uT where and when a recording was made, or None and the reason.

    It is None where place or date is not known, or lies outside the World Magnetic Models.
    """
    if info.place_lat_lon_alt is None or not info.date:
        return None, "the date or place is not known"
    try:
        return compute_magnetic_field_n_ut(info.place_lat_lon_alt, info.date), ""
    except BadParameter as error:
        return None, str(error)


def normal_gravity_mps2(lat_deg: float, height_m: float) -> float:
    """Return the size of normal gravity: Somigliana's formula on the ellipsoid, Taylor series in height above it.

    Source: NIMA TR8350.2 (WGS 84), third edition, eqs (4-1) and (4-3) with the constants of its chapter 3.
    Raises :class:`BadParameter` for a latitude beyond the poles or a height the series is not meant for (over 20 km).
    """
    lat_deg, _, height_m = _check_place((lat_deg, 0.0, height_m))
    if abs(height_m) > 20_000:
        raise BadParameter(f"height {height_m:g} m: normal gravity is given up to 20 km; give the height in metres")
    equator, k, e2 = 9.7803253359, 0.00193185265241, 0.00669437999014
    a, f, m = 6378137.0, 1 / 298.257223563, 0.00344978650684
    sin2 = np.sin(np.deg2rad(lat_deg)) ** 2
    surface = equator * (1 + k * sin2) / np.sqrt(1 - e2 * sin2)
    return float(surface * (1 - 2 / a * (1 + f + m - 2 * f * sin2) * height_m + 3 / a**2 * height_m**2))


def enu_m(lat_deg: ArrayLike, lon_deg: ArrayLike, height_m: ArrayLike, origin: Place) -> Floats:
    """Return positions (N, 3) in m, East-North-Up of ``origin``; NaN stays NaN."""
    lat0, lon0, height0 = _check_place(origin)
    return np.stack(pymap3d.geodetic2enu(lat_deg, lon_deg, height_m, lat0, lon0, height0), axis=-1).astype(np.float64)


def to_geodetic(position_n_m: ArrayLike, origin: Place) -> tuple[Floats, Floats, Floats]:
    """Return latitude and longitude (deg) and height (m) of positions (N, 3) in East-North-Up of ``origin``."""
    east, north, up = np.moveaxis(np.asarray(position_n_m, dtype=np.float64), -1, 0)
    lat_deg, lon_deg, height_m = pymap3d.enu2geodetic(east, north, up, *_check_place(origin))
    return np.asarray(lat_deg), np.asarray(lon_deg), np.asarray(height_m)


def _check_place(place: Place) -> Place:
    """Return the place; raises :class:`BadParameter` for a latitude or longitude out of range."""
    lat_deg, lon_deg, height_m = place
    if not (np.isfinite(place).all() and abs(lat_deg) <= 90 and abs(lon_deg) <= 360):
        raise BadParameter(
            f"place {lat_deg:g}, {lon_deg:g}, {height_m:g}: latitude is within +-90 deg, longitude within +-360 deg; "
            "give degrees, degrees, metres"
        )
    return lat_deg, lon_deg, height_m


@lru_cache(maxsize=8)
def _load_model(year: int) -> GeoMag:
    return GeoMag(base_year=year)
