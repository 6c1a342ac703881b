"""Find where a spin is too slow for its squared rate to determine the rate.

The sd of a rate w from its square is that of the square over 2w while the square is nearly linear in w. Near zero it is
not, and the rate may change its sign unseen. A constant bias of the square then explains the data as well as a rate, so
that neither the graph's answer nor its sd can be trusted.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from stillpoint.datasets.errors import Unobservable
from stillpoint.datasets.recording import Floats
from stillpoint.smoother.spin.encoder import EncoderReadings
from stillpoint.smoother.spin.once_per_turn import Line
from stillpoint.smoother.spin.params import SpinCalibration
from stillpoint.smoother.spin.samples import SpinSamples

_MEDIAN_OF = 25  # samples of the squared rate: glitches do not move it
_OF_MEDIAN = np.sqrt(np.pi / 2 / _MEDIAN_OF)  # its sd, relative to that of a sample
_LEAST = 3.0  # sd of the squared rate, bias and noise together: below, the rate is known to worse than a sixth
_OF_GRAVITY = 1 / 3  # of its swing in the squared rate: below, the angle cannot be followed
_SOME = 0.1  # of the samples
_MOSTLY = 0.9  # of the samples of a stretch: below, its square swings
_APART_S = 1.0  # find_stretches nearer to each other are one


def smooth_squared(samples: SpinSamples) -> Floats:
    """Return the squared rate (N,) without glitches and most of its noise, interpolated where it is not valid."""
    rows = np.arange(len(samples))
    valid = samples.squared_valid
    squared = median_filter(samples.squared_rad2ps2[valid], _MEDIAN_OF, mode="nearest")
    return np.asarray(np.interp(rows, rows[valid], squared))


def find_least_squared(samples: SpinSamples, params: SpinCalibration, line: Line | None = None) -> float:
    """Return the squared rate, rad^2/s^2, below which it does not determine the rate."""
    bias = params.accel_bias_sd_mps2 * float(np.linalg.norm(samples.bias_per_accel[0]))
    least = _LEAST * float(np.hypot(bias, _OF_MEDIAN * samples.squared_sd))
    if line is not None and line.is_gravity:
        least += _OF_GRAVITY * line.gravity_mps2 * float(np.linalg.norm(samples.squared_gravity))
    return least


def require_spin(samples: SpinSamples, params: SpinCalibration, name: str) -> None:
    """Raise :class:`Unobservable` when a bias could explain the squared rate everywhere."""
    squared, least = smooth_squared(samples), find_least_squared(samples, params)
    if (squared > least).any():
        return
    median = float(np.median(squared))
    if (squared < -least).mean() > _SOME:
        raise Unobservable(
            f"{name}: the squared rate is negative throughout, {median:.0f} rad^2/s^2 in the median: turn the sign of "
            "the radial accelerometer, or its lever arm; `stillpoint doctor` tests it. At rest, gravity does the same"
        )
    raise Unobservable(
        f"{name}: no spin can be seen: the squared rate is {median:.2g} rad^2/s^2 in the median and nowhere above "
        f"{least:.2g}, which a bias may be; record a spin above {_root_degps(least):.0f} deg/s"
    )


def find_slow_stretch(
    samples: SpinSamples, squared_rad2ps2: Floats, least: float, readings: EncoderReadings | None, name: str
) -> Unobservable | None:
    """Return the error that names where the squared rate (N,) is below ``least``; None where it is not.

    Stretches with encoder readings are fast enough at any rate.
    """
    slow = squared_rad2ps2 < least
    if readings is not None and len(readings.k):
        slow[readings.k.min() - 1 : readings.k.max() + 1] = False  # k is never 0
    if not slow.any():
        return None
    t_s = (samples.t_ns - samples.t_ns[0]) / 1e9
    found = find_stretches(t_s, slow)
    first, last = max(found, key=lambda one: one[1] - one[0])
    more = f" (the longest of {len(found)} such find_stretches)" if len(found) > 1 else ""
    swings = samples.squared_gravity.any() and slow[(t_s >= first) & (t_s <= last)].mean() < _MOSTLY
    tilted = ", or a tilted axis lets gravity take its square down to that" if swings else ""
    return Unobservable(
        f"{name}: between {first:.2f} and {last:.2f} s{more} the spin rests, passes through zero or is slower than "
        f"{_root_degps(least):.0f} deg/s{tilted}: a square tells no rate there; "
        "cut the recording to what is faster (stillpoint cut)"
    )


def find_stretches(t_s: Floats, wanted: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Return start and end of the find_stretches where ``wanted``; those less than APART_S apart are joined."""
    times = t_s[wanted]
    breaks = np.flatnonzero(np.diff(times) > _APART_S)
    return list(zip(times[np.r_[0, breaks + 1]], times[np.r_[breaks, len(times) - 1]], strict=True))


def _root_degps(squared_rad2ps2: float) -> float:
    return float(np.rad2deg(np.sqrt(squared_rad2ps2)))
