"""Measure angular acceleration and squared rate of every sample, with validity and noise."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import binom

from stillpoint.datasets.constants import MEDIAN_DEVIATION_TO_SD
from stillpoint.datasets.errors import Unobservable
from stillpoint.datasets.recording import Floats, Recording, Spin, Times
from stillpoint.datasets.spin import Channel, SpinChannels, channels, find_saturated, measure
from stillpoint.smoother.spin.params import SpinCalibration, SpinNoise

_DIFFERENCE = 4  # order of the differences that leave only the white noise of a smooth signal
_ROUNDING = 1e-9  # relative
_RUN = 8  # equal values in a row
_COARSE = 0.3  # share of values that repeat the one before
_LEAST_ALONG = 0.1  # of a gyro's axis that must lie along the spin
_SIGN_SD = 5.0  # by which the products must differ from zero
_FEWEST = 50  # valid samples of a channel
_LEAST_ACCEL, _LEAST_SQUARED = 1e-2, 1e-4  # relative noise of the channels from inexact stamps, arms and axes


@dataclass(frozen=True, eq=False)
class SpinSamples:
    """Both channels at N samples. A channel's gravity is ``amplitude * (c cos angle + s sin angle)``."""

    t_ns: Times
    step_s: Floats  # (N,) from the sample before; the first has the median step
    accel_radps2: Floats  # (N,) angular acceleration, 0 where it is not valid
    squared_rad2ps2: Floats  # (N,) squared rate, 0 where it is not valid
    accel_valid: NDArray[np.bool_]  # (N,)
    squared_valid: NDArray[np.bool_]  # (N,)
    accel_sd: float  # rad/s^2, white, per sample
    squared_sd: float  # rad^2/s^2, white, per sample
    accel_gravity: Floats  # (2,) 1/m: c and s of gravity's amplitude in m/s^2
    squared_gravity: Floats  # (2,) 1/m
    bias_per_accel: Floats  # (2, k) 1/m: biases of squared rate and acceleration by those of the accelerometers

    def __len__(self) -> int:
        return len(self.t_ns)


def measure_samples(recording: Recording, params: SpinNoise) -> SpinSamples:
    """Return the channels of a recording's spin stream; raise :class:`Unobservable` when too few samples are valid."""
    spin = recording.spin
    if spin is None:
        raise Unobservable(f"{recording.name}: has no spin stream; method roll-graph needs one")
    by = channels(spin.geometry)
    seen = measure(spin, by)
    accel_valid = seen.omega_dot_valid & ~_find_frozen(seen.omega_dot_radps2)
    squared_valid = seen.omega_squared_valid & ~_find_frozen(seen.omega_squared_radps2)
    accel = np.where(accel_valid, seen.omega_dot_radps2, 0.0)
    squared = np.where(squared_valid, seen.omega_squared_radps2, 0.0)
    for name, valid in (("angular acceleration", accel_valid), ("squared rate", squared_valid)):
        if valid.sum() < _FEWEST:
            raise Unobservable(
                f"{recording.name}: {int(valid.sum())} of {len(valid)} samples give the {name}, {_FEWEST} are needed; "
                "the others are missing, at the range of an accelerometer, or repeat themselves"
            )
    given = params.source == "given"
    return SpinSamples(
        t_ns=spin.t_ns,
        step_s=_steps_s(spin),
        accel_radps2=accel,
        squared_rad2ps2=squared,
        accel_valid=accel_valid,
        squared_valid=squared_valid,
        accel_sd=params.accel_sd_radps2 if given else _estimate_white_sd(accel, accel_valid, _LEAST_ACCEL),
        squared_sd=params.squared_sd_rad2ps2 if given else _estimate_white_sd(squared, squared_valid, _LEAST_SQUARED),
        accel_gravity=_gravity_parts(by, by.omega_dot),
        squared_gravity=_gravity_parts(by, by.omega_squared),
        bias_per_accel=np.stack([by.omega_squared.accel, by.omega_dot.accel]),
    )


