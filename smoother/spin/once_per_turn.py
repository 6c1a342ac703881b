"""Find what occurs once per turn: gravity, a true ripple of the rate, or a vibration.

Written as Re(L exp(i angle)), the channels contain once per turn

    squared rate:  L_s = 2 w a + G k_s + n_s
    acceleration:  L_a = i w a + G k_a + n_a

with a ripple a of the rate w, gravity G = g sin(tilt) exp(i phase) times the sensitivity k = c - i s of each channel,
and vibrations n. Z = L_s + 2i L_a is free of the ripple. Gravity and a ripple together explain any L_s and L_a, which
therefore proves nothing; but if both channels by themselves, L_s / k_s and L_a / k_a, show the same gravity, it is
gravity.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.constants import MEDIAN_DEVIATION_TO_SD, STANDARD_GRAVITY_MPS2
from stillpoint.datasets.recording import Floats
from stillpoint.smoother.spin.chain import Chain, integrate_angles, interpolate_rates
from stillpoint.smoother.spin.params import HarmonicParams
from stillpoint.smoother.spin.samples import SpinSamples
from stillpoint.smoother.spin.state import SpinState

_FEWEST_IN_WINDOW = 48  # valid samples of each channel
_LEAST_TURNS = 2.0  # of the body in a window
_ROBUST_ROUNDS = 4
_ROBUST = 5.0  # sd
_RIPPLE_SD = 4.0  # of Z, as :func:`_measure_excess` has it: below, a ripple of the rate explains both channels
_APART_SD = 3.0  # sd by which gravity in one channel may differ from that in the other, beside what is allowed in parts
_MOST_GRAVITY = 1.05  # of g: as much as scales and lever arms may be off
_NOTHING = 1e-6  # relative: a channel that feels less of gravity feels none

Complexes = NDArray[np.complex128]
Verdict = Literal["ripple", "gravity", "vibration"]


@dataclass(frozen=True, eq=False)
class Line:
    """The line at the spin frequency, followed through the recording, and its verdict.

    Adding ``phase_rad`` to the angle makes L_s and L_a those stated; for gravity, angle 0 is then where z points up.
    """

    verdict: Verdict
    why: str
    squared: complex  # L_s, rad^2/s^2
    accel: complex  # L_a, rad/s^2
    significance: float  # sd by which Z differs from zero, all windows together
    by_squared_mps2: float | None  # gravity as the squared rate alone shows it; None where it feels none
    by_accel_mps2: float | None
    gravity_mps2: float  # as both show it together, a ripple aside; 0 unless taken for gravity
    ripple_radps: float | None  # amplitude of the ripple that is then left; None for a vibration, which hides it
    rate_radps: float  # w, median
    phase_rad: Floats  # (N,)

    @property
    def is_gravity(self) -> bool:
        """Return whether the line is gravity, from which the angle is measured."""
        return self.verdict == "gravity"

    @property
    def is_vibration(self) -> bool:
        """Return whether the line is a vibration, which is not a motion of the body."""
        return self.verdict == "vibration"


@dataclass(frozen=True, eq=False)
class Windows:
    """L_s and L_a in W windows, with the variances of their real and imaginary parts."""

    middle_s: Floats  # (W,)
    squared: Complexes  # (W,)
    accel: Complexes  # (W,)
    squared_var: Floats  # (W,)
    accel_var: Floats  # (W,)

    def phase(self) -> tuple[Floats, float]:
        """Return the phases (W,) of the channel that shows the line best, and its significance in sd."""
        channels = ((self.squared, self.squared_var), (self.accel, self.accel_var))
        clear = [_measure_excess(np.abs(line) ** 2 / var) for line, var in channels]
        best = int(np.argmax(clear))
        return np.unwrap(np.angle(channels[best][0])), clear[best]

    def remove_phase(self, phase_rad: Floats) -> tuple[complex, complex, float, float]:
        """Return the means of L_s and L_a with the phases (W,) removed, and their variances."""
        back = np.exp(-1j * phase_rad)
        by_squared, by_accel = 1 / self.squared_var, 1 / self.accel_var
        squared = np.sum(by_squared * self.squared * back) / by_squared.sum()
        accel = np.sum(by_accel * self.accel * back) / by_accel.sum()
        return complex(squared), complex(accel), float(1 / by_squared.sum()), float(1 / by_accel.sum())


def find_line(chain: Chain, state: SpinState, params: HarmonicParams) -> Line | None:
    """Return the line along a trajectory that was solved without it; None where there is none."""
    samples = chain.samples
    windows = _fit_windows(chain, state, params.window_s)
    if windows is None:
        return None
    phase, clear = windows.phase()
    if clear < params.significance:
        return None
    squared, accel, squared_var, accel_var = windows.remove_phase(phase)
    free = windows.squared + 2j * windows.accel
    significance = _measure_excess(np.abs(free) ** 2 / (windows.squared_var + 4 * windows.accel_var))
    k_s, k_a = _gravity_sensitivity(samples.squared_gravity), _gravity_sensitivity(samples.accel_gravity)
    sd = np.sqrt(sum(var / abs(k) ** 2 for var, k in ((squared_var, k_s), (accel_var, k_a)) if k))
    verdict, why = judge_line(squared, accel, k_s, k_a, float(sd), significance, params)
    gravity, rate = 0j, float(np.median(interpolate_rates(chain, state)))
    if verdict == "gravity":
        phase = np.unwrap(np.angle(free / (k_s + 2j * k_a)))
        squared, accel, _, _ = windows.remove_phase(phase)
        gravity = (squared + 2j * accel) / (k_s + 2j * k_a)
    return Line(
        verdict=verdict,
        why=why,
        squared=squared,
        accel=accel,
        significance=significance,
        by_squared_mps2=abs(squared / k_s) if k_s else None,
        by_accel_mps2=abs(accel / k_a) if k_a else None,
        gravity_mps2=abs(gravity),
        ripple_radps=abs(squared - gravity * k_s) / abs(2 * rate) if verdict != "vibration" else None,
        rate_radps=rate,
        phase_rad=np.interp(_elapsed_s(samples), windows.middle_s, phase),
    )


def follow_line(chain: Chain, state: SpinState, line: Line, params: HarmonicParams) -> Line:
    """Return the same line, followed along another trajectory."""
    windows = _fit_windows(chain, state, params.window_s)
    if windows is None:
        return line
    phase, _ = windows.phase()
    squared, accel, _, _ = windows.remove_phase(phase)
    phase = np.interp(_elapsed_s(chain.samples), windows.middle_s, phase)
    return replace(line, squared=squared, accel=accel, phase_rad=phase)


def _measure_excess(squares: Floats) -> float:
    """Return by how many sd the sum of chi-squared numbers (W,), 2 degrees of freedom each, exceeds its mean."""
    count = len(squares)
    return float((squares.sum() - 2 * count) / np.sqrt(4 * count))


def _gravity_sensitivity(gravity: Floats) -> complex:
    """Return the sensitivity k of a channel to gravity, 1/m."""
    return complex(gravity[0], -gravity[1])


def judge_line(
    squared: complex,
    accel: complex,
    k_s: complex,
    k_a: complex,
    apart_sd: float,
    significance: float,
    p: HarmonicParams,
) -> tuple[Verdict, str]:
    """Return what a line is, and why. ``apart_sd`` is the sd of the difference of the two channels' gravity."""
    if significance < _RIPPLE_SD:
        return "ripple", "a ripple of the rate explains both channels"
    together = k_s + 2j * k_a
    if not (k_s or k_a):
        return "vibration", "neither channel feels gravity"
    if abs(together) <= _NOTHING * (abs(k_s) + 2 * abs(k_a)):
        return "vibration", "by this geometry gravity looks like a ripple of the rate; taken for a vibration"
    if p.search == "gravity":
        return "gravity", "taken for gravity as told, without a test"
    if not (k_s and k_a):
        return "vibration", (
            f"only the {'squared rate' if k_s else 'acceleration'} feels gravity, so it cannot be tested; taken for a "
            "vibration: if the axis is known not to be vertical, set harmonic.search=gravity"
        )
    by_squared, by_accel = squared / k_s, accel / k_a
    shown = (
        f"gravity by the squared rate {abs(by_squared):.3f} m/s^2, by the acceleration {abs(by_accel):.3f}, "
        f"{abs(np.rad2deg(np.angle(by_squared / by_accel))):.0f} deg apart"
    )
    if abs(by_squared - by_accel) > p.agreement * min(abs(by_squared), abs(by_accel)) + _APART_SD * apart_sd:
        return "vibration", f"{shown}: they contradict each other"
    if abs((squared + 2j * accel) / together) > _MOST_GRAVITY * STANDARD_GRAVITY_MPS2:
        return "vibration", f"{shown}: more than g"
    if significance < p.significance:
        return "vibration", f"{shown}: too little to be sure"
    return "gravity", f"{shown}: they agree"


