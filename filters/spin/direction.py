"""The sense of a spin, where something other than the square of its rate shows it.

A gyro with a part along the spin axis shows it even when it is saturated. So does an accelerometer that sees a product
of the spin with a rate about y or z (one outside the y-z plane, against eq (2)), together with the gyros about these
axes: w_x w_y * w_y has the sign of w_x. Neither the five accelerometers of Asghari et al. 2018 nor their bench show it.
"""

from typing import NamedTuple

import numpy as np

from stillpoint.datasets.compiled import compiled
from stillpoint.datasets.recording import Floats
from stillpoint.datasets.spin import SpinChannels

_LEAST_GYRO_RADPS = 1.0  # a slower rate about the axis may be bias
_FORGETTING = 0.96  # per sample: about 25 samples are summed
_SIGNIFICANT = 5.0  # standard deviations of the sum


class Evidence(NamedTuple):
    """Sums over the last samples, passed from one to the next."""

    total: float  # of what has the sign of the rate
    var: float


def describe_direction(by: SpinChannels) -> str:
    """Return what shows the sense of the spin, in words; "" where nothing does."""
    if axial_weights(by).any():
        return "by a gyro about the spin axis"
    if by.transverse.any() and (by.omega_xy is not None or by.omega_xz is not None):
        return "by accelerometers that see products of the spin with the rates about y and z"
    return ""


def axial_weights(by: SpinChannels) -> Floats:
    """Return the weights (m,) of the gyros for the rate about x; 0 where they do not give it."""
    axes = by.geometry.gyro_axis_b
    if not len(axes):
        return np.zeros(0)
    weights = np.linalg.pinv(axes)[0]
    return weights if abs(weights @ axes[:, 0] - 1.0) < 1e-9 else np.zeros(len(axes))


@compiled
def find_direction(evidence: Evidence, axial_radps: float, shown: float, var: float) -> tuple[Evidence, int]:
    """Return the evidence with one sample more, and the sense of the spin: +1, -1, or 0 if it is not known.

    ``axial_radps`` is the rate about x by a gyro (0 where there is none), ``shown`` what has the rate's sign, with its
    variance.
    """
    total, total_var = _FORGETTING * evidence.total + shown, _FORGETTING**2 * evidence.var + var
    direction = 0
    if abs(axial_radps) > _LEAST_GYRO_RADPS:
        direction = 1 if axial_radps > 0.0 else -1
    elif total * total > _SIGNIFICANT**2 * total_var:
        direction = 1 if total > 0.0 else -1
    return Evidence(total, total_var), direction
