"""The disc flight: spin rate from accelerometers at an unknown lever arm, beside the gyro.

The IMU sits where nobody has written down. The direction of its lever arm is that of the force while the disc spins;
its length is a state of the graph. The accelerometers alone do not fix it: the gyro is given to the graph, as an
encoder would be, over the first part of the flight, and the second part is judged.

The forces hold a line at 1.22 per turn, a wobble that the graph takes for the rate. Air slows a disc smoothly, so what
the estimated rate does around a parabola is no spin: it is counted in the sd, which takes no gyro.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.errors import BadRecording
from stillpoint.datasets.importers.options import Options
from stillpoint.datasets.importers.table import IMPORTERS
from stillpoint.datasets.recording import Encoder, Floats, Recording, Spin, SpinGeometry
from stillpoint.datasets.trajectory import SpinReference
from stillpoint.smoother.spin.graph import make_spin_reference
from stillpoint.smoother.spin.params import (
    EncoderParams,
    HarmonicParams,
    SpinCalibration,
    SpinGraphParams,
    SpinNoise,
)

_FLYING_RADPS = np.deg2rad(3000.0)  # spin rate, by the gyro, between release and catch
_FILTER_S = 1 / (2 * np.pi * 1.04)  # time constant of the accelerometers' low-pass at a hundredth of 104 Hz
_SETTLED = 4.0  # of these after the release
_CATCH_S = 0.05  # before the last sample of the flight, which the catch has touched
_GUESS_M = 0.03  # lever arm to begin with, from the size of the circuit board
_PARAMS = SpinGraphParams(
    noise=SpinNoise(unseen_radps2=10.0),
    calibration=SpinCalibration(accel_bias_sd_mps2=0.1, accel_bias_walk=0.02, lever_arm_sd=0.7, step_s=0.5),
    harmonic=HarmonicParams(search="off"),
    encoder=EncoderParams(use=True, latency_sd_s=1e-3, sd_rad=0.01),
    rate_limit_radps=1e-4,
)


@dataclass(frozen=True, eq=False)
class DiscFlight:
    """A flight, and the reference that the graph makes of its settled part."""

    all_t_s: Floats  # (M,) from the release
    all_gyro_radps: Floats  # (M,) spin rate
    all_force_mps2: Floats  # (M,) size of the force across the axis
    t_s: Floats  # (N,) of the settled part
    gyro_radps: Floats  # (N,)
    taught: NDArray[np.bool_]  # (N,) samples at which the graph had the gyro
    reference: SpinReference
    sd_radps: Floats  # (N,) of the rate: what the graph states and the wobble together
    wobble_radps: Floats  # (N,) RMS of the rate around a parabola, in the half of the flight that a sample is in
    arm_m: tuple[float, float]  # length and its sd


def read_disc_flight(file: Path) -> DiscFlight:
    """Read the flight in a log of the flatball firmware; raises :class:`BadRecording` when there is none."""
    recording = next(IMPORTERS["flatball"](file, Options(units_unchecked=True)))
    spin = recording.spin
    assert spin is not None
    flying = np.flatnonzero(spin.gyro_radps[:, 0] > _FLYING_RADPS)
    if len(flying) < 100:
        raise BadRecording(f"{file}: spins above 3000 deg/s for less than a second; there is no flight to look at")
    t_s = (spin.t_ns - spin.t_ns[flying[0]]) / 1e9
    rows = np.flatnonzero((t_s > _SETTLED * _FILTER_S) & (t_s < t_s[flying[-1]] - _CATCH_S))
    flight = _place_at_arm(recording, spin, rows)
    taught = t_s[rows] < (t_s[rows[0]] + t_s[rows[-1]]) / 2
    assert flight.encoder is not None
    half = replace(flight, encoder=_find_first(flight.encoder, int(taught.sum())))
    made = make_spin_reference(half, _PARAMS)
    error, sd = made.diagnostics["arm_squared"]
    wobble = np.where(taught, _measure_wobble_radps(made, taught), _measure_wobble_radps(made, ~taught))
    return DiscFlight(
        all_t_s=t_s[flying],
        all_gyro_radps=spin.gyro_radps[flying, 0],
        all_force_mps2=np.linalg.norm(spin.accel_mps2[flying, 1:], axis=1),
        t_s=t_s[rows],
        gyro_radps=spin.gyro_radps[rows, 0],
        taught=taught,
        reference=made,
        sd_radps=np.hypot(made.rate_sd_radps, wobble),
        wobble_radps=wobble,
        arm_m=(_GUESS_M * (1 + error), _GUESS_M * sd),
    )


def _place_at_arm(recording: Recording, spin: Spin, rows: NDArray[np.int64]) -> Recording:
    """Return the two accelerometers across the spin axis at the guessed arm, with the gyro's angle as an encoder."""
    across = spin.accel_mps2[rows, 1:]
    inward = np.median(across, axis=0)
    arm = np.array([0.0, *(-_GUESS_M * inward / np.linalg.norm(inward))])
    geometry = SpinGeometry(np.tile(arm, (2, 1)), np.eye(3)[1:], np.empty((0, 3)), None, fixed_axis=True)
    t_ns = spin.t_ns[rows] - spin.t_ns[rows[0]]
    rate = spin.gyro_radps[rows, 0]
    angle = np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) / 2 * np.diff(t_ns) / 1e9)])
    still = np.empty((len(rows), 0))
    return Recording(
        recording.name,
        spin=Spin(t_ns, across, still, geometry),
        encoder=Encoder(t_ns, angle, rate),
        info=recording.info,
    )


def _measure_wobble_radps(made: SpinReference, part: NDArray[np.bool_]) -> float:
    """Return the rms of the rate around a parabola."""
    t_s, rate = (made.t_ns[part] - made.t_ns[part][0]) / 1e9, made.rate_radps[part]
    return float(np.std(rate - np.polyval(np.polyfit(t_s, rate, 2), t_s)))


def _find_first(encoder: Encoder, count: int) -> Encoder:
    return Encoder(encoder.t_ns[:count], encoder.angle_rad[:count], encoder.rate_radps[:count])
