"""Simulate ``spin-constant``, ``spin-variable`` and ``spin-flight``: the bench and projectile of Asghari et al.
(2018).
"""

import json
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from stillpoint.datasets.constants import STANDARD_GRAVITY_MPS2
from stillpoint.datasets.recording import Encoder, Floats, Info, Recording, Spin, SpinGeometry, Times
from stillpoint.datasets.simulate.generators import make_generator
from stillpoint.datasets.simulate.spin_path import (
    Flight,
    Motor,
    SpinPath,
    compute_braking_b_mps2,
    compute_coning_radps,
    compute_constant_speed,
    compute_decaying_speed,
    compute_variable_speed,
    make_path,
)
from stillpoint.datasets.simulate.spin_sensor import EncoderModel, SpinAccel, SpinSensor
from stillpoint.datasets.spin import BENCH, FIVE_ACCELEROMETERS, compute_specific_force, find_saturated


@dataclass(frozen=True)
class Scenario:
    """A spinning body and the sensors on it."""

    motor: Motor
    geometry: SpinGeometry
    flight: Flight | None = None  # None: on a motor's shaft


CONSTANT = Scenario(Motor(compute_constant_speed, ripple_degps=5.0), BENCH)
VARIABLE = Scenario(Motor(compute_variable_speed, ripple_degps=1.5), BENCH)
FLIGHT = Scenario(
    Motor(compute_decaying_speed, ripple_degps=0.0, once_per_turn_degps=0.0), FIVE_ACCELEROMETERS, Flight()
)


@dataclass(frozen=True, eq=False)
class _Motion:
    """The motion of the body at the sampling instants."""

    t_s: Floats  # (N,)
    angle_rad: Floats  # (N,) about x
    rate_radps: Floats  # (N, 3)
    accel_radps2: Floats  # (N, 3)
    centre_b_mps2: Floats  # (N, 3) specific force at the centre


