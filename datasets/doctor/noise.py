"""Noise and bias at rest, per sensor; without a rest, the gyro's bias by what the other sensors say."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.constants import MEDIAN_DEVIATION_TO_SD
from stillpoint.datasets.doctor.finding import Finding, Remedy
from stillpoint.datasets.doctor.witness import Witness
from stillpoint.datasets.recording import Floats, Imu, Recording, Times, rate_hz
from stillpoint.datasets.times import is_inside

_BIAS_RADPS = np.deg2rad(2.0)  # above it attitude drifts by a full circle in three minutes
# White noise per sqrt(Hz) above which a MEMS sensor is not at its best: ten times what data sheets promise.
_NOISE = {"gyro": np.deg2rad(0.1), "accel": 0.02, "mag": 1.0}
_UNITS = {"gyro": (180 / np.pi, "deg/s"), "accel": (1.0, "m/s^2"), "mag": (1.0, "uT")}
_MAG_BIAS_RADPS, _MAG_GAIN = np.deg2rad(3.0), 1.5  # by the magnetometer alone only above these is a warning given
_FEWEST_SAMPLES = 50
_CALM_SPREAD = 0.01  # of the force's size: the smoothed force of a calm second varies by less
_SMOOTH_S = 0.1


def check_noise(recording: Recording, rests_ns: Times, witnesses: Sequence[Witness]) -> list[Finding]:
    """Measure the white noise of each sensor in the calm stretches, and the gyro's bias."""
    imu = recording.require_imu()
    spans = rests_ns if len(rests_ns) else find_calm_seconds(imu)
    where = f"in {len(rests_ns)} rests" if len(rests_ns) else f"in {len(spans)} calm seconds"
    columns = [("gyro", imu.t_ns, imu.gyro_b_radps), ("accel", imu.t_ns, imu.accel_b_mps2)]
    if recording.mag is not None:
        columns.append(("mag", recording.mag.t_ns, recording.mag.mag_b_ut))
    findings = []
    for name, t_ns, values in columns:
        still = is_inside(t_ns, spans)
        if still.sum() >= _FEWEST_SAMPLES:
            findings.append(_report_noise(name, values, still, rate_hz(t_ns), where))
    if not findings:
        findings.append(Finding("noise-not-tested", "fact", "noise: not tested, as nothing rests"))
    return findings + _report_bias(recording, rests_ns, witnesses)


def measure_white_noise(values: Floats, still: np.ndarray) -> Floats:
    """Return the standard deviation of white noise per column, from differences between neighbouring still samples.

    It is computed from third differences, so that slow turning does not count, and is robust against single jolts.
    """
    run = still[3:] & still[2:-1] & still[1:-2] & still[:-3]
    third = values[3:] - 3 * values[2:-1] + 3 * values[1:-2] - values[:-3]
    if not run.any():
        return np.full(values.shape[1], np.nan)
    return np.asarray(MEDIAN_DEVIATION_TO_SD * np.median(np.abs(third[run]), axis=0) / np.sqrt(20.0))


def _report_noise(name: str, values: Floats, still: np.ndarray, rate: float, where: str) -> Finding:
    """Return the finding about the white noise of a sensor (N, 3) over its still samples (N,)."""
    sd = measure_white_noise(values, still)
    density = float(np.max(sd) / np.sqrt(rate))
    factor, unit = _UNITS[name]
    message = (
        f"{name}: white noise {factor * float(np.max(sd)):.3g} {unit} a sample on the worst axis, "
        f"{factor * density:.2g} {unit}/sqrt(Hz), {where}"
    )
    noisy = np.isfinite(density) and density > _NOISE[name]
    values_out = {"density": density, "sd": float(np.max(sd))}
    if noisy:
        advice = "; look for vibration, or a damaged or wrongly set sensor"
        return Finding(f"{name}-noise", "warning", message + advice, values=values_out)
    return Finding(f"{name}-noise", "fact", message, values=values_out)


def _report_bias(recording: Recording, rests_ns: Times, witnesses: Sequence[Witness]) -> list[Finding]:
    """Return the finding about the gyro's bias: from rest, else by the truth, else by the magnetometer."""
    imu = recording.require_imu()
    still = is_inside(imu.t_ns, rests_ns)
    how, bias = "at rest", None
    sure = any(one.name == "mag" and one.choice is not None and one.choice.gain > _MAG_GAIN for one in witnesses)
    if still.sum() >= _FEWEST_SAMPLES:
        bias = imu.gyro_b_radps[still].mean(axis=0)
    else:
        for name, words in (("truth", "by the truth"), ("mag", "by the magnetometer")):
            found = [w.gyro_bias_b_radps for w in witnesses if w.name == name and w.gyro_bias_b_radps is not None]
            if bias is None and found:
                how, bias = words, found[0]
    if bias is None:
        return [Finding("gyro-bias", "fact", "gyro: bias not tested, as nothing rests and no other sensor shows it")]
    size = float(np.linalg.norm(bias))
    shown = ", ".join(f"{b:.2f}" for b in np.rad2deg(bias))
    values = {"bias_radps": size}
    message = f"gyro: bias ({shown}) deg/s {how}"
    if size <= _BIAS_RADPS:
        return [Finding("gyro-bias", "fact", message, values=values)]
    if how == "by the magnetometer":
        if not sure or size <= _MAG_BIAS_RADPS:
            return [Finding("gyro-bias", "fact", message + ", roughly", values=values)]
        advice = ", known to a few deg/s only; let the sensor rest at the start of a recording"
        return [Finding("gyro-bias", "warning", message + advice, values=values)]
    remedy = Remedy("offset", "gyro", f"gyro less bias ({shown}) deg/s", tuple(float(b) for b in bias))
    return [Finding("gyro-bias", "warning", message + "; subtract it", remedy, values)]


def find_calm_seconds(imu: Imu) -> Times:
    """Return the first and last stamps of whole seconds in which the smoothed specific force keeps still, (S, 2)."""
    tenth = _number_bins(imu.t_ns, _SMOOTH_S)
    first, mean = _average_bins(tenth, imu.accel_b_mps2)
    second = tenth[first] // round(1 / _SMOOTH_S)
    starts, middle = _average_bins(second, mean)
    _, square = _average_bins(second, mean**2)
    spread = np.sqrt(np.maximum((square - middle**2).sum(axis=1), 0.0))
    whole = np.diff(starts, append=len(second)) == round(1 / _SMOOTH_S)
    calm = np.flatnonzero(whole & (spread < _CALM_SPREAD * np.linalg.norm(middle, axis=1)))
    ends = np.append(first[starts[1:]], len(imu.t_ns)) - 1
    return np.stack([imu.t_ns[first[starts[calm]]], imu.t_ns[ends[calm]]], axis=1)


def _number_bins(t_ns: Times, width_s: float) -> Times:
    """Return the number of the bin (N,) in which each stamp lies, from 0 on."""
    return np.asarray((t_ns - t_ns[0]) // int(width_s * 1e9))


def _average_bins(bins: Times, values: Floats) -> tuple[NDArray[np.intp], Floats]:
    """Start of each run of equal bins, and the mean over it."""
    starts = np.flatnonzero(np.diff(bins, prepend=bins[0] - 1))
    counts = np.diff(starts, append=len(bins))
    return starts, np.add.reduceat(values, starts, axis=0) / counts[:, None]
