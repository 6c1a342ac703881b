"""Factors that a user adds to the graph: wheel odometry, a barometer, poses of a camera, a known turn.

A generator is a function of the states and the recording that yields gtsam factors:

    def wheel_factors(states: States, recording: Recording) -> Iterator[gtsam.NonlinearFactor]:
        ...
        yield gtsam.BetweenFactorPose3(X(i), X(i + 1), moved, noise)

The symbols are those of factors.py, from ``gtsam.symbol_shorthand``: X(i) is the pose of state i (attitude in n,
position in m East-North-Up from the first fix, or from a free origin), V(i) its velocity in n, C(i) the effective IMU
bias of the interval from i to i + 1 (accelerometer, gyro), B(k) the bias of step k, M(0) the calibration, H(0) the
field. Factors must be gtsam's own: a Python ``CustomFactor`` is refused, as gtsam's optimiser calls it from other
threads.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.recording import Floats, Recording, Times
from stillpoint.smoother.attitude.keys import Keys

CONTRADICTS = 4.0  # mean square of a generator's normalised residuals from which it contradicts the rest
ADDED = "added "  # before the generator's name, in the residuals
_KINDS_OF_STATES = frozenset(map(ord, "xvc"))  # unknowns that have the number of a state


@dataclass(frozen=True, eq=False)
class States:
    """The n states of a graph, for generators of factors."""

    t_ns: Times  # (n,) on the clock of the recording's IMU
    gap: NDArray[np.bool_]  # (n - 1,) the IMU has a gap between state i and i + 1
    gyro_b_radps: Floats  # (n - 1, 3) mean over the interval, as measured
    accel_b_mps2: Floats  # (n - 1, 3)
    at_rest: NDArray[np.bool_]  # (n - 1,)

    def nearest(self, t_ns: Times) -> NDArray[np.int64]:
        """Return the numbers (K,) of the states that are nearest to stamps (K,)."""
        after = np.clip(np.searchsorted(self.t_ns, t_ns), 1, len(self.t_ns) - 1)
        return np.asarray(after - (t_ns - self.t_ns[after - 1] < self.t_ns[after] - t_ns), dtype=np.int64)


Generator = Callable[[States, Recording], Iterable[gtsam.NonlinearFactor]]


@dataclass(frozen=True, eq=False)
class Added:
    """One added factor: whose it is, and the states that it spans."""

    name: str
    factor: gtsam.NonlinearFactor
    first: int
    last: int


def collect_added(keys: Keys, t0_ns: int, recording: Recording, generators: Sequence[Generator]) -> tuple[Added, ...]:
    """Return the factors of all generators, named by the function that yields them.

    Raises :class:`BadParameter` for what is no factor of gtsam's own, or refers to a state that is not there.
    """
    states = States(
        t_ns=t0_ns + np.round(keys.t_s * 1e9).astype(np.int64),
        gap=keys.gap,
        gyro_b_radps=keys.gyro_b_radps,
        accel_b_mps2=keys.accel_b_mps2,
        at_rest=keys.at_rest,
    )
    added = []
    for generator in generators:
        name = name_generator(generator)
        for factor in generator(states, recording):
            added.append(_check(factor, name, len(keys.t_s), keys.gap))
    return tuple(added)


def name_generator(generator: Generator) -> str:
    """Return the name under which the residuals of a generator are reported."""
    return str(getattr(generator, "__name__", type(generator).__name__))


def _check(factor: object, name: str, n: int, gap: NDArray[np.bool_]) -> Added:
    if isinstance(factor, gtsam.CustomFactor) or not isinstance(factor, gtsam.NonlinearFactor):
        raise BadParameter(
            f"factors: {name} yields a {type(factor).__name__}; give factors that gtsam has built in (no CustomFactor)"
        )
    symbols = [gtsam.Symbol(key) for key in list(factor.keys())]
    numbers = [symbol.index() for symbol in symbols if symbol.chr() in _KINDS_OF_STATES]
    for symbol in symbols:
        last = n - 2 if symbol.chr() == ord("c") else n - 1
        if symbol.chr() in _KINDS_OF_STATES and symbol.index() > last:
            raise BadParameter(f"factors: {name} refers to {symbol.string()}; the states are numbered 0 to {n - 1}")
        if symbol.chr() == ord("c") and gap[symbol.index()]:
            raise BadParameter(f"factors: {name} refers to {symbol.string()}, an interval in which the IMU has a gap")
    if not numbers:
        raise BadParameter(f"factors: {name} yields a factor on no state; give it a pose X, a velocity V or a bias C")
    return Added(name, factor, min(numbers), max(numbers))


def select_added(added: Sequence[Added], states: range, held: range) -> list[Added]:
    """Return the factors that begin in ``states``; raises :class:`BadParameter` for one that ends beyond ``held``."""
    chosen = [one for one in added if one.first in states]
    for one in chosen:
        if one.last not in held:
            raise BadParameter(
                f"factors: {one.name} ties states {one.first} and {one.last}, which are in no common window; "
                "set keys.window_s to the length of the recording"
            )
    return chosen


def find_effective(added: Sequence[Added]) -> list[int]:
    """Return the intervals whose effective bias C is in one of the factors."""
    symbols = {gtsam.Symbol(key) for one in added for key in list(one.factor.keys())}
    return sorted({symbol.index() for symbol in symbols if symbol.chr() == ord("c")})


def measure_added(added: Sequence[Added], values: gtsam.Values) -> dict[str, float]:
    """Return the mean square of normalised residuals per degree of freedom, by generator ("added NAME")."""
    squares: dict[str, list[float]] = {}
    for one in added:
        squares.setdefault(f"{ADDED}{one.name}", []).append(2 * one.factor.error(values) / max(one.factor.dim(), 1))
    return {name: float(np.mean(each)) for name, each in squares.items()}
