"""Single precision, as on a microcontroller: the same functions, compiled for float32 arguments."""

from typing import Any, Literal

import numpy as np

from stillpoint.datasets import Estimate
from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.frames import rotation

Precision = Literal["double", "single"]


def to_precision(tree: Any, precision: Precision) -> Any:
    """Return tuples, named tuples and arrays with their floats in this precision; integers and booleans stay.

    Raises :class:`BadParameter` for another precision.
    """
    if precision == "double":
        return tree
    if precision != "single":
        raise BadParameter(f"precision {precision!r}: give double or single")
    return _single(tree)


def _single(tree: Any) -> Any:
    if isinstance(tree, float):
        return np.float32(tree)
    if isinstance(tree, np.ndarray) and tree.dtype == np.float64:
        return tree.astype(np.float32)
    if isinstance(tree, tuple):
        parts = [_single(part) for part in tree]
        return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)
    return tree


class DoubleComparison:
    """How far the attitudes or angles of a run in single precision are off those in double, piece by piece."""

    def __init__(self) -> None:
        self._largest_deg, self._squares_deg2, self._count = 0.0, 0.0, 0

    def add(self, single: Estimate, double: Estimate) -> None:
        """Take the next samples of both runs."""
        if single.q_nb is not None and double.q_nb is not None:
            apart_rad = (rotation(single.q_nb) * rotation(double.q_nb).inv()).magnitude()
        else:
            assert single.angle_rad is not None
            assert double.angle_rad is not None
            apart_rad = np.abs(single.angle_rad - double.angle_rad)
        apart_deg = np.rad2deg(apart_rad)
        self._largest_deg = max(self._largest_deg, float(apart_deg.max()))
        self._squares_deg2 += float(np.sum(apart_deg**2))
        self._count += len(apart_deg)

    def report(self) -> dict[str, float]:
        """Return the largest and the RMS angle, in deg."""
        rms_deg = (self._squares_deg2 / self._count) ** 0.5
        return {"off_double_max_deg": self._largest_deg, "off_double_rms_deg": rms_deg}
