"""A reference's path as KML, for Google Earth and other maps."""

from xml.sax.saxutils import escape

import numpy as np

from stillpoint.datasets.earth import to_geodetic
from stillpoint.datasets.errors import BadRecording
from stillpoint.datasets.trajectory import Reference

_POINTS_PER_S = 10.0  # at most: a map shows no more


def format_kml(made: Reference) -> str:
    """Return the path as one line of longitude, latitude and height above the ellipsoid.

    Raises :class:`BadRecording` for a reference without positions.
    """
    if made.position_n_m is None or made.origin_lat_lon_alt is None:
        raise BadRecording(f"{made.name}: has no positions; a reference has them where its recording has satellites")
    cell = np.floor((made.t_ns - made.t_ns[0]) / 1e9 * _POINTS_PER_S)
    rows = np.flatnonzero(np.diff(cell, prepend=-1.0))
    lat_deg, lon_deg, height_m = to_geodetic(made.position_n_m[rows], made.origin_lat_lon_alt)
    points = " ".join(
        f"{lon:.9f},{lat:.9f},{height:.3f}" for lon, lat, height in zip(lon_deg, lat_deg, height_m, strict=True)
    )
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2"><Document>\n'
        f"<name>{escape(made.name)}</name>\n<Placemark><name>{escape(made.name)} ({escape(made.method)})</name>\n"
        f"<LineString><altitudeMode>absolute</altitudeMode><coordinates>{points}</coordinates></LineString>\n"
        "</Placemark>\n</Document></kml>\n"
    )
