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
        raise BadParameter(f"precision {precision!r}: there are double and single")
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


def compare_with_double(single: Estimate, double: Estimate) -> dict[str, float]:
    """Return the largest and the RMS angle, in deg, by which two estimates of the same samples differ."""
    if single.q_nb is not None and double.q_nb is not None:
        apart_rad = (rotation(single.q_nb) * rotation(double.q_nb).inv()).magnitude()
    else:
        assert single.angle_rad is not None
        assert double.angle_rad is not None
        apart_rad = np.abs(single.angle_rad - double.angle_rad)
    apart_deg = np.rad2deg(apart_rad)
    rms_deg = float(np.sqrt(np.mean(apart_deg**2)))
    return {"off_double_max_deg": float(apart_deg.max()), "off_double_rms_deg": rms_deg}
