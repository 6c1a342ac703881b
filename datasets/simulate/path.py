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

from stillpoint.datasets.frames import rotation
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
    """

    base_q_nb: Floats  # (4,) wxyz
    turn_b_rad: BPoly  # (3,) rotation vector from the base attitude, in the body axes of the base
    place_n_m: tuple[BPoly, ...]  # (3,) each; the position is their sum
    rests_s: Floats  # (R, 2) from, to; the first begins at 0, the last ends with the path

    @property
    def duration_s(self) -> float:
        """Length of the path."""
        return float(self.rests_s[-1, 1])

    def attitude(self, t_s: ArrayLike) -> Rotation:
        """Return the rotation from body to n at times (N,)."""
        return rotation(self.base_q_nb) * Rotation.from_rotvec(self.turn_b_rad(self._within(t_s)))

    def rate_b_radps(self, t_s: ArrayLike) -> Floats:
        """Return the angular rate of the body in n, in body axes, (N, 3): the right Jacobian of exp times the turn's
        rate.
        """
        t = self._within(t_s)
        turn, turn_rate = self.turn_b_rad(t), self._turn_rate(t)
        angle = np.linalg.norm(turn, axis=1, keepdims=True)
        small = angle < 1e-4
        safe = np.where(small, 1.0, angle)
        first = np.where(small, 0.5 - angle**2 / 24, (1 - np.cos(safe)) / safe**2)
        second = np.where(small, 1 / 6 - angle**2 / 120, (safe - np.sin(safe)) / safe**3)
        crossed = np.cross(turn, turn_rate)
        return np.asarray(turn_rate - first * crossed + second * np.cross(turn, crossed))

    def steps_b_rad(self, t_s: Floats) -> Floats:
        """Return the exact rotation vectors (N - 1, 3) from the attitude at each time to that at the next.

        Over their time these are the samples of a perfect integrating gyro, coning included.
        """
        attitude = self.attitude(t_s)
        return np.asarray((attitude[:-1].inv() * attitude[1:]).as_rotvec())

    def position(self, t_s: ArrayLike) -> Floats:
        """Return the position in n, (N, 3) in m."""
        t = self._within(t_s)
        return np.sum([chain(t) for chain in self.place_n_m], axis=0)

    def acceleration_n_mps2(self, t_s: ArrayLike) -> Floats:
        """Return the second derivative of the position in n, (N, 3)."""
        t = self._within(t_s)
        return np.sum([chain(t) for chain in self._accelerations], axis=0)

    def moving(self, t_s: ArrayLike) -> NDArray[np.bool_]:
        """Return whether each time (N,) lies outside all rests."""
        t = self._within(t_s)
        rest = np.maximum(np.searchsorted(self.rests_s[:, 0], t, side="right") - 1, 0)
        return np.asarray(t > self.rests_s[rest, 1])

    @cached_property
    def _turn_rate(self) -> BPoly:
        return self.turn_b_rad.derivative()

    @cached_property
    def _accelerations(self) -> list[BPoly]:
        return [chain.derivative(2) for chain in self.place_n_m]

    def _within(self, t_s: ArrayLike) -> Floats:
        return np.clip(np.asarray(t_s, dtype=np.float64), 0.0, self.duration_s)
