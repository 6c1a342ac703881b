"""Noise and sense that the estimators of a spin assume, and their values for a geometry.

Asghari et al. 2018, eq (25).
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from stillpoint.datasets.recording import Floats, SpinGeometry
from stillpoint.datasets.settings import Settings, choice, number
from stillpoint.datasets.spin import TERMS, SpinChannels, channels, coefficients


@dataclass(frozen=True)
class SpinParams(Settings):
    """Parameters that all estimators of a spin have."""

    radial_var_m2ps4: float = number(
        0.8, 1e-8, 1e6, "noise variance D4 of the accelerometers that see the square of the rate, (m/s^2)^2"
    )
    tangential_var_m2ps4: float = number(
        0.12, 1e-8, 1e6, "noise variance D5 of those that see more of the angular acceleration, (m/s^2)^2"
    )
    direction: Literal["positive", "negative"] = choice(
        "positive", "sense of the spin about x where no sensor tells it: a square has no sign"
    )
    saturated: Literal["skip", "use"] = choice(
        "skip", "samples at the range of their accelerometer: left out, or used as in Asghari et al. 2018"
    )


class Noise(NamedTuple):
    """Variances of the two observations, and the sense to assume."""

    accel_var: float  # Q of (25), (rad/s^2)^2
    square_var: float  # R of (25), (rad^2/s^2)^2
    sense: int  # +1 or -1


def _accel_variances(params: SpinParams, geometry: SpinGeometry) -> Floats:
    """Return the noise variance (k,) of each accelerometer, by which observation it sees more of in m/s^2 per 1/s^2."""
    seen = np.abs(coefficients(geometry))
    tangential = seen[:, TERMS.index("omega_x dot")] > seen[:, TERMS.index("omega_x^2")]
    return np.where(tangential, params.tangential_var_m2ps4, params.radial_var_m2ps4)


def make_channels(params: SpinParams, geometry: SpinGeometry) -> SpinChannels:
    """Return the observations of a geometry, weighted by the noise that the parameters state.

    Raises :class:`Unobservable` where it does not fix rate and angular acceleration.
    """
    return channels(geometry, _accel_variances(params, geometry))


def observation_noise(params: SpinParams, geometry: SpinGeometry) -> Noise:
    """Return Q and R of (25); raises :class:`Unobservable` where the geometry fixes neither rate nor acceleration."""
    by = make_channels(params, geometry)
    return Noise(by.q_rad2ps4, by.r_rad2ps4, 1 if params.direction == "positive" else -1)
