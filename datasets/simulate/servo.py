"""Simulate the bench of Byambajav et al.: an MPU6050 and an HMC5883L on a servo platform that swings +-90 deg.

After a minute of rest, swings at a low and at a high rate alternate, with rests between. A swing is harmonic; over its
first and last period its amplitude rises and falls as a minimum-jerk movement does. Angle, rate and acceleration are in
closed form. The board sits beside the axis, so it is accelerated as it turns, and the servo, which is moved on fifty
times a second, shakes it with every step: both make the accelerometer's angle worse at the high rate.
"""

from dataclasses import asdict, dataclass, replace
from itertools import cycle

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BPoly
from scipy.spatial.transform import Rotation

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.frames import from_euler, rotation
from stillpoint.datasets.recording import Floats, Recording
from stillpoint.datasets.simulate.generators import make_generator
from stillpoint.datasets.simulate.path import join_strokes
from stillpoint.datasets.simulate.record import Order, Scene, record_path
from stillpoint.datasets.simulate.sensor import PERFECT, AccelModel, ClockModel, GyroModel, MagModel, Sensor

# Where the paper was written; it has no date.
ULAANBAATAR = Scene((47.92, 106.92, 1350.0), "2014-05-01T04:00:00+00:00")
_HOME_EULER_ENU_DEG = (0.5, -0.3, 20.0)  # nearly level; the axis of the servo is the body's x

# By their data sheets (PS-MPU-6000A rev. 3.4; HMC5883L): a tolerance counts as three standard deviations.
MPU6050 = Sensor(
    "mpu6050",
    gyro=GyroModel(
        noise_density_degps_rthz=0.005,
        bias_instability_degph=20.0,
        turn_on_bias_degps=1.25,  # the sheet allows 20; this drifts by the paper's 50 deg a minute, in the median
        warming_degps=0.15,
        scale_error=0.01,
        misalignment_deg=0.4,
        g_sensitivity_degps_g=0.03,
        range_degps=250.0,
        bits=16,
    ),
    accel=AccelModel(
        noise_density_ug_rthz=400.0,
        bias_instability_ug=100.0,
        turn_on_bias_mg=17.0,
        warming_mg=1.0,
        scale_error=0.01,
        misalignment_deg=0.4,
        range_g=2.0,
        bits=16,
    ),
    mag=MagModel(
        noise_density_ut_rthz=0.023,  # 2 mG in a sample at 75 Hz
        hard_iron_ut=1.0,  # what calibration beside a servo leaves
        soft_iron=0.01,
        misalignment_deg=0.5,
        range_ut=187.9,  # 2048 / 1090 gauss
        bits=12,
        max_rate_hz=75.0,
    ),
    imu_clock=ClockModel(rate_error=1e-4, jitter_s=1e-4),
    mag_clock=ClockModel(rate_error=1e-4, jitter_s=1e-4),
)
SERVO_SENSORS: dict[str, Sensor] = {sensor.name: sensor for sensor in (MPU6050, PERFECT)}


@dataclass(frozen=True)
class Bench:
    """How the platform moves, and where the board sits on it."""

    first_rest_s: float = 60.0
    rest_s: float = 10.0
    swing_deg: float = 90.0
    low_hz: float = 0.1  # 57 deg/s at most
    high_hz: float = 0.4  # 226 deg/s: what a range of 250 has room for
    low_periods: int = 6  # a minute
    high_periods: int = 24
    home_deg: float = 0.1  # sd: how well the servo comes home
    lever_b_m: tuple[float, float, float] = (0.0, 0.03, 0.02)  # of the board from the axis
    step_s: float = 0.02  # of the servo's controller
    shake_m_degps: float = 5e-7  # sd of a step's shake on each axis, per rate

    def swing_s(self, rate_hz: float) -> float:
        """Return the length of the swings at one of the two rates."""
        return (self.low_periods if rate_hz == self.low_hz else self.high_periods) / rate_hz


BENCH = Bench()


