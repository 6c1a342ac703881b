"""Settings of the attitude graph, and presets for kinds of motion."""

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from stillpoint.datasets.recording import Floats
from stillpoint.datasets.settings import Settings, choice, degrees, number
from stillpoint.smoother.base_pose import ReturnParams
from stillpoint.smoother.rest import RestParams


@dataclass(frozen=True)
class KeyParams(Settings):
    """Spacing of the states, and windows: default, lowest, highest, meaning."""

    moving_s: float = number(0.1, 0.02, 1.0, "between keys in motion")
    resting_s: float = number(1.0, 0.1, 10.0, "between keys at rest")
    window_s: float = number(1800.0, 60.0, 1e6, "longer recordings are solved in windows of this length")
    overlap_s: float = number(120.0, 10.0, 3600.0, "by which neighbouring windows overlap")


@dataclass(frozen=True)
class InertialNoise(Settings):
    """Noise and priors of gyro and accelerometer.

    The densities in motion are larger than a sensor's white noise on purpose: they include what a constant calibration
    does not explain (vibration, clipping, non-linearity, clock jitter). That of the gyro grows with the rate where a
    rest shows that the gyro is quiet; without a rest it is the largest one.
    """

    gyro_radps_rthz: float = number(0.003, 1e-6, 1.0, "gyro in motion, white, at the most")
    accel_mps2_rthz: float = number(0.1, 1e-4, 10.0, "accelerometer in motion, white")
    gyro_rest_radps_rthz: float = number(0.001, 1e-6, 1.0, "gyro at rest")
    gyro_per_rate_rthz: float = number(1e-3, 0.0, 10.0, "by which that grows per rad/s, where there is a rest")
    accel_rest_mps2_rthz: float = number(0.02, 1e-4, 10.0, "accelerometer at rest")
    gyro_beyond: float = number(1.0, 0.01, 10.0, "a clipped rate is extended: wrong by this share of it")
    accel_beyond: float = number(2.0, 0.01, 10.0, "and so is a clipped specific force")
    gyro_bias_sd_radps: float = degrees(1.0, 0.01, 20.0, "the gyro's bias around its start value")
    free_bias_sd_radps: float = degrees(3.0, 0.01, 20.0, "the same where there is no rest")
    gyro_bias_walk: float = number(1e-4, 1e-7, 0.1, "rad/s per sqrt(s): its random walk")
    gyro_bias_shift_radps: float = degrees(0.06, 1e-5, 10.0, "by which it changes between rest and motion")
    accel_bias_sd_mps2: float = number(0.1, 1e-4, 5.0, "the accelerometer's bias")
    accel_bias_walk: float = number(1e-3, 1e-7, 1.0, "m/s^2 per sqrt(s): its random walk")
    bias_step_s: float = number(10.0, 1.0, 600.0, "the bias is constant for so long at the most")
    gyro_matrix_sd: float = number(0.005, 1e-5, 0.2, "each scale and misalignment of the gyro by itself, relative")
    gyro_scale_sd: float = number(0.0, 0.0, 0.2, "beside that, a scale that its axes have in common")
    free_scale_sd: float = number(0.01, 0.0, 0.2, "the same where there is no rest")
    accel_matrix_sd: float = number(0.005, 1e-5, 0.2, "the same of the accelerometer")
    raw_matrix_sd: float = number(0.03, 1e-5, 0.2, "of both matrices, tried when the data contradict those")
    rawest_matrix_sd: float = number(0.1, 1e-5, 0.2, "of both, tried when the data contradict that, too")
    accel_late_sd_s: float = number(0.02, 1e-5, 0.2, "by which the accelerometer may be late against the gyro")
    gap_rate_sd_radps: float = degrees(60.0, 0.1, 3000.0, "rate that a gap in the stamps may hide")

    @property
    def gyro_matrix_covariance(self) -> Floats:
        """Return the prior covariance (9, 9) of the elements of the gyro's matrix, row by row."""
        return make_matrix_covariance(self.gyro_matrix_sd, self.gyro_scale_sd)


def make_matrix_covariance(element_sd: float, scale_sd: float) -> Floats:
    """Return the covariance (9, 9) of a matrix, row by row: of each element by itself, and of a scale of all axes.

    One clock and one reference voltage serve all axes of a gyro, so that their scales have a part in common.
    """
    diagonal = np.eye(3).ravel()
    return element_sd**2 * np.eye(9) + scale_sd**2 * np.outer(diagonal, diagonal)