def simulate_trial(
    kind: str, scenario: Scenario, sensor: SpinSensor, seed: int, minutes: float, rate_hz: float
) -> Recording:
    """Simulate one trial. The geometry of the recording is the stated one; the true arms are in ``info.extra``."""
    path = make_path(scenario.motor, minutes * 60, seed)
    step_ns = round(1e9 / rate_hz)
    t_ns = np.arange(max(int(round(minutes * 60e9) // step_ns), 2), dtype=np.int64) * step_ns
    motion = _compute_motion(scenario, path, sensor.tilt_deg, t_ns / 1e9)
    spin, drawn, notes = _spin(scenario.geometry, motion, sensor, t_ns, seed)
    motor = asdict(scenario.motor) | {"speed_degps": scenario.motor.speed_degps.__name__}
    flight = None if scenario.flight is None else asdict(scenario.flight)
    return Recording(
        f"{kind}-{sensor.name}-seed{seed}",
        spin=spin,
        encoder=None if sensor.encoder is None or scenario.flight else _measure_encoder(path, sensor.encoder, t_ns),
        roll_truth=Encoder(t_ns, motion.angle_rad, motion.rate_radps[:, 0]),
        info=Info(
            source=f"stillpoint simulate {kind} --sensor {sensor.name} --seed {seed} --minutes {minutes:g} "
            f"--rate {rate_hz:g}",
            licence="CC0-1.0",
            sensor=f"simulated: ADXL345, {sensor.name}",
            notes=notes,
            extra={
                "sensor_model": json.dumps(asdict(sensor)),
                "sensor_drawn": json.dumps(drawn),
                "motion": json.dumps({"motor": motor, "flight": flight}),
            },
        ),
    )


def _compute_motion(scenario: Scenario, path: SpinPath, tilt_deg: float, t_s: Floats) -> _Motion:
    """Return angle, rates and specific force at times (N,), on a tilted shaft or in flight."""
    angle, rate, accel = path.angle_rad(t_s), np.zeros((len(t_s), 3)), np.zeros((len(t_s), 3))
    rate[:, 0], accel[:, 0] = path.rate_radps(t_s), path.accel_radps2(t_s)
    if scenario.flight is None:
        return _Motion(t_s, angle, rate, accel, _compute_gravity_b_mps2(angle, np.deg2rad(tilt_deg)))
    rate[:, 1:], accel[:, 1:] = compute_coning_radps(scenario.flight, path, t_s)
    return _Motion(t_s, angle, rate, accel, compute_braking_b_mps2(scenario.flight, path, t_s))


def _compute_gravity_b_mps2(angle_rad: Floats, tilt_rad: float) -> Floats:
    """Return the specific force (N, 3) in b that holds a tilted shaft; at angle 0 the body's z axis points up most."""
    across = np.sin(tilt_rad)
    up = [np.full(len(angle_rad), np.cos(tilt_rad)), across * np.sin(angle_rad), across * np.cos(angle_rad)]
    return np.asarray(STANDARD_GRAVITY_MPS2 * np.column_stack(up))


def _spin(
    geometry: SpinGeometry, motion: _Motion, sensor: SpinSensor, t_ns: Times, seed: int
) -> tuple[Spin, dict[str, Any], tuple[str, ...]]:
    """Return the recorded stream, the errors drawn, and notes on both."""
    count = len(geometry.accel_r_b_m)
    parts = [sensor.centre] * (count - 2) + [sensor.radial, sensor.tangential]  # F4 and F5 are the last two
    made = [
        _measure_accelerometer(
            part, geometry.accel_r_b_m[k], geometry.accel_axis_b[k], motion, sensor, seed, f"F{6 - count + k}"
        )
        for k, part in enumerate(parts)
    ]
    gyro, gyro_bias = _measure_gyros(geometry.gyro_axis_b, motion, sensor, seed)
    came = make_generator(seed, "spin/lost").random(len(t_ns)) >= sensor.lost_share
    came[0] = True
    ranged = replace(geometry, accel_range_mps2=np.full(count, sensor.range_g * STANDARD_GRAVITY_MPS2))
    spin = Spin(t_ns[came], np.column_stack([one for one, _ in made])[came], gyro[came], ranged)
    full = find_saturated(spin).sum(axis=0)
    notes = [f"accelerometer {k + 1}: {n} samples at its range" for k, n in enumerate(full) if n]
    if not came.all():
        notes.append(f"{int((~came).sum())} samples lost on the way")
    return spin, {"accelerometers": [drawn for _, drawn in made], "gyro_bias_radps": gyro_bias}, tuple(notes)


def _measure_accelerometer(
    part: SpinAccel, stated_arm_m: Floats, axis: Floats, motion: _Motion, sensor: SpinSensor, seed: int, name: str
) -> tuple[Floats, dict[str, float]]:
    """Return samples (N,) with all their errors, and the errors drawn."""
    sizes = {"arm": part.arm_error, "scale": part.scale_error, "bias": part.bias_mg * STANDARD_GRAVITY_MPS2 / 1e3}
    error = {what: make_generator(seed, f"spin/{name}/{what}").standard_normal() * size for what, size in sizes.items()}
    arm = stated_arm_m * (1 + error["arm"])
    ideal = compute_specific_force(arm, motion.centre_b_mps2, motion.rate_radps, motion.accel_radps2) @ axis
    felt = (ideal + _shake_motor(part, motion, seed, name)) * (1 + error["scale"]) + error["bias"] + part.offset_mps2
    felt += part.noise_mps2 * make_generator(seed, f"spin/{name}/noise").standard_normal(len(felt))
    spoilt, glitches = _draw_glitches(part, motion.t_s, seed, f"spin/{name}")
    felt += glitches
    limit = sensor.range_g * STANDARD_GRAVITY_MPS2
    if sensor.bits is not None:
        unit = 2 * limit / 2**sensor.bits
        felt = np.round(felt / unit) * unit
    drawn = {what: float(value) for what, value in error.items()} | {"glitches": spoilt}
    return np.clip(felt, -limit, limit), drawn


def _shake_motor(part: SpinAccel, motion: _Motion, seed: int, name: str) -> Floats:
    """Return the vibration of the motor (N,), with a random phase."""
    phases = make_generator(seed, f"spin/{name}/vibration").uniform(0, 2 * np.pi, 2)
    once, twice = np.sqrt(2) * part.vibration_1x_mps2, np.sqrt(2) * part.vibration_2x_mps2
    return np.asarray(once * np.sin(motion.angle_rad + phases[0]) + twice * np.sin(2 * motion.angle_rad + phases[1]))


def _draw_glitches(part: SpinAccel, t_s: Floats, seed: int, name: str) -> tuple[int, Floats]:
    """Return the number of glitches, and the size of each sample's glitch (N,) in m/s^2.

    One at a random instant of each stretch of 1 / rate: no recording of the paper's length is without any.
    """
    spoilt = np.zeros(len(t_s), dtype=np.bool_)
    if part.glitches_per_s > 0:
        stretches = np.arange(np.ceil(part.glitches_per_s * (t_s[-1] - t_s[0])))
        at_s = (
            t_s[0] + (stretches + make_generator(seed, f"{name}/glitches").random(len(stretches))) / part.glitches_per_s
        )
        spoilt[np.searchsorted(t_s, at_s[at_s < t_s[-1]])] = True
    kinds = make_generator(seed, f"{name}/glitch-sizes").random((len(t_s), 2))
    size = part.glitch_low_g + (part.glitch_high_g - part.glitch_low_g) * kinds[:, 0]
    return int(spoilt.sum()), np.asarray(spoilt * np.where(kinds[:, 1] < 0.5, -size, size) * STANDARD_GRAVITY_MPS2)


def _measure_gyros(axes: Floats, motion: _Motion, sensor: SpinSensor, seed: int) -> tuple[Floats, list[float]]:
    """Return samples (N, m) of the gyros at the instants of the stamps, and their biases."""
    bias = np.deg2rad(sensor.gyro_bias_degps) * make_generator(seed, "spin/gyro/bias").standard_normal(len(axes))
    noise = make_generator(seed, "spin/gyro/noise").standard_normal((len(motion.t_s), len(axes)))
    return motion.rate_radps @ axes.T + bias + np.deg2rad(sensor.gyro_noise_degps) * noise, bias.tolist()


def _measure_encoder(path: SpinPath, model: EncoderModel, t_ns: Times) -> Encoder:
    """Return the counted angle, and the rate between the last edges of this sample and the one before, by the timer.

    The first rate is that of the second sample.
    """
    at_s = t_ns / 1e9 - model.latency_s
    angle, rate = path.angle_rad(at_s), path.rate_radps(at_s)
    if model.counts_per_turn is None:
        return Encoder(t_ns, angle, rate)
    count = 2 * np.pi / model.counts_per_turn
    counted = np.floor(angle / count) * count
    edge_s = at_s - (angle - counted) / rate
    if model.timer_s > 0:
        edge_s = np.round(edge_s / model.timer_s) * model.timer_s
    timed = np.diff(counted) / np.diff(edge_s)
    return Encoder(t_ns, counted, np.concatenate([timed[:1], timed]))
