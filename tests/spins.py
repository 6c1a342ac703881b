"""Recordings of a spinning body for tests: simulated, spoilt, or exact."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.recording import Encoder, Recording, Spin, SpinGeometry
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.simulate.spin_sensor import noisy
from stillpoint.datasets.spin import BENCH

CONSTANT = {"radial_var_m2ps4": 0.8, "tangential_var_m2ps4": 0.125}  # R = 80, Q = 0.5 on the bench
VARIABLE = {"radial_var_m2ps4": 0.4, "tangential_var_m2ps4": 3.0}  # R = 40, Q = 12
QUIET = noisy("quiet", 0.06, 0.13, 0.08)

Floats = NDArray[np.float64]


def spoilt(spoil: Callable[[Floats], None], seed: int = 0, kind: str = "spin-constant") -> Recording:
    """The bench with quiet sensors, and what ``spoil`` does to its columns F4, F5 (N, 2)."""
    recording = simulate(kind, seed=seed, sensor=QUIET)
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
