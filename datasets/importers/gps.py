"""Satellite fixes as the phone apps and bags give them."""

import numpy as np

from stillpoint.datasets.importers.clock import Log, Series, rising
from stillpoint.datasets.recording import Gps

COLUMNS = ("latitude", "longitude", "altitude", "bearing", "speed")  # deg, deg, m, deg clockwise from north, m/s


def fixes(series: Series, log: Log) -> Gps:
    """A :class:`Gps` of rows in the order of ``COLUMNS``; a negative bearing or speed means that it is unknown."""
    series = rising(series, "gps", log)
    lat, lon, alt, bearing, speed = series.values.T
    valid = np.isfinite(lat) & np.isfinite(lon)
    course_rad = np.where(bearing >= 0, np.deg2rad(np.maximum(bearing, 0.0)), np.nan)
    speed_mps = np.where(speed >= 0, speed, np.nan)
    log.converted("gps bearing deg -> course rad, clockwise from true north")
    return Gps(series.t_ns, lat, lon, alt, course_rad, speed_mps, valid)
