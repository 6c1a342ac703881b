"""A drive through a town: a car that accelerates, brakes, turns and stops, with satellites and a wheel speed.

The body is forward-left-up. Speed, heading, slope and roll are smoothed polygons; attitude and velocity are splines of
degree five through them, as in the mission of the underwater vehicle. The car never slips: its velocity lies along the
body's x axis.
"""

from dataclasses import asdict, dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import make_interp_spline
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from stillpoint.datasets.recording import Floats, Gps, Recording, Series
from stillpoint.datasets.simulate.auv import KNOTS_HZ, MARGIN_S, Phases, Voyage
from stillpoint.datasets.simulate.generators import make_generator
from stillpoint.datasets.simulate.measure import draw_sample_times
from stillpoint.datasets.simulate.record import Order, Scene, record_path
from stillpoint.datasets.simulate.satellites import GpsModel, measure_gps, velocity_n_mps
from stillpoint.datasets.simulate.sensor import AccelModel, ClockModel, GyroModel, MagModel, Sensor

TOWN = Scene((48.14, 11.57, 519.0), "2024-05-14T09:00:00+00:00")

_LEG_S = (18.0, 35.0)  # between two stops
_STOP_S = 12.0
_SPEED_MPS = (8.0, 20.0)
_ACCELERATING_S = (6.0, 9.0)  # from standstill to speed
_TURNING_MPS2 = 2.0  # largest acceleration to the side
_SLOPE_DEG, _ROLL_DEG = 2.0, 1.0
_SMOOTH_S = 0.7
_GPS_HZ, _WHEEL_HZ = 1.0, 20.0
_FLU_FROM_FRD = Rotation.from_euler("x", 180, degrees=True)


@dataclass(frozen=True)
class Receiver:
    """Where the antenna is, how late its fixes are, and where it receives nothing."""

    antenna_x_m: float = 0.0  # from the IMU, body axes
    antenna_y_m: float = 0.0
    antenna_z_m: float = 0.0
    late_s: float = 0.0  # stamps after the instant of the fix
    tunnel_start_s: float = 0.0
    tunnel_s: float = 0.0


@dataclass(frozen=True)
class WheelModel:
    """Speed of the wheels."""

    scale_error: float = 0.0  # sd, fraction
    noise_mps: float = 0.0  # white, each sample


@dataclass(frozen=True)
class CarSensor(Sensor):
    """The sensors of a car."""

    gps: GpsModel = field(default_factory=GpsModel)
    receiver: Receiver = field(default_factory=Receiver)
    wheel: WheelModel = field(default_factory=WheelModel)


# A MEMS IMU on the dashboard: the noise densities are mostly the road's.
CAR = CarSensor(
    "car",
    gyro=GyroModel(noise_density_degps_rthz=0.05, turn_on_bias_degps=0.3, scale_error=0.003, misalignment_deg=0.2),
    accel=AccelModel(noise_density_ug_rthz=2000.0, turn_on_bias_mg=3.0, scale_error=0.003),
    mag=MagModel(noise_density_ut_rthz=0.1, hard_iron_ut=5.0, soft_iron=0.02),
    imu_clock=ClockModel(jitter_s=1e-4),
    mag_clock=ClockModel(jitter_s=1e-3),
    gps=GpsModel(position_sd_m=1.5, velocity_sd_mps=0.1),
    wheel=WheelModel(scale_error=0.005, noise_mps=0.05),
)
CAR_SENSORS: dict[str, CarSensor] = {"car": CAR, "perfect": CarSensor("perfect")}


@dataclass(frozen=True, eq=False)
class Drive(Voyage):
    """The true motion of the car; with ``antenna_b_m`` the positions are those of the antenna."""

    antenna_b_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def attitude(self, t_s: ArrayLike) -> Rotation:
        """Return the attitude, body (forward-left-up) to n, at times (N,)."""
        return super().attitude(t_s) * _FLU_FROM_FRD

    def position(self, t_s: ArrayLike) -> Floats:
        """Return the position in n (N, 3) in m, from where the IMU is when the drive begins."""
        place = super().position(t_s)
        return place + self.attitude(t_s).apply(self.antenna_b_m) if any(self.antenna_b_m) else place


