"""Recordings of a spinning body for tests: simulated, spoilt, or exact."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.recording import Encoder, Recording, Spin, SpinGeometry
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.simulate import spin as simulated
from stillpoint.datasets.simulate.spin_sensor import CONSTANT as PRESETS
from stillpoint.datasets.simulate.spin_sensor import SpinSensor, make_white_noise
from stillpoint.datasets.spin import BENCH
from stillpoint.datasets.trajectory import SpinReference
from stillpoint.filters.precision import Precision
from stillpoint.filters.table import SPINS
from stillpoint.smoother.spin.params import SpinCalibration, SpinGraphParams, SpinNoise

CONSTANT = {"radial_var_m2ps4": 0.8, "tangential_var_m2ps4": 0.125}  # R = 80, Q = 0.5 on the bench
VARIABLE = {"radial_var_m2ps4": 0.4, "tangential_var_m2ps4": 3.0}  # R = 40, Q = 12
# A stream is compiled anew for each estimator and precision; one in single precision stands for all.
STREAMED: list[tuple[str, Precision]] = [*((name, "double") for name in SPINS), ("roll-ekf", "single")]
QUIET = make_white_noise("quiet", 0.06, 0.13, 0.08)
RIG = SpinGraphParams(calibration=SpinCalibration(accel_bias_sd_mps2=0.1, lever_arm_sd=1e-3))  # 10 mg, 0.1 %
GIVEN = SpinNoise(source="given", accel_sd_radps2=0.12**0.5 / 0.5, squared_sd_rad2ps2=0.8**0.5 / 0.1)
X, Y, Z = np.eye(3)
SQUARE = SpinGeometry(np.array([0.1 * Z, 0.5 * Z]), np.array([Z, -Y]), np.empty((0, 3)), None, fixed_axis=True)

Floats = NDArray[np.float64]


@cache
def _simulate_quiet(kind: str, seed: int) -> Recording:
    return simulate(kind, seed=seed, sensor=QUIET)


def spoilt(spoil: Callable[[Floats], None], seed: int = 0, kind: str = "spin-constant") -> Recording:
    """The bench with quiet sensors, and what ``spoil`` does to its columns F4, F5 (N, 2)."""
    recording = _simulate_quiet(kind, seed)
    assert recording.spin is not None
    accel = recording.spin.accel_mps2.copy()
    spoil(accel)
    return replace(recording, spin=replace(recording.spin, accel_mps2=accel))


def exact(
    rate: Callable[[Floats], Floats],
    accel: Callable[[Floats], Floats],
    seconds: float = 4.0,
    geometry: SpinGeometry = BENCH,
    gyro: Callable[[Floats], Floats] | None = None,
) -> Recording:
    """Perfect F4 and F5 at 250 Hz of a body whose rate (rad/s) and angular acceleration are given over time."""
    t_s = np.arange(0, seconds, 0.004)
    t_ns = np.round(t_s * 1e9).astype(np.int64)
    columns = np.column_stack([-0.1 * rate(t_s) ** 2, 0.5 * accel(t_s)])
    fine_s = np.arange(0, seconds, 0.0001)
    angle = np.append(0.0, np.cumsum((rate(fine_s)[1:] + rate(fine_s)[:-1]) / 2 * 0.0001))
    gyros = np.empty((len(t_s), 0)) if gyro is None else gyro(t_s)[:, None]
    truth = Encoder(t_ns, np.interp(t_s, fine_s, angle), rate(t_s))
    return Recording("exact", spin=Spin(t_ns, columns, gyros, geometry), roll_truth=truth)


def tilted(tilt_deg: float, seed: int, geometry: SpinGeometry = BENCH, wrong: bool = True) -> Recording:
    """The constant bench on a tilted shaft; biases and arms are wrong as RIG's prior says, one draw per recording."""
    white = PRESETS["white"]
    errors = {"bias_mg": 0.1 / 9.80665e-3, "arm_error": 1e-3} if wrong else {}
    radial, tangential = replace(white.radial, **errors), replace(white.tangential, **errors)
    sensor: SpinSensor = replace(white, name="tilted", tilt_deg=tilt_deg, radial=radial, tangential=tangential)
    return simulated.simulate_trial("tilted", replace(simulated.CONSTANT, geometry=geometry), sensor, seed, 0.5, 250.0)


def absolute_error(made: SpinReference, recording: Recording) -> Floats:
    """Of the angle, whole turns aside."""
    assert recording.roll_truth is not None
    error = made.angle_rad - recording.roll_truth.angle_rad
    return np.asarray(error - 2 * np.pi * np.round(np.median(error) / (2 * np.pi)))


def known(noise: SpinNoise) -> SpinGraphParams:
    """Nothing is unknown but the rate."""
    calibration = SpinCalibration(accel_bias_sd_mps2=1e-6, accel_bias_walk=1e-7, lever_arm_sd=1e-7)
    return SpinGraphParams(noise=noise, calibration=calibration, rate_limit_radps=1e-9)
