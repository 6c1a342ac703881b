"""Lags between the clocks: find the shift at which a loss over windows is smallest, and report what it means."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stillpoint.datasets.doctor.finding import Finding, Remedy
from stillpoint.datasets.recording import Floats, Recording, Times, rate_hz

REACH_S = 0.25  # lags up to this are looked for
_COARSE_S = 0.025
_FINER = 5  # each search has steps so many times shorter than the one before
_SEARCHES = 3
_BLOCKS = 10  # the recording is cut into so many parts, for the standard error
_SIGMAS = 5.0  # a lag of this many standard errors differs from zero
_MIN_CONTRAST = 0.1  # share of the loss that the best lag takes away from the worst; below, nothing is said
# What a lag may be off by beside its standard error, measured where the lag is known (docs/doctor.md).
_TRUTH_S = 0.001
_ACCEL_S = 0.015  # translation that goes with turning looks like a lag of gravity
_MAG_S = 0.020  # so does a field that changes with the place


@dataclass(frozen=True)
class Lag:
    """The stamps are late by ``lag_s``, with its standard error."""

    lag_s: float
    sd_s: float

    @property
    def clear(self) -> bool:
        """Well above its standard error."""
        return abs(self.lag_s) > _SIGMAS * self.sd_s


def find_lag(loss: Callable[[float], Floats | None]) -> Lag | None:
    """Minimise the sum of ``loss(lag_s)`` (n,), the same n windows for every lag; None when it hardly depends on it.

    A coarse search over +-0.25 s, then two finer ones, then a parabola. The standard error is a jackknife over ten
    parts of the recording, or more where the minimum is blunt: see :func:`_compute_unsure_s`.
    """
    grids = [np.arange(-REACH_S, REACH_S + _COARSE_S / 2, _COARSE_S)]
    tables: list[Floats] = []
    for search in range(_SEARCHES):
        table = _tabulate_loss(loss, grids[-1])
        if table is None:
            return None
        tables.append(table)
        total = table.sum(axis=1)
        if search == 0 and (total.max() <= 0 or (total.max() - total.min()) / total.max() < _MIN_CONTRAST):
            return None
        if search < _SEARCHES - 1:
            step = _COARSE_S / _FINER ** (search + 1)
            grid = grids[-1][int(total.argmin())] + step * np.arange(1 - _FINER, _FINER)
            grids.append(grid[np.abs(grid) <= REACH_S])
    bounds = _find_bounds(tables[0])
    parts = _sum_parts(tables[-1], bounds)
    best = _find_bottom(grids[-1], total)
    without = np.array([_find_bottom(grids[-1], total - part) for part in parts.T])
    jackknife = float(np.sqrt((_BLOCKS - 1) / _BLOCKS * np.sum((without - without.mean()) ** 2)))
    lowest = parts[int(total.argmin())]
    unsure = max(
        _compute_unsure_s(grid - best, _sum_parts(one, bounds) - lowest)
        for grid, one in zip(grids, tables, strict=True)
    )
    return Lag(best, max(jackknife, unsure / _SIGMAS))


def _compute_unsure_s(away_s: Floats, more: Floats) -> float:
    """Return how far from the best lag the loss is not yet clearly larger, by the scatter of its excess (L, BLOCKS).

    Around a smooth minimum the excess grows as d^2 and its scatter as d: it is half as many standard errors above zero
    as d is standard errors of the lag. Where noise ripples the loss, several minima compete, and the farthest counts.
    """
    scatter = np.sqrt(_BLOCKS) * more.std(axis=1, ddof=1)
    return float(np.abs(away_s[more.sum(axis=1) <= _SIGMAS / 2 * scatter]).max(initial=0.0))


def _find_bounds(table: Floats) -> Times:
    """Return where the parts of the recording meet, (BLOCKS - 1,), so that each shows as much of the lag."""
    told = np.cumsum(np.ptp(table, axis=0))
    return np.searchsorted(told / told[-1], np.linspace(0, 1, _BLOCKS + 1)[1:-1])


def _sum_parts(table: Floats, bounds: Times) -> Floats:
    """Return sums (L, BLOCKS) of losses (L, n) over the parts of the recording."""
    return np.stack([part.sum(axis=1) for part in np.split(table, bounds, axis=1)], axis=1)


def _tabulate_loss(loss: Callable[[float], Floats | None], grid: Floats) -> Floats | None:
    """Return the losses (L, n) at the lags of a grid (L,) in s; None where one of them has none."""
    rows = [loss(float(lag_s)) for lag_s in grid]
    return None if any(row is None for row in rows) else np.array(rows)


def _find_bottom(grid: Floats, total: Floats) -> float:
    """Return Vertex of a parabola through the points around the smallest."""
    around = slice(max(0, int(total.argmin()) - 3), int(total.argmin()) + 4)
    if len(grid[around]) < 4:
        return float(grid[int(total.argmin())])
    curvature, slope, _ = np.polyfit(grid[around] - grid[int(total.argmin())], total[around], 2)
    if curvature <= 0:
        return float(grid[int(total.argmin())])
    shift = np.clip(-slope / (2 * curvature), grid[0] - grid[-1], grid[-1] - grid[0])
    return float(grid[int(total.argmin())] + shift)


def check_lags(
    recording: Recording, gyro: Lag | None, accel_by_truth: Lag | None, accel_by_gravity: Lag | None, mag: Lag | None
) -> list[Finding]:
    """Return one finding per pair of clocks that the motion lets compare; positive lags are late.

    ``gyro`` and ``accel_by_truth`` are against the truth, the others against the gyro.
    """
    findings = [] if gyro is None else [_report_gyro_against_truth(recording, gyro)]
    if accel_by_truth is not None and gyro is not None:
        both = Lag(accel_by_truth.lag_s - gyro.lag_s, (accel_by_truth.sd_s**2 + gyro.sd_s**2) ** 0.5)
        findings.append(_report_gyro_lag("accel", "accelerometer", both, 2 * _TRUTH_S, "by way of the truth"))
    elif accel_by_gravity is not None:
        findings.append(_report_gyro_lag("accel", "accelerometer", accel_by_gravity, _ACCEL_S, "by gravity"))
    if mag is not None:
        findings.append(_report_gyro_lag("mag", "magnetometer", mag, _MAG_S, "by the field"))
    return findings


def _report_gyro_against_truth(recording: Recording, lag: Lag) -> Finding:
    """Return the finding about the lag of the truth against the gyro.

    The rate at a stamp is late by half a step more than the attitude, as a sample describes the step before."""
    half_s = 0.5 / rate_hz(recording.require_imu().t_ns)
    values = {"lag_s": lag.lag_s + half_s, "sd_s": lag.sd_s, "half_step_s": half_s, "shift_s": lag.lag_s}
    message = (
        f"gyro: stamps are {_format_ms(lag.lag_s + half_s)} late (+) against the truth, +-{1e3 * lag.sd_s:.1f} ms; "
        f"half a step ({1e3 * half_s:.1f} ms) of it is the convention that a sample describes the step before its stamp"
    )
    if abs(lag.lag_s) < _TRUTH_S + _SIGMAS * lag.sd_s:
        return Finding("gyro-truth-lag", "fact", message + ", so nothing is to be shifted", None, values)
    remedy = Remedy("shift", "truth", f"truth shifted by {_format_ms(lag.lag_s)}", (lag.lag_s,))
    advice = f"; {_format_ms(lag.lag_s)} remain: shift the truth by them"
    return Finding("gyro-truth-lag", "warning", message + advice, remedy, values)


def _report_gyro_lag(sensor: str, name: str, lag: Lag, systematic_s: float, how: str) -> Finding:
    """Return the finding about a lag against the gyro; it is a fault when it is clearly above its errors."""
    values = {"lag_s": lag.lag_s, "sd_s": lag.sd_s, "systematic_s": systematic_s}
    message = (
        f"{sensor}: the {name}'s stamps are {_format_ms(lag.lag_s)} late (+) against the gyro's {how}, "
        f"+-{1e3 * lag.sd_s:.1f} ms (and up to {1e3 * systematic_s:.0f} ms from motion and surroundings)"
    )
    code = f"{sensor}-gyro-lag"
    doubtful = abs(lag.lag_s) > 0.9 * REACH_S
    if doubtful or abs(lag.lag_s) < systematic_s + _SIGMAS * lag.sd_s:
        return Finding(code, "fact", message, None, values)
    remedy = Remedy("shift", sensor, f"{sensor} shifted by {_format_ms(-lag.lag_s)}", (-lag.lag_s,))
    return Finding(code, "warning", message + f"; shift it by {_format_ms(-lag.lag_s)}", remedy, values)


def _format_ms(seconds: float) -> str:
    return f"{1e3 * seconds:+.1f} ms"
