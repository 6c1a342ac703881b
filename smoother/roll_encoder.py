"""A shaft encoder in the graph of a spinning body: its resolution, and its readings as rows of the blocks."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.recording import Encoder, Floats
from stillpoint.smoother.roll_params import EncoderParams
from stillpoint.smoother.roll_state import LATENCY, OFFSET, Layout, RollState

UNIFORM_SD = np.sqrt(1 / 12)  # of a uniform distribution of width 1
LEVELS = 100_000  # a turn that shows more different angles than this is not taken for quantised
ROBUST = 5.0  # residuals above this many sd lose their weight


@dataclass(frozen=True, eq=False)
class EncoderReadings:
    """Angles on the clock of the samples."""

    t_s: Floats  # (E,) from the first sample of the accelerometers
    angle_rad: Floats  # (E,)
    resolution_rad: float  # 0 where none shows
    sd_rad: float


def readings_of(encoder: Encoder, t0_ns: int, params: EncoderParams) -> EncoderReadings:
    """The readings, with the noise that their resolution makes."""
    step_rad = resolution_rad(encoder.angle_rad)
    t_s = (encoder.t_ns - t0_ns) / 1e9
    return EncoderReadings(t_s, encoder.angle_rad, step_rad, float(np.hypot(params.sd_rad, UNIFORM_SD * step_rad)))


def resolution_rad(angle_rad: Floats) -> float:
    """The step of the angles (E,), that all of them are multiples of from the first one on; 0 where there is none."""
    steps = np.abs(angle_rad - angle_rad[0])
    levels = np.unique(np.round(steps[steps > 0], 12))
    if len(levels) < 2:
        return 0.0
    gaps = np.diff(levels)
    step = float(gaps[gaps > 1e-9].min(initial=np.inf))
    if not step > 2 * np.pi / LEVELS:
        return 0.0
    step = float(levels[-1] / np.round(levels[-1] / step))
    off = np.abs(levels / step - np.round(levels / step))
    return step if off.max() < 0.05 else 0.0


def encoder_rows(
    readings: EncoderReadings, layout: Layout, t_s: Floats, step_s: Floats, angle_rad: Floats, state: RollState
) -> tuple[Floats, Floats]:
    """Whitened rows (B, slots, columns + right side), and the residuals (E,) with NaN outside the samples.

    ``t_s``, ``step_s`` and ``angle_rad`` are those of the N samples. The angle runs straight between samples.
    """
    m, rate = layout.m, state.mean_rate_radps
    blocks = -(-len(t_s) // m)
    at_s = readings.t_s - state.constants[0, LATENCY]
    k = np.searchsorted(t_s, at_s)
    inside = (k > 0) & (k < len(t_s))
    k = np.minimum(k, len(t_s) - 1)
    back_s = t_s[k] - at_s
    residual = readings.angle_rad - (angle_rad[k] - back_s * rate[k] + state.constants[0, OFFSET])
    sd = max(readings.sd_rad, 1.4826 * float(np.median(np.abs(residual[inside]))) if inside.any() else 0.0)
    root = np.where(inside, 1 / (1 + (residual / (ROBUST * sd)) ** 2) / sd, 0.0)

    which = np.flatnonzero(inside)
    block, j = k[which] // m, k[which] % m
    slot = np.arange(len(which)) - np.searchsorted(block, block)
    rows = np.zeros((blocks, int(slot.max(initial=-1)) + 1, layout.inside + layout.shared + 1))
    local = np.arange(m)
    steps = np.zeros(blocks * m)
    steps[: len(step_s)] = step_s
    by_rate = (
        np.where(local <= j[:, None], steps.reshape(-1, m)[block], 0.0) - (local == j[:, None]) * back_s[which, None]
    )
    target: NDArray[np.float64] = np.zeros((len(which), rows.shape[2]))
    target[:, layout.rates[:m]] = by_rate
    target[:, layout.angle] = 1.0
    target[:, layout.constants[OFFSET]] = 1.0
    target[:, layout.constants[LATENCY]] = -rate[k[which]]
    target[:, -1] = residual[which]
    rows[block, slot] = target * root[which, None]
    return rows, np.where(inside, residual, np.nan)