def _elapsed_s(samples: SpinSamples) -> Floats:
    """Return the time (N,) from the first sample."""
    return np.asarray((samples.t_ns - samples.t_ns[0]) / 1e9)


def _fit_windows(chain: Chain, state: SpinState, window_s: float) -> Windows | None:
    """Return the line along a trajectory in each window that is long enough; None if there is no such window."""
    samples, angle_rad = chain.samples, integrate_angles(chain, state)
    t_s = _elapsed_s(samples)
    edges = np.searchsorted(t_s, np.arange(0.0, t_s[-1] + window_s, window_s))
    found = []
    for first, last in pairwise(edges):
        rows = slice(first, last)
        valid_s, valid_a = samples.squared_valid[rows], samples.accel_valid[rows]
        if min(valid_s.sum(), valid_a.sum()) < _FEWEST_IN_WINDOW:
            continue
        if abs(angle_rad[last - 1] - angle_rad[first]) < _LEAST_TURNS * 2 * np.pi:
            continue
        squared = _fit(samples.squared_rad2ps2[rows][valid_s], angle_rad[rows][valid_s], samples.squared_sd)
        accel = _fit(samples.accel_radps2[rows][valid_a], angle_rad[rows][valid_a], samples.accel_sd)
        found.append((float(t_s[rows].mean()), squared, accel))
    if not found:
        return None
    return Windows(
        middle_s=np.array([middle for middle, _, _ in found]),
        squared=np.array([line for _, (line, _), _ in found]),
        accel=np.array([line for _, _, (line, _) in found]),
        squared_var=np.array([var for _, (_, var), _ in found]),
        accel_var=np.array([var for _, _, (_, var) in found]),
    )


def _fit(values: Floats, angle_rad: Floats, least_sd: float) -> tuple[complex, float]:
    """Return L of a channel, fitted robustly beside a parabola, and the variance of its real and imaginary parts.

    The noise is taken to be at least ``least_sd``.
    """
    line = np.linspace(-1, 1, len(values))
    design = np.column_stack([np.cos(angle_rad), np.sin(angle_rad), np.ones(len(values)), line, line**2])
    root = np.ones(len(values))
    solution: Floats = np.zeros(design.shape[1])
    sd = least_sd
    for _ in range(_ROBUST_ROUNDS):
        solution = np.asarray(np.linalg.lstsq(design * root[:, None], values * root, rcond=None)[0])
        left = values - design @ solution
        sd = max(least_sd, MEDIAN_DEVIATION_TO_SD * float(np.median(np.abs(left))))
        root = 1 / (1 + (left / (_ROBUST * sd)) ** 2)
    white = design * root[:, None]
    covariance = np.linalg.pinv(white.T @ white) * sd**2
    return complex(solution[0], -solution[1]), float(np.trace(covariance[:2, :2]) / 2)