@dataclass(frozen=True, eq=False)
class Swings:
    """The true motion: the angle about body x; a :class:`stillpoint.datasets.simulate.path.Motion`."""

    home_q_nb: Floats  # (4,)
    rests_s: Floats  # (R, 2); swing k lies between the rests k and k + 1
    rates_hz: Floats  # (R - 1,) of the swings
    homes_rad: Floats  # (R,) angle in each rest
    amplitude_rad: float
    lever_b_m: Floats  # (3,)
    shake_n_m: BPoly  # (3,)

    @property
    def duration_s(self) -> float:
        """Length of the motion."""
        return float(self.rests_s[-1, 1])

    def angle(self, t_s: ArrayLike) -> tuple[Floats, Floats, Floats]:
        """Return angle (N,), rate and angular acceleration about body x at times (N,)."""
        t = np.clip(np.asarray(t_s, dtype=np.float64), 0.0, self.duration_s)
        rest = np.maximum(np.searchsorted(self.rests_s[:, 0], t, side="right") - 1, 0)
        swing = np.minimum(rest, len(self.rates_hz) - 1)
        start, end = self.rests_s[swing, 1], self.rests_s[swing + 1, 0]
        since = np.where(t > self.rests_s[rest, 1], t - start, 0.0)
        period, w = 1 / self.rates_hz[swing], 2 * np.pi * self.rates_hz[swing]
        size, size_1, size_2 = _evaluate_minimum_jerk(np.minimum(since, end - start - since) / period)
        falls = np.where(since > (end - start) / 2, -1.0, 1.0)
        size_1, size_2 = falls * size_1 / period, size_2 / period**2
        sine, cosine = np.sin(w * since), np.cos(w * since)
        moved, moved_1, moved_2 = _evaluate_minimum_jerk(since / (end - start))
        way = np.where(since > 0, self.homes_rad[swing + 1] - self.homes_rad[swing], 0.0)
        angle = self.homes_rad[rest] + way * moved + self.amplitude_rad * size * sine
        rate = way * moved_1 / (end - start) + self.amplitude_rad * (size_1 * sine + size * w * cosine)
        accel = way * moved_2 / (end - start) ** 2 + self.amplitude_rad * (
            size_2 * sine + 2 * size_1 * w * cosine - size * w**2 * sine
        )
        return angle, rate, accel

    def attitude(self, t_s: ArrayLike) -> Rotation:
        """Return the attitude, body to n, at times (N,)."""
        angle = np.atleast_1d(self.angle(t_s)[0])
        return rotation(self.home_q_nb) * Rotation.from_rotvec(angle[:, None] * [1.0, 0.0, 0.0])

    def steps_b_rad(self, t_s: Floats) -> Floats:
        """Return rotation vectors (N - 1, 3) from the attitude at each of the times (N,) to that at the next."""
        return np.diff(self.angle(t_s)[0])[:, None] * np.array([1.0, 0.0, 0.0])

    def position(self, t_s: ArrayLike) -> Floats:
        """Return the position of the board in n, (N, 3) in m, from a point on the axis."""
        return np.asarray(self.attitude(t_s).apply(self.lever_b_m) + self.shake_n_m(np.atleast_1d(t_s)))

    def acceleration_n_mps2(self, t_s: ArrayLike) -> Floats:
        """Return the second derivative of the position, (N, 3)."""
        _, rate, accel = (np.atleast_1d(part) for part in self.angle(t_s))
        across = np.cross([1.0, 0.0, 0.0], self.lever_b_m)
        inward = np.cross([1.0, 0.0, 0.0], across)
        accel_b = accel[:, None] * across + rate[:, None] ** 2 * inward
        return np.asarray(self.attitude(t_s).apply(accel_b) + self.shake_n_m.derivative(2)(np.atleast_1d(t_s)))

    def moving(self, t_s: ArrayLike) -> NDArray[np.bool_]:
        """Return whether each time (N,) lies outside all rests."""
        t = np.asarray(t_s, dtype=np.float64)
        rest = np.maximum(np.searchsorted(self.rests_s[:, 0], t, side="right") - 1, 0)
        return np.asarray(t > self.rests_s[rest, 1])


def _evaluate_minimum_jerk(share: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the stroke from 0 to 1 and its first two derivatives; it is still before 0 and after 1."""
    u = np.clip(share, 0.0, 1.0)
    value = u**3 * (10 + u * (6 * u - 15))
    return value, 30 * (u * (1 - u)) ** 2, 60 * u * (1 - u) * (1 - 2 * u)


def simulate_experiment(
    kind: str, bench: Bench, sensor: Sensor, seed: int, minutes: float, rate_hz: float
) -> Recording:
    """Simulate the bench. Raises :class:`BadParameter` when ``minutes`` leave no room for a swing."""
    path = plan_swings(bench, minutes * 60, seed, kind)
    facts = {"motion": asdict(bench), "rests_s": path.rests_s.tolist(), "swings_hz": path.rates_hz.tolist()}
    recording = record_path(path, sensor, ULAANBAATAR, Order(kind, seed, minutes, rate_hz), facts)
    return replace(recording, base_pose=path.home_q_nb)


def plan_swings(bench: Bench, total_s: float, seed: int, kind: str) -> Swings:
    """Return a rest, then swings and rests; time left over lengthens the last rest."""
    rests, rates = [[0.0, bench.first_rest_s]], []
    for rate_hz in cycle((bench.low_hz, bench.high_hz)):
        start = rests[-1][1] + bench.swing_s(rate_hz)
        if start + bench.rest_s > total_s:
            break
        rests.append([start, start + bench.rest_s])
        rates.append(rate_hz)
    if not rates:
        shortest = (bench.first_rest_s + bench.swing_s(bench.low_hz) + bench.rest_s) / 60
        raise BadParameter(f"minutes {total_s / 60:g}: {kind} needs at least {shortest:.2f}, a rest and one swing")
    rests[-1][1] = total_s
    homes = np.array(
        [make_generator(seed, f"{kind}/home/{k}").standard_normal() * bench.home_deg for k in range(len(rests))]
    )
    still = Swings(
        from_euler(np.deg2rad(_HOME_EULER_ENU_DEG), "enu"),
        np.array(rests),
        np.array(rates),
        np.deg2rad(np.concatenate([[0.0], homes[1:]])),
        np.deg2rad(bench.swing_deg),
        np.array(bench.lever_b_m),
        join_strokes([0.0, total_s], np.zeros((2, 3))),
    )
    return replace(still, shake_n_m=_add_servo_steps(bench, still, seed, kind))


def _add_servo_steps(bench: Bench, path: Swings, seed: int, kind: str) -> BPoly:
    """Return small strokes at every step of the servo's controller, larger at higher rates and none at rest."""
    times = np.arange(0.0, path.duration_s, bench.step_s)
    rate_degps = np.rad2deg(np.abs(path.angle(times)[1]))
    size = (
        make_generator(seed, f"{kind}/shake").standard_normal((len(times), 3))
        * (bench.shake_m_degps * rate_degps)[:, None]
    )
    return join_strokes(np.append(times, path.duration_s), np.vstack([size, np.zeros(3)]))
