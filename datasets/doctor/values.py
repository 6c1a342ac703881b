"""Values that no working sensor gives: a stuck axis, clipping, held or frozen samples, coarse steps."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.doctor.finding import Finding, Remedy
from stillpoint.datasets.doctor.remedy import find_repeats
from stillpoint.datasets.doctor.turning import find_large_sizes
from stillpoint.datasets.recording import Floats, Recording, Times

_CLIPPED_SAMPLES = 5  # fewer at the extreme may be chance
_CLIPPED_SPAN = 0.1  # of the column's range: as many samples as half of those so near below must lie on the extreme
_ENTRY_STEPS = 3.0  # a value enters the extreme by more than so many steps within two samples
_CLIPPED_STEPS = 20.0  # the extreme is further than so many steps of the converter from the median
_HELD_SHARE = 0.2  # of the samples in motion that repeat the one before
_HELD_STEPS = 3.0  # ... while the others move on by more than so many steps of the converter
_FROZEN_S, _FROZEN_SAMPLES = 0.3, 10  # a run of equal samples in motion, longer than both
_COARSE = {"gyro": np.deg2rad(0.5), "accel": 0.05, "mag": 1.0}  # steps above these hide slow motion
_SPIN_AT_REST_MPS2, _SPIN_AT_REST_RADPS = 15.0, 0.3  # below both, a spinning body may as well lie still
_TO_SHOW = {"gyro": (180 / np.pi, "deg/s"), "accel": (1.0, "m/s^2"), "mag": (1.0, "uT")}


@dataclass(frozen=True, eq=False)
class _Sensor:
    """One sensor's columns, and which samples fall into motion that the other sensors see."""

    name: str
    stream: str
    t_ns: Times
    values: Floats  # (N, k)
    moving: NDArray[np.bool_]

    @property
    def axes(self) -> list[str]:
        """Names of the columns."""
        return ["x", "y", "z"] if self.name in _TO_SHOW else [f"{k + 1}" for k in range(self.values.shape[1])]

    def show(self, value: float) -> str:
        """Return a value with its unit."""
        factor, unit = _TO_SHOW.get(self.name, (1.0, "m/s^2" if "accel" in self.name else "rad/s"))
        return f"{factor * value:.4g} {unit}"


def check_values(recording: Recording) -> list[Finding]:
    """Return what is wrong with the values of each sensor, whatever their unit."""
    findings: list[Finding] = []
    for sensor in _list_sensors(recording):
        if len(sensor.t_ns) < 10:
            continue
        stuck = _find_stuck(sensor)
        findings += stuck
        if stuck:
            continue
        findings += _find_clipping(sensor)
        frozen = _find_frozen(sensor)
        findings += frozen or _find_held(sensor, recording)
    return _merge_imu(findings)


def check_steps(recording: Recording) -> list[Finding]:
    """Find values in steps so coarse that slow motion hides between them; for a recording whose units are right."""
    return [finding for sensor in _list_sensors(recording) for finding in _find_coarse_steps(sensor)]


def _list_sensors(recording: Recording) -> list[_Sensor]:
    """Return the sensors of a recording with a mask (N,) of the samples during which their values must change."""
    sensors = []
    if recording.imu is not None:
        imu = recording.imu
        turning = find_large_sizes(np.linalg.norm(imu.gyro_b_radps - np.median(imu.gyro_b_radps, axis=0), axis=1))
        norm = np.linalg.norm(imu.accel_b_mps2, axis=1)
        shaken = np.abs(norm - np.median(norm)) > 0.03 * np.median(norm)
        sensors.append(_Sensor("gyro", "imu", imu.t_ns, imu.gyro_b_radps, _find_neighbours(turning | shaken)))
        sensors.append(_Sensor("accel", "imu", imu.t_ns, imu.accel_b_mps2, _find_neighbours(turning | shaken)))
        if recording.mag is not None:
            mag = recording.mag
            at = np.clip(np.searchsorted(imu.t_ns, mag.t_ns), 0, len(imu.t_ns) - 1)
            sensors.append(_Sensor("mag", "mag", mag.t_ns, mag.mag_b_ut, _find_neighbours(turning)[at]))
    if recording.spin is not None:
        spin = recording.spin
        pressed = np.linalg.norm(np.nan_to_num(spin.accel_mps2), axis=1) > _SPIN_AT_REST_MPS2
        turning = np.linalg.norm(np.nan_to_num(spin.gyro_radps), axis=1) > _SPIN_AT_REST_RADPS
        for name, values in (("spin-accel", spin.accel_mps2), ("spin-gyro", spin.gyro_radps)):
            whole = np.isfinite(values).all(axis=1)
            if values.shape[1] and whole.any():
                sensors.append(_Sensor(name, "spin", spin.t_ns[whole], values[whole], (pressed | turning)[whole]))
    return sensors


