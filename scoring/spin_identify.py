"""Noise variances of the accelerometers on a shaft, from trials with an encoder (paper 000, eqs (28)-(31))."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.errors import BadRecording
from stillpoint.datasets.recording import Encoder, Floats, Recording, Spin
from stillpoint.datasets.spin import TERMS, channels, coefficients, saturated

MAD_TO_SD = 1.4826  # of a normal distribution
GLITCH_SDS = 6.0  # robust standard deviations beyond which a residual is counted as a glitch
FEWEST = 100  # samples below which a variance says little


@dataclass(frozen=True)
class Residual:
    """What one accelerometer of a trial reads beyond what the encoder explains."""

    variance_m2ps4: float
    robust_m2ps4: float  # by the median absolute deviation: the variance without its glitches
    glitches: int  # residuals beyond 6 robust standard deviations
    mean_mps2: float  # bias, and error of the lever arm or the scale
    once_per_turn_mps2: float  # amplitude of what turns with the shaft: g sin(tilt), or vibration; in the variance


@dataclass(frozen=True)
class Trial:
    """One recording's variances."""

    recording: str
    samples: int  # that were used
    left_out: int  # lost, saturated, or outside the encoder's time
    radial: Residual  # eq (28): d1 w^2 + F4
    tangential: Residual  # eq (30): d2 w' - F5, w' the difference of the encoder's rates over T
    encoder_m2ps4: float  # the part of (30) that is the encoder's own noise
    d1_m: float
    d2_m: float

    @property
    def turning_share(self) -> float:
        """The part of D4 that turns with the shaft: gravity on a shaft that is tilted, or vibration."""
        return self.radial.once_per_turn_mps2**2 / 2 / self.radial.variance_m2ps4

    @property
    def tangential_alone_m2ps4(self) -> float:
        """The tangential accelerometer's variance without the encoder's part."""
        return max(self.tangential.variance_m2ps4 - self.encoder_m2ps4, 0.0)


@dataclass(frozen=True)
class Identified:
    """The maximum over trials, as the paper takes it, and what follows by eq (25)."""

    trials: tuple[Trial, ...]
    d4_m2ps4: float
    d5_m2ps4: float  # as (30) gives it, the encoder's noise included
    d5_alone_m2ps4: float
    r_rad2ps4: float
    q_rad2ps4: float
    q_alone_rad2ps4: float


def identify(recordings: Sequence[Recording], by_truth: bool = False) -> Identified:
    """Variances of F4 and F5 from trials of one rig with a fixed axis; ``by_truth`` takes the true rate instead.

    Raises :class:`BadRecording` for a recording without spin or encoder, of another geometry than the first one, or
    with too few samples.
    """
    trials = tuple(_trial(recording, by_truth) for recording in recordings)
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
    radial, tangential = _which(first, recordings[0].name)
    variance = np.ones(len(first.geometry.accel_r_b_m))
    variance[[radial, tangential]] = d4, d5
    with_encoder = channels(first.geometry, variance)
    variance[tangential] = max(d5_alone, 1e-12)
    alone = channels(first.geometry, variance)
    return Identified(trials, d4, d5, d5_alone, with_encoder.r_rad2ps4, with_encoder.q_rad2ps4, alone.q_rad2ps4)


def _trial(recording: Recording, by_truth: bool) -> Trial:
    spin = recording.spin
    if spin is None:
        raise BadRecording(f"{recording.name}: has no spin stream; import it with `stillpoint import spin`")
    if not spin.geometry.fixed_axis:
        raise BadRecording(f"{recording.name}: turns freely; identification needs a shaft (fixed_axis in its geometry)")
    reference = recording.roll_truth if by_truth else recording.encoder
    if reference is None:
        what = "truth of its roll" if by_truth else "encoder to compare with"
        raise BadRecording(f"{recording.name}: has no {what}; import the trial with its column")
    radial, tangential = _which(spin, recording.name)
    rate, turning, inside = _of_encoder(spin, reference)
    use = inside & np.isfinite(spin.accel_mps2).all(axis=1) & ~saturated(spin).any(axis=1)
    if use.sum() < FEWEST:
        raise BadRecording(
            f"{recording.name}: {int(use.sum())} samples can be used and {FEWEST} are needed; check ranges and the "
            "encoder's time"
        )
    seen = coefficients(spin.geometry)
    arm1, arm2 = -seen[radial, TERMS.index("omega_x^2")], seen[tangential, TERMS.index("omega_x dot")]
    inward = arm1 * rate[use] ** 2 + spin.accel_mps2[use, radial]
    angle = np.interp(spin.t_ns[use], reference.t_ns, reference.angle_rad)
    ahead, felt = arm2 * turning[use], spin.accel_mps2[use, tangential]
    # Noise of encoder and accelerometer are independent: what they share beside gravity is motion.
    shared = np.cov(_without_turns(ahead, angle), _without_turns(felt, angle))
    return Trial(
        recording=recording.name,
        samples=int(use.sum()),
        left_out=int((~use).sum()),
        radial=_residual(inward, angle),
        tangential=_residual(ahead - felt, angle),
        encoder_m2ps4=max(float(shared[0, 0] - shared[0, 1]), 0.0),
        d1_m=float(arm1),
        d2_m=float(arm2),
    )


def _which(spin: Spin, name: str) -> tuple[int, int]:
    """Columns of the radial and of the tangential accelerometer: the only ones that see w^2 and w'."""
    seen = np.abs(coefficients(spin.geometry))
    found = [np.flatnonzero(seen[:, TERMS.index(term)] > 1e-9) for term in ("omega_x^2", "omega_x dot")]
    if any(len(one) != 1 for one in found) or found[0][0] == found[1][0]:
        raise BadRecording(
            f"{name}: identification needs one radial and one tangential accelerometer, not {len(seen)} mixed"
        )
    return int(found[0][0]), int(found[1][0])


def _of_encoder(spin: Spin, encoder: Encoder) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Rate (N,) at the samples, its difference over the step before (N,), and which lie within the encoder's time."""
    rate = np.interp(spin.t_ns, encoder.t_ns, encoder.rate_radps)
    turning = np.diff(rate, prepend=rate[:1]) / (np.diff(spin.t_ns, prepend=spin.t_ns[0] - 1) / 1e9)
    inside = (spin.t_ns >= encoder.t_ns[0]) & (spin.t_ns <= encoder.t_ns[-1])
    inside[0] = False  # has no step before it
    return rate, np.asarray(turning), inside


def _residual(values: Floats, angle_rad: Floats) -> Residual:
    robust_sd = MAD_TO_SD * float(np.median(np.abs(values - np.median(values))))
    return Residual(
        variance_m2ps4=float(np.var(values)),
        robust_m2ps4=robust_sd**2,
        glitches=int((np.abs(values - np.median(values)) > GLITCH_SDS * robust_sd).sum()),
        mean_mps2=float(values.mean()),
        once_per_turn_mps2=float(np.sqrt(2) * np.std(values - _without_turns(values, angle_rad))),
    )


def _without_turns(values: Floats, angle_rad: Floats) -> Floats:
    """Values (N,) without their mean and what turns with the shaft once per turn."""
    turns = np.column_stack([np.ones(len(values)), np.cos(angle_rad), np.sin(angle_rad)])
    return np.asarray(values - turns @ np.linalg.lstsq(turns, values, rcond=None)[0])
