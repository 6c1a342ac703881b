"""A spinning body's accelerometers: lost and saturated values, useless places, signs and scales."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.constants import MEDIAN_DEVIATION_TO_SD
from stillpoint.datasets.doctor.finding import Finding, Severity
from stillpoint.datasets.errors import Unobservable
from stillpoint.datasets.recording import Encoder, Floats, Recording, Spin
from stillpoint.datasets.spin import SpinChannels, channels, find_saturated, measure

_LOST_SHARE = 0.01  # of an accelerometer's values: above it a warning
_SCALE_LIMIT = 0.02  # of the rate: 4 % of a lever arm
_CERTAIN = 5.0  # standard errors
_SLOWEST_RADPS = 3.0  # a slower squared rate does not show a scale


def check_spin(recording: Recording) -> Iterator[Finding]:
    """Return what is wrong with the spin stream; its encoder is the witness where there is one."""
    spin = recording.spin
    if spin is None:
        return
    yield from _check_values(spin, ~np.isfinite(spin.accel_mps2), "missing", "hold no value")
    yield from _check_values(
        spin, find_saturated(spin), "saturated", "lie at the end of the stated range; they are never used"
    )
    try:
        by = channels(spin.geometry)
    except Unobservable as error:
        unknown = bool(np.isnan(spin.geometry.accel_r_b_m).any())  # which the smoother may find
        yield Finding("spin-geometry", "warning" if unknown else "error", f"spin: {error}")
        return
    if by.misplaced:
        yield Finding("spin-misplaced", "warning", f"spin: {'; '.join(by.misplaced)}")
    yield from _check_radial(spin, by, recording.encoder)
    if recording.encoder is not None:
        yield from _check_tangential(spin, by, recording.encoder)


def _check_values(spin: Spin, of: NDArray[np.bool_], what: str, text: str) -> Iterator[Finding]:
    """Return how many values of each accelerometer are lost or saturated."""
    counts = of.sum(axis=0)
    if not counts.any():
        return
    share = float(counts.max()) / len(spin.t_ns)
    listed = ", ".join(f"{n} of accelerometer {k + 1}" for k, n in enumerate(counts) if n)
    severity: Severity = "warning" if share > _LOST_SHARE else "fact"
    yield Finding(f"spin-{what}", severity, f"spin: values that {text}: {listed}", values={"share": share})


def _check_radial(spin: Spin, by: SpinChannels, encoder: Encoder | None) -> Iterator[Finding]:
    """Yield findings where the squared rate is not positive, or not the encoder's."""
    samples = measure(spin, by)
    squared = samples.omega_squared_radps2[samples.omega_squared_valid]
    if len(squared) < 10:
        return
    middle = float(np.median(squared))
    error = MEDIAN_DEVIATION_TO_SD * float(np.median(np.abs(squared - middle))) / np.sqrt(len(squared))
    if middle < -_CERTAIN * error and middle < -(_SLOWEST_RADPS**2):
        message = f"spin: the squared rate is {middle:.4g} rad^2/s^2 in the median: reverse the sign of the radial one"
        yield Finding("spin-radial-sign", "error", message, values={"omega_squared_radps2": middle})
        return
    if encoder is None:
        return
    rate = np.interp(spin.t_ns, encoder.t_ns, encoder.rate_radps)
    fast = samples.omega_squared_valid & (np.abs(rate) > _SLOWEST_RADPS)
    if fast.sum() < 10:
        return
    scale = float(np.sqrt(max(np.median(samples.omega_squared_radps2[fast] / rate[fast] ** 2), 0.0)))
    if abs(scale - 1) > _SCALE_LIMIT:
        message = (
            f"spin: the rate by the accelerometers is {scale:.3f} times the encoder's: check the radial arm "
            f"({100 * (scale**2 - 1):+.1f} %), its unit, and the counts of a turn"
        )
        yield Finding("spin-scale", "warning", message, values={"scale": scale})


def _check_tangential(spin: Spin, by: SpinChannels, encoder: Encoder) -> Iterator[Finding]:
    """Yield a finding where accelerometers and encoder give angular accelerations of opposite sign."""
    if len(encoder.t_ns) < 20:
        return
    samples = measure(spin, by)
    known = samples.omega_dot_valid
    if known.sum() < 20:
        return
    middle_ns = 0.5 * (encoder.t_ns[1:] + encoder.t_ns[:-1])
    turning = np.diff(encoder.rate_radps) / (np.diff(encoder.t_ns) / 1e9)
    seen = np.interp(middle_ns, spin.t_ns[known], samples.omega_dot_radps2[known])
    alike = _compute_correlation(seen, turning, np.interp(middle_ns, encoder.t_ns, encoder.angle_rad))
    if alike < -_CERTAIN / np.sqrt(len(seen)) and alike < -0.1:
        message = (
            f"spin: the tangential accelerometer contradicts the encoder (correlation {alike:.2f}): reverse its sign"
        )
        yield Finding("spin-tangential-sign", "error", message, values={"correlation": alike})


def _compute_correlation(seen: Floats, turning: Floats, angle_rad: Floats) -> float:
    """Return the correlation without the harmonics of the angle: on a tilted shaft, gravity makes harmonics."""
    harmonics = np.column_stack([np.ones(len(angle_rad)), np.cos(angle_rad), np.sin(angle_rad)])
    rest = [one - harmonics @ np.linalg.lstsq(harmonics, one, rcond=None)[0] for one in (seen, turning)]
    sizes = [float(np.linalg.norm(one)) for one in rest]
    return float(rest[0] @ rest[1]) / (sizes[0] * sizes[1]) if min(sizes) > 0 else 0.0