def _find_neighbours(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return samples with more than half of their 21 neighbours in the mask."""
    return _share_around(mask, 21) > 0.5


def _share_around(mask: NDArray[np.bool_], width: int) -> Floats:
    """Return the share (N,) of a mask that is True in a window around each sample."""
    width = min(width, len(mask))
    return np.asarray(np.convolve(mask, np.ones(width) / width, mode="same"))


def _find_stuck(sensor: _Sensor) -> list[Finding]:
    """Return the finding that axes of a sensor never change."""
    still = [k for k in range(sensor.values.shape[1]) if (sensor.values[:, k] == sensor.values[0, k]).all()]
    if not still:
        return []
    names = ", ".join(sensor.axes[k] for k in still)
    levels = ", ".join(sensor.show(sensor.values[0, k]) for k in still)
    missing = "missing" if not sensor.values[:, still].any() else "stuck"
    message = f"{sensor.name} {names}: {missing}, every sample reads {levels}"
    code = f"{sensor.name}-stuck"
    if sensor.name == "mag":
        remedy = Remedy("drop-stream", "mag", f"magnetometer dropped: {names} {missing}")
        return [Finding(code, "error", message + "; leave the magnetometer out", remedy)]
    return [Finding(code, "error", message + "; there is no attitude without it: record or import again")]


def _find_clipping(sensor: _Sensor) -> list[Finding]:
    """Return findings about axes that rest on an extreme value in motion: the end of the sensor's range."""
    findings = []
    for k, name in enumerate(sensor.axes):
        column = sensor.values[:, k]
        step, span = _find_converter_step(column), float(np.ptp(column))
        for sign in (1.0, -1.0):
            toward = sign * column
            extreme = float(toward.max())
            on_limit = toward == extreme
            at = int((on_limit & sensor.moving).sum())
            near = (toward < extreme) & (toward > extreme - _CLIPPED_SPAN * span)
            below = int((near & sensor.moving).sum())
            far = extreme - np.median(toward) > _CLIPPED_STEPS * step
            # A natural peak is reached slowly, the end of the range in full motion.
            enters = np.flatnonzero(on_limit[2:] & ~on_limit[1:-1]) + 2
            fast = len(enters) > 0 and np.median(toward[enters] - toward[enters - 2]) > _ENTRY_STEPS * step
            together = bool((on_limit[1:] & on_limit[:-1]).any())
            if at >= _CLIPPED_SAMPLES and at > 0.5 * below and far and fast and together:
                message = (
                    f"{sensor.name} {name}: {at} samples lie on {sensor.show(sign * extreme)}, the end of the range: "
                    "the motion was larger; set a larger range, and trust no attitude after them"
                )
                values = {"samples": float(at), "level": sign * extreme}
                findings.append(Finding(f"{sensor.name}-clipped", "warning", message, values=values))
    return findings


def _find_frozen(sensor: _Sensor) -> list[Finding]:
    """Return the finding that all axes repeat the same value for a while in motion."""
    same = find_repeats(sensor.values)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same.astype(np.int8), [0]])))
    first, last = edges[::2], edges[1::2] - 1  # of the repeating samples; the one before is genuine
    seconds = (sensor.t_ns[last] - sensor.t_ns[np.maximum(first - 1, 0)]) / 1e9
    moving = np.array([sensor.moving[a : b + 1].mean() > 0.5 for a, b in zip(first, last, strict=True)], dtype=np.bool_)
    frozen = moving & (seconds >= _FROZEN_S) & (last - first + 1 >= _FROZEN_SAMPLES)
    if not frozen.any() or _is_slow_for_steps(sensor, same, sensor.moving):
        return []
    first, last = first[frozen], last[frozen]
    spans = tuple(int(t) for pair in zip(sensor.t_ns[first], sensor.t_ns[last], strict=True) for t in pair)
    at_s = (sensor.t_ns[first[0]] - sensor.t_ns[0]) / 1e9
    message = (
        f"{sensor.name}: frozen in motion for {seconds[frozen].sum():.2f} s in {len(first)} stretches, the first "
        f"{at_s:.2f} s after the start; drop these samples"
    )
    remedy = Remedy("drop", sensor.stream, f"{sensor.stream}: frozen samples dropped", spans)
    values = {"frozen_s": float(seconds[frozen].sum()), "at_s": float(at_s)}
    return [Finding(f"{sensor.name}-frozen", "error", message, remedy if sensor.stream != "spin" else None, values)]


