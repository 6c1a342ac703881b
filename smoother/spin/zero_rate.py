"""Where a spin is too slow for its square to tell the rate.

The sd of a rate w from its square is that of the square over 2w, as far as w may be taken to be straight there: near
zero it may not, and the sign of the rate may change unseen. A constant bias of the square is then as good an
explanation as a rate, so that what the graph finds there, and states of it, is worth nothing.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from stillpoint.datasets.errors import Unobservable
from stillpoint.datasets.recording import Floats
from stillpoint.smoother.spin.encoder import EncoderReadings
from stillpoint.smoother.spin.once_per_turn import Line
from stillpoint.smoother.spin.params import RollCalibration
from stillpoint.smoother.spin.samples import RollSamples

MEDIAN_OF = 25  # samples of the squared rate: a glitch, or a run of them, does not move it
OF_MEDIAN = np.sqrt(np.pi / 2 / MEDIAN_OF)  # its sd, of that of a sample
LEAST = 3.0  # sd of the squared rate, bias and noise together: at less the rate is known to worse than a sixth
OF_GRAVITY = 1 / 3  # of its swing in the squared rate: at less the angle it is followed along is not to be found
SOME = 0.1  # of the samples
MOSTLY = 0.9  # of the samples of a stretch: at less its square swings
APART_S = 1.0  # stretches nearer to each other are one


def smooth_squared(samples: RollSamples) -> Floats:
    """The squared rate (N,) without its glitches and most of its noise, filled up where it is not valid."""
    rows = np.arange(len(samples))
    valid = samples.squared_valid
    squared = median_filter(samples.squared_rad2ps2[valid], MEDIAN_OF, mode="nearest")
    return np.asarray(np.interp(rows, rows[valid], squared))


def least_squared(samples: RollSamples, params: RollCalibration, line: Line | None = None) -> float:
    """The squared rate, rad^2/s^2, below which it does not tell the rate."""
    bias = params.accel_bias_sd_mps2 * float(np.linalg.norm(samples.bias_per_accel[0]))
    least = LEAST * float(np.hypot(bias, OF_MEDIAN * samples.squared_sd))
    if line is not None and line.is_gravity:
        least += OF_GRAVITY * line.gravity_mps2 * float(np.linalg.norm(samples.squared_gravity))
    return least


def require_spin(samples: RollSamples, params: RollCalibration, name: str) -> None:
    """Raise :class:`Unobservable` where the squared rate is nowhere above what a bias makes of it."""
    squared, least = smooth_squared(samples), least_squared(samples, params)
    if (squared > least).any():
        return
    median = float(np.median(squared))
    if (squared < -least).mean() > SOME:
        raise Unobservable(
            f"{name}: the squared rate is negative throughout, {median:.0f} rad^2/s^2 in the median: turn the sign of "
            "the radial accelerometer, or its lever arm; `stillpoint doctor` tests it. At rest, gravity does the same"
        )
    raise Unobservable(
        f"{name}: no spin is to be seen: the squared rate is {median:.2g} rad^2/s^2 in the median and nowhere above "
        f"{least:.2g}, which a bias may be; record a spin above {_degps(least):.0f} deg/s"
    )


def too_slow(
    samples: RollSamples, squared_rad2ps2: Floats, least: float, readings: EncoderReadings | None, name: str
) -> Unobservable | None:
    """The error that names where the squared rate (N,) is below the least one; None where it is not.

    While an encoder is read, it tells the rate.
    """
    slow = squared_rad2ps2 < least
    if readings is not None and len(readings.k):
        slow[readings.k.min() - 1 : readings.k.max() + 1] = False  # k is never 0
    if not slow.any():
        return None
    t_s = (samples.t_ns - samples.t_ns[0]) / 1e9
    found = stretches(t_s, slow)
    first, last = max(found, key=lambda one: one[1] - one[0])
    more = f" (the longest of {len(found)} such stretches)" if len(found) > 1 else ""
    swings = samples.squared_gravity.any() and slow[(t_s >= first) & (t_s <= last)].mean() < MOSTLY
    tilted = ", or a tilted axis lets gravity take its square down to that" if swings else ""
    return Unobservable(
        f"{name}: between {first:.2f} and {last:.2f} s{more} the spin rests, passes through zero or is slower than "
        f"{_degps(least):.0f} deg/s{tilted}: a square tells no rate there; cut the recording to what is faster"
    )


def stretches(t_s: Floats, wanted: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """From when to when; those less than APART_S apart are one."""
    times = t_s[wanted]
    breaks = np.flatnonzero(np.diff(times) > APART_S)
    return list(zip(times[np.r_[0, breaks + 1]], times[np.r_[breaks, len(times) - 1]], strict=True))


def _degps(squared_rad2ps2: float) -> float:
    return float(np.rad2deg(np.sqrt(squared_rad2ps2)))
