"""Identify noise variances of accelerometers on a shaft, with an encoder (Asghari et al. 2018, eqs (28)-(31)).

Of an encoder that gives its angle alone, the rate is a difference of counts: at 4096 a turn and 4 ms its noise makes
a D5 of 1000 (m/s^2)^2. Rate and angular acceleration are then taken from the angle over a window, by a parabola, just
as long as the noise of the counts needs. Motion that is faster than the window counts as the accelerometers'.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from stillpoint.datasets.constants import MEDIAN_DEVIATION_TO_SD
from stillpoint.datasets.errors import BadRecording
from stillpoint.datasets.recording import Encoder, Floats, Recording, Spin
from stillpoint.datasets.spin import TERMS, channels, coefficients, find_saturated

_GLITCH_SDS = 6.0  # robust standard deviations beyond which a residual is counted as a glitch
_FEWEST = 100  # samples below which a variance says little
_TOLD_SDS = 5.0  # a variance of so many of its standard deviations counts as found beside the encoder's
_DIFFERENT_SDS, _DIFFERENT = 6.0, 1.5  # sd and ratio, beyond which robust variances of two trials are of two rigs
_ROBUST_SD = 2.33  # standard deviation of a robust variance, relative, times the root of the number of samples
_ENCODER_SHARE = 0.02  # of the variance of F5, which the noise of a smoothed angle may reach
_LONGEST_S = 0.2  # over which an angle is smoothed
_SHORTEST = 5  # samples
_FOURTH = 70.0  # sum of the squares of 1, -4, 6, -4, 1


@dataclass(frozen=True)
class Residual:
    """The readings of one accelerometer of a trial that the encoder does not explain."""

    variance_m2ps4: float
    robust_m2ps4: float  # by the median absolute deviation: the variance without its glitches
    glitches: int  # residuals beyond 6 robust standard deviations
    mean_mps2: float  # bias, and error of the lever arm or the scale
    once_per_turn_mps2: float  # amplitude of what turns with the shaft: g sin(tilt), or vibration; in the variance


@dataclass(frozen=True)
class Trial:
    """The variances of one recording."""

    recording: str
    samples: int  # that were used
    left_out: int  # lost, saturated, or outside the encoder's time
    radial: Residual  # eq (28): d1 w^2 + F4
    tangential: Residual  # eq (30): d2 w' - F5, w' the difference of the encoder's rates over T
    encoder_m2ps4: float  # the part of (30) that is the encoder's own noise
    encoder_radial_m2ps4: float  # the part of (28)
    smoothed_s: float  # the window over which an angle was smoothed that came without a rate; 0 where there is one
    smoothed_samples: float  # of the accelerometers, in it
    d1_m: float
    d2_m: float

    @property
    def turning_share(self) -> float:
        """Return the part of D4 that turns with the shaft: gravity on a shaft that is tilted, or vibration."""
        return self.radial.once_per_turn_mps2**2 / 2 / self.radial.variance_m2ps4

    @property
    def tangential_alone_m2ps4(self) -> float:
        """The variance of the tangential accelerometer without the part of the encoder."""
        return max(self.tangential.variance_m2ps4 - self.encoder_m2ps4, 0.0)

    @property
    def tells_tangential(self) -> bool:
        """Return whether the encoder leaves enough of (30) to show the accelerometer's variance."""
        sd = np.sqrt(2 / self.samples) * self.tangential.variance_m2ps4
        sd += np.sqrt(2 * self.smoothed_samples / self.samples) * self.encoder_m2ps4
        return bool(self.tangential_alone_m2ps4 > _TOLD_SDS * sd)


@dataclass(frozen=True)
class Identified:
    """The maximum over trials, as the paper takes it, and the noise by eq (25)."""

    trials: tuple[Trial, ...]
    d4_m2ps4: float
    d5_m2ps4: float  # as (30) gives it, the encoder's noise included
    d5_alone_m2ps4: float
    r_rad2ps4: float
    q_rad2ps4: float
    q_alone_rad2ps4: float

    @property
    def tells_tangential(self) -> bool:
        """Return whether the encoders of all trials leave enough of (30) to show F5's variance."""
        return all(one.tells_tangential for one in self.trials)

    def find_differing(self, which: str) -> tuple[Trial, Trial] | None:
        """Return the trials with the least and the most "radial" or "tangential" noise, if they differ too much."""
        ordered = sorted(self.trials, key=lambda one: getattr(one, which).robust_m2ps4)
        low, high = (getattr(one, which).robust_m2ps4 for one in (ordered[0], ordered[-1]))
        sd = _ROBUST_SD * (low**2 / ordered[0].samples + high**2 / ordered[-1].samples) ** 0.5
        return (ordered[0], ordered[-1]) if high - low > _DIFFERENT_SDS * sd and high > _DIFFERENT * low else None


