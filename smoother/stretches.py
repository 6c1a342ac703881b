"""Stretches of samples between gaps, and which of them are too short for a reference.

Across a gap the attitude is next to unknown. A lone sample or a tail of a few samples behind one has no measurement
that says how it is oriented: gravity cannot be told from acceleration in so short a time. Such an island is left out of
the reference and reported; the rest of the recording gets its reference.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.errors import Unobservable
from stillpoint.datasets.recording import Imu, Recording, Times
from stillpoint.datasets.times import GAP_STEPS
from stillpoint.smoother.missing import LONG_GAP_S

SHORTEST_STRETCH_S = 0.5
_FEWEST_SAMPLES = 5


@dataclass(frozen=True)
class Island:
    """A stretch of IMU samples between gaps that is too short for a reference."""

    start_s: float  # from the recording's first IMU sample
    length_s: float
    samples: int


def _find_longest_bridged_s(t_ns: Times) -> float:
    """Return the longest step (s) between samples that is integrated across; a longer one is a gap in the graph."""
    return max(LONG_GAP_S, GAP_STEPS * float(np.median(np.diff(t_ns))) / 1e9)


def leave_out_islands(recording: Recording) -> tuple[Recording, tuple[Island, ...]]:
    """Return the recording without its islands, and these in the order of time.

    An island is shorter than SHORTEST_STRETCH_S or has fewer than FEWEST_SAMPLES samples. Raises
    :class:`Unobservable` when nothing else is there.
    """
    imu = recording.require_imu()
    if len(imu.t_ns) < 2:
        raise Unobservable(f"{recording.name}: has one sample of gyro and accelerometer; a reference needs seconds")
    edges = np.flatnonzero(np.diff(imu.t_ns) / 1e9 > _find_longest_bridged_s(imu.t_ns)) + 1
    first, stop = np.r_[0, edges], np.r_[edges, len(imu.t_ns)]
    length_s = (imu.t_ns[stop - 1] - imu.t_ns[first]) / 1e9
    short = (length_s < SHORTEST_STRETCH_S) | (stop - first < _FEWEST_SAMPLES)
    if len(first) == 1 or not short.any():
        return recording, ()
    if short.all():
        raise Unobservable(
            f"{recording.name}: gaps cut gyro and accelerometer into {len(first)} pieces, the longest of "
            f"{length_s.max():.2f} s; a reference needs seconds without a gap: check the clock of the recording"
        )
    start_s = (imu.t_ns[first] - imu.t_ns[0]) / 1e9
    samples = stop - first
    islands = tuple(Island(float(start_s[k]), float(length_s[k]), int(samples[k])) for k in np.flatnonzero(short))
    return replace(recording, imu=_keep(imu, np.repeat(~short, samples))), islands


def _keep(imu: Imu, rows: NDArray[np.bool_]) -> Imu:
    return Imu(imu.t_ns[rows], imu.gyro_b_radps[rows], imu.accel_b_mps2[rows])
