"""The samples of a spinning body as a chain of mean rates, in blocks.

x_k is the mean rate over the interval (t_{k-1}, t_k] that ends at sample k, as a gyro would give it. It makes the
angle exact, angle_k = angle_{k-1} + dt_k x_k, and each sample of the acceleration one link of a chain whose noise is
white: x_{k+1} - x_k = h_k (acceleration_k + noise), h_k = (dt_k + dt_{k+1}) / 2. The rate at t_k lies between:
rate_k = p_k x_k + (1 - p_k) x_{k+1}.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.recording import Floats
from stillpoint.smoother.spin.encoder import EncoderReadings
from stillpoint.smoother.spin.params import SpinNoise
from stillpoint.smoother.spin.samples import SpinSamples
from stillpoint.smoother.spin.state import Layout, SpinState, split_blocks

LONG_STEP = 1.5  # of the median step: the samples do not show the acceleration within a longer one


@dataclass(frozen=True, eq=False)
class Chain:
    """The samples padded to whole blocks, (B, m), and the constants that hold in each block."""

    samples: SpinSamples
    params: SpinNoise
    layout: Layout
    step_s: Floats  # (N + 1,) with the one after the last sample
    span_s: Floats  # (B, m) h
    before: Floats  # (B, m) share p of x_k in the rate at the sample
    constants_of: NDArray[np.int64]  # (B,) row of SpinState.constants
    accel_radps2: Floats  # (B, m) interpolated where not valid
    accel_seen: NDArray[np.bool_]  # (B, m) where a sample measures it
    squared_valid: NDArray[np.bool_]  # (B, m)
    readings: EncoderReadings | None
    shaken: Floats | None = None  # (2, B, m) cos and sin of the angle along which a vibration is fitted

    @property
    def blocks(self) -> int:
        """Return the number of blocks."""
        return len(self.span_s)


def build_chain(
    samples: SpinSamples, readings: EncoderReadings | None, block: int, bias_step_s: float, params: SpinNoise
) -> Chain:
    """Return the samples arranged in blocks of ``block`` samples."""
    n = len(samples)
    count = -(-n // block)
    median_s = float(np.median(samples.step_s))
    step_s = np.append(samples.step_s, median_s)
    usual = step_s <= LONG_STEP * median_s
    seen = samples.accel_valid & usual[:-1] & usual[1:]
    rows = np.arange(n)
    accel = np.interp(rows, rows[samples.accel_valid], samples.accel_radps2[samples.accel_valid])
    first_s = (samples.t_ns[::block][:count] - samples.t_ns[0]) / 1e9
    return Chain(
        samples=samples,
        params=params,
        layout=Layout(block),
        step_s=step_s,
        span_s=split_blocks((step_s[:-1] + step_s[1:]) / 2, block, median_s),
        before=split_blocks(step_s[1:] / (step_s[:-1] + step_s[1:]), block, 0.5),
        constants_of=(first_s / bias_step_s).astype(np.int64),
        accel_radps2=split_blocks(accel, block, 0.0),
        accel_seen=split_blocks(seen, block, False),
        squared_valid=split_blocks(samples.squared_valid, block, False),
        readings=readings,
    )


def integrate_angles(chain: Chain, state: SpinState) -> Floats:
    """Return the angle at every sample, (N,)."""
    return np.asarray(state.start_angle_rad + np.cumsum(chain.step_s[:-1] * state.mean_rate_radps[:-1]))


def interpolate_rates(chain: Chain, state: SpinState) -> Floats:
    """Return the rate at every sample, (N,)."""
    n = len(chain.samples)
    p, x = chain.before.ravel()[:n], state.mean_rate_radps
    return np.asarray(p * x[:-1] + (1 - p) * x[1:])
