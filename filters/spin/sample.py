"""The input and the output of one step of an estimator of a spin, as single values and as columns.

Asghari et al. 2018. An estimator of a spin is built as those of attitude are (:mod:`stillpoint.filters.sample`):
``Params``, ``Coefficients``, ``State``, compiled ``start`` and ``step``. Its inputs are the two observations that
accelerometers on a spinning body give: the angular acceleration and the square of the rate about the spin axis (eqs
(4), (5), (26)).
"""

from math import pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.compiled import compiled, like
from stillpoint.datasets.recording import Floats

_TURN_RAD = 2.0 * pi
_DOUBLE_TURN_RAD = np.float64(_TURN_RAD)  # also in single precision


class SpinSample(NamedTuple):
    """One stamp of the accelerometers. Values that are not valid (lost, saturated) are not used."""

    dt_s: float  # since the sample before
    accel_radps2: float  # angular acceleration at the stamp
    square_rad2ps2: float  # square of the rate; negative where its noise is larger than it
    accel_widened: float  # its variance by that which all accelerometers together leave it: 1, or more without one
    square_widened: float
    has_accel: bool
    has_square: bool
    direction: int  # +1, -1: the sense of the spin by gyros or further accelerometers; 0 where nothing tells


class SpinMotion(NamedTuple):
    """Angle and rate with their covariance; the angle as whole turns and a rest, which single precision can hold."""

    turns: int
    rest_rad: float  # within +-half a turn
    rate_radps: float
    angle_var: float  # rad^2
    cross_var: float  # rad^2/s, of angle and rate
    rate_var: float  # rad^2/s^2


class SpinOutput(NamedTuple):
    """The output of an estimator of a spin after a sample."""

    motion: SpinMotion
    innovation: float  # normalised; NaN where there was no update
    ready: bool  # False while it is starting, and when it has lost its variance


class SpinLog(NamedTuple):
    """N samples as columns."""

    dt_s: Floats
    accel_radps2: Floats
    square_rad2ps2: Floats
    accel_widened: Floats
    square_widened: Floats
    has_accel: NDArray[np.bool_]
    has_square: NDArray[np.bool_]
    direction: NDArray[np.int64]


class SpinTrack(NamedTuple):
    """Columns for the outputs of a batch run."""

    angle_rad: Floats  # (N,) unwrapped
    rate_radps: Floats
    angle_var: Floats
    rate_var: Floats
    innovation: Floats
    ready: NDArray[np.bool_]


@compiled
def start_motion(zero: float) -> SpinMotion:
    """Return angle and rate 0, before anything is known; ``zero`` gives the precision."""
    return SpinMotion(0, zero, zero, zero, zero, zero)


@compiled
def wrap_angle(turns: int, rest_rad: float) -> tuple[int, float]:
    """Return the same angle with its rest within half a turn."""
    whole = round(rest_rad / _TURN_RAD)
    if whole == 0:
        return turns, rest_rad
    return turns + whole, rest_rad - _TURN_RAD * like(rest_rad, whole)


@compiled
def read_spin_sample(log: SpinLog, k: int) -> SpinSample:
    """Return sample ``k`` of the columns."""
    return SpinSample(
        log.dt_s[k],
        log.accel_radps2[k],
        log.square_rad2ps2[k],
        log.accel_widened[k],
        log.square_widened[k],
        log.has_accel[k],
        log.has_square[k],
        log.direction[k],
    )


@compiled
def unwrap_angle(motion: SpinMotion) -> float:
    """Return the unwrapped angle in rad, in double precision."""
    return motion.turns * _DOUBLE_TURN_RAD + motion.rest_rad


@compiled
def write_spin_output(track: SpinTrack, k: int, output: SpinOutput) -> None:
    """Write output ``k`` into the columns."""
    motion = output.motion
    track.angle_rad[k] = unwrap_angle(motion)
    track.rate_radps[k] = motion.rate_radps
    track.angle_var[k] = motion.angle_var
    track.rate_var[k] = motion.rate_var
    track.innovation[k] = output.innovation
    track.ready[k] = output.ready


def empty_track(n: int) -> SpinTrack:
    """Return columns for n outputs."""
    angle, rate, angle_var, rate_var, innovation = np.empty((5, n))
    return SpinTrack(angle, rate, angle_var, rate_var, innovation, np.empty(n, dtype=np.bool_))
