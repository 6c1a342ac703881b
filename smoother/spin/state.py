"""The unknowns of a spinning body's graph, and their columns in the rows of a block."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.recording import Floats

CONSTANTS = (
    "bias_squared_rad2ps2",
    "bias_accel_radps2",
    "arm_squared",
    "arm_accel",
    "gravity_mps2",
    "encoder_offset_rad",
    "encoder_latency_s",
    "vibration_squared_cos_rad2ps2",
    "vibration_squared_sin_rad2ps2",
    "vibration_accel_cos_radps2",
    "vibration_accel_sin_radps2",
)  # biases of the channels, relative errors of their lever arms, gravity at the spin frequency, encoder, vibration
BIAS_S, BIAS_A, ARM_S, ARM_A, AMPLITUDE, OFFSET, LATENCY, COS_S, SIN_S, COS_A, SIN_A = range(len(CONSTANTS))


@dataclass(frozen=True, eq=False)
class SpinState:
    """A trajectory: the angle before the first sample, mean rates, and constants that change in steps."""

    start_angle_rad: float
    mean_rate_radps: Floats  # (N + 1,) x_0 .. x_N
    constants: Floats  # (S, 11) CONSTANTS


@dataclass(frozen=True)
class Layout:
    """Columns of a block of m samples: m - 1 rates inside, then angle and rate of both keys, then the constants."""

    m: int

    @property
    def inside(self) -> int:
        """Return the number of unknowns inside a block."""
        return self.m - 1

    @property
    def shared(self) -> int:
        """Return the number of unknowns shared with other blocks: both keys and the constants."""
        return 4 + len(CONSTANTS)

    @property
    def angle(self) -> int:
        """Return the column of the angle at the first key; that of the second key is two columns further."""
        return self.inside

    @property
    def rates(self) -> NDArray[np.int64]:
        """Return the columns of the m + 1 rates in order of time."""
        return np.concatenate([[self.inside + 1], np.arange(self.inside), [self.inside + 3]])

    @property
    def constants(self) -> NDArray[np.int64]:
        """Return the columns of CONSTANTS."""
        return np.asarray(self.inside + 4 + np.arange(len(CONSTANTS)))


def split_blocks(values: NDArray, m: int, fill: object) -> NDArray:
    """Return a column (N,) as (B, m), padded with ``fill``."""
    whole = np.full(-(-len(values) // m) * m, fill, dtype=values.dtype)
    whole[: len(values)] = values
    return whole.reshape(-1, m)
