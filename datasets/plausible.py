"""Check that the sizes of a recording fit its units: a second of rest separates m/s^2 from g, and uT from gauss."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.errors import BadRecording
from stillpoint.datasets.running import ThinnedValues

if TYPE_CHECKING:
    from stillpoint.datasets.recording import Imu, Mag, Recording

GRAVITY_RANGE_MPS2 = (8.0, 12.0)  # a question of units only; a steady bend or braking adds 1-2 m/s^2 to gravity
GRAVITY_IN = {
    1.0: "in g: multiply by 9.80665",
    980.665: "in cm/s^2 (gal): divide by 100",
    1000.0: "in milli-g: multiply by 0.00980665",
}
FIELD_RANGE_UT = (20.0, 70.0)
_FIELD_IN = {1e6: "tesla", 100.0: "gauss", 0.1: "milligauss", 1e-3: "nanotesla"}  # by what to multiply for uT
_MISTAKEN_FOR_TESLA = {1e-4: "gauss", 1e-6: "microtesla"}  # what drivers publish where tesla are agreed
STILL_ACCEL_SPREAD = 0.01  # of its size: a second whose norm varies less is at rest or close to it
_STILL_RATE_RADPS = 0.15  # above a phone's bias of 6 deg/s; a second of faster turning is a spin or a bend
FASTEST_GYRO_RADPS = 120.0  # 7000 deg/s: no MEMS gyro ranges further
WINDOW_S = 1.0
_ROWS_AT_ONCE = 1 << 16
_WITHOUT_GRAVITY_MPS2 = 4.0  # a body in motion has gravity in the median of its specific force; 0.4 g is none


def check_units(recording: "Recording") -> None:
    """Raise :class:`BadRecording` with the likely unit when a size does not fit; do nothing when no second is still."""
    check = UnitCheck(recording.name, recording.info.mag_uncalibrated)
    check.add(recording.imu, recording.mag)
    check.raise_doubt()


class UnitCheck:
    """Collects the sizes that show the units of a recording, piece by piece; medians use every 2^k-th sample."""

    def __init__(self, name: str, mag_uncalibrated: bool) -> None:
        self._name, self._mag_uncalibrated = name, mag_uncalibrated
        self._fastest_radps = 0.0
        self._seconds = _Seconds()
        self._forces_mps2, self._fields_ut = ThinnedValues(), ThinnedValues()

    def add(self, imu: "Imu | None", mag: "Mag | None") -> None:
        """Take the next samples of gyro and accelerometer, and of the magnetometer."""
        if imu is not None:
            for rows in _iterate_rows(len(imu.t_ns)):
                gyro, accel = imu.gyro_b_radps[rows], imu.accel_b_mps2[rows]
                self._fastest_radps = max(self._fastest_radps, float(gyro.max()), -float(gyro.min()))
                self._seconds.add(imu.t_ns[rows], accel, gyro)
                self._forces_mps2.add(accel, _measure_sizes)
        if mag is not None and not self._mag_uncalibrated:
            for rows in _iterate_rows(len(mag.t_ns)):
                self._fields_ut.add(mag.mag_b_ut[rows], _measure_sizes)

    def raise_doubt(self) -> None:
        """Raise :class:`BadRecording` with the likely unit when a size does not fit."""
        if self._forces_mps2.count:
            self._check_imu()
        if self._fields_ut.count:
            doubt = describe_field_size(float(np.median(self._fields_ut.values())))
            if doubt:
                raise BadRecording(
                    f"{self._name}: mag.mag_b_ut has a {doubt}; "
                    "convert it, or give --mag-uncalibrated where the sensor is not calibrated"
                )

    def _check_imu(self) -> None:
        """Raise :class:`BadRecording` where gyro or accelerometer look like another unit, or lack gravity."""
        name, fastest = self._name, self._fastest_radps
        if fastest > FASTEST_GYRO_RADPS:
            raise BadRecording(
                f"{name}: imu.gyro_b_radps reaches {fastest:.4g} rad/s; it looks like deg/s: "
                "multiply by pi/180, or keep it with --units-unchecked for the doctor"
            )
        size = self._seconds.find_still_norm()
        if size is not None and not GRAVITY_RANGE_MPS2[0] <= size <= GRAVITY_RANGE_MPS2[1]:
            _, near = min((abs(size - gravity), gravity) for gravity in GRAVITY_IN)
            hint = f"; it looks {GRAVITY_IN[near]}" if 0.9 < size / near < 1.1 else ""
            raise BadRecording(
                f"{name}: imu.accel_b_mps2 is {size:.4g} at rest, not near 9.8 m/s^2{hint}; "
                "convert it, or keep it with --units-unchecked for the doctor"
            )
        usual = float(np.median(self._forces_mps2.values()))
        if size is None and usual < _WITHOUT_GRAVITY_MPS2 and self._seconds.duration_ns > WINDOW_S * 1e9:
            raise BadRecording(
                f"{name}: imu.accel_b_mps2 has a median size of {usual:.3g} m/s^2, so that gravity was taken out of it "
                "(linear acceleration); log the accelerometer with gravity, or keep it with --units-unchecked"
            )


def describe_field_size(median_ut: float) -> str:
    """Return what is wrong with the median size of a field, with its likely unit; "" for one the Earth can have."""
    if FIELD_RANGE_UT[0] <= median_ut <= FIELD_RANGE_UT[1]:
        return ""
    fitting = (factor for factor in _FIELD_IN if FIELD_RANGE_UT[0] <= median_ut * factor <= FIELD_RANGE_UT[1])
    hint = "".join(f"; it looks like {_FIELD_IN[factor]}: multiply by {factor:g}" for factor in fitting)
    mistaken = (f for f in _MISTAKEN_FOR_TESLA if FIELD_RANGE_UT[0] <= median_ut * f <= FIELD_RANGE_UT[1])
    hint += "".join(
        f"; it looks like {_MISTAKEN_FOR_TESLA[f]} that was read as tesla: multiply by {f:g}" for f in mistaken
    )
    return f"median size of {median_ut:.4g} uT, not 20-70{hint}"


def _iterate_rows(count: int) -> Iterator[slice]:
    """Yield ranges of rows, short enough that intermediate results of one take little memory."""
    return (slice(first, first + _ROWS_AT_ONCE) for first in range(0, count, _ROWS_AT_ONCE))


def _measure_sizes(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the length of each vector (N, 3); in a third of the time of ``np.linalg.norm``."""
    lengths: NDArray[np.float64] = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))
    return lengths


