"""Describe MEMS sensors as their data sheets do, with presets.

Every parameter that differs from unit to unit, or from one switching-on to the next, is given as one standard
deviation per axis and drawn once per recording; the rest are plain values. Earth's rotation (0.004 deg/s) is left out:
it is far below the bias of these sensors.
"""

from dataclasses import asdict, dataclass, field

import numpy as np

from stillpoint.datasets.errors import BadParameter


@dataclass(frozen=True)
class GyroModel:
    """The errors of a gyro."""

    noise_density_degps_rthz: float = 0.0  # white noise, deg/s per sqrt(Hz)
    bias_instability_degph: float = 0.0  # top of the Allan deviation of the wandering bias, deg/h
    bias_time_s: float = 200.0  # correlation time of the wandering bias (first-order Gauss-Markov)
    turn_on_bias_degps: float = 0.0  # sd, constant over a recording
    warming_degps: float = 0.0  # sd of what the bias changes by while the device warms up
    warming_s: float = 300.0  # time constant of that
    scale_error: float = 0.0  # sd, fraction
    misalignment_deg: float = 0.0  # sd of each axis against each other axis
    g_sensitivity_degps_g: float = 0.0  # sd of each element of the response to specific force
    range_degps: float | None = None  # beyond it the output stays at the range
    bits: int | None = None  # of the converter, over the range to both sides
    lag_s: float = 0.0  # a sample stamped t describes the motion of t - lag


@dataclass(frozen=True)
class AccelModel:
    """The errors of an accelerometer."""

    noise_density_ug_rthz: float = 0.0  # white noise, 1e-6 g per sqrt(Hz)
    bias_instability_ug: float = 0.0  # as for the gyro
    bias_time_s: float = 200.0
    turn_on_bias_mg: float = 0.0  # sd
    warming_mg: float = 0.0  # as for the gyro
    warming_s: float = 300.0
    scale_error: float = 0.0  # sd, fraction
    misalignment_deg: float = 0.0  # sd
    range_g: float | None = None
    bits: int | None = None
    lag_s: float = 0.0


@dataclass(frozen=True)
class MagModel:
    """The errors of a magnetometer that remain after the phone's own calibration."""

    noise_density_ut_rthz: float = 0.0  # white noise, uT per sqrt(Hz)
    hard_iron_ut: float = 0.0  # sd
    soft_iron: float = 0.0  # sd of each element of a symmetric matrix, fraction
    misalignment_deg: float = 0.0  # sd
    range_ut: float | None = None
    bits: int | None = None
    lag_s: float = 0.0
    max_rate_hz: float = 100.0  # sampled with the IMU's rate, but not faster than this
    passings_per_min: float = 0.0  # how often the moving phone passes iron or a current
    passing_ut: float = 0.0  # sd of each component of the disturbance at its peak
    passing_s: float = 1.5  # sd of its bell curve in time


@dataclass(frozen=True)
class ClockModel:
    """The errors of a stream's stamps."""

    rate_error: float = 0.0  # sd, fraction: the sensor samples a little faster or slower than asked (stamps show it)
    jitter_s: float = 0.0  # sd of each stamp about its true instant
    skew_ppm: float = 0.0  # stamps run fast by this against true time


@dataclass(frozen=True)
class Sensor:
    """All errors between the true motion and the recorded numbers."""

    name: str
    gyro: GyroModel = field(default_factory=GyroModel)
    accel: AccelModel = field(default_factory=AccelModel)
    mag: MagModel = field(default_factory=MagModel)
    imu_clock: ClockModel = field(default_factory=ClockModel)
    mag_clock: ClockModel = field(default_factory=ClockModel)

    def __post_init__(self) -> None:
        """Check all values; raises :class:`BadParameter` for one that is not finite or negative."""
        for part, values in asdict(self).items():
            if part == "name":
                continue
            for name, value in values.items():
                signed = name in ("lag_s", "skew_ppm", "late_s") or name.startswith("antenna_")
                if value is not None and not (np.isfinite(value) and (signed or value >= 0)):
                    raise BadParameter(f"sensor {self.name}, {part}.{name}: is {value:g}; give a finite value >= 0")
            limits = [value for name, value in values.items() if name.startswith("range_")]
            if values.get("bits") is not None and limits == [None]:
                raise BadParameter(f"sensor {self.name}, {part}.bits: a converter's step needs the range; give both")


PERFECT = Sensor("perfect")

# A telephone with an IMU of the BMI160 class and a magnetometer of the AK0991x class, after its factory and background
# calibration; docs/simulation.md says more on the numbers.
PHONE = Sensor(
    "phone",
    gyro=GyroModel(
        noise_density_degps_rthz=0.007,
        bias_instability_degph=10.0,
        turn_on_bias_degps=0.1,
        scale_error=0.005,
        misalignment_deg=0.3,
        g_sensitivity_degps_g=0.01,
        range_degps=2000.0,
        bits=16,
    ),
    accel=AccelModel(
        noise_density_ug_rthz=150.0,
        bias_instability_ug=50.0,
        turn_on_bias_mg=5.0,
        scale_error=0.003,
        misalignment_deg=0.3,
        range_g=8.0,
        bits=16,
    ),
    mag=MagModel(
        noise_density_ut_rthz=0.04,
        hard_iron_ut=1.0,
        soft_iron=0.01,
        misalignment_deg=0.5,
        range_ut=4912.0,
        bits=16,
        passings_per_min=2.0,
        passing_ut=4.0,
    ),
    imu_clock=ClockModel(rate_error=0.003, jitter_s=1e-4),
    mag_clock=ClockModel(rate_error=0.003, jitter_s=1e-3),
)

SENSORS: dict[str, Sensor] = {sensor.name: sensor for sensor in (PHONE, PERFECT)}