def simulate_drive(kind: str, sensor: CarSensor, seed: int, minutes: float, rate_hz: float) -> Recording:
    """Simulate one drive."""
    path = _plan_drive(minutes * 60, seed)
    facts = {"body_axes": "forward, left, up", "receiver": asdict(sensor.receiver)}
    recording = record_path(path, sensor, TOWN, Order(kind, seed, minutes, rate_hz), facts)
    return replace(
        recording, gps=_measure_fixes(path, sensor, seed), extra={"wheel": _measure_wheel(path, sensor.wheel, seed)}
    )


def _plan_drive(total_s: float, seed: int) -> Drive:
    """Return the path of one drive: legs between stops, on each a speed and turns to either side."""
    t_s = np.arange(-MARGIN_S, total_s + MARGIN_S, 1 / KNOTS_HZ)
    draw = make_generator(seed, "car/path")
    at_s, speed = [-MARGIN_S, _STOP_S], [0.0, 0.0]
    while at_s[-1] < total_s:
        leg_s, up_s = draw.uniform(*_LEG_S), draw.uniform(*_ACCELERATING_S)
        fast = draw.uniform(*_SPEED_MPS)
        start_s = at_s[-1]
        at_s += [start_s + up_s, start_s + leg_s, start_s + leg_s + up_s, start_s + leg_s + up_s + _STOP_S]
        speed += [fast, fast, 0.0, 0.0]
    smooth = _SMOOTH_S * KNOTS_HZ
    speed_mps = gaussian_filter1d(np.interp(t_s, at_s, speed), smooth)
    corner_s = np.arange(-MARGIN_S, total_s + 8.0, 4.0)
    wanted = np.interp(t_s, corner_s, draw.uniform(-1, 1, len(corner_s)))
    turn_radps = gaussian_filter1d(wanted * _TURNING_MPS2 / np.maximum(speed_mps, 4.0) * (speed_mps > 1.0), smooth)
    heading = draw.uniform(0, 2 * np.pi) + np.cumsum(turn_radps) / KNOTS_HZ
    hills_s = np.arange(-MARGIN_S, total_s + 40.0, 20.0)
    slopes = np.stack([draw.uniform(-1, 1, len(hills_s)) for _ in range(2)])
    pitch, roll = (
        np.deg2rad(size) * gaussian_filter1d(np.interp(t_s, hills_s, slope), 3 * smooth)
        for size, slope in zip((_SLOPE_DEG, _ROLL_DEG), slopes, strict=True)
    )
    forward = np.column_stack([np.sin(heading) * np.cos(pitch), np.cos(heading) * np.cos(pitch), np.sin(pitch)])
    euler = make_interp_spline(t_s, np.column_stack([roll, pitch, heading]), k=5)
    velocity = make_interp_spline(t_s, speed_mps[:, None] * forward, k=5)
    return Drive(euler, velocity, Phases(0.0, 0.0, 0.0, 0.0, total_s))


def _measure_fixes(path: Drive, sensor: CarSensor, seed: int) -> Gps:
    """Return the fixes of the receiver: late by its latency, and none in the tunnel."""
    receiver = sensor.receiver
    antenna = replace(path, antenna_b_m=(receiver.antenna_x_m, receiver.antenna_y_m, receiver.antenna_z_m))
    at = draw_sample_times(path, ClockModel(), _GPS_HZ, TOWN.world, seed, "gps")
    covered = (at.t_s >= receiver.tunnel_start_s) & (at.t_s < receiver.tunnel_start_s + receiver.tunnel_s)
    open_sky = replace(sensor.gps, covered_below_m=np.inf)
    seen = measure_gps(antenna, open_sky, at, TOWN.place, seed)
    names = ("lat_deg", "lon_deg", "alt_m", "course_rad", "speed_mps")
    hidden = {name: np.where(covered, np.nan, getattr(seen, name)) for name in names}
    return replace(seen, t_ns=seen.t_ns + round(receiver.late_s * 1e9), valid=seen.valid & ~covered, **hidden)


def _measure_wheel(path: Drive, wheel: WheelModel, seed: int) -> Series:
    """Return the speed that the wheels give, with an error of scale and noise."""
    at = draw_sample_times(path, ClockModel(), _WHEEL_HZ, TOWN.world, seed, "wheel")
    draw = make_generator(seed, "wheel/errors")
    scale = 1 + wheel.scale_error * draw.standard_normal()
    speed = np.linalg.norm(velocity_n_mps(path, at.t_s), axis=1)
    noisy = scale * speed + wheel.noise_mps * draw.standard_normal(len(speed)) * (speed > 0.1)
    return Series(at.stamp_ns, noisy, ("speed_mps",))
