"""Simulate the mission of Zia (2022): an underwater vehicle on the surface, 600 s submerged, and on the surface again.

The body is forward-right-down. The vehicle sails along its x axis; waves roll, pitch and turn it, and throw it sideways
and up, as strong on the surface as :class:`Sea` says and a share of that below. Attitude (roll, pitch, heading) and
velocity are splines of degree five through what the mission asks for at 20 Hz; the position is the integral of the
velocity spline and the acceleration its derivative, both exact.
"""

from dataclasses import asdict, dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline, make_interp_spline
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from scipy.special import ndtr

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.frames import from_euler, rotation
from stillpoint.datasets.recording import Floats, Recording
from stillpoint.datasets.simulate.generators import make_generator
from stillpoint.datasets.simulate.measure import draw_sample_times
from stillpoint.datasets.simulate.record import Order, Scene, record_path
from stillpoint.datasets.simulate.satellites import GpsModel, measure_gps
from stillpoint.datasets.simulate.sensor import AccelModel, ClockModel, GyroModel, MagModel, Sensor

# Off the coast where the paper was written, on the day on which the journal received it.
CASPIAN = Scene((36.9, 50.9, -27.0), "2022-08-09T08:00:00+00:00")

_SURFACE_S, _DIVE_S = 110.0, 40.0  # before and after; down and up
_SHORTEST_CRUISE_S = 60.0
_DIVE_PITCH_DEG = 20.0
_SPEED_MPS = (1.5, 2.5)  # on the surface, below
_HEADING_DEG = 40.0  # true
_SLALOM_DEG, _SLALOM_S = -25.0, (30.0, 60.0)  # a leg of another heading on the first surface run
_SNAKING_DEG, _SNAKING_PERIOD_S = 1.5, 90.0  # how well the heading is kept
_GPS_HZ = 1.0
KNOTS_HZ = 20.0
MARGIN_S = 1.0  # the splines reach beyond the mission, where their ends would ring

# Shares and frequencies (Hz) of the components of the waves.
_ROLLING = ((0.6, 0.18), (0.4, 0.25), (0.3, 0.33), (0.15, 0.5))
_PITCHING = ((0.6, 0.15), (0.4, 0.22))
_YAWING = ((1.0, 0.08),)
_HEAVING = ((1.0, 0.2),)
_SWAYING = ((1.0, 0.25),)


@dataclass(frozen=True)
class Sea:
    """The waves that move the vehicle on the surface, and the share of them that it feels below."""

    roll_deg: float = 6.0
    pitch_deg: float = 2.0
    yaw_deg: float = 3.0
    heave_mps2: float = 0.4  # amplitude of the vertical acceleration
    sway_mps2: float = 0.3  # amplitude of the horizontal one, across the heading
    share_below: float = 0.12


WAVES = Sea()
CALM = Sea(heave_mps2=0.0, sway_mps2=0.0)  # a long, low swell: it rolls the vehicle, but does not throw it


@dataclass(frozen=True)
class DriftModel:
    """A gyro bias that swings slowly with the temperature of the unit, of the same size on each axis."""

    bias_degph: float = 0.0  # plain value; its sign is drawn per axis
    swing: float = 0.0  # amplitude as a share of it
    period_s: float = 800.0


@dataclass(frozen=True, eq=False)
class _Drift:
    """The drift drawn for one unit."""

    model: DriftModel
    sign: Floats  # (3,)
    phase_rad: Floats  # (3,)

    def bias_b_radps(self, t_s: Floats) -> Floats:
        """Return the swinging bias (N, 3) at times (N,)."""
        swing = 1 + self.model.swing * np.sin(2 * np.pi * t_s[:, None] / self.model.period_s + self.phase_rad)
        return np.asarray(np.deg2rad(self.model.bias_degph / 3600) * self.sign * swing)


@dataclass(frozen=True)
class IronModel:
    """Hard iron of the hull in body axes, uT; no calibration of the sensor alone removes it."""

    x_ut: float = 0.0
    y_ut: float = 0.0
    z_ut: float = 0.0

    @property
    def hard_iron_b_ut(self) -> Floats:
        """Return the hard iron as a vector (3,)."""
        return np.array([self.x_ut, self.y_ut, self.z_ut])


@dataclass(frozen=True)
class AuvSensor(Sensor):
    """The sensors of a vehicle: an IMU and a magnetometer with a gyro drift, the iron of the hull, and a receiver."""

    drift: DriftModel = field(default_factory=DriftModel)
    iron: IronModel = field(default_factory=IronModel)
    gps: GpsModel = field(default_factory=GpsModel)


