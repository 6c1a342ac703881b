"""Show how the two parameters of the complementary filter of Elmi Aziz and Mohseni Araste 2021 act on its errors.

The errors of CF that come from Acc are those of Acc times F(s) of eq (11); those of Acc_MA are Acc's times the moving
average. So the size of F(j omega) says which of the two can be the better one, whatever the motion was.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.recording import Floats, Recording
from stillpoint.datasets.trajectory import Reference
from stillpoint.filters import estimate
from stillpoint.scoring.compare import find_moving
from stillpoint.scoring.errors import compute_euler_error


class Parameters(NamedTuple):
    """The two parameters of (11)."""

    omega0_radps: float
    zeta: float


PRINTED = Parameters(0.25, 3.0)  # section 3-3, from ground vehicles
SLOWER = Parameters(0.08, 0.707)  # with it table 2 is possible; found by a search in sight of that table
MEAN_S = 7.0  # window of Acc_MA
LOWEST_HZ, HIGHEST_HZ = 0.001, 31.6
OMEGA0_RADPS = (0.03, 0.05, 0.08, 0.125, 0.25, 0.5, 1.0)
ZETA = (0.3, 0.5, 0.707, 1.0, 2.0, 3.0, 5.0)


def compute_filter_gain(hz: Floats, parameters: Parameters) -> Floats:
    """Return the size of F (N,) of eq (11) at frequencies (N,)."""
    s, (w0, zeta) = 2j * np.pi * hz, parameters
    passed = 2 * zeta * w0 * s + w0**2
    return np.asarray(np.abs(passed / (s**2 + passed)))


def compute_mean_gain(hz: Floats, window_s: float = MEAN_S) -> Floats:
    """Return the size (N,) of the moving average's transfer function, |sin(pi f T) / (pi f T)|."""
    return np.asarray(np.abs(np.sinc(hz * window_s)))


def compute_mean_envelope(hz: Floats, window_s: float = MEAN_S) -> Floats:
    """Return the largest value (N,) that the moving average's gain takes at a frequency or any higher one."""
    peaks = np.minimum(1.0, 1.0 / (np.pi * hz * window_s))
    return np.asarray(np.where(hz * window_s < 0.5, compute_mean_gain(hz, window_s), peaks))


def find_frequencies_below_mean(parameters: Parameters) -> NDArray[np.bool_]:
    """Return at which of 2000 frequencies, LOWEST_HZ to HIGHEST_HZ, F is below the envelope of the moving average."""
    hz = np.geomspace(LOWEST_HZ, HIGHEST_HZ, 2000)
    return np.asarray(compute_filter_gain(hz, parameters) < compute_mean_envelope(hz))


def map_errors_deg(recording: Recording, benchmark: Reference) -> Floats:
    """Return CF's RMSE of roll, pitch, yaw (K, L, 3) against a benchmark, over OMEGA0_RADPS (K) and ZETA (L).

    Every moving sample of the benchmark counts, also while the filter says that it is starting, which with small
    parameters it says for minutes.
    """
    return np.array(
        [[_measure_errors_deg(recording, benchmark, Parameters(w0, zeta)) for zeta in ZETA] for w0 in OMEGA0_RADPS]
    )


def _measure_errors_deg(recording: Recording, benchmark: Reference, parameters: Parameters) -> Floats:
    """Return the RMSE (3,) in deg of roll, pitch and yaw of CF with these parameters."""
    found = estimate(recording, "cf", parameters._asdict())
    moving = find_moving(benchmark)
    assert found.q_nb is not None
    error_rad = compute_euler_error(found.q_nb[moving], benchmark.q_nb[moving], "nwu")
    return np.asarray(np.rad2deg(np.sqrt(np.mean(error_rad**2, axis=0))))
