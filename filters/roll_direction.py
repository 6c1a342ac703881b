"""The sense of a spin, where anything but the square of its rate shows it.

A gyro with a part along the spin axis shows it even when it is saturated. So does an accelerometer that sees a product
of the spin with a rate about y or z (one outside the y-z plane, against eq (2)), together with the gyros about these:
w_x w_y * w_y has the sign of w_x. The paper's five accelerometers and its bench show nothing of it.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.recording import Floats, Spin
from stillpoint.datasets.spin import SpinChannels
from stillpoint.filters.compiled import compiled

LEAST_GYRO_RADPS = 1.0  # a slower rate about the axis may be bias
FORGETTING = 0.96  # per sample: about 25 samples are summed
SIGNIFICANT = 5.0  # standard deviations of the sum


class Evidence(NamedTuple):
    """Sums over the last samples, handed on from one to the next."""

    total: float  # of what has the sign of the rate
    var: float


def no_evidence() -> Evidence:
    """Before the first sample."""
    return Evidence(0.0, 0.0)


def says_direction(by: SpinChannels) -> str:
    """What shows the sense of the spin, in words; "" where nothing does."""
    if axial_weights(by).any():
        return "by a gyro about the spin axis"
    if by.transverse.any() and (by.omega_xy is not None or by.omega_xz is not None):
        return "by accelerometers that see products of the spin with the rates about y and z"
    return ""


def axial_weights(by: SpinChannels) -> Floats:
    """Weights (m,) of the gyros for the rate about x; 0 where they do not give it."""
    axes = by.geometry.gyro_axis_b
    if not len(axes):
        return np.zeros(0)
    weights = np.linalg.pinv(axes)[0]
    return weights if abs(weights @ axes[:, 0] - 1.0) < 1e-9 else np.zeros(len(axes))


def directions(spin: Spin, by: SpinChannels, evidence: Evidence) -> tuple[NDArray[np.int64], Evidence]:
    """+1, -1 or 0 (N,) for each sample of ``spin`` by those up to it, and what to go on with."""
    gyro = np.where(np.isfinite(spin.gyro_radps), spin.gyro_radps, 0.0)
    axial = (gyro * axial_weights(by)).sum(axis=1)
    shown = np.zeros(len(axial))
    var = np.zeros(len(axial))
    rates = (gyro[:, None, :] * by.transverse).sum(axis=2)
    for channel, rate in ((by.omega_xy, rates[:, 0]), (by.omega_xz, rates[:, 1])):
        if channel is not None:
            product = channel.value(spin.accel_mps2, rates)
            known = np.isfinite(product)
            shown += np.where(known, product * rate, 0.0)
            var += np.where(known, channel.variance * rate * rate, 0.0)
    found = np.zeros(len(axial), dtype=np.int64)
    return found, summed(axial, shown, var, evidence, found)


@compiled
def summed(axial: Floats, shown: Floats, var: Floats, evidence: Evidence, found: NDArray[np.int64]) -> Evidence:
    """Fill ``found`` sample by sample."""
    total, total_var = evidence
    for k in range(len(axial)):
        total, total_var = FORGETTING * total + shown[k], FORGETTING**2 * total_var + var[k]
        if abs(axial[k]) > LEAST_GYRO_RADPS:
            found[k] = 1 if axial[k] > 0.0 else -1
        elif total * total > SIGNIFICANT**2 * total_var:
            found[k] = 1 if total > 0.0 else -1
    return Evidence(total, total_var)