# Low-cost sensors. The iron makes 2 deg of heading error on the heading of the mission: 0.93 uT across it, of 27.3 uT.
AUV = AuvSensor(
    "auv",
    gyro=GyroModel(noise_density_degps_rthz=0.007, bias_instability_degph=4.0, scale_error=0.002, misalignment_deg=0.1),
    accel=AccelModel(noise_density_ug_rthz=150.0, bias_instability_ug=20.0, turn_on_bias_mg=0.2, scale_error=0.001),
    mag=MagModel(noise_density_ut_rthz=0.04, soft_iron=0.001),
    imu_clock=ClockModel(rate_error=0.001, jitter_s=1e-4),
    mag_clock=ClockModel(rate_error=0.001, jitter_s=1e-3),
    drift=DriftModel(bias_degph=60.0, swing=0.25),
    iron=IronModel(0.67, 0.67, 0.5),
    gps=GpsModel(position_sd_m=2.0, velocity_sd_mps=0.03, first_fix_s=5.0),
)
_PERFECT_AUV = AuvSensor("perfect")
AUV_SENSORS: dict[str, AuvSensor] = {sensor.name: sensor for sensor in (AUV, _PERFECT_AUV)}


@dataclass(frozen=True)
class Phases:
    """The times, in s from the start, at which the vehicle leaves the surface, is down, comes up and is back."""

    dive_s: float
    cruise_s: float
    ascent_s: float
    surfaced_s: float
    end_s: float


@dataclass(frozen=True, eq=False)
class Voyage:
    """The true motion as splines with exact derivatives; a :class:`stillpoint.datasets.simulate.path.Motion`."""

    euler_ned_rad: BSpline  # roll, pitch, heading
    velocity_n_mps: BSpline
    phases: Phases

    @property
    def duration_s(self) -> float:
        """Length of the mission."""
        return self.phases.end_s

    @property
    def rests_s(self) -> Floats:
        """Return no rest: the sea is never still."""
        return np.empty((0, 2))

    def attitude(self, t_s: ArrayLike) -> Rotation:
        """Return the attitude, body to n, at times (N,)."""
        return rotation(from_euler(self.euler_ned_rad(np.asarray(t_s)), "ned"))

    def steps_b_rad(self, t_s: Floats) -> Floats:
        """Return the exact rotation vectors (N - 1, 3) from the attitude at each time to that at the next."""
        attitude = self.attitude(t_s)
        return np.asarray((attitude[:-1].inv() * attitude[1:]).as_rotvec())

    def position(self, t_s: ArrayLike) -> Floats:
        """Return the position in n (N, 3) in m, from the start of the mission."""
        return np.asarray(self._position(np.asarray(t_s)) - self._position(0.0))

    def acceleration_n_mps2(self, t_s: ArrayLike) -> Floats:
        """Return the derivative of the velocity in n, (N, 3)."""
        return np.asarray(self._acceleration(np.asarray(t_s)))

    def moving(self, t_s: ArrayLike) -> NDArray[np.bool_]:
        """Return True for every time."""
        return np.ones(len(np.atleast_1d(t_s)), dtype=np.bool_)

    @cached_property
    def _position(self) -> BSpline:
        return self.velocity_n_mps.antiderivative()

    @cached_property
    def _acceleration(self) -> BSpline:
        return self.velocity_n_mps.derivative()


def simulate_mission(kind: str, sea: Sea, sensor: AuvSensor, seed: int, minutes: float, rate_hz: float) -> Recording:
    """Simulate one mission. Raises :class:`BadParameter` when ``minutes`` leave no room for a cruise."""
    path = sail(sea, plan_phases(minutes * 60, kind), seed)
    drift = _draw_drift(sensor.drift, seed)
    facts = {"sea": asdict(sea), "phases_s": asdict(path.phases), "body_axes": "forward, right, down"}
    drawn = {"drift": {"sign": drift.sign.tolist(), "phase_rad": drift.phase_rad.tolist()}}
    recording = record_path(path, sensor, CASPIAN, Order(kind, seed, minutes, rate_hz), facts, drawn)
    imu, mag, truth = recording.imu, recording.mag, recording.truth
    assert imu is not None
    assert mag is not None
    assert truth is not None
    drift_b_radps = drift.bias_b_radps((truth.t_ns - CASPIAN.start_ns) / 1e9)
    gps_at = draw_sample_times(path, ClockModel(), _GPS_HZ, CASPIAN.world, seed, "gps")
    return replace(
        recording,
        imu=replace(imu, gyro_b_radps=imu.gyro_b_radps + drift_b_radps),
        mag=replace(mag, mag_b_ut=mag.mag_b_ut + sensor.iron.hard_iron_b_ut),
        gps=measure_gps(path, sensor.gps, gps_at, CASPIAN.place, seed),
    )


def plan_phases(total_s: float, kind: str) -> Phases:
    """Return the phases of a mission of this length: only the cruise changes with it. Raises :class:`BadParameter`."""
    cruise_s = total_s - 2 * (_SURFACE_S + _DIVE_S)
    if cruise_s < _SHORTEST_CRUISE_S:
        shortest = (total_s - cruise_s + _SHORTEST_CRUISE_S) / 60
        raise BadParameter(f"minutes {total_s / 60:g}: {kind} needs at least {shortest:.2f}, a minute of it submerged")
    ends = np.cumsum([_SURFACE_S, _DIVE_S, cruise_s, _DIVE_S, _SURFACE_S]).tolist()
    return Phases(*ends)