@dataclass(frozen=True)
class MotionPriors(Settings):
    """Priors of position and velocity: zero-mean, independent from second to second."""

    position_sd_m: float = number(5.0, 0.01, 1e7, "position around a free origin")
    velocity_sd_mps: float = number(5.0, 0.01, 1e4, "speed around standstill")
    integration_sd_m_rts: float = number(1e-3, 1e-5, 10.0, "m per sqrt(s): error of integrating twice")
    rest_velocity_sd_mps: float = number(0.01, 1e-5, 1.0, "speed at rest")
    rest_turn_sd_rad: float = number(1e-3, 1e-5, 0.1, "between neighbouring keys at rest")
    return_position_sd_m: float = number(0.02, 1e-4, 1e5, "how well the place of the base pose is met again")
    nonholonomic: bool = choice(False, "a wheeled vehicle: it moves along its forward axis only")
    forward_axis: Literal["x", "-x", "y", "-y"] = choice("x", "the body axis that points forward then")
    sideways_sd_mps: float = number(0.5, 0.01, 10.0, "speed across that axis, one draw a second")
    stops: bool = choice(False, "the velocity is zero while the satellites see the vehicle stand")


@dataclass(frozen=True)
class FieldParams(Settings):
    """Magnetometer: b(t) = (1 + S) R(t - d)^T m + h; field m, hard iron h, delay d and matrix S are unknowns."""

    use: bool = choice(True, "the magnetometer is used, where there is one")
    sd_ut: float = number(6.0, 0.05, 100.0, "of one measurement, with the disturbances of ordinary rooms")
    widening_with_returns: float = number(2.0, 1.0, 100.0, "factor on that sd up to a lone return that stood its test")
    step_s: float = number(0.5, 0.05, 60.0, "between the measurements that are used")
    robust: float = number(2.0, 0.5, 10.0, "residuals above this many sd lose their weight (Geman-McClure)")
    field_sd_ut: float = number(30.0, 1.0, 200.0, "of the local field around its start value")
    iron_sd_ut: float = number(50.0, 0.1, 1000.0, "of the hard iron around its start value")
    late_sd_s: float = number(0.03, 1e-5, 0.5, "by which the magnetometer may be late against the gyro")
    matrix_sd: float = number(0.02, 1e-6, 0.5, "scale, axes and soft iron of the magnetometer, relative")


@dataclass(frozen=True)
class GpsParams(Settings):
    """Satellite fixes, where a recording has them."""

    position_sd_m: float = number(3.0, 0.01, 1000.0, "horizontally, at the least; three times that vertically")
    velocity_sd_mps: float = number(0.5, 0.01, 100.0, "velocity from the fixes' speed and course")
    course_speed_mps: float = number(2.0, 0.1, 50.0, "below this speed the course says nothing")
    late_s: float = number(0.0, -2.0, 5.0, "by which the stamps of the fixes are late")
    lever_x_m: float = number(0.0, -100.0, 100.0, "where the antenna is from the IMU, along body x")
    lever_y_m: float = number(0.0, -100.0, 100.0, "along body y")
    lever_z_m: float = number(0.0, -100.0, 100.0, "along body z")


@dataclass(frozen=True)
class GraphParams(Settings):
    """Settings of ``method="graph"``, by station."""

    keys: KeyParams = field(default_factory=KeyParams)
    inertial: InertialNoise = field(default_factory=InertialNoise)
    motion: MotionPriors = field(default_factory=MotionPriors)
    magnetic: FieldParams = field(default_factory=FieldParams)
    gps: GpsParams = field(default_factory=GpsParams)
    rest: RestParams = field(default_factory=RestParams)
    returns: ReturnParams = field(default_factory=ReturnParams)
    turn_limit_rad: float = degrees(0.02, 1e-5, 5.0, "the solution is found when no key turns by more in an iteration")
    variance_factor: float = number(1.0, 0.01, 100.0, "on all variances but the two below")
    rest_variance_factor: float = number(0.2, 0.01, 100.0, "on that of the tilt where there is a rest")
    heading_variance_factor: float = number(
        0.6, 0.01, 100.0, "on that of the heading around its mean where there are returns"
    )
    prior_returns: float = number(12.0, 0.01, 100.0, "how many returns' worth of trust that factor deserves")
    bending_rad_per_mps2: float = degrees(0.02, 0.0, 10.0, "by which the body bends against its sensor")
    iterations: float = number(40.0, 1.0, 200.0, "that the solution may take")


HANDHELD = GraphParams()
PRESETS: dict[str, GraphParams] = {
    "handheld": HANDHELD,
    "phone": HANDHELD,
    "vehicle": replace(
        HANDHELD,
        inertial=replace(HANDHELD.inertial, gyro_per_rate_rthz=10.0),  # an engine shakes the gyro at any rate
        motion=replace(HANDHELD.motion, position_sd_m=1000.0, velocity_sd_mps=30.0, integration_sd_m_rts=0.1),
    ),
    "bench": replace(HANDHELD, motion=replace(HANDHELD.motion, position_sd_m=0.3, velocity_sd_mps=0.5)),
}

_VEHICLE_MPS = 20.0  # a prior of the velocity from here on allows for a vehicle


def allows_vehicle(params: GraphParams) -> bool:
    """Return whether the settings allow for the velocities of a vehicle."""
    return params.motion.velocity_sd_mps >= _VEHICLE_MPS