def _find_frozen(values: Floats) -> NDArray[np.bool_]:
    """Return where a channel (N,) repeats the same value for RUN samples or more, as a frozen sensor does.

    In a channel that repeats itself most of the time the converter is coarser than the noise: nothing counts as frozen.
    """
    repeats = np.concatenate([[False], np.diff(values) == 0])
    if repeats.mean() > _COARSE:
        return np.zeros(len(values), dtype=np.bool_)
    run = np.cumsum(~repeats)  # one number for each run of equal values
    return np.asarray(np.bincount(run)[run] >= _RUN)


def find_sign(spin: Spin, params: SpinCalibration) -> float | None:
    """Return the sign of the spin about x, +1.0 or -1.0, None where no sensor shows it.

    The gyro that sees most of the spin decides; without one, the products of the spin with the rates about y and z.
    """
    along = spin.geometry.gyro_axis_b[:, 0]
    if not len(along) or np.abs(along).max() < _LEAST_ALONG:
        return _sign_by_products(spin, params)
    best = int(np.abs(along).argmax())
    seen = spin.gyro_radps[:, best]
    seen = seen[np.isfinite(seen)]
    return float(np.sign(np.median(seen) * along[best])) or None if len(seen) else None


def _sign_by_products(spin: Spin, params: SpinCalibration) -> float | None:
    """Return the sign of the sum of w_x w_y * w_y and w_x w_z * w_z, measured by accelerometers and gyros.

    None where the noise, biases and scales of the accelerometers could explain the sum.
    """
    by = channels(spin.geometry)
    rates = np.stack([spin.gyro_radps[:, one != 0] @ one[one != 0] for one in by.transverse])  # (2, N)
    full = find_saturated(spin)
    total, noise_var = 0.0, 0.0
    by_bias, by_scale = np.zeros((2, spin.accel_mps2.shape[1]))  # of the total, by what is one number all along
    for channel, weights, rate in zip((by.omega_xy, by.omega_xz), by.transverse, rates, strict=True):
        if channel is None or not weights.any():
            continue
        used = channel.accel != 0
        shown = channel.value(spin.accel_mps2, rates.T)
        good = np.isfinite(shown) & np.isfinite(rate) & ~full[:, used].any(axis=1)
        if good.sum() < _FEWEST:
            continue
        shown, rate = shown[good], rate[good]
        total += float(shown @ rate)
        noise_var += _estimate_white_sd(shown, np.ones(len(shown), dtype=np.bool_), 0.0) ** 2 * float(rate @ rate)
        by_bias += channel.accel * rate.sum()
        by_scale[used] += channel.accel[used] * (rate @ spin.accel_mps2[good][:, used])
    off_var = params.accel_bias_sd_mps2**2 * by_bias @ by_bias + params.lever_arm_sd**2 * by_scale @ by_scale
    return float(np.sign(total)) if abs(total) > _SIGN_SD * np.sqrt(noise_var + off_var) else None


def _estimate_white_sd(values: Floats, valid: NDArray[np.bool_], least: float) -> float:
    """Return the sd of the white noise in a smooth signal (N,), robustly, from its fourth differences.

    The result is at least the share ``least`` of the signal's RMS.
    """
    whole = np.convolve(valid, np.ones(_DIFFERENCE + 1), "valid") == _DIFFERENCE + 1
    differences = np.diff(values, _DIFFERENCE)[whole]
    size = float(np.median(np.abs(differences))) * MEDIAN_DEVIATION_TO_SD / np.sqrt(binom(2 * _DIFFERENCE, _DIFFERENCE))
    return max(size, least * float(np.sqrt(np.mean(values[valid] ** 2))), 1e-9)


def _steps_s(spin: Spin) -> Floats:
    steps = np.diff(spin.t_ns) / 1e9
    return np.concatenate([[np.median(steps)], steps])


def _gravity_parts(by: SpinChannels, channel: Channel) -> Floats:
    """Return the parts of gravity along the axes: at angle 0 the body's z axis points up as far as the spin axis
    allows.
    """
    seen = channel.accel @ by.geometry.accel_axis_b
    seen = np.where(np.abs(seen) > _ROUNDING * np.abs(channel.accel).max(), seen, 0.0)  # it cancels where F3 is there
    return np.array([seen[2], seen[1]])
