"""Stamps of a source become clocks that rise; nothing is dropped, moved or interpolated without a line that says so."""

from dataclasses import dataclass, field
from decimal import Decimal, InvalidOperation

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.errors import BadSource
from stillpoint.datasets.recording import Floats, Imu, Times

UNIX_FROM_NS = 10**17  # stamps beyond 1973 count from 1970; no device runs for three years
BRIDGED_S = 0.1  # a gap of the accelerometer up to this is bridged, or three of its steps where that is more


@dataclass
class Log:
    """What an importer did, in the words of ``Info.conversions`` and ``Info.notes``."""

    conversions: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def converted(self, line: str) -> None:
        """A change of unit, sign, frame or clock."""
        self.conversions.append(line)

    def noted(self, line: str) -> None:
        """Something dropped, merged, missing or doubtful."""
        self.notes.append(line)


@dataclass(frozen=True, eq=False)
class Series:
    """Samples of one sensor with its own stamps."""

    t_ns: Times  # (N,)
    values: Floats  # (N, k)

    def where(self, keep: NDArray[np.bool_]) -> "Series":
        """The samples of a mask."""
        return Series(self.t_ns[keep], self.values[keep])


def finite_rows(values: Floats) -> NDArray[np.bool_]:
    """(N,) True where a row of (N, k) holds numbers only."""
    return np.asarray(np.isfinite(values).all(axis=1), dtype=np.bool_)


def seconds_to_ns(t_s: Floats) -> Times:
    """Whole nanoseconds."""
    return np.asarray(np.round(np.asarray(t_s, dtype=np.float64) * 1e9), dtype=np.int64)


def cells_to_ns(cells: list[str], exponent: int, where: str, first_line: int) -> Times:
    """Exact nanoseconds of decimal numbers in units of 10^exponent s (a double keeps only 0.2 us of epoch seconds)."""
    times = np.empty(len(cells), dtype=np.int64)
    for row, cell in enumerate(cells):
        try:
            times[row] = int(Decimal(cell).scaleb(9 + exponent).to_integral_value())
        except (InvalidOperation, ValueError, OverflowError):
            raise BadSource(f"{where}, line {first_line + row}: {cell!r} is not a time; remove this line") from None
    return times


def rising(series: Series, what: str, log: Log) -> Series:
    """Sort by time and keep the first of equal stamps; both are counted in the notes."""
    moved = int((np.diff(series.t_ns) < 0).sum())
    if moved:
        order = np.argsort(series.t_ns, kind="stable")
        series = Series(series.t_ns[order], series.values[order])
        log.noted(f"{what}: {moved} steps back in time; sorted by stamp")
    first = np.diff(series.t_ns, prepend=series.t_ns[:1] - 1) > 0
    if not first.all():
        log.noted(f"{what}: {int((~first).sum())} samples with the stamp of the one before dropped")
        series = series.where(first)
    return series


def from_zero(series: Series, what: str, log: Log) -> Series:
    """Without the samples before the zero of the clock, counted."""
    keep = series.t_ns >= 0
    if not keep.all():
        log.noted(f"{what}: {int((~keep).sum())} samples before the zero of the clock dropped")
        series = series.where(keep)
    return series


def finite(series: Series, what: str, log: Log) -> Series:
    """Without the rows that are not numbers, counted."""
    keep = finite_rows(series.values)
    if not keep.all():
        log.noted(f"{what}: {int((~keep).sum())} of {len(keep)} rows without a number dropped")
        series = series.where(keep)
    return series


def merge(gyro: Series, accel: Series, where: str, log: Log) -> Imu:
    """One IMU clock: the gyro's, with the accelerometer brought onto its stamps by linear interpolation.

    Gyro samples with no accelerometer sample on both sides within ``BRIDGED_S`` are dropped and counted. The gyro is
    the one to keep: it is integrated, and the accelerometer is averaged. Raises :class:`BadSource` when none is left.
    """
    if len(gyro.t_ns) == len(accel.t_ns) and (gyro.t_ns == accel.t_ns).all():
        return Imu(gyro.t_ns, gyro.values, accel.values)
    if len(accel.t_ns) < 2 or len(gyro.t_ns) == 0:
        raise BadSource(f"{where}: gyro and accelerometer do not overlap in time; check that both were logged")
    right = np.clip(np.searchsorted(accel.t_ns, gyro.t_ns, side="left"), 1, len(accel.t_ns) - 1)
    span_ns = accel.t_ns[right] - accel.t_ns[right - 1]
    inside = (gyro.t_ns >= accel.t_ns[0]) & (gyro.t_ns <= accel.t_ns[-1])
    exact = np.isin(gyro.t_ns, accel.t_ns)
    bridge_ns = max(BRIDGED_S * 1e9, 3 * float(np.median(np.diff(accel.t_ns))))
    keep = inside & ((span_ns <= bridge_ns) | exact)
    if not keep.any():
        raise BadSource(f"{where}: gyro and accelerometer do not overlap in time; check that both were logged")
    t_ns, right = gyro.t_ns[keep], right[keep]
    left = right - 1
    share = ((t_ns - accel.t_ns[left]) / (accel.t_ns[right] - accel.t_ns[left]))[:, None]
    force = accel.values[left] * (1 - share) + accel.values[right] * share
    log.converted(
        f"accelerometer ({len(accel.t_ns)} samples on its own stamps) interpolated linearly onto the gyro's stamps"
    )
    lost = int((~keep).sum())
    if lost:
        log.noted(f"gyro: {lost} samples without accelerometer samples around them dropped")
    return Imu(t_ns, gyro.values[keep], force)


def straight(t_s: Floats, what: str, log: Log) -> Floats:
    """Evenly spaced times for stamps of receipt that come in bursts: the straight line through them.

    The line is fitted to time against sample number by least squares with Huber weights, so that a late burst
    pulls little. It says the rate and the delay of the stamps against it.
    """
    number = np.arange(len(t_s), dtype=np.float64)
    weight = np.ones(len(t_s))
    for _ in range(20):
        slope, start = np.polyfit(number, t_s, 1, w=np.sqrt(weight))
        residual = t_s - (start + slope * number)
        scale = 1.4826 * float(np.median(np.abs(residual))) + 1e-12
        weight = np.minimum(1.0, 1.345 * scale / np.maximum(np.abs(residual), 1e-300))
    log.converted(
        f"{what} times of receipt -> straight line at {1 / slope:.3f} Hz "
        f"(residual rms {1e3 * np.sqrt(np.mean(residual**2)):.1f} ms, largest {1e3 * np.abs(residual).max():.1f} ms)"
    )
    return np.asarray(start + slope * number, dtype=np.float64)
