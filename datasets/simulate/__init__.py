"""Recordings whose truth is known by construction: the path first, then what a sensor makes of it."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.nearest import require_known
from stillpoint.datasets.recording import Recording
from stillpoint.datasets.simulate import phone
from stillpoint.datasets.simulate.sensor import PERFECT, PHONE, SENSORS, Sensor

__all__ = ["PERFECT", "PHONE", "SENSORS", "SIMULATIONS", "Sensor", "Simulation", "simulate"]


@dataclass(frozen=True)
class Simulation:
    """One entry of the table of simulations."""

    summary: str
    minutes: float  # unless another length is asked for
    sensor: Sensor
    build: Callable[[Sensor, int, float, float], Recording]  # sensor, seed, minutes, rate_hz


SIMULATIONS: dict[str, Simulation] = {
    "phone-1": Simulation(
        "phone slid over a table, turned about the vertical only (paper 002, experiment 1)",
        2.0,
        PHONE,
        partial(phone.experiment, "phone-1", phone.SLIDING),
    ),
    "phone-2": Simulation(
        "phone on a tripod, turned slowly about all axes (paper 002, experiment 2)",
        4.0,
        PHONE,
        partial(phone.experiment, "phone-2", phone.TRIPOD),
    ),
    "phone-3": Simulation(
        "phone in the hand, violent turns and accelerations (paper 002, experiment 3)",
        4.0,
        PHONE,
        partial(phone.experiment, "phone-3", phone.IN_HAND),
    ),
}


def simulate(
    kind: str, seed: int = 0, minutes: float | None = None, rate_hz: float = 100.0, sensor: Sensor | None = None
) -> Recording:
    """A recording of the simulation ``kind`` with its truth; the same arguments give the same bytes.

    ``minutes`` and ``sensor`` (:data:`PERFECT` for exact samples) default to those of the simulation's table entry.
    Raises :class:`BadParameter`.
    """
    require_known(kind, SIMULATIONS, "simulation")
    entry = SIMULATIONS[kind]
    minutes = entry.minutes if minutes is None else minutes
    if seed < 0:
        raise BadParameter(f"seed {seed}: give a whole number from 0 on")
    if not (np.isfinite(minutes) and 0 < minutes <= 1440):
        raise BadParameter(f"minutes {minutes:g}: give a length above 0 and up to 1440 (a day)")
    if not (np.isfinite(rate_hz) and 10 <= rate_hz <= 2000):
        raise BadParameter(f"rate {rate_hz:g}: give 10 to 2000 Hz")
    return entry.build(entry.sensor if sensor is None else sensor, seed, minutes, rate_hz)
