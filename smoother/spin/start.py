"""Start values of a spinning body's graph: rates from the squared rate, and the once-per-turn line once it is found."""

from dataclasses import replace

import numpy as np

from stillpoint.datasets.recording import Floats
from stillpoint.smoother.spin.chain import Chain, integrate_angles
from stillpoint.smoother.spin.encoder import EncoderReadings
from stillpoint.smoother.spin.once_per_turn import Line
from stillpoint.smoother.spin.samples import SpinSamples
from stillpoint.smoother.spin.state import (
    AMPLITUDE,
    ARM_S,
    CONSTANTS,
    COS_A,
    COS_S,
    OFFSET,
    SIN_A,
    SIN_S,
    SpinState,
    split_blocks,
)
from stillpoint.smoother.spin.zero_rate import smooth_squared


def _start_rates(samples: SpinSamples, sign: float) -> Floats:
    """Return the start values of the mean rates x (N + 1,)."""
    rows = np.arange(len(samples))
    rate = sign * np.sqrt(np.maximum(smooth_squared(samples), 0.0))
    return np.asarray(np.interp(np.arange(len(rows) + 1) - 0.5, rows, rate))


def make_start(chain: Chain, readings: EncoderReadings | None, sign: float) -> SpinState:
    """Return rates from the squared rate and angle 0 at the first sample; with an encoder its sign, scale and angle."""
    rates = _start_rates(chain.samples, sign)
    constants = np.zeros((int(chain.constants_of[-1]) + 1, len(CONSTANTS)))
    if readings is None:
        return SpinState(-float(rates[0] * chain.step_s[0]), rates, constants)
    scale = float(np.median(readings.rate_radps)) / float(np.median(rates[readings.k]))
    constants[:, ARM_S] = 1 / scale**2 - 1
    state = SpinState(0.0, scale * rates, constants)
    first = float(np.median(readings.angle_rad - integrate_angles(chain, state)[readings.k]))
    return replace(state, start_angle_rad=first)


def add_gravity(chain: Chain, state: SpinState, line: Line) -> tuple[Chain, SpinState]:
    """Return chain and state with gravity: the angle is shifted so that gravity's phase is 0 throughout."""
    turned = np.diff(line.phase_rad, prepend=line.phase_rad[0]) / chain.step_s[:-1]
    rates = state.mean_rate_radps + np.append(turned, 0.0)
    constants = state.constants.copy()
    constants[:, AMPLITUDE] = line.gravity_mps2
    moved = SpinState(state.start_angle_rad + float(line.phase_rad[0]), rates, constants)
    angle = integrate_angles(chain, moved)
    if chain.readings is not None:
        constants[:, OFFSET] = np.median(chain.readings.angle_rad - angle[chain.readings.k])
    return _fit_along(chain, angle), moved


def add_vibration(chain: Chain, state: SpinState, line: Line) -> tuple[Chain, SpinState]:
    """Return chain and state with a vibration along the line's own angle, which stays fixed in later iterations."""
    constants = state.constants.copy()
    constants[:, [COS_S, SIN_S]] = line.squared.real, -line.squared.imag
    constants[:, [COS_A, SIN_A]] = line.accel.real, -line.accel.imag
    return _fit_along(chain, integrate_angles(chain, state) + line.phase_rad), replace(state, constants=constants)


def _fit_along(chain: Chain, angle_rad: Floats) -> Chain:
    parts = [split_blocks(part, chain.layout.m, 0.0) for part in (np.cos(angle_rad), np.sin(angle_rad))]
    return replace(chain, shaken=np.stack(parts))
