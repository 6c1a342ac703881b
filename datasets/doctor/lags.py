"""Lags between the clocks: gyro against truth, accelerometer and magnetometer against gyro. Positive: late."""

from collections.abc import Sequence

from stillpoint.datasets.doctor.finding import Finding, Remedy
from stillpoint.datasets.doctor.lag import REACH_S, SIGMAS, Lag
from stillpoint.datasets.doctor.witness import Witness
from stillpoint.datasets.recording import Recording, rate_hz

# What a lag may be off by beside its standard error, measured where the lag is known (docs/doctor.md).
TRUTH_S = 0.001
ACCEL_S = 0.015  # translation that goes with turning looks like a lag of gravity
MAG_S = 0.020  # so does a field that changes with the place


def check_lags(
    recording: Recording, witnesses: Sequence[Witness], accel_by_truth: Lag | None, accel_by_gravity: Lag | None
) -> list[Finding]:
    """One finding per pair of clocks that the motion lets compare."""
    by_name = {one.name: one for one in witnesses}
    findings = []
    truth = by_name.get("truth")
    gyro_lag = truth.lag if truth is not None and truth.choice is not None else None
    if gyro_lag is not None:
        findings.append(_gyro_against_truth(recording, gyro_lag))
    if accel_by_truth is not None and gyro_lag is not None:
        both = Lag(accel_by_truth.lag_s - gyro_lag.lag_s, (accel_by_truth.sd_s**2 + gyro_lag.sd_s**2) ** 0.5)
        findings.append(_against_gyro("accel", "accelerometer", both, 2 * TRUTH_S, "by way of the truth"))
    elif accel_by_gravity is not None:
        findings.append(_against_gyro("accel", "accelerometer", accel_by_gravity, ACCEL_S, "by gravity"))
    mag = by_name.get("mag")
    if mag is not None and mag.choice is not None and mag.lag is not None:
        findings.append(_against_gyro("mag", "magnetometer", mag.lag, MAG_S, "by the field"))
    return findings


def _gyro_against_truth(recording: Recording, lag: Lag) -> Finding:
    """The rate at a stamp is late by half a step more than the attitude, as a sample describes the step before."""
    half_s = 0.5 / rate_hz(recording.require_imu().t_ns)
    values = {"lag_s": lag.lag_s + half_s, "sd_s": lag.sd_s, "half_step_s": half_s, "shift_s": lag.lag_s}
    message = (
        f"gyro: stamps are {_ms(lag.lag_s + half_s)} late (+) against the truth, +-{1e3 * lag.sd_s:.1f} ms; "
        f"half a step ({1e3 * half_s:.1f} ms) of it is the convention that a sample describes the step before its stamp"
    )
    if abs(lag.lag_s) < TRUTH_S + SIGMAS * lag.sd_s:
        return Finding("gyro-truth-lag", "fact", message + ", which leaves nothing to mend", None, values)
    remedy = Remedy("shift", "truth", f"truth shifted by {_ms(lag.lag_s)}", (lag.lag_s,))
    advice = f"; {_ms(lag.lag_s)} remain: shift the truth by them"
    return Finding("gyro-truth-lag", "warning", message + advice, remedy, values)


def _against_gyro(sensor: str, name: str, lag: Lag, systematic_s: float, how: str) -> Finding:
    values = {"lag_s": lag.lag_s, "sd_s": lag.sd_s, "systematic_s": systematic_s}
    message = (
        f"{sensor}: the {name}'s stamps are {_ms(lag.lag_s)} late (+) against the gyro's {how}, "
        f"+-{1e3 * lag.sd_s:.1f} ms (and up to {1e3 * systematic_s:.0f} ms from motion and surroundings)"
    )
    code = f"{sensor}-gyro-lag"
    doubtful = abs(lag.lag_s) > 0.9 * REACH_S
    if doubtful or abs(lag.lag_s) < systematic_s + SIGMAS * lag.sd_s:
        return Finding(code, "fact", message, None, values)
    remedy = Remedy("shift", sensor, f"{sensor} shifted by {_ms(-lag.lag_s)}", (-lag.lag_s,))
    return Finding(code, "warning", message + f"; shift it by {_ms(-lag.lag_s)}", remedy, values)


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:+.1f} ms"