def identify_variances(recordings: Sequence[Recording], by_truth: bool = False) -> Identified:
    """Identify the variances of F4 and F5 from trials of one rig with a fixed axis; ``by_truth`` takes the true rate.

    Raises :class:`BadRecording` for a recording without spin or encoder, of another geometry than the first one, or
    with too few samples.
    """
    trials = tuple(_identify_trial(recording, by_truth) for recording in recordings)
    first = recordings[0].spin
    assert first is not None  # a trial of it was made
    for recording in recordings[1:]:
        assert recording.spin is not None
        if not np.array_equal(recording.spin.geometry.accel_r_b_m, first.geometry.accel_r_b_m):
            raise BadRecording(
                f"{recording.name}: has other lever arms than {recordings[0].name}; give one rig at a time"
            )
    d4, d5, d5_alone = (
        max(values)
        for values in zip(
            *((one.radial.variance_m2ps4, one.tangential.variance_m2ps4, one.tangential_alone_m2ps4) for one in trials),
            strict=True,
        )
    )
    radial, tangential = _find_columns(first, recordings[0].name)
    variance = np.ones(len(first.geometry.accel_r_b_m))
    variance[[radial, tangential]] = d4, d5
    with_encoder = channels(first.geometry, variance)
    variance[tangential] = max(d5_alone, 1e-12)
    alone = channels(first.geometry, variance)
    return Identified(trials, d4, d5, d5_alone, with_encoder.r_rad2ps4, with_encoder.q_rad2ps4, alone.q_rad2ps4)


def _identify_trial(recording: Recording, by_truth: bool) -> Trial:
    """Return variances and means of the residuals of F4 and F5; raises :class:`BadRecording` for unfit recordings."""
    spin = recording.spin
    if spin is None:
        raise BadRecording(f"{recording.name}: has no spin stream; import it with `stillpoint import spin`")
    if not spin.geometry.fixed_axis:
        raise BadRecording(f"{recording.name}: turns freely; identification needs a shaft (fixed_axis in its geometry)")
    reference = recording.roll_truth if by_truth else recording.encoder
    if reference is None:
        what = "truth of its roll" if by_truth else "encoder to compare with"
        raise BadRecording(f"{recording.name}: has no {what}; import the trial with its column")
    radial, tangential = _find_columns(spin, recording.name)
    seen = coefficients(spin.geometry)
    arm1, arm2 = -seen[radial, TERMS.index("omega_x^2")], seen[tangential, TERMS.index("omega_x dot")]
    window_s = 0.0
    if _is_angle_alone(reference):
        window_s = _choose_window_s(reference, float(np.nanvar(spin.accel_mps2[:, tangential]) / arm2**2))
        rate, turning, inside = _smooth_encoder(spin, reference, window_s)
    else:
        rate, turning, inside = _read_encoder(spin, reference)
    use = inside & np.isfinite(spin.accel_mps2).all(axis=1) & ~find_saturated(spin).any(axis=1)
    if use.sum() < _FEWEST:
        raise BadRecording(
            f"{recording.name}: {int(use.sum())} samples can be used and {_FEWEST} are needed; check ranges and the "
            "encoder's time"
        )
    along, felt_along = arm1 * rate[use] ** 2, spin.accel_mps2[use, radial]
    angle = np.interp(spin.t_ns[use], reference.t_ns, reference.angle_rad)
    ahead, felt = arm2 * turning[use], spin.accel_mps2[use, tangential]
    # Noise of encoder and accelerometer are independent: what they share beside gravity is motion.
    shared = np.cov(_remove_turns(ahead, angle), _remove_turns(felt, angle))
    shared_along = np.cov(_remove_turns(along, angle), -_remove_turns(felt_along, angle))
    return Trial(
        recording=recording.name,
        samples=int(use.sum()),
        left_out=int((~use).sum()),
        radial=_compute_residual(along + felt_along, angle),
        tangential=_compute_residual(ahead - felt, angle),
        encoder_m2ps4=max(float(shared[0, 0] - shared[0, 1]), 0.0),
        encoder_radial_m2ps4=max(float(shared_along[0, 0] - shared_along[0, 1]), 0.0),
        smoothed_s=window_s,
        smoothed_samples=window_s / (float(np.median(np.diff(spin.t_ns))) / 1e9),
        d1_m=float(arm1),
        d2_m=float(arm2),
    )