def sail(sea: Sea, when: Phases, seed: int) -> Voyage:
    """Return the path of one mission; the ascent is as steep as brings the vehicle back to the surface."""
    t = np.arange(-MARGIN_S, when.end_s + MARGIN_S, 1 / KNOTS_HZ)

    def make_voyage(ascent_pitch_deg: float) -> Voyage:
        """Return the voyage that ascends at this pitch."""
        euler = euler_ned_rad(sea, when, t, ascent_pitch_deg, seed)
        return Voyage(
            make_interp_spline(t, euler, k=5),
            make_interp_spline(t, _compute_velocities(sea, when, t, euler, seed), k=5),
            when,
        )

    def find_final_depth_m(ascent_pitch_deg: float) -> float:
        return float(make_voyage(ascent_pitch_deg).position([when.end_s])[0, 2])

    return make_voyage(brentq(find_final_depth_m, 0.5 * _DIVE_PITCH_DEG, 2.0 * _DIVE_PITCH_DEG, xtol=1e-3))


def euler_ned_rad(sea: Sea, when: Phases, t_s: Floats, ascent_pitch_deg: float, seed: int) -> Floats:
    """Return roll, pitch, heading (N, 3) in North-East-Down."""
    rough = _compute_roughness(sea, when, t_s)
    roll = rough * sea.roll_deg * sum_waves(_ROLLING, t_s, seed, "roll")
    pitch = rough * sea.pitch_deg * sum_waves(_PITCHING, t_s, seed, "pitch")
    pitch += -_DIVE_PITCH_DEG * _smooth_window(when.dive_s, when.cruise_s, t_s, 2.5)
    pitch += ascent_pitch_deg * _smooth_window(when.ascent_s, when.surfaced_s, t_s, 2.5)
    heading = _HEADING_DEG + _SLALOM_DEG * _smooth_window(*_SLALOM_S, t_s, 6.0)
    heading += _SNAKING_DEG * sum_waves(((1.0, 1 / _SNAKING_PERIOD_S),), t_s, seed, "snaking")
    heading += rough * sea.yaw_deg * sum_waves(_YAWING, t_s, seed, "yaw")
    return np.deg2rad(np.column_stack([roll, pitch, heading]))


def _compute_velocities(sea: Sea, when: Phases, t_s: Floats, euler_rad: Floats, seed: int) -> Floats:
    """Return the velocity in n (N, 3): along the body's x axis, plus the waves across the heading and upwards."""
    _, pitch, heading = euler_rad.T
    below = _smooth_window(when.dive_s, when.surfaced_s, t_s, 6.0)
    speed = _SPEED_MPS[0] + (_SPEED_MPS[1] - _SPEED_MPS[0]) * below
    forward = np.column_stack([np.sin(heading) * np.cos(pitch), np.cos(heading) * np.cos(pitch), np.sin(pitch)])
    right = np.column_stack([np.cos(heading), -np.sin(heading), np.zeros_like(heading)])
    rough = _compute_roughness(sea, when, t_s)
    sway = rough * sea.sway_mps2 * sum_waves(_SWAYING, t_s, seed, "sway") / (2 * np.pi * _SWAYING[0][1])
    heave = rough * sea.heave_mps2 * sum_waves(_HEAVING, t_s, seed, "heave") / (2 * np.pi * _HEAVING[0][1])
    moved = speed[:, None] * forward + sway[:, None] * right
    moved[:, 2] += heave
    return moved


def _compute_roughness(sea: Sea, when: Phases, t_s: Floats) -> Floats:
    """Return the share of the waves that the vehicle feels: 1 on the surface."""
    return 1 - (1 - sea.share_below) * _smooth_window(when.dive_s, when.surfaced_s, t_s, 5.0)


def _smooth_window(start_s: float, end_s: float, t_s: Floats, soft_s: float) -> Floats:
    """Return 1 between two times and 0 outside, with the edges of a normal distribution of this sd."""
    return np.asarray(ndtr((t_s - start_s) / soft_s) - ndtr((t_s - end_s) / soft_s))


def sum_waves(components: tuple[tuple[float, float], ...], t_s: Floats, seed: int, name: str) -> Floats:
    """Return the sum of sines with these shares and frequencies (Hz), each with its own phase."""
    angles = make_generator(seed, f"auv/{name}").uniform(0, 2 * np.pi, len(components))
    parts = [
        share * np.sin(2 * np.pi * hz * t_s + angle) for (share, hz), angle in zip(components, angles, strict=True)
    ]
    return np.sum(parts, axis=0)


def _draw_drift(model: DriftModel, seed: int) -> _Drift:
    """Draw the gyro drift of one unit."""
    rng = make_generator(seed, "gyro/drift")
    return _Drift(model, rng.choice([-1.0, 1.0], 3), rng.uniform(0, 2 * np.pi, 3))
