"""Which samples of a recording are no measurement: zeros, sentinels and frozen values of a sensor that is not working.

A driver that is not ready reports zeros, a broken bus reports the largest number of its format, and a sensor that
hangs repeats its last value. :func:`drop_non_measurements` removes such samples and counts them; it stands in front of
the smoother and of the peers. The streaming filters apply the same limits sample by sample (filters/front/guard.py).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.plausible import FASTEST_GYRO_RADPS
from stillpoint.datasets.recording import Floats, Imu, Mag, Recording

# No sensor reads as much: such a number is a broken one. The gyro's limit is that of the check of units.
LARGEST_RADPS = FASTEST_GYRO_RADPS
LARGEST_MPS2 = 5000.0  # accelerometers end at 400 g
LARGEST_UT = 5000.0  # magnetometers of an IMU end at 4900 uT

FROZEN_S = 2.0  # a field that repeats bit for bit for so long, while the body turns, is frozen
_TURNING_RADPS = 0.1  # deviation of the rate that shows a turning body
_TILTING_MPS2 = 0.5  # deviation of the specific force that shows one


@dataclass(frozen=True)
class Dropped:
    """How many samples were no measurement."""

    imu: int = 0  # rate or specific force beyond any sensor
    mag_zero: int = 0
    mag_beyond: int = 0  # larger than any sensor reads
    mag_frozen: int = 0

    def counts(self) -> dict[str, int]:
        """Return the counts that are not 0, under the names that diagnostics have."""
        named = {
            "n_bad_imu": self.imu,
            "n_no_field": self.mag_zero,
            "n_bad_mag": self.mag_beyond,
            "n_frozen_mag": self.mag_frozen,
        }
        return {name: count for name, count in named.items() if count}


def drop_non_measurements(recording: Recording) -> tuple[Recording, Dropped]:
    """Return the recording without samples that are no measurement, and their counts.

    It is the same object where there are none. A magnetometer of which nothing is left is removed. An IMU of which
    fewer than two samples are left stays as it is.
    """
    imu, mag, dropped = recording.imu, recording.mag, Dropped()
    if imu is not None:
        good = _is_within(imu.gyro_b_radps, LARGEST_RADPS) & _is_within(imu.accel_b_mps2, LARGEST_MPS2)
        if not good.all() and good.sum() > 1:
            dropped = Dropped(imu=int((~good).sum()))
            imu = Imu(imu.t_ns[good], imu.gyro_b_radps[good], imu.accel_b_mps2[good])
    if mag is not None and imu is not None:
        mag, of_field = drop_non_fields(mag, imu)
        dropped = replace(of_field, imu=dropped.imu)
    return (replace(recording, imu=imu, mag=mag) if dropped.counts() else recording), dropped


def drop_non_fields(mag: Mag, imu: Imu) -> tuple[Mag | None, Dropped]:
    """Return the magnetometer without samples that are no measurement, None where nothing is left, and their counts."""
    zero = ~mag.mag_b_ut.any(axis=1)
    beyond = ~_is_within(mag.mag_b_ut, LARGEST_UT)
    frozen = _find_frozen(mag, imu) & ~zero & ~beyond
    keep = ~(zero | beyond | frozen)
    dropped = Dropped(0, int(zero.sum()), int(beyond.sum()), int(frozen.sum()))
    if keep.all():
        return mag, dropped
    return (Mag(mag.t_ns[keep], mag.mag_b_ut[keep]) if keep.any() else None), dropped


def _is_within(values: Floats, largest: float) -> NDArray[np.bool_]:
    """Return which rows (N, 3) have every component below ``largest`` in size."""
    return np.asarray((np.abs(values) < largest).all(axis=1))


def _find_frozen(mag: Mag, imu: Imu) -> NDArray[np.bool_]:
    """Return which samples of the magnetometer belong to a run of equal values during which the IMU shows a turning
    body.

    A run is a candidate from FROZEN_S on: a magnetometer that is stored faster than it measures repeats itself for much
    less. At rest equal values are no fault: a coarse sensor, or a simulated one without noise, shows them too.
    """
    frozen = np.zeros(len(mag.t_ns), dtype=np.bool_)
    changes = np.flatnonzero((np.diff(mag.mag_b_ut, axis=0) != 0).any(axis=1)) + 1
    first, stop = np.r_[0, changes], np.r_[changes, len(mag.t_ns)]
    long = mag.t_ns[stop - 1] - mag.t_ns[first] >= FROZEN_S * 1e9
    for begin, end in zip(first[long], stop[long], strict=True):
        rows = slice(*np.searchsorted(imu.t_ns, [mag.t_ns[begin], mag.t_ns[end - 1]]))
        if rows.stop - rows.start < 2:
            continue
        turning = np.linalg.norm(imu.gyro_b_radps[rows].std(axis=0)) > _TURNING_RADPS
        tilting = np.linalg.norm(imu.accel_b_mps2[rows].std(axis=0)) > _TILTING_MPS2
        frozen[begin:end] = turning and tilting
    return frozen