class _Seconds:
    """The mean specific force of each second and how much it varies, from samples that come piece by piece."""

    def __init__(self) -> None:
        self._first_ns: int | None = None
        self._last_ns = 0
        self._counts: list[NDArray[np.int64]] = []
        self._sizes: list[NDArray[np.float64]] = []  # of the mean
        self._spreads: list[NDArray[np.float64]] = []  # relative to it; infinite for a second of spin
        self._rest: tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]] | None = None

    @property
    def duration_ns(self) -> int:
        """The time from the first sample to the last."""
        return 0 if self._first_ns is None else self._last_ns - self._first_ns

    def add(self, t_ns: NDArray[np.int64], vectors: NDArray[np.float64], rates: NDArray[np.float64]) -> None:
        """Take the next samples; those of the second that is not over wait for the next piece."""
        if self._first_ns is None:
            self._first_ns = int(t_ns[0])
        self._last_ns = int(t_ns[-1])
        if self._rest is not None:
            old_ns, old_vectors, old_rates = self._rest
            t_ns, vectors = np.concatenate([old_ns, t_ns]), np.concatenate([old_vectors, vectors])
            rates = np.concatenate([old_rates, rates])
        over = int(np.searchsorted(t_ns, t_ns[-1] - (t_ns[-1] - self._first_ns) % int(WINDOW_S * 1e9)))
        if over:
            self._add_seconds(t_ns[:over], vectors[:over], rates[:over])
        self._rest = t_ns[over:].copy(), vectors[over:].copy(), rates[over:].copy()

    def find_still_norm(self) -> float | None:
        """Return the mean length over the calmest second without spin; None when there is none, or no whole second."""
        if self._rest is None or self.duration_ns < WINDOW_S * 1e9:
            return None
        self._add_seconds(*self._rest)
        self._rest = None
        counts, sizes = np.concatenate(self._counts), np.concatenate(self._sizes)
        whole = counts >= 0.5 * np.median(counts)
        if counts.max() < 5:
            return None
        spreads = np.where(whole, np.concatenate(self._spreads), np.inf)
        calmest = int(spreads.argmin())
        return float(sizes[calmest]) if spreads[calmest] < STILL_ACCEL_SPREAD else None

    def _add_seconds(self, t_ns: NDArray[np.int64], vectors: NDArray[np.float64], rates: NDArray[np.float64]) -> None:
        """Add mean length and relative spread of vectors (N, 3) over each whole second; rates (N, 3) show spins."""
        assert self._first_ns is not None
        seconds = (t_ns - self._first_ns) // int(WINDOW_S * 1e9)
        starts = np.flatnonzero(np.diff(seconds, prepend=-1))
        counts = np.diff(starts, append=len(t_ns))
        mean = np.add.reduceat(vectors, starts, axis=0) / counts[:, None]
        spread = np.add.reduceat(vectors**2, starts, axis=0) / counts[:, None] - mean**2
        size = np.linalg.norm(mean, axis=1)
        relative = np.sqrt(np.maximum(spread.sum(axis=1), 0)) / np.maximum(size, 1e-300)
        spins = np.linalg.norm(np.add.reduceat(rates, starts, axis=0) / counts[:, None], axis=1) > _STILL_RATE_RADPS
        relative[spins] = np.inf
        self._counts.append(counts)
        self._sizes.append(size)
        self._spreads.append(relative)
