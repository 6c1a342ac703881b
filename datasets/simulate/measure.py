"""Simulate what sensors record of a path: ideal samples, then each sensor's errors from its own random numbers."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import lfilter

from stillpoint.datasets.constants import STANDARD_GRAVITY_MPS2
from stillpoint.datasets.frames import quaternion
from stillpoint.datasets.recording import Floats, Imu, Mag, Times, Truth
from stillpoint.datasets.simulate.generators import make_generator
from stillpoint.datasets.simulate.path import Motion
from stillpoint.datasets.simulate.sensor import AccelModel, ClockModel, GyroModel, MagModel

ALLAN_TOP = 0.6178  # largest Allan deviation of a first-order Gauss-Markov process of unit sd (at 1.89 times its time)


@dataclass(frozen=True)
class World:
    """The gravity and field that are the same everywhere along a path."""

    start_ns: int  # of the path's time 0
    gravity_mps2: float
    field_n_ut: Floats  # (3,)


@dataclass(frozen=True, eq=False)
class Samples:
    """The true sampling instants of one sensor, from the start of the path, and the stamps that it gave them."""

    true_ns: Times  # (N,)
    stamp_ns: Times  # (N,)
    step_ns: int

    @property
    def t_s(self) -> Floats:
        """Return the true instants (N,) in s."""
        return self.true_ns / 1e9

    @property
    def step_s(self) -> float:
        """Return the step between samples in s."""
        return self.step_ns / 1e9


@dataclass(frozen=True)
class Axes:
    """The errors that gyro, accelerometer and magnetometer have in common, in SI units (uT for the magnetometer)."""

    noise_density: float  # per sqrt(Hz)
    bias: float  # sd
    scale_error: float
    misalignment_rad: float
    limit: float | None
    bits: int | None
    instability: float = 0.0
    instability_time_s: float = 1.0
    warming: float = 0.0  # sd
    warming_s: float = 1.0


def draw_sample_times(path: Motion, clock: ClockModel, rate_hz: float, world: World, seed: int, name: str) -> Samples:
    """Return the sampling instants from one step after the start of the path to its end."""
    true_rate_hz = rate_hz * (1 + clock.rate_error * make_generator(seed, f"{name}/rate").standard_normal())
    step_ns = round(1e9 / true_rate_hz)
    first_ns = step_ns + int(step_ns * make_generator(seed, f"{name}/phase").random())
    count = int((path.duration_s * 1e9 - first_ns) / step_ns) + 1
    true_ns = first_ns + step_ns * np.arange(count, dtype=np.int64)
    step_s = step_ns / 1e9
    # Stamps keep their order however bad the jitter.
    jitter_s = make_generator(seed, f"{name}/jitter").standard_normal(count) * clock.jitter_s
    jitter_s = np.clip(jitter_s, -0.45 * step_s, 0.45 * step_s)
    late_ns = np.round(jitter_s * 1e9 + true_ns * clock.skew_ppm * 1e-6).astype(np.int64)
    return Samples(true_ns, world.start_ns + true_ns + late_ns, step_ns)


def measure_imu(
    path: Motion, gyro: GyroModel, accel: AccelModel, at: Samples, world: World, seed: int
) -> tuple[Imu, dict[str, Any]]:
    """Return gyro and accelerometer samples, and the errors drawn for this unit. The IMU sits at the origin of the
    body.
    """
    instants = np.concatenate([[at.true_ns[0] - at.step_ns], at.true_ns]) / 1e9 - gyro.lag_s
    rate = path.steps_b_rad(instants) / at.step_s
    response = make_generator(seed, "gyro/g-sensitivity").standard_normal((3, 3)) * np.deg2rad(
        gyro.g_sensitivity_degps_g
    )
    rate += _compute_specific_force_b(path, instants[1:], world) / STANDARD_GRAVITY_MPS2 @ response.T
    force = _compute_specific_force_b(path, at.t_s - accel.lag_s, world)
    gyro_axes = Axes(
        noise_density=np.deg2rad(gyro.noise_density_degps_rthz),
        bias=np.deg2rad(gyro.turn_on_bias_degps),
        scale_error=gyro.scale_error,
        misalignment_rad=np.deg2rad(gyro.misalignment_deg),
        limit=None if gyro.range_degps is None else np.deg2rad(gyro.range_degps),
        bits=gyro.bits,
        instability=np.deg2rad(gyro.bias_instability_degph) / 3600,
        instability_time_s=gyro.bias_time_s,
        warming=np.deg2rad(gyro.warming_degps),
        warming_s=gyro.warming_s,
    )
    accel_axes = Axes(
        noise_density=accel.noise_density_ug_rthz * 1e-6 * STANDARD_GRAVITY_MPS2,
        bias=accel.turn_on_bias_mg * 1e-3 * STANDARD_GRAVITY_MPS2,
        scale_error=accel.scale_error,
        misalignment_rad=np.deg2rad(accel.misalignment_deg),
        limit=None if accel.range_g is None else accel.range_g * STANDARD_GRAVITY_MPS2,
        bits=accel.bits,
        instability=accel.bias_instability_ug * 1e-6 * STANDARD_GRAVITY_MPS2,
        instability_time_s=accel.bias_time_s,
        warming=accel.warming_mg * 1e-3 * STANDARD_GRAVITY_MPS2,
        warming_s=accel.warming_s,
    )
    gyro_b, gyro_drawn = add_sensor_errors(rate, gyro_axes, at.step_s, seed, "gyro")
    accel_b, accel_drawn = add_sensor_errors(force, accel_axes, at.step_s, seed, "accel")
    gyro_drawn |= {"g_sensitivity": (response / STANDARD_GRAVITY_MPS2).tolist()}
    return Imu(at.stamp_ns, gyro_b, accel_b), {"gyro": gyro_drawn, "accel": accel_drawn}


def _compute_specific_force_b(path: Motion, t_s: Floats, world: World) -> Floats:
    """Return the specific force (N, 3) in m/s^2 at the origin of the body."""
    force_n = path.acceleration_n_mps2(t_s) + np.array([0.0, 0.0, world.gravity_mps2])
    return np.asarray(path.attitude(t_s).inv().apply(force_n))


def measure_mag(path: Motion, mag: MagModel, at: Samples, world: World, seed: int) -> tuple[Mag, dict[str, Any]]:
    """Return magnetometer samples, and the errors drawn for this unit."""
    t = at.t_s - mag.lag_s
    field_b = path.attitude(t).inv().apply(world.field_n_ut + draw_field_disturbances_n_ut(path, mag, t, seed))
    elements = make_generator(seed, "mag/soft-iron").standard_normal((3, 3)) * mag.soft_iron
    soft = np.triu(elements) + np.triu(elements, 1).T
    axes = Axes(
        noise_density=mag.noise_density_ut_rthz,
        bias=mag.hard_iron_ut,
        scale_error=0.0,
        misalignment_rad=np.deg2rad(mag.misalignment_deg),
        limit=mag.range_ut,
        bits=mag.bits,
    )
    mag_b, drawn = add_sensor_errors(field_b + field_b @ soft.T, axes, at.step_s, seed, "mag")
    return Mag(at.stamp_ns, mag_b), {"mag": drawn | {"soft_iron": soft.tolist()}}


def draw_field_disturbances_n_ut(path: Motion, mag: MagModel, t_s: Floats, seed: int) -> Floats:
    """Return disturbances of the field in n (N, 3): bell curves in time, as the phone passes magnetic objects in
    motion.
    """
    disturbance = np.zeros((len(t_s), 3))
    for swing, (start, end) in enumerate(zip(path.rests_s[:-1, 1], path.rests_s[1:, 0], strict=True)):
        rng = make_generator(seed, f"mag/passings/{swing}")
        for _ in range(rng.poisson(mag.passings_per_min * (end - start) / 60)):
            peak_n, when = rng.standard_normal(3) * mag.passing_ut, rng.uniform(start, end)
            near = slice(*np.searchsorted(t_s, [when - 6 * mag.passing_s, when + 6 * mag.passing_s]))
            bell = np.exp(-0.5 * ((t_s[near] - when) / mag.passing_s) ** 2)
            disturbance[near] += bell[:, None] * peak_n
    return disturbance


def add_sensor_errors(ideal: Floats, axes: Axes, step_s: float, seed: int, name: str) -> tuple[Floats, dict[str, Any]]:
    """Add scale, misalignment, bias, noise, bias instability, warming, range and quantisation, in this order.

    ``ideal`` are the samples (N, 3) of a perfect sensor. Returns what is recorded and the drawn constants in SI units,
    with the number of samples at the limit of the range.
    """
    scale = make_generator(seed, f"{name}/scale").standard_normal(3) * axes.scale_error
    misalignment = make_generator(seed, f"{name}/misalignment").standard_normal((3, 3)) * axes.misalignment_rad
    response = np.eye(3) + np.diag(scale) + misalignment - np.diag(np.diag(misalignment))
    bias = make_generator(seed, f"{name}/bias").standard_normal(3) * axes.bias
    out = ideal @ response.T + bias
    out += make_generator(seed, f"{name}/noise").standard_normal(out.shape) * (axes.noise_density / np.sqrt(step_s))
    if axes.instability > 0:
        out += draw_gauss_markov(axes.instability / ALLAN_TOP, axes.instability_time_s, step_s, len(out), seed, name)
    drawn = {"bias": bias.tolist(), "response": response.tolist()}
    if axes.warming > 0:
        warming = make_generator(seed, f"{name}/warming").standard_normal(3) * axes.warming
        out -= np.expm1(-step_s / axes.warming_s * np.arange(len(out)))[:, None] * warming
        drawn["warming"] = warming.tolist()
    clipped = 0
    if axes.limit is not None:
        clipped = int((np.abs(out) > axes.limit).any(axis=1).sum())
        out = np.clip(out, -axes.limit, axes.limit)
        if axes.bits is not None:
            unit = 2 * axes.limit / 2**axes.bits
            out = np.round(out / unit) * unit
    return out, drawn | {"samples_at_range": clipped}


def draw_gauss_markov(sd: float, time_s: float, step_s: float, count: int, seed: int, name: str) -> Floats:
    """Draw a first-order Gauss-Markov process (count, 3) that is stationary from its first sample."""
    rng = make_generator(seed, f"{name}/wandering")
    keep = np.exp(-step_s / time_s)
    first = rng.standard_normal(3) * sd
    kicks = rng.standard_normal((count, 3)) * (sd * np.sqrt(1 - keep**2))
    kicks[0] = first
    return np.asarray(lfilter([1.0], [1.0, -keep], kicks, axis=0))


def sample_truth(path: Motion, at: Samples, world: World) -> Truth:
    """Return the truth at the true instants of a sensor's samples."""
    return Truth(
        world.start_ns + at.true_ns, quaternion(path.attitude(at.t_s)), path.moving(at.t_s), path.position(at.t_s)
    )
