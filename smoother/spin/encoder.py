"""A shaft encoder in the graph of a spinning body: its resolution, and its readings as rows of the blocks."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.recording import Encoder, Floats, Times
from stillpoint.smoother.spin.params import EncoderParams
from stillpoint.smoother.spin.state import LATENCY, OFFSET, Layout, SpinState

_UNIFORM_SD = np.sqrt(1 / 12)  # of a uniform distribution of width 1
_FINEST = 2 * np.pi / 1e5  # rad: finer steps are not looked for
_RATE_S = 0.1  # over which the encoder's rate is taken
_ROUNDING = 0.05  # of a step, by which angles of whole steps may be off


@dataclass(frozen=True, eq=False)
class EncoderReadings:
    """Readings within the samples' time span, each in the middle of its step.

    ``rate_radps`` is the encoder's own over RATE_S: with the rate of the trajectory, the latency would let the noise of
    one explain the noise of the other.
    """

    angle_rad: Floats  # (E,)
    rate_radps: Floats  # (E,)
    k: NDArray[np.int64]  # (E,) the sample that ends the interval a reading lies in
    back_s: Floats  # (E,) from the reading to that sample
    resolution_rad: float  # 0 where none shows
    sd_rad: float
    outside: int  # readings left out


def select_readings(encoder: Encoder, t_ns: Times, params: EncoderParams) -> EncoderReadings:
    """Return the readings within the samples at ``t_ns`` (N,), moved forward by half a step of the counter."""
    step_rad = find_resolution_rad(encoder.angle_rad)
    forward = np.sign(encoder.angle_rad[-1] - encoder.angle_rad[0])
    t_s = (encoder.t_ns - t_ns[0]) / 1e9
    half = _RATE_S / 2
    early, late = np.clip(t_s - half, t_s[0], t_s[-1]), np.clip(t_s + half, t_s[0], t_s[-1])
    rate = np.interp(late, t_s, encoder.angle_rad) - np.interp(early, t_s, encoder.angle_rad)
    k = np.searchsorted(t_ns, encoder.t_ns)
    inside = (k > 0) & (k < len(t_ns))
    return EncoderReadings(
        angle_rad=(encoder.angle_rad + forward * step_rad / 2)[inside],
        rate_radps=(rate / np.maximum(late - early, 1e-9))[inside],
        k=k[inside],
        back_s=(t_ns[k[inside]] - encoder.t_ns[inside]) / 1e9,
        resolution_rad=step_rad,
        sd_rad=float(np.hypot(params.sd_rad, _UNIFORM_SD * step_rad)),
        outside=int((~inside).sum()),
    )


def find_resolution_rad(angle_rad: Floats) -> float:
    """Return the step of the angles (E,), a whole fraction of a turn; 0 if no step shows."""
    levels = np.unique(np.round(np.mod(angle_rad - angle_rad[0], 2 * np.pi), 9))
    gaps = np.diff(levels)
    gaps = gaps[gaps > _FINEST]
    if not len(gaps):
        return 0.0
    step = 2 * np.pi / np.round(2 * np.pi / float(gaps.min()))
    off = np.abs(levels / step - np.round(levels / step))
    return float(step) if off.max() < _ROUNDING else 0.0


def compute_encoder_residuals(
    readings: EncoderReadings, angle_rad: Floats, state: SpinState, constants_of: NDArray[np.int64]
) -> Floats:
    """Return readings minus predictions (E,); between two samples the angle changes at the mean rate.

    ``angle_rad`` and the step of the constants are those of the N samples.
    """
    constants = state.constants[constants_of[readings.k]]
    angle = angle_rad[readings.k] - readings.back_s * state.mean_rate_radps[readings.k]
    late = constants[:, LATENCY] * readings.rate_radps
    return np.asarray(readings.angle_rad - (angle - late + constants[:, OFFSET]))


def build_encoder_rows(
    readings: EncoderReadings, residual: Floats, root: Floats, layout: Layout, step_s: Floats
) -> Floats:
    """Return whitened rows (B, slots, columns + right side) for the roots of the weights (E,) and the steps (B, m)."""
    m, local = layout.m, np.arange(layout.m)
    block, j = readings.k // m, readings.k % m
    slot = np.arange(len(block)) - np.searchsorted(block, block)
    width = layout.inside + layout.shared + 1
    each = np.zeros((len(block), width))
    each[:, layout.rates[:m]] = np.where(local <= j[:, None], step_s[block], 0.0)
    each[np.arange(len(block)), layout.rates[j]] -= readings.back_s
    each[:, layout.angle] = 1.0
    each[:, layout.constants[OFFSET]] = 1.0
    each[:, layout.constants[LATENCY]] = -readings.rate_radps
    each[:, -1] = residual
    rows = np.zeros((len(step_s), int(slot.max(initial=-1)) + 1, width))
    rows[block, slot] = each * root[:, None]
    return rows
