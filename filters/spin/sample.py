"""What goes into one step of an estimator of roll and what comes out, one by one and as columns (paper 000).

An estimator of roll is built as those of attitude are (:mod:`stillpoint.filters.sample`): ``Params``, ``Coefficients``,
``State``, compiled ``start``, ``step`` and ``run``. It is fed with the two observations that accelerometers on a
spinning body give: the angular acceleration and the square of the rate about the spin axis (eqs (4), (5), (26)).
"""

from math import pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.recording import Floats
from stillpoint.filters.compiled import compiled, like

TURN_RAD = 2.0 * pi


class RollSample(NamedTuple):
    """One stamp of the accelerometers. What is not valid (lost, saturated) is not looked at."""

    dt_s: float  # since the sample before
    accel_radps2: float  # angular acceleration at the stamp
    square_rad2ps2: float  # square of the rate; negative where its noise is larger than it
    accel_widened: float  # its variance by that which all accelerometers together leave it: 1, or more without one
    square_widened: float
    has_accel: bool
    has_square: bool
    direction: int  # +1, -1: the sense of the spin by gyros or further accelerometers; 0 where nothing tells


class Roll(NamedTuple):
    """Angle and rate with their covariance; the angle as whole turns and a rest, which single precision can hold."""

    turns: int
    rest_rad: float  # within +-half a turn
    rate_radps: float
    angle_var: float  # rad^2
    cross_var: float  # rad^2/s, of angle and rate
    rate_var: float  # rad^2/s^2


class RollOutput(NamedTuple):
    """What an estimator of roll says after a sample."""

    roll: Roll
    innovation: float  # normalised; NaN where there was no update
    ready: bool  # False while it is starting, and when it has lost its variance


class RollLog(NamedTuple):
    """N samples as columns."""

    dt_s: Floats
    accel_radps2: Floats
    square_rad2ps2: Floats
    accel_widened: Floats
    square_widened: Floats
    has_accel: NDArray[np.bool_]
    has_square: NDArray[np.bool_]
    direction: NDArray[np.int64]


class RollTrack(NamedTuple):
    """Where a batch run puts its outputs."""

    angle_rad: Floats  # (N,) unwrapped
    rate_radps: Floats
    angle_var: Floats
    rate_var: Floats
    innovation: Floats
    ready: NDArray[np.bool_]


@compiled
def no_roll(zero: float) -> Roll:
    """At angle and rate zero, before anything is known; ``zero`` gives the precision."""
    return Roll(0, zero, zero, zero, zero, zero)


@compiled
def turned(turns: int, rest_rad: float) -> tuple[int, float]:
    """The same angle with its rest within half a turn."""
    whole = round(rest_rad / TURN_RAD)
    if whole == 0:
        return turns, rest_rad
    return turns + whole, rest_rad - TURN_RAD * like(rest_rad, whole)


@compiled
def roll_sample_at(log: RollLog, k: int) -> RollSample:
    """Sample ``k`` of the columns."""
    return RollSample(
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
def angle_of(roll: Roll) -> float:
    """The unwrapped angle in rad, in double precision."""
    return roll.turns * TURN_RAD + roll.rest_rad


@compiled
def keep_roll(track: RollTrack, k: int, output: RollOutput) -> None:
    """Put output ``k`` into the columns."""
    roll = output.roll
    track.angle_rad[k] = angle_of(roll)
    track.rate_radps[k] = roll.rate_radps
    track.angle_var[k] = roll.angle_var
    track.rate_var[k] = roll.rate_var
    track.innovation[k] = output.innovation
    track.ready[k] = output.ready


def empty_track(n: int) -> RollTrack:
    """Columns for n outputs."""
    angle, rate, angle_var, rate_var, innovation = np.empty((5, n))
    return RollTrack(angle, rate, angle_var, rate_var, innovation, np.empty(n, dtype=np.bool_))
