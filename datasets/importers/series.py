"""Samples of one sensor with their stamps, and what an importer does to them. Every change is counted in the log."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.constants import MEDIAN_DEVIATION_TO_SD
from stillpoint.datasets.errors import BadSource
from stillpoint.datasets.recording import LAST_T_NS, Floats, Gps, Imu, Times

_BRIDGED_S = 0.1  # gaps of the accelerometer up to this long, or three of its steps, are bridged by interpolation
_FASTER = 0.75  # an accelerometer with a step below this share of the gyro's is averaged over the gyro's intervals


@dataclass
class Log:
    """The log of what an importer did, in the words of ``Info.conversions`` and ``Info.notes``."""

    conversions: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    dropped: dict[str, int] = field(default_factory=dict)  # sensor -> rows without a number, which have a note each
    is_resampled: bool = False  # the accelerometer was brought to other stamps

    def add_conversion(self, line: str) -> None:
        """Add a change of unit, sign, frame or clock."""
        self.conversions.append(line)

    def add_note(self, line: str) -> None:
        """Add something that was dropped, merged, missing or doubtful."""
        self.notes.append(line)

    def count_dropped_rows(self, what: str, lost: int, rows: int) -> None:
        """Add how many rows of a table hold no number for a sensor; nothing where each does."""
        if lost:
            self.dropped[what] = lost
            self.add_note(f"{what}: {lost} of {rows} rows without a number dropped")


@dataclass(frozen=True, eq=False)
class Series:
    """Samples of one sensor with its own stamps."""

    t_ns: Times  # (N,)
    values: Floats  # (N, k)

    def where(self, keep: NDArray[np.bool_]) -> "Series":
        """Return the samples that the mask keeps."""
        return Series(self.t_ns[keep], self.values[keep])


def find_finite_rows(values: Floats) -> NDArray[np.bool_]:
    """Return a mask (N,) of the rows of (N, k) that hold only finite numbers."""
    return np.asarray(np.isfinite(values).all(axis=1), dtype=np.bool_)


def seconds_to_ns(t_s: Floats) -> Times:
    """Round seconds to whole nanoseconds; raises :class:`BadSource` for one that is not finite or beyond 2038."""
    t_ns = np.round(np.asarray(t_s, dtype=np.float64) * 1e9)
    if not (np.abs(t_ns) <= LAST_T_NS).all():
        raise BadSource(
            f"a time of {t_s[int(np.argmin(np.abs(t_ns) <= LAST_T_NS))]:g} s is not a valid time; remove this sample"
        )
    return np.asarray(t_ns, dtype=np.int64)


def sort_by_time(series: Series, what: str, log: Log) -> Series:
    """Sort by stamp and keep the first of equal stamps; both are counted in the notes."""
    moved = int((np.diff(series.t_ns) < 0).sum())
    if moved:
        order = np.argsort(series.t_ns, kind="stable")
        series = Series(series.t_ns[order], series.values[order])
        log.add_note(f"{what}: {moved} steps back in time; sorted by stamp")
    first = np.diff(series.t_ns, prepend=series.t_ns[:1] - 1) > 0
    if not first.all():
        log.add_note(f"{what}: {int((~first).sum())} samples with the stamp of the one before dropped")
        series = series.where(first)
    return series


def drop_before_zero(series: Series, what: str, log: Log) -> Series:
    """Drop the samples before the zero of the clock and count them."""
    keep = series.t_ns >= 0
    if not keep.all():
        log.add_note(f"{what}: {int((~keep).sum())} samples before the zero of the clock dropped")
        series = series.where(keep)
    return series


def drop_incomplete_rows(series: Series, what: str, log: Log) -> Series:
    """Drop the rows that hold NaN or infinity and count them."""
    keep = find_finite_rows(series.values)
    if not keep.all():
        log.add_note(f"{what}: {int((~keep).sum())} of {len(keep)} rows without a number dropped")
        series = series.where(keep)
    return series


def merge_imu(gyro: Series, accel: Series, where: str, log: Log) -> Imu:
    """Bring the accelerometer to the stamps of the gyro, which keeps its samples because it is integrated.

    A faster accelerometer is averaged over the intervals that end at the gyro's stamps: of single readings between
    others, vibration above half of the gyro's rate would remain as an error. Another one is interpolated linearly.
    Gyro samples without an accelerometer sample on both sides within ``_BRIDGED_S`` are dropped and counted. Raises
    :class:`BadSource` when no sample is left.
    """
    if len(gyro.t_ns) == len(accel.t_ns) and (gyro.t_ns == accel.t_ns).all():
        return Imu(gyro.t_ns, gyro.values, accel.values)
    if len(accel.t_ns) < 2 or len(gyro.t_ns) == 0:
        raise BadSource(f"{where}: gyro and accelerometer do not overlap in time; check that both were logged")
    right = np.clip(np.searchsorted(accel.t_ns, gyro.t_ns, side="left"), 1, len(accel.t_ns) - 1)
    span_ns = accel.t_ns[right] - accel.t_ns[right - 1]
    inside = (gyro.t_ns >= accel.t_ns[0]) & (gyro.t_ns <= accel.t_ns[-1])
    exact = np.isin(gyro.t_ns, accel.t_ns)
    bridge_ns = max(_BRIDGED_S * 1e9, 3 * float(np.median(np.diff(accel.t_ns))))
    keep = inside & ((span_ns <= bridge_ns) | exact)
    if not keep.any():
        raise BadSource(f"{where}: gyro and accelerometer do not overlap in time; check that both were logged")
    t_ns = gyro.t_ns[keep]
    step_ns = float(np.median(np.diff(gyro.t_ns))) if len(gyro.t_ns) > 1 else 0.0
    if float(np.median(np.diff(accel.t_ns))) < _FASTER * step_ns:
        force, how = _average_before(accel, t_ns, step_ns), "averaged over the intervals that end at the gyro's stamps"
    else:
        force, how = _interpolate(accel, t_ns), "interpolated linearly onto the gyro's stamps"
    log.is_resampled = True
    log.add_conversion(f"accelerometer ({len(accel.t_ns)} samples on its own stamps) {how}")
    lost = int((~keep).sum())
    if lost:
        log.add_note(f"gyro: {lost} samples without accelerometer samples around them dropped")
    return Imu(t_ns, gyro.values[keep], force)


def _interpolate(series: Series, t_ns: Times) -> Floats:
    """Return the readings (K, k) at stamps (K,), linear between samples."""
    return np.stack([np.interp(t_ns, series.t_ns, column) for column in series.values.T], axis=1)


def _average_before(series: Series, t_ns: Times, step_ns: float) -> Floats:
    """Return the means (K, k) over the intervals that end at stamps (K,), of readings that are linear in between.

    An interval begins at the stamp before, but is no longer than ``step_ns`` (behind a gap) and begins no earlier than
    the series.
    """
    before = np.concatenate([[0], t_ns[:-1]])
    begin_ns = np.maximum(np.maximum(before, t_ns - round(step_ns)), series.t_ns[0])
    edges_ns = np.unique(np.concatenate([series.t_ns, begin_ns, t_ns]))
    values = _interpolate(series, edges_ns)
    areas = (values[1:] + values[:-1]) / 2 * np.diff(edges_ns)[:, None]
    integral = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(areas, axis=0)])
    first, last = np.searchsorted(edges_ns, begin_ns), np.searchsorted(edges_ns, t_ns)
    span_ns = (t_ns - begin_ns)[:, None]
    means = (integral[last] - integral[first]) / np.maximum(span_ns, 1)
    return np.asarray(np.where(span_ns > 0, means, values[last]))


def fit_even_times(t_s: Floats, what: str, log: Log) -> Floats:
    """Replace stamps of receipt, which come in bursts, by the straight line through them; (N,) seconds.

    The line is fitted to time against sample number by least squares with Huber weights, so that a late burst
    pulls little. The log states the rate and how far the stamps lie from the line.
    """
    number = np.arange(len(t_s), dtype=np.float64)
    weight = np.ones(len(t_s))
    for _ in range(20):
        slope, start = np.polyfit(number, t_s, 1, w=np.sqrt(weight))
        residual = t_s - (start + slope * number)
        scale = MEDIAN_DEVIATION_TO_SD * float(np.median(np.abs(residual))) + 1e-12
        weight = np.minimum(1.0, 1.345 * scale / np.maximum(np.abs(residual), 1e-300))
    log.add_conversion(
        f"{what} times of receipt -> straight line at {1 / slope:.3f} Hz "
        f"(residual rms {1e3 * np.sqrt(np.mean(residual**2)):.1f} ms, largest {1e3 * np.abs(residual).max():.1f} ms)"
    )
    return np.asarray(start + slope * number, dtype=np.float64)


def make_gps(series: Series, log: Log) -> Gps:
    """Make satellite fixes of rows latitude, longitude (deg), altitude (m), course (deg from north), speed (m/s).

    A row without a position is no fix. A negative course or speed means that it is unknown.
    """
    series = sort_by_time(series, "gps", log)
    lat, lon, alt, course, speed = series.values.T
    outside = (np.abs(lat) > 90) | (np.abs(lon) > 360)
    if outside.any():
        log.add_note(f"gps: {int(outside.sum())} fixes outside +-90, +-360 deg; marked as no fix")
    unset = (lat == 0) & (lon == 0)  # receivers without a fix write zeros
    if unset.any():
        log.add_note(f"gps: {int(unset.sum())} fixes at 0, 0 deg; marked as no fix")
    valid = np.isfinite(lat) & np.isfinite(lon) & ~outside & ~unset
    course_rad = np.where(course >= 0, np.deg2rad(np.maximum(course, 0.0)), np.nan)
    speed_mps = np.where(speed >= 0, speed, np.nan)
    log.add_conversion("gps course deg -> rad, clockwise from true north")
    return Gps(series.t_ns, lat, lon, alt, course_rad, speed_mps, valid)
