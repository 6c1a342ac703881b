"""``spin-constant``, ``spin-variable`` and ``spin-flight``: what paper 000's bench and projectile would record."""

import json
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from stillpoint.datasets.recording import Encoder, Floats, Info, Recording, Spin, SpinGeometry, Times
from stillpoint.datasets.simulate.draws import draws
from stillpoint.datasets.simulate.spin_path import (
    Flight,
    Motor,
    SpinPath,
    braking_b_mps2,
    coning_radps,
    constant,
    decaying,
    turn,
    variable,
)
from stillpoint.datasets.simulate.spin_sensor import G_MPS2, EncoderModel, SpinAccel, SpinSensor
from stillpoint.datasets.spin import BENCH, FIVE_ACCELEROMETERS, saturated, specific_force


@dataclass(frozen=True)
class Scenario:
    """What spins, and what sits on it."""

    motor: Motor
    geometry: SpinGeometry
    flight: Flight | None = None  # None: on a motor's shaft


CONSTANT = Scenario(Motor(constant, ripple_degps=5.0), BENCH)
VARIABLE = Scenario(Motor(variable, ripple_degps=1.5), BENCH)
FLIGHT = Scenario(Motor(decaying, ripple_degps=0.0, once_per_turn_degps=0.0), FIVE_ACCELEROMETERS, Flight())


