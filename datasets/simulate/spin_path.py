"""Describe the true motion of a spinning body: angle, rate and acceleration as exact derivatives of one another.

The drive's rate is a spline; the shaft follows it with a ripple once per turn: angle = drive + e sin(drive + phase).
In flight the axis cones: the rates about y and z turn with the drive, and the centre is braked.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator, PPoly
from scipy.signal import lfilter

from stillpoint.datasets.recording import Floats
from stillpoint.datasets.simulate.generators import make_generator

_KNOT_S = 0.02  # between the knots of the drive's rate
_RIPPLE_AT_DEGPS = 2020.0  # the speed at which the ripple once per turn has its stated size


@dataclass(frozen=True)
class Motor:
    """The rate profile of a driven shaft."""

    speed_degps: Callable[[Floats], Floats]  # at times in s
    ripple_degps: float  # standard deviation of the controller's slow wandering
    ripple_s: float = 0.5  # its time constant (a first-order lag, twice)
    once_per_turn_degps: float = 1.0  # amplitude of the ripple at 2020 deg/s, in proportion at other speeds


@dataclass(frozen=True)
class Flight:
    """The motion of a flying body beside its spin; in free flight no accelerometer measures gravity."""

    coning_degps: float = 100.0  # size of the rate across the axis, at first
    coning_ratio: float = 0.9  # turns of that rate in the body, per turn of the body
    drag_mps2: float = 30.0  # along -x, at first
    lift_mps2: float = 3.0  # across the axis, turning with the coning
    decay_s: float = 20.0  # time constant of all of these


@dataclass(frozen=True, eq=False)
class SpinPath:
    """The motion at any time from 0 to its length."""

    drive_rad: PPoly  # the drive's angle, 0 at time 0
    ripple: float  # e, rad
    phase_rad: float

    def angle_rad(self, t_s: Floats) -> Floats:
        """Return the body's angle (N,) about its axis, unwrapped, 0 at time 0."""
        drive = self.drive_rad(t_s)
        return np.asarray(drive + self.ripple * (np.sin(drive + self.phase_rad) - np.sin(self.phase_rad)))

    def rate_radps(self, t_s: Floats) -> Floats:
        """Return the derivative of the angle (N,)."""
        return np.asarray(self.drive_rad(t_s, 1) * (1 + self.ripple * np.cos(self.drive_rad(t_s) + self.phase_rad)))

    def accel_radps2(self, t_s: Floats) -> Floats:
        """Return the derivative of the rate (N,)."""
        at, drive_radps = self.drive_rad(t_s) + self.phase_rad, self.drive_rad(t_s, 1)
        changing = self.drive_rad(t_s, 2) * (1 + self.ripple * np.cos(at))
        return np.asarray(changing - drive_radps**2 * self.ripple * np.sin(at))


def compute_constant_speed(t_s: Floats) -> Floats:
    """Return the constant speed of Asghari et al. (2018), section 4.1: 2020 deg/s."""
    return np.full(len(t_s), 2020.0)


def compute_variable_speed(t_s: Floats) -> Floats:
    """Return slow changes between 1500 and 2100 deg/s, as in figure 18; after 60 s the profile runs back, and so on."""
    known = PchipInterpolator([0, 8, 18, 26, 38, 48, 60], [1550, 1550, 2080, 2080, 1520, 1900, 1900])
    return np.asarray(known(60 - np.abs(np.mod(t_s, 120) - 60)))


def compute_decaying_speed(t_s: Floats) -> Floats:
    """Return the spin of a projectile that air slows: 2050 deg/s, half of it lost in 90 s."""
    return np.asarray(2050 * 0.5 ** (t_s / 90))


def make_path(motor: Motor, length_s: float, seed: int) -> SpinPath:
    """Return the path of a motor, or of a body that air slows."""
    knots_s = np.arange(int(np.ceil(length_s / _KNOT_S)) + 5) * _KNOT_S - 2 * _KNOT_S
    speed_degps = motor.speed_degps(np.maximum(knots_s, 0)) + motor.ripple_degps * _draw_wander(
        motor.ripple_s, len(knots_s), seed
    )
    drive = CubicSpline(knots_s, np.deg2rad(speed_degps)).antiderivative()
    drive.c[-1] -= drive(0.0)
    phase = make_generator(seed, "spin/phase").uniform(0, 2 * np.pi)
    return SpinPath(drive, motor.once_per_turn_degps / _RIPPLE_AT_DEGPS, phase)


def _draw_wander(time_s: float, count: int, seed: int) -> Floats:
    """Return white noise through two first-order lags, of unit standard deviation in the long run."""
    keep = np.exp(-_KNOT_S / time_s)
    settle = int(10 * time_s / _KNOT_S)
    noise = make_generator(seed, "spin/ripple").standard_normal(settle + count)
    twice = lfilter([1.0], [1.0, -2 * keep, keep**2], noise)[settle:]
    return np.asarray(twice * np.sqrt((1 - keep**2) ** 3 / (1 + keep**2)))


def compute_coning_radps(flight: Flight, path: SpinPath, t_s: Floats) -> tuple[Floats, Floats]:
    """Return the rates about y and z (N, 2) and their derivatives (N, 2)."""
    size = np.deg2rad(flight.coning_degps) * np.exp(-t_s / flight.decay_s)
    at, speed = flight.coning_ratio * path.drive_rad(t_s), flight.coning_ratio * path.drive_rad(t_s, 1)
    along, across = np.column_stack([np.cos(at), np.sin(at)]), np.column_stack([-np.sin(at), np.cos(at)])
    rate = size[:, None] * along
    return rate, np.asarray(-rate / flight.decay_s + (size * speed)[:, None] * across)


def compute_braking_b_mps2(flight: Flight, path: SpinPath, t_s: Floats) -> Floats:
    """Return the specific force at the centre in flight (N, 3): drag along -x, lift across."""
    decay, at = np.exp(-t_s / flight.decay_s), flight.coning_ratio * path.drive_rad(t_s)
    lift = flight.lift_mps2 * decay
    return np.column_stack([-flight.drag_mps2 * decay, lift * np.cos(at), lift * np.sin(at)])
