"""Where the graph of a spinning body begins: rates from the squared rate, and gravity's harmonic when it is there."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.ndimage import median_filter

from stillpoint.datasets.recording import Floats
from stillpoint.smoother.roll_chain import Chain, angles_of, rates_of
from stillpoint.smoother.roll_params import HarmonicParams
from stillpoint.smoother.roll_samples import RollSamples
from stillpoint.smoother.roll_state import RollState

MEDIAN_OF = 25  # samples of the squared rate: a glitch, or a run of them, does not move the start
FEWEST_PER_TERM = 6  # samples of a window, for each of the terms that are fitted to it
ROBUST_ROUNDS = 4
LEAST_TURNS = 2.0  # of the body in a window


def start_rates(samples: RollSamples, sign: float) -> Floats:
    """Mean rates x (N + 1,) to begin with."""
    rows = np.arange(len(samples))
    valid = samples.squared_valid
    squared = median_filter(samples.squared_rad2ps2[valid], MEDIAN_OF, mode="nearest")
    rate = sign * np.sqrt(np.maximum(np.interp(rows, rows[valid], squared), 0.0))
    return np.asarray(np.interp(np.arange(len(rows) + 1) - 0.5, rows, rate))


@dataclass(frozen=True, eq=False)
class Harmonic:
    """Gravity at the spin frequency, followed through the recording."""

    amplitude_mps2: float
    significance: float  # sd by which all windows together differ from none
    phase_rad: Floats  # (N,) by which the angle is to be increased, so that 0 is where z points up


def find_harmonic(chain: Chain, state: RollState, params: HarmonicParams) -> Harmonic | None:
    """The harmonic along a trajectory that knows nothing of it; None where it does not show.

    In each window both channels are fitted together with a ripple of the rate at the spin frequency, which is real and
    looks alike in each channel, but not in both.
    """
    samples = chain.samples
    if not (np.any(samples.accel_gravity) or np.any(samples.squared_gravity)):
        return None
    t_s = (samples.t_ns - samples.t_ns[0]) / 1e9
    angle, rate = angles_of(chain, state), rates_of(chain, state)
    edges = np.searchsorted(t_s, np.arange(0.0, t_s[-1] + params.window_s, params.window_s))
    found = []
    for first, last in pairwise(edges):
        rows = np.arange(first, last)
        if len(rows) < 8 * FEWEST_PER_TERM or abs(angle[rows[-1]] - angle[rows[0]]) < LEAST_TURNS * 2 * np.pi:
            continue
        found.append((t_s[rows].mean(), *_fit(samples, rows, angle[rows], rate[rows])))
    if not found:
        return None
    middle_s = np.array([one[0] for one in found])
    amplitudes = np.array([one[1] for one in found])
    squares = np.array([one[2] for one in found])
    phase = np.unwrap(np.angle(amplitudes))
    significance = float((squares.sum() - 2 * len(squares)) / np.sqrt(4 * len(squares)))
    if significance < params.significance:
        return None
    return Harmonic(
        amplitude_mps2=float(np.median(np.abs(amplitudes))),
        significance=significance,
        phase_rad=np.asarray(np.interp(t_s, middle_s, phase)),
    )


def _fit(samples: RollSamples, rows: np.ndarray, angle: Floats, rate: Floats) -> tuple[complex, float]:
    """Gravity's amplitude times exp(i phase) in a window, and its square by its covariance (chi-squared, 2 degrees)."""
    cos, sin = np.cos(angle), np.sin(angle)
    one, line, nothing = np.ones(len(rows)), np.linspace(-1, 1, len(rows)), np.zeros(len(rows))
    (ca, sa), (cs, ss) = samples.accel_gravity, samples.squared_gravity
    of_squared = [cs * cos + ss * sin, ss * cos - cs * sin, 2 * rate * cos, 2 * rate * sin]
    of_accel = [ca * cos + sa * sin, sa * cos - ca * sin, -rate * sin, rate * cos]
    design = np.concatenate(
        [
            np.column_stack([*of_squared, one, line, line**2, nothing, nothing]) / samples.squared_sd,
            np.column_stack([*of_accel, nothing, nothing, nothing, one, line]) / samples.accel_sd,
        ]
    )
    values = np.concatenate(
        [samples.squared_rad2ps2[rows] / samples.squared_sd, samples.accel_radps2[rows] / samples.accel_sd]
    )
    root = np.concatenate([samples.squared_valid[rows], samples.accel_valid[rows]]).astype(np.float64)
    valid = root > 0
    solution: Floats = np.zeros(design.shape[1])
    sd = 1.0
    for _ in range(ROBUST_ROUNDS):
        solution = np.asarray(np.linalg.lstsq(design * root[:, None], values * root, rcond=None)[0], np.float64)
        left = values - design @ solution
        sd = 1.4826 * float(np.median(np.abs(left[valid]))) if valid.any() else 1.0
        root = valid / (1 + (left / (5 * max(sd, 1e-9))) ** 2)
    covariance = np.linalg.pinv((design * root[:, None]).T @ (design * root[:, None]))[:2, :2] * max(sd, 1.0) ** 2
    g = solution[:2]
    return complex(g[0], g[1]), float(g @ np.linalg.solve(covariance, g))
