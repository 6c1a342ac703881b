"""Turn a true motion into a recording, with its scene, the command that makes it again, and the drawn errors."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Any

from stillpoint.datasets.earth import Place, compute_magnetic_field_n_ut, normal_gravity_mps2
from stillpoint.datasets.recording import Info, Recording
from stillpoint.datasets.simulate.measure import World, draw_sample_times, measure_imu, measure_mag, sample_truth
from stillpoint.datasets.simulate.path import Motion
from stillpoint.datasets.simulate.sensor import Sensor


@dataclass(frozen=True)
class Scene:
    """The place and date of a motion."""

    place: Place  # latitude and longitude in deg, altitude in m
    date: str  # ISO 8601 with its offset to UTC

    @property
    def start_ns(self) -> int:
        """Return the Unix time of the start of the motion."""
        return int(datetime.fromisoformat(self.date).timestamp()) * 10**9

    @property
    def world(self) -> World:
        """Return gravity and magnetic field at the scene."""
        gravity_mps2 = normal_gravity_mps2(self.place[0], self.place[2])
        return World(self.start_ns, gravity_mps2, compute_magnetic_field_n_ut(self.place, self.date))


@dataclass(frozen=True)
class Order:
    """The arguments of a simulation."""

    kind: str
    seed: int
    minutes: float
    rate_hz: float

    @property
    def command(self) -> str:
        """Return the command that makes the same recording."""
        words = f"--seed {self.seed} --minutes {self.minutes:g} --rate {self.rate_hz:g}"
        return f"stillpoint simulate {self.kind} {words}"


def record_path(
    path: Motion,
    sensor: Sensor,
    scene: Scene,
    order: Order,
    facts: Mapping[str, Any],
    drawn: Mapping[str, Any] | None = None,
) -> Recording:
    """Return the recording of a path by a sensor with an IMU and a magnetometer, with its truth.

    ``facts`` go into ``info.extra``, as JSON unless they are text; ``drawn`` beside what is drawn here.
    """
    world, seed = scene.world, order.seed
    imu_at = draw_sample_times(path, sensor.imu_clock, order.rate_hz, world, seed, "imu")
    mag_at = draw_sample_times(path, sensor.mag_clock, min(order.rate_hz, sensor.mag.max_rate_hz), world, seed, "mag")
    imu, imu_drawn = measure_imu(path, sensor.gyro, sensor.accel, imu_at, world, seed)
    mag, mag_drawn = measure_mag(path, sensor.mag, mag_at, world, seed)
    measured = imu_drawn | mag_drawn
    extra = {"sensor_model": asdict(sensor), "sensor_drawn": measured | dict(drawn or {}), **facts}
    info = Info(
        source=order.command,
        licence="CC0-1.0",
        sensor=f"simulated: {sensor.name}",
        epoch="unix",
        date=scene.date,
        place_lat_lon_alt=scene.place,
        notes=tuple(
            f"{name}: {found['samples_at_range']} samples at the range of the sensor"
            for name, found in measured.items()
            if found["samples_at_range"]
        ),
        extra={name: fact if isinstance(fact, str) else json.dumps(fact) for name, fact in extra.items()},
    )
    return Recording(f"{order.kind}-seed{seed}", imu=imu, mag=mag, truth=sample_truth(path, imu_at, world), info=info)