def spinning(kind: str, scenario: Scenario, sensor: SpinSensor, seed: int, minutes: float, rate_hz: float) -> Recording:
    """Simulate one trial. The geometry of the recording is the stated one; the true arms are in ``info.extra``."""
    path = turn(scenario.motor, minutes * 60, seed)
    step_ns = round(1e9 / rate_hz)
    t_ns = np.arange(max(int(round(minutes * 60e9) // step_ns), 2), dtype=np.int64) * step_ns
    geometry = replace(scenario.geometry, accel_range_mps2=np.full(_count(scenario.geometry), sensor.range_g * G_MPS2))
    accel, drawn = _accelerometers(scenario, geometry, path, sensor, t_ns / 1e9, seed)
    gyro, gyro_drawn = _gyros(scenario, path, sensor, t_ns / 1e9, seed)
    came = draws(seed, "spin/lost").random(len(t_ns)) >= sensor.lost_share
    came[0] = True
    spin = Spin(t_ns[came], accel[came], gyro[came], geometry)
    full = saturated(spin).sum(axis=0)
    notes = [f"accelerometer {k + 1}: {n} samples at its range" for k, n in enumerate(full) if n]
    if not came.all():
        notes.append(f"{int((~came).sum())} samples lost on the way")
    return Recording(
        f"{kind}-{sensor.name}-seed{seed}",
        spin=spin,
        encoder=None if sensor.encoder is None or scenario.flight else _encoder(path, sensor.encoder, t_ns),
        roll_truth=Encoder(t_ns, path.angle_rad(t_ns / 1e9), path.rate_radps(t_ns / 1e9)),
        info=Info(
            source=f"stillpoint simulate {kind} --sensor {sensor.name} --seed {seed} --minutes {minutes:g} "
            f"--rate {rate_hz:g}",
            licence="CC0-1.0",
            sensor=f"simulated: ADXL345, {sensor.name}",
            notes=tuple(notes),
            extra={
                "sensor_model": json.dumps(asdict(sensor)),
                "sensor_drawn": json.dumps(drawn | gyro_drawn),
                "motion": json.dumps(_motion(scenario)),
            },
        ),
    )


def _count(geometry: SpinGeometry) -> int:
    return len(geometry.accel_r_b_m)


def _motion(scenario: Scenario) -> dict[str, Any]:
    motor = asdict(scenario.motor) | {"speed_degps": scenario.motor.speed_degps.__name__}
    return {"motor": motor, "flight": None if scenario.flight is None else asdict(scenario.flight)}


def _parts(geometry: SpinGeometry, sensor: SpinSensor) -> list[SpinAccel]:
    """The model of each accelerometer of the two presets: the last two are F4 and F5."""
    return [sensor.centre] * (_count(geometry) - 2) + [sensor.radial, sensor.tangential]


def _accelerometers(
    scenario: Scenario, geometry: SpinGeometry, path: SpinPath, sensor: SpinSensor, t_s: Floats, seed: int
) -> tuple[Floats, dict[str, Any]]:
    """Samples (N, k) with all their errors, and what was drawn."""
    rate, accel, centre = np.zeros((len(t_s), 3)), np.zeros((len(t_s), 3)), _gravity_b_mps2(path, sensor, t_s)
    rate[:, 0], accel[:, 0] = path.rate_radps(t_s), path.accel_radps2(t_s)
    if scenario.flight is not None:
        rate[:, 1:], accel[:, 1:] = coning_radps(scenario.flight, path, t_s)
        centre = braking_b_mps2(scenario.flight, path, t_s)
    columns, drawn = [], []
    limit = sensor.range_g * G_MPS2
    for k, part in enumerate(_parts(geometry, sensor)):
        name = f"spin/F{k + 1}" if _count(geometry) == 5 else f"spin/F{k + 4}"
        error = {
            what: draws(seed, f"{name}/{what}").standard_normal() * size
            for what, size in (
                ("arm", part.arm_error),
                ("scale", part.scale_error),
                ("bias", part.bias_mg * G_MPS2 / 1e3),
            )
        }
        arm = geometry.accel_r_b_m[k] * (1 + error["arm"])
        ideal = specific_force(arm, centre, rate, accel) @ geometry.accel_axis_b[k]
        felt = (ideal + _shaking(part, path, t_s, seed, name)) * (1 + error["scale"]) + error["bias"] + part.offset_mps2
        felt += part.noise_mps2 * draws(seed, f"{name}/noise").standard_normal(len(t_s))
        spoilt, glitches = _glitches(part, t_s, seed, name)
        felt += glitches
        if sensor.bits is not None:
            unit = 2 * limit / 2**sensor.bits
            felt = np.round(felt / unit) * unit
        columns.append(np.clip(felt, -limit, limit))
        drawn.append({name: float(value) for name, value in error.items()} | {"glitches": spoilt})
    return np.column_stack(columns), {"accelerometers": drawn}


def _gravity_b_mps2(path: SpinPath, sensor: SpinSensor, t_s: Floats) -> Floats:
    """What holds a tilted shaft against gravity, in b (N, 3); at angle 0 the body's z axis points up most."""
    tilt, angle = np.deg2rad(sensor.tilt_deg), path.angle_rad(t_s)
    up = [np.full(len(t_s), np.cos(tilt)), np.sin(tilt) * np.sin(angle), np.sin(tilt) * np.cos(angle)]
    return np.asarray(G_MPS2 * np.column_stack(up))


def _shaking(part: SpinAccel, path: SpinPath, t_s: Floats, seed: int, name: str) -> Floats:
    phases = draws(seed, f"{name}/vibration").uniform(0, 2 * np.pi, 2)
    sizes = np.sqrt(2) * np.array([part.vibration_1x_mps2, part.vibration_2x_mps2])
    if not sizes.any():
        return np.zeros(len(t_s))
    angle = path.angle_rad(t_s)
    return np.asarray(sizes[0] * np.sin(angle + phases[0]) + sizes[1] * np.sin(2 * angle + phases[1]))


def _glitches(part: SpinAccel, t_s: Floats, seed: int, name: str) -> tuple[int, Floats]:
    """How many samples are spoilt, and by how much each (N,) in m/s^2.

    One at a random instant of each stretch of 1 / rate: no recording of the paper's length is without any.
    """
    spoilt = np.zeros(len(t_s), dtype=np.bool_)
    if part.glitches_per_s > 0:
        stretches = np.arange(np.ceil(part.glitches_per_s * (t_s[-1] - t_s[0])))
        at_s = t_s[0] + (stretches + draws(seed, f"{name}/glitches").random(len(stretches))) / part.glitches_per_s
        spoilt[np.searchsorted(t_s, at_s[at_s < t_s[-1]])] = True
    kinds = draws(seed, f"{name}/glitch-sizes").random((len(t_s), 2))
    size = part.glitch_low_g + (part.glitch_high_g - part.glitch_low_g) * kinds[:, 0]
    return int(spoilt.sum()), np.asarray(spoilt * np.where(kinds[:, 1] < 0.5, -size, size) * G_MPS2)


def _gyros(
    scenario: Scenario, path: SpinPath, sensor: SpinSensor, t_s: Floats, seed: int
) -> tuple[Floats, dict[str, Any]]:
    """Samples (N, m) of the gyros, at the instants of the stamps."""
    axes = scenario.geometry.gyro_axis_b
    if scenario.flight is None or not len(axes):
        return np.zeros((len(t_s), len(axes))), {}
    rate = np.column_stack([path.rate_radps(t_s), coning_radps(scenario.flight, path, t_s)[0]])
    bias = np.deg2rad(sensor.gyro_bias_degps) * draws(seed, "spin/gyro/bias").standard_normal(len(axes))
    noise = draws(seed, "spin/gyro/noise").standard_normal((len(t_s), len(axes)))
    gyro = rate @ axes.T + bias + np.deg2rad(sensor.gyro_noise_degps) * noise
    return gyro, {"gyro_bias_radps": bias.tolist()}


def _encoder(path: SpinPath, model: EncoderModel, t_ns: Times) -> Encoder:
    """Counted angle, and the rate between the last edges of this sample and the one before, by the timer.

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
