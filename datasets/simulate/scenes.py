"""Scenes that test a streaming estimator: one disturbance each, in the hand, and the same motion without any.

The motion is that of a hand that carries a calibrated phone about. ``hand-magnet`` passes magnets, ``hand-vibration``
has bursts of vibration, which also shift the mean of MEMS sensors, ``hand-bias-steps`` has a gyro whose bias steps (a
shock of temperature, a relaxing package), ``hand-translation`` is moved over metres with up to 1 g.
"""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.errors import BadRecording
from stillpoint.datasets.frames import rotation, slerp
from stillpoint.datasets.recording import Floats, Imu, Mag, Recording
from stillpoint.datasets.simulate.generators import make_generator
from stillpoint.datasets.simulate.measure import draw_gauss_markov
from stillpoint.datasets.simulate.phone import Hand, simulate_experiment
from stillpoint.datasets.simulate.sensor import PHONE, Sensor

CARRIED = Hand(
    initial_rest_s=10.0,
    turn_deg=(50.0, 40.0, 120.0),
    peak_rate_degps=(20.0, 200.0),
    reach_m=(0.3, 0.3, 0.2),
    peak_accel_mps2=(0.2, 2.0),
    jolt_m=(0.005, 0.005, 0.005),
    jolt_accel_mps2=(0.2, 2.0),
)
# Over metres, as on an arm of a crane or in a game: 3 s of the same acceleration, which looks like tilt.
FLUNG = replace(CARRIED, reach_m=(4.0, 4.0, 1.0), peak_accel_mps2=(3.0, 10.0))
# What a calibration leaves: an error of the heading of 0.3 deg, where that of the preset "phone" is 2 deg.
CALIBRATED = replace(
    PHONE,
    name="calibrated",
    mag=replace(PHONE.mag, hard_iron_ut=0.2, soft_iron=0.002, misalignment_deg=0.1, passings_per_min=0.0),
)


@dataclass(frozen=True)
class Magnets:
    """Magnets that the hand passes: bell curves in time with a peak of any direction."""

    passings_per_min: float = 4.0
    peak_ut: float = 30.0  # sd of each component
    width_s: float = 1.5  # sd of the bell curve


@dataclass(frozen=True)
class Vibration:
    """Bursts of vibration: white noise, and a shift of the mean that is drawn anew for each burst."""

    pause_s: tuple[float, float] = (10.0, 20.0)
    burst_s: tuple[float, float] = (2.0, 6.0)
    gyro_degps: float = 30.0  # sd of the noise
    gyro_shift_degps: float = 1.0  # sd
    accel_mps2: float = 8.0
    accel_shift_mps2: float = 0.3


@dataclass(frozen=True)
class BiasSteps:
    """Steps of the gyro's bias."""

    pause_s: tuple[float, float] = (20.0, 60.0)
    step_degps: float = 0.5  # sd, each axis


Disturbance = Magnets | Vibration | BiasSteps | None


def simulate_scene(
    kind: str, hand: Hand, disturbance: Disturbance, sensor: Sensor, seed: int, minutes: float, rate_hz: float
) -> Recording:
    """Simulate one scene. Raises :class:`BadParameter` when ``minutes`` leave no room for a swing."""
    if isinstance(disturbance, Magnets):
        d = disturbance
        mag = replace(sensor.mag, passings_per_min=d.passings_per_min, passing_ut=d.peak_ut, passing_s=d.width_s)
        sensor = replace(sensor, mag=mag)
    recording = simulate_experiment(kind, hand, sensor, seed, minutes, rate_hz)
    if isinstance(disturbance, Vibration):
        recording = _shake(recording, disturbance, make_generator(seed, f"{kind}/vibration"))
    if isinstance(disturbance, BiasSteps):
        recording = _step_bias(recording, disturbance, make_generator(seed, f"{kind}/bias-steps"))
    facts = {} if disturbance is None else {"disturbance": json.dumps(asdict(disturbance))}
    return replace(recording, info=replace(recording.info, extra={**recording.info.extra, **facts}))


def let_field_wander(recording: Recording, sd_ut: float, time_s: float, seed: int) -> Recording:
    """Return the recording in a place full of iron: with errors of the field in n that wander.

    They are a Gauss-Markov process with the standard deviation ``sd_ut`` per axis and the correlation time ``time_s``,
    turned into the body by the truth. Raises :class:`BadRecording` without magnetometer or truth.
    """
    mag, truth = recording.mag, recording.truth
    if mag is None or truth is None:
        missing = "magnetometer" if mag is None else "independent truth"
        raise BadRecording(f"{recording.name}: has no {missing}; choose a recording with one")
    step_s = float(np.median(np.diff(mag.t_ns))) / 1e9
    wander = draw_gauss_markov(sd_ut, time_s, step_s, len(mag.t_ns), seed, f"field {sd_ut:g} {time_s:g}")
    q_nb = rotation(slerp(truth.t_ns, truth.q_nb, np.clip(mag.t_ns, truth.t_ns[0], truth.t_ns[-1])))
    return replace(recording, mag=Mag(mag.t_ns, mag.mag_b_ut + q_nb.inv().apply(wander)))


def _shake(recording: Recording, vibration: Vibration, rng: np.random.Generator) -> Recording:
    """Return the recording with bursts of vibration, during which gyro and accelerometer also shift."""
    imu = recording.require_imu()
    t_s = (imu.t_ns - imu.t_ns[0]) / 1e9
    shares = _draw_intervals(t_s, vibration.pause_s, lambda: rng.uniform(*vibration.burst_s), rng)

    def disturb(values: Floats, noise: float, shift: float) -> Floats:
        """Return values (N, 3) with noise and a shift of the mean within each burst, by their standard deviations."""
        shifts = np.vstack([np.zeros(3), rng.normal(0, shift, (shares.max(), 3))])[shares]
        return np.asarray(values + shifts + (shares > 0)[:, None] * rng.normal(0, noise, values.shape))

    gyro = disturb(imu.gyro_b_radps, np.deg2rad(vibration.gyro_degps), np.deg2rad(vibration.gyro_shift_degps))
    accel = disturb(imu.accel_b_mps2, vibration.accel_mps2, vibration.accel_shift_mps2)
    return replace(recording, imu=Imu(imu.t_ns, gyro, accel))


def _step_bias(recording: Recording, steps: BiasSteps, rng: np.random.Generator) -> Recording:
    """Return the recording with steps of the gyro's bias at random times."""
    imu = recording.require_imu()
    t_s = (imu.t_ns - imu.t_ns[0]) / 1e9
    bias = np.zeros_like(imu.gyro_b_radps)
    at_s = rng.uniform(*steps.pause_s)
    while at_s < t_s[-1]:
        bias[t_s >= at_s] += rng.normal(0, np.deg2rad(steps.step_degps), 3)
        at_s += rng.uniform(*steps.pause_s)
    return replace(recording, imu=Imu(imu.t_ns, imu.gyro_b_radps + bias, imu.accel_b_mps2))


def _draw_intervals(
    t_s: Floats, pause_s: tuple[float, float], length_s: Callable[[], float], rng: np.random.Generator
) -> NDArray[np.int64]:
    """Return for each time the number of the interval that it lies in, from 1 on, and 0 between them."""
    number, at_s, count = np.zeros(len(t_s), dtype=np.int64), rng.uniform(*pause_s), 0
    while at_s < t_s[-1]:
        end_s, count = at_s + length_s(), count + 1
        number[(t_s >= at_s) & (t_s < end_s)] = count
        at_s = end_s + rng.uniform(*pause_s)
    return number