def _find_columns(spin: Spin, name: str) -> tuple[int, int]:
    """Return the columns of the radial and the tangential accelerometer, which alone see w^2 and w'."""
    seen = np.abs(coefficients(spin.geometry))
    found = [np.flatnonzero(seen[:, TERMS.index(term)] > 1e-9) for term in ("omega_x^2", "omega_x dot")]
    if any(len(one) != 1 for one in found) or found[0][0] == found[1][0]:
        raise BadRecording(
            f"{name}: identification needs one radial and one tangential accelerometer, not {len(seen)} mixed"
        )
    return int(found[0][0]), int(found[1][0])


def _read_encoder(spin: Spin, encoder: Encoder) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return rate (N,), its difference over the step before (N,), and which samples lie within the encoder's time."""
    rate = np.interp(spin.t_ns, encoder.t_ns, encoder.rate_radps)
    turning = np.diff(rate, prepend=rate[:1]) / (np.diff(spin.t_ns, prepend=spin.t_ns[0] - 1) / 1e9)
    inside = (spin.t_ns >= encoder.t_ns[0]) & (spin.t_ns <= encoder.t_ns[-1])
    inside[0] = False  # has no step before it
    return rate, np.asarray(turning), inside


def _is_angle_alone(encoder: Encoder) -> bool:
    """Return whether the rate was made from the angle, as an import does where a log has none."""
    if len(encoder.t_ns) < _FEWEST:
        return False
    made = np.diff(encoder.angle_rad) / (np.diff(encoder.t_ns) / 1e9)
    return bool(np.allclose(encoder.rate_radps[1:], made, rtol=1e-9, atol=1e-9))


def _choose_window_s(encoder: Encoder, accel_var: float) -> float:
    """Return the shortest window in which the noise of the angle is a small part of the variance of the acceleration.

    A parabola through n angles with noise s at steps of T has the second derivative to 720 s^2 / (T^4 n^5).
    """
    step_s = float(np.median(np.diff(encoder.t_ns))) / 1e9
    noise_var = float(np.var(np.diff(_resample_evenly(encoder)[1], 4))) / _FOURTH
    needed = (720 * noise_var / (step_s**4 * _ENCODER_SHARE * max(accel_var, 1e-12))) ** 0.2
    most = max(_LONGEST_S / step_s, _SHORTEST)
    return float(np.clip(needed, _SHORTEST, most)) * step_s


def _resample_evenly(encoder: Encoder) -> tuple[Floats, Floats]:
    """Return times in s from the first stamp, at the median step, and the angles there."""
    t_s = (encoder.t_ns - encoder.t_ns[0]) / 1e9
    even_s = np.arange(0, t_s[-1], float(np.median(np.diff(t_s))))
    return even_s, np.interp(even_s, t_s, encoder.angle_rad)


def _smooth_encoder(spin: Spin, encoder: Encoder, window_s: float) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return what :func:`_read_encoder` does, by parabolas through the angles of a window."""
    even_s, angle = _resample_evenly(encoder)
    step_s = float(even_s[1])
    length = 2 * min(round(window_s / step_s / 2), (len(angle) - 1) // 2) + 1
    rate, turning = (savgol_filter(angle, length, 2, deriv=order, delta=step_s) for order in (1, 2))
    t_s, half_s = (spin.t_ns - encoder.t_ns[0]) / 1e9, length // 2 * step_s
    inside = (t_s >= half_s) & (t_s <= even_s[-1] - half_s)
    return np.interp(t_s, even_s, rate), np.interp(t_s, even_s, turning), inside


def _compute_residual(values: Floats, angle_rad: Floats) -> Residual:
    """Return the statistics of residuals (N,) in m/s^2 at angles (N,) in rad, with what turns with the shaft."""
    robust_sd = MEDIAN_DEVIATION_TO_SD * float(np.median(np.abs(values - np.median(values))))
    return Residual(
        variance_m2ps4=float(np.var(values)),
        robust_m2ps4=robust_sd**2,
        glitches=int((np.abs(values - np.median(values)) > _GLITCH_SDS * robust_sd).sum()),
        mean_mps2=float(values.mean()),
        once_per_turn_mps2=float(np.sqrt(2) * np.std(values - _remove_turns(values, angle_rad))),
    )


def _remove_turns(values: Floats, angle_rad: Floats) -> Floats:
    """Return values (N,) without their mean and without what turns with the shaft once per turn."""
    turns = np.column_stack([np.ones(len(values)), np.cos(angle_rad), np.sin(angle_rad)])
    return np.asarray(values - turns @ np.linalg.lstsq(turns, values, rcond=None)[0])
