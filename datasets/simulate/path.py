"""Describe a true motion: attitude and position as polynomials of time, whose derivatives are exact.

Both are chains of strokes. A stroke takes a coordinate from one value to the next along the polynomial of degree five
that starts and ends with zero velocity and acceleration, the minimum-jerk movement of the human arm (Flash and Hogan,
J. Neuroscience 5, 1985). A stroke between equal values is a rest, and is exactly still.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BPoly
from scipy.spatial.transform import Rotation

from stillpoint.datasets.frames import compose, rotation
from stillpoint.datasets.recording import Floats


class Motion(Protocol):
    """The quantities of a true motion that sensors measure; times (N,) are seconds from its start."""

    @property
    def duration_s(self) -> float:
        """Its length."""

    @property
    def rests_s(self) -> Floats:
        """Rests (R, 2): from, to."""

    def attitude(self, t_s: ArrayLike) -> Rotation:
        """Return the attitude, body to n."""

    def steps_b_rad(self, t_s: Floats) -> Floats:
        """Return rotation vectors (N - 1, 3) from the attitude at each time to that at the next."""

    def position(self, t_s: ArrayLike) -> Floats:
        """Return the position in n, (N, 3) in m."""

    def acceleration_n_mps2(self, t_s: ArrayLike) -> Floats:
        """Return the second derivative of the position, (N, 3)."""

    def moving(self, t_s: ArrayLike) -> NDArray[np.bool_]:
        """Return whether a time lies outside all rests."""


def join_strokes(times_s: ArrayLike, values: ArrayLike) -> BPoly:
    """Return the chain of minimum-jerk strokes through ``values`` (K, d) at rising ``times_s`` (K,)."""
    points = np.asarray(values, dtype=np.float64)
    start, end = points[:-1], points[1:]
    # In Bernstein form three equal coefficients at an end mean zero first and second derivative there.
    return BPoly(np.stack([start, start, start, end, end, end]), np.asarray(times_s, dtype=np.float64))


@dataclass(frozen=True, eq=False)
class Path:
    """Attitude q_nb = base * exp(turn) and position, with exact derivatives.

    Times are seconds from the start of the path. The path is at rest at both ends, and stays there before and after.
    The position is that of the sensor, at ``arm_b_m`` from the point that the chains of places move; it is 0 at first.
    """

    base_q_nb: Floats  # (4,) wxyz
    turn_b_rad: BPoly  # (3,) rotation vector from the base attitude, in the body axes of the base
    place_n_m: tuple[BPoly, ...]  # (3,) each; the position is their sum
    rests_s: Floats  # (R, 2) from, to; the first begins at 0, the last ends with the path
    arm_b_m: tuple[float, float, float] = (0.0, 0.0, 0.0)  # from the point about which the body turns to the sensor

    @property
    def duration_s(self) -> float:
        """Length of the path."""
        return float(self.rests_s[-1, 1])

    def attitude(self, t_s: ArrayLike) -> Rotation:
        """Return the rotation from body to n at times (N,)."""
        return compose(rotation(self.base_q_nb), Rotation.from_rotvec(self.turn_b_rad(self._clip_time(t_s))))

    def rate_b_radps(self, t_s: ArrayLike) -> Floats:
        """Return the angular rate of the body in n, in body axes, (N, 3): the right Jacobian of exp times the turn's
        rate.
        """
        t = self._clip_time(t_s)
        turn, turn_rate = self.turn_b_rad(t), self._turn_rate(t)
        first, second, _, _ = _compute_jacobian_shares(turn)
        crossed = np.cross(turn, turn_rate)
        return np.asarray(turn_rate - first * crossed + second * np.cross(turn, crossed))

    def angular_acceleration_b_radps2(self, t_s: ArrayLike) -> Floats:
        """Return the derivative of the angular rate, in body axes, (N, 3)."""
        t = self._clip_time(t_s)
        turn, turn_rate, turn_accel = self.turn_b_rad(t), self._turn_rate(t), self._turn_accel(t)
        first, second, first_slope, second_slope = _compute_jacobian_shares(turn)
        growth = np.sum(turn * turn_rate, axis=1, keepdims=True)
        once, once_rate = np.cross(turn, turn_rate), np.cross(turn, turn_accel)
        twice, twice_rate = np.cross(turn, once), np.cross(turn_rate, once) + np.cross(turn, once_rate)
        return np.asarray(
            turn_accel
            - first * once_rate
            - first_slope * growth * once
            + second * twice_rate
            + second_slope * growth * twice
        )

    def steps_b_rad(self, t_s: Floats) -> Floats:
        """Return the exact rotation vectors (N - 1, 3) from the attitude at each time to that at the next.

        Over their time these are the samples of a perfect integrating gyro, coning included.
        """
        attitude = self.attitude(t_s)
        return np.asarray(compose(attitude[:-1].inv(), attitude[1:]).as_rotvec())

    def position(self, t_s: ArrayLike) -> Floats:
        """Return the position in n, (N, 3) in m."""
        t = self._clip_time(t_s)
        moved = np.sum([chain(t) for chain in self.place_n_m], axis=0)
        if not any(self.arm_b_m):
            return np.asarray(moved)
        return np.asarray(moved + self.attitude(t).apply(self.arm_b_m) - self.attitude(0.0).apply(self.arm_b_m))

    def acceleration_n_mps2(self, t_s: ArrayLike) -> Floats:
        """Return the second derivative of the position in n, (N, 3)."""
        t = self._clip_time(t_s)
        moved = np.sum([chain(t) for chain in self._accelerations], axis=0)
        if not any(self.arm_b_m):
            return np.asarray(moved)
        rate, arm = self.rate_b_radps(t), np.broadcast_to(self.arm_b_m, (len(t), 3))
        turned = np.cross(self.angular_acceleration_b_radps2(t), arm) + np.cross(rate, np.cross(rate, arm))
        return np.asarray(moved + self.attitude(t).apply(turned))

    def moving(self, t_s: ArrayLike) -> NDArray[np.bool_]:
        """Return whether each time (N,) lies outside all rests."""
        t = self._clip_time(t_s)
        rest = np.maximum(np.searchsorted(self.rests_s[:, 0], t, side="right") - 1, 0)
        return np.asarray(t > self.rests_s[rest, 1])

    @cached_property
    def _turn_rate(self) -> BPoly:
        return self.turn_b_rad.derivative()

    @cached_property
    def _turn_accel(self) -> BPoly:
        return self.turn_b_rad.derivative(2)

    @cached_property
    def _accelerations(self) -> list[BPoly]:
        return [chain.derivative(2) for chain in self.place_n_m]

    def _clip_time(self, t_s: ArrayLike) -> Floats:
        """Return times (N,) within the path."""
        return np.clip(np.asarray(t_s, dtype=np.float64), 0.0, self.duration_s)


def _compute_jacobian_shares(turn: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Return (1 - cos a) / a^2 and (a - sin a) / a^3 of the angles a of turns (N, 3), and their slopes over a; (N, 1).

    A slope over a times the turn's product with its rate is the derivative over time.
    """
    angle = np.linalg.norm(turn, axis=1, keepdims=True)
    small = angle < 0.02
    a = np.where(small, 1.0, angle)
    sine, cosine = np.sin(a), np.cos(a)
    square = angle**2
    first = np.where(small, 1 / 2 - square / 24 + square**2 / 720, (1 - cosine) / a**2)
    second = np.where(small, 1 / 6 - square / 120 + square**2 / 5040, (a - sine) / a**3)
    first_slope = np.where(small, -1 / 12 + square / 180, (a * sine - 2 * (1 - cosine)) / a**4)
    second_slope = np.where(small, -1 / 60 + square / 1260, (a * (1 - cosine) - 3 * (a - sine)) / a**5)
    return first, second, first_slope, second_slope
