"""Simulate recordings whose truth is known by construction: first the path, then the sensors on it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from stillpoint.datasets.errors import BadParameter, require_known
from stillpoint.datasets.recording import Recording
from stillpoint.datasets.simulate import auv, car, phone, scenes, servo, spin, spin_sensor
from stillpoint.datasets.simulate.sensor import PERFECT, PHONE, SENSORS, Sensor

__all__ = ["PERFECT", "PHONE", "SENSORS", "SIMULATIONS", "Sensor", "Simulation", "simulate"]


@dataclass(frozen=True)
class Simulation:
    """One entry of the table of simulations."""

    summary: str
    minutes: float  # unless another length is asked for
    sensors: Mapping[str, Any]  # presets of what measures, of one class; the first is used unless another is asked for
    build: Callable[[Any, int, float, float], Recording]  # sensor, seed, minutes, rate_hz
    rate_hz: float = 100.0  # unless another is asked for


_HAND_SENSORS = {sensor.name: sensor for sensor in (scenes.CALIBRATED, PHONE, PERFECT)}

SIMULATIONS: dict[str, Simulation] = {
    "phone-1": Simulation(
        "phone slid over a table, turned about the vertical only (Elmi Aziz and Mohseni Araste 2021, experiment 1)",
        2.0,
        SENSORS,
        partial(phone.simulate_experiment, "phone-1", phone.SLIDING),
    ),
    "phone-2": Simulation(
        "phone on a tripod, turned slowly about all axes (Elmi Aziz and Mohseni Araste 2021, experiment 2)",
        4.0,
        SENSORS,
        partial(phone.simulate_experiment, "phone-2", phone.TRIPOD),
    ),
    "phone-3": Simulation(
        "phone in the hand, violent turns and accelerations (Elmi Aziz and Mohseni Araste 2021, experiment 3)",
        4.0,
        SENSORS,
        partial(phone.simulate_experiment, "phone-3", phone.IN_HAND),
    ),
    "phone-3-shaken": Simulation(
        "phone-3 held in one place and shaken evenly, at about 5 Hz",
        4.0,
        SENSORS,
        partial(phone.simulate_experiment, "phone-3-shaken", phone.SHAKEN),
    ),
    "phone-3-level": Simulation(
        "phone-3-shaken to the sides, and not up and down",
        4.0,
        SENSORS,
        partial(phone.simulate_experiment, "phone-3-level", phone.LEVEL),
    ),
    "hand-calm": Simulation(
        "calibrated phone carried about, without disturbance: what the other hand-… are compared with",
        3.0,
        _HAND_SENSORS,
        partial(scenes.simulate_scene, "hand-calm", scenes.CARRIED, None),
    ),
    "hand-magnet": Simulation(
        "the same, passing magnets of 30 uT, four in a minute of motion",
        3.0,
        _HAND_SENSORS,
        partial(scenes.simulate_scene, "hand-magnet", scenes.CARRIED, scenes.Magnets()),
    ),
    "hand-vibration": Simulation(
        "the same, with bursts of vibration that shift the mean of gyro and accelerometer",
        3.0,
        _HAND_SENSORS,
        partial(scenes.simulate_scene, "hand-vibration", scenes.CARRIED, scenes.Vibration()),
    ),
    "hand-bias-steps": Simulation(
        "the same, with a gyro whose bias steps by 0.5 deg/s",
        3.0,
        _HAND_SENSORS,
        partial(scenes.simulate_scene, "hand-bias-steps", scenes.CARRIED, scenes.BiasSteps()),
    ),
    "hand-translation": Simulation(
        "the same phone moved over metres with accelerations of up to 1 g",
        3.0,
        _HAND_SENSORS,
        partial(scenes.simulate_scene, "hand-translation", scenes.FLUNG, None),
    ),
    "auv-dolphin": Simulation(
        "underwater vehicle: surface with waves, dive, 600 s submerged, ascent, surface (Zia 2022)",
        15.0,
        auv.AUV_SENSORS,
        partial(auv.simulate_mission, "auv-dolphin", auv.WAVES),
        50.0,
    ),
    "auv-dolphin-calm": Simulation(
        "the same in a calm sea: it rolls, but no wave accelerates it",
        15.0,
        auv.AUV_SENSORS,
        partial(auv.simulate_mission, "auv-dolphin-calm", auv.CALM),
        50.0,
    ),
    "car": Simulation(
        "car in a town, with stops, satellite fixes and a wheel speed",
        6.0,
        car.CAR_SENSORS,
        partial(car.simulate_drive, "car"),
    ),
    "servo-bench": Simulation(
        "MPU6050 and HMC5883L on a servo that swings by +-90 deg, slowly and fast (Byambajav et al.)",
        30.0,
        servo.SERVO_SENSORS,
        partial(servo.simulate_experiment, "servo-bench", servo.BENCH),
    ),
    "spin-constant": Simulation(
        "motor at 2020 deg/s with two accelerometers and an encoder (Asghari et al. 2018, section 4.1)",
        0.5,
        spin_sensor.CONSTANT,
        partial(spin.simulate_trial, "spin-constant", spin.CONSTANT),
        250.0,
    ),
    "spin-variable": Simulation(
        "motor at 1500 to 2100 deg/s, slowly changing (Asghari et al. 2018, section 4.2)",
        1.0,
        spin_sensor.VARIABLE,
        partial(spin.simulate_trial, "spin-variable", spin.VARIABLE),
        250.0,
    ),
    "spin-flight": Simulation(
        "spinning projectile with five accelerometers and two gyros, coning (Asghari et al. 2018, section 2)",
        0.5,
        spin_sensor.FLIGHT,
        partial(spin.simulate_trial, "spin-flight", spin.FLIGHT),
        250.0,
    ),
}


def simulate(
    kind: str,
    seed: int = 0,
    minutes: float | None = None,
    rate_hz: float | None = None,
    sensor: Any | str | None = None,
) -> Recording:
    """Return a recording of the simulation ``kind`` with its truth; the same arguments give the same bytes.

    ``minutes``, ``rate_hz`` and ``sensor`` (a preset's name, such as ``"perfect"``, or an object of the presets' class)
    default to those of the simulation's table entry. Raises :class:`BadParameter`.
    """
    require_known(kind, SIMULATIONS, "simulation")
    entry = SIMULATIONS[kind]
    minutes = entry.minutes if minutes is None else minutes
    rate_hz = entry.rate_hz if rate_hz is None else rate_hz
    default = next(iter(entry.sensors.values()))
    if isinstance(sensor, str):
        require_known(sensor, entry.sensors, f"sensor of {kind}")
        sensor = entry.sensors[sensor]
    sensor = default if sensor is None else sensor
    if not isinstance(sensor, type(default)):
        raise BadParameter(f"sensor: is a {type(sensor).__name__}; {kind} takes a {type(default).__name__}")
    if seed < 0:
        raise BadParameter(f"seed {seed}: give a whole number from 0 on")
    if not (np.isfinite(minutes) and 0 < minutes <= 1440):
        raise BadParameter(f"minutes {minutes:g}: give a length above 0 and up to 1440 (a day)")
    if not (np.isfinite(rate_hz) and 10 <= rate_hz <= 2000):
        raise BadParameter(f"rate {rate_hz:g}: give 10 to 2000 Hz")
    return entry.build(sensor, seed, minutes, rate_hz)