def _find_held(sensor: _Sensor, recording: Recording) -> list[Finding]:
    """Return the finding that values are repeated between samples: the sensor is slower than its stamps."""
    if sensor.stream == "spin" or sensor.moving.sum() < 20:
        return []
    same = find_repeats(sensor.values)
    share = float(same[sensor.moving].mean())
    # A stretch of doubled samples is a fault as well, however short beside the recording.
    pairs = same & sensor.moving
    stretch = _share_around(pairs, 40) > 0.4
    where = sensor.moving if share >= _HELD_SHARE else stretch & sensor.moving
    if not where.any() or _is_slow_for_steps(sensor, same, where):
        return []
    if sensor.stream == "mag":
        remedy = Remedy("drop-repeats", "mag", "mag: of equal neighbouring samples the first kept")
    elif _repeat_together(pairs, find_repeats(_get_other_sensor(sensor.name, recording)) & sensor.moving):
        remedy = Remedy("drop-repeats", "imu", "imu: of equal neighbouring samples the first kept")
    else:
        remedy = Remedy("interpolate", sensor.name, f"{sensor.name}: held samples interpolated")
    message = (
        f"{sensor.name}: {100 * share:.0f} % of the samples in motion repeat the one before "
        f"({int(pairs.sum())} samples): the sensor is slower than its stamps; {remedy.text.split(': ', 1)[1]}"
    )
    return [Finding(f"{sensor.name}-held", "warning", message, remedy, {"share": share})]


def _is_slow_for_steps(sensor: _Sensor, same: NDArray[np.bool_], where: NDArray[np.bool_]) -> bool:
    """Do values repeat because the converter's steps are larger than what happens between samples?"""
    step = np.array([_find_converter_step(column) for column in sensor.values.T])
    changes = np.abs(np.diff(sensor.values, axis=0))[(where & ~same)[1:]]
    if len(changes) == 0 or not step.any():
        return False
    return bool(np.median((changes / np.where(step > 0, step, np.inf)).max(axis=1)) < _HELD_STEPS)


def _repeat_together(one: NDArray[np.bool_], other: NDArray[np.bool_]) -> bool:
    """Do the repeats of the rarer of two sensors fall on repeats of the other?"""
    return bool((one & other).sum() > 0.9 * max(1, min(one.sum(), other.sum())))


def _get_other_sensor(sensor: str, recording: Recording) -> Floats:
    imu = recording.require_imu()
    return imu.accel_b_mps2 if sensor == "gyro" else imu.gyro_b_radps


def _find_coarse_steps(sensor: _Sensor) -> list[Finding]:
    """Return the finding that the sensor's values come in steps too coarse for its signal."""
    if sensor.name not in _COARSE:
        return []
    steps = [_find_converter_step(column) for column in sensor.values.T]
    step = max(steps)
    if step <= _COARSE[sensor.name]:
        return []
    message = (
        f"{sensor.name}: values come in steps of {sensor.show(step)}: slower changes are invisible; "
        "set a smaller range, or keep more digits when recording"
    )
    return [Finding(f"{sensor.name}-coarse", "warning", message, values={"step": step})]


def _find_converter_step(column: Floats) -> float:
    """Return the converter's step: the smallest difference where all differences are multiples of it, else 0."""
    levels = np.unique(column)
    if len(levels) < 2 or len(levels) > 0.5 * len(column):
        return 0.0
    gaps = np.diff(levels)
    step = float(gaps[gaps > 1e-9 * np.abs(levels).max()].min(initial=np.inf))
    if not np.isfinite(step):
        return 0.0
    off = np.abs(gaps / step - np.round(gaps / step))
    return step if np.median(off) < 0.05 else 0.0


def _merge_imu(findings: list[Finding]) -> list[Finding]:
    """Merge equal remedies of gyro and accelerometer, which share their rows, into one."""
    seen: set[tuple[str, str]] = set()
    merged = []
    for finding in findings:
        remedy = finding.remedy
        if remedy is not None and remedy.kind == "drop-repeats":
            if (remedy.kind, remedy.target) in seen:
                finding = Finding(finding.code, finding.severity, finding.message, None, finding.values)
            seen.add((remedy.kind, remedy.target))
        merged.append(finding)
    return merged
