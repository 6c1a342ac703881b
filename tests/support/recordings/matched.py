"""Recordings whose noise is as the parameters of the Kalman filters say: white, and a bias that walks."""

from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from stillpoint.datasets import Imu, Info, Mag, Recording
from stillpoint.datasets.recording import Floats
from stillpoint.datasets.settings import choose_settings
from stillpoint.filters import ESTIMATORS
from stillpoint.filters.precision import Precision, to_precision
from stillpoint.filters.sample import Log, Track
from stillpoint.filters.table import Estimator

RATE_HZ = 50.0
GYRO_SD, ACCEL_SD, MAG_SD = 0.01, 0.5, 0.5  # per sample: rad/s, m/s^2, uT
BIAS_SD, BIAS_WALK = np.deg2rad(0.5), np.deg2rad(0.01)  # rad/s, and rad/s in 1 s
FIELD_N = np.array([0.0, 20.0, -44.0])
PARAMS = {
    "gyro_noise_rad_rts": GYRO_SD / np.sqrt(RATE_HZ),
    "turn_error": 0.0,
    "bias_sd_radps": BIAS_SD,
    "bias_walk_radps": BIAS_WALK,
    "accel_noise_mps_rts": ACCEL_SD / np.sqrt(RATE_HZ),
    "velocity_mps_rts": 1e-3,  # the body does not move
    "field_noise_ut_rts": MAG_SD / np.sqrt(RATE_HZ),
    "unseen_disturbance": 0.0,
    "gate_sd": 1e3,
    "rest_accel_mps2": 1e-3,  # it never rests
}


def matched(seed: int, seconds: float) -> tuple[Recording, Rotation, Floats]:
    """A recording, its true attitudes, and the true biases of its gyro."""
    draw, n = np.random.default_rng(seed), int(seconds * RATE_HZ)
    t_s = np.arange(n) / RATE_HZ
    phase = draw.uniform(0, 2 * np.pi, 3)
    angles = np.column_stack([0.9 * np.sin(0.7 * t_s + phase[0]), 0.7 * np.sin(1.1 * t_s + phase[1]), 0.3 * t_s])
    true = Rotation.from_euler("XYZ", angles + phase)
    rate = np.vstack([np.zeros(3), (true[:-1].inv() * true[1:]).as_rotvec() * RATE_HZ])
    bias = draw.normal(0, BIAS_SD, 3) + np.cumsum(draw.normal(0, BIAS_WALK / np.sqrt(RATE_HZ), (n, 3)), axis=0)
    t_ns = np.round(t_s * 1e9).astype(np.int64)
    imu = Imu(
        t_ns,
        rate + bias + draw.normal(0, GYRO_SD, (n, 3)),
        true.inv().apply([0, 0, 9.81]) + draw.normal(0, ACCEL_SD, (n, 3)),
    )
    mag = Mag(t_ns, true.inv().apply(FIELD_N) + draw.normal(0, MAG_SD, (n, 3)))
    return Recording(f"matched-{seed}", imu, mag=mag, info=Info(units_unchecked=True)), true, bias


class Ran(NamedTuple):
    """What a compiled run gives, with the state that ``estimate`` does not show."""

    track: Track
    state: Any  # at the end


def columns(recording: Recording) -> Log:
    """The samples of a recording whose streams share their stamps, or that has no magnetometer."""
    imu, mag = recording.require_imu(), recording.mag
    n = len(imu.t_ns)
    assert mag is None or (mag.t_ns == imu.t_ns).all()
    return Log(
        dt_s=np.diff(imu.t_ns, prepend=imu.t_ns[0]) / 1e9,
        gyro_b_radps=np.array(imu.gyro_b_radps),
        accel_b_mps2=np.array(imu.accel_b_mps2),
        mag_b_ut=np.zeros((n, 3)) if mag is None else np.array(mag.mag_b_ut),
        has_accel=np.ones(n, dtype=np.bool_),
        has_mag=np.full(n, mag is not None),
        hidden_b_radps=np.zeros((n, 3)),
    )


def run(name: str, log: Log, params: dict[str, Any], state: Any = None, precision: Precision = "double") -> Ran:
    """From the start, or on from a state."""
    entry = ESTIMATORS[name]
    assert isinstance(entry, Estimator)
    c = to_precision(entry.coefficients(choose_settings(entry.params(), params, name), 0.0), precision)
    n = len(log.dt_s)
    track = Track(np.empty((n, 4)), np.empty((n, 3)), np.empty((n, 9)), np.empty((n, 3)), np.empty(n, dtype=np.bool_))
    begin = to_precision(entry.start(c) if state is None else state, precision)
    end = entry.run(to_precision(log, precision), begin, c, track)
    return Ran(track, end)
