"""Where the graph of a spinning body begins: rates from the squared rate, and what turns with the shaft once found."""

from dataclasses import replace

import numpy as np

from stillpoint.datasets.recording import Floats
from stillpoint.smoother.spin.chain import Chain, angles_of
from stillpoint.smoother.spin.encoder import EncoderReadings
from stillpoint.smoother.spin.once_per_turn import Line
from stillpoint.smoother.spin.samples import RollSamples
from stillpoint.smoother.spin.state import (
    AMPLITUDE,
    ARM_S,
    CONSTANTS,
    COS_A,
    COS_S,
    OFFSET,
    SIN_A,
    SIN_S,
    RollState,
    in_blocks,
)
from stillpoint.smoother.spin.zero_rate import smooth_squared


def start_rates(samples: RollSamples, sign: float) -> Floats:
    """Mean rates x (N + 1,) to begin with."""
    rows = np.arange(len(samples))
    rate = sign * np.sqrt(np.maximum(smooth_squared(samples), 0.0))
    return np.asarray(np.interp(np.arange(len(rows) + 1) - 0.5, rows, rate))


def start_of(chain: Chain, readings: EncoderReadings | None, sign: float) -> RollState:
    """Rates from the squared rate; the angle is 0 at the first sample. With an encoder, its sign, scale and angle."""
    rates = start_rates(chain.samples, sign)
    constants = np.zeros((int(chain.constants_of[-1]) + 1, len(CONSTANTS)))
    if readings is None:
        return RollState(-float(rates[0] * chain.step_s[0]), rates, constants)
    scale = float(np.median(readings.rate_radps)) / float(np.median(rates[readings.k]))
    constants[:, ARM_S] = 1 / scale**2 - 1
    state = RollState(0.0, scale * rates, constants)
    first = float(np.median(readings.angle_rad - angles_of(chain, state)[readings.k]))
    return replace(state, start_angle_rad=first)


def with_gravity(chain: Chain, state: RollState, line: Line) -> tuple[Chain, RollState]:
    """The state turned so that gravity's phase is 0 all along; what the scales make of gravity has the same angle."""
    turned = np.diff(line.phase_rad, prepend=line.phase_rad[0]) / chain.step_s[:-1]
    rates = state.mean_rate_radps + np.append(turned, 0.0)
    constants = state.constants.copy()
    constants[:, AMPLITUDE] = line.gravity_mps2
    moved = RollState(state.start_angle_rad + float(line.phase_rad[0]), rates, constants)
    angle = angles_of(chain, moved)
    if chain.readings is not None:
        constants[:, OFFSET] = np.median(chain.readings.angle_rad - angle[chain.readings.k])
    return _along(chain, angle), moved


def with_vibration(chain: Chain, state: RollState, line: Line) -> tuple[Chain, RollState]:
    """Chain and state with a vibration along the line's own angle, which stays: it does not count the turns."""
    constants = state.constants.copy()
    constants[:, [COS_S, SIN_S]] = line.squared.real, -line.squared.imag
    constants[:, [COS_A, SIN_A]] = line.accel.real, -line.accel.imag
    return _along(chain, angles_of(chain, state) + line.phase_rad), replace(state, constants=constants)


def _along(chain: Chain, angle_rad: Floats) -> Chain:
    parts = [in_blocks(part, chain.layout.m, 0.0) for part in (np.cos(angle_rad), np.sin(angle_rad))]
    return replace(chain, shaken=np.stack(parts))
