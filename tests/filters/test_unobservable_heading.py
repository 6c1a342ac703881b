"""A heading that no sensor measures: no filter may move it but by the gyro, and none may claim to know it better.

Without a magnetometer the accelerometer shows the tilt only. A filter that moves the heading by it, or whose variance
of the heading falls, invents information (false observability).
"""

import numpy as np
import pytest
from matched import matched
from scipy.spatial.transform import Rotation

from stillpoint.datasets import Estimate, Imu, Info, Recording
from stillpoint.datasets.frames import rotation
from stillpoint.filters import ESTIMATORS, estimate
from stillpoint.filters.kalman.covariance import ANY_ANGLE_RAD2
from stillpoint.filters.table import Estimator

# acc and acc-ma have no gyro: their heading without a field is 0 by definition. cf-literal corrects roll as an angle,
# which is a turn about body x, and that has a part about up wherever x is not level.
GYRO_FILTERS = [
    n for n, entry in ESTIMATORS.items() if isinstance(entry, Estimator) and n not in ("acc", "acc-ma", "cf-literal")
]
WITH_COVARIANCE = [n for n in GYRO_FILTERS if ESTIMATORS[n].gives_cov]


def wobbling(seed: int, every: int) -> Recording:
    """Twenty seconds of turns about all axes with noise and a bias, without a magnetometer, every n-th of 50 Hz."""
    recording, true, bias = matched(seed, 20.0)
    imu = recording.require_imu()
    kept = np.arange(0, len(imu.t_ns), every)
    t_ns = imu.t_ns[kept]
    steps = (true[kept][:-1].inv() * true[kept][1:]).as_rotvec() / np.diff(t_ns)[:, None] * 1e9
    gyro = np.vstack([np.zeros(3), steps]) + bias[kept] + np.random.default_rng(seed).normal(0, 0.01, (len(kept), 3))
    return Recording("wobbling", Imu(t_ns, gyro, imu.accel_b_mps2[kept]), info=Info(units_unchecked=True))


def resting(seed: int) -> Recording:
    """A body at rest in any attitude for 15 s, with noise and a bias of 1 deg/s."""
    draw, n = np.random.default_rng(seed), 1500
    pose = Rotation.random(random_state=seed)
    gyro = draw.normal(0, np.deg2rad(1.0), 3) + draw.normal(0, 0.003, (n, 3))
    accel = pose.inv().apply([0.0, 0.0, 9.81]) + draw.normal(0, 0.05, (n, 3))
    imu = Imu(np.arange(n, dtype=np.int64) * 10_000_000, gyro, accel)
    return Recording("resting", imu, info=Info(units_unchecked=True))


def heading_corrections_rad(found: Estimate, recording: Recording) -> np.ndarray:
    """By how much each sample turned the heading otherwise than by the rate less the bias before it.

    That is the turn about up of the correction in n; for a filter of Euler angles, the change of its yaw.
    """
    imu, q_nb = recording.require_imu(), rotation(found.q_nb)
    bias = np.zeros_like(imu.gyro_b_radps) if found.gyro_bias_b_radps is None else found.gyro_bias_b_radps
    turns = (imu.gyro_b_radps[1:] - bias[:-1]) * (np.diff(imu.t_ns) / 1e9)[:, None]
    predicted = q_nb[:-1] * Rotation.from_rotvec(turns)
    if found.name == "kf-axis":
        yaw = q_nb[1:].as_euler("ZYX")[:, 0] - predicted.as_euler("ZYX")[:, 0]
        return np.angle(np.exp(1j * yaw))
    return (q_nb[1:] * predicted.inv()).as_rotvec()[:, 2]


@pytest.mark.parametrize("name", GYRO_FILTERS)
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("every", [1, 2])
def test_only_the_gyro_moves_a_heading_that_nothing_measures(name: str, seed: int, every: int) -> None:
    for recording in (wobbling(seed, every), resting(seed)):
        found = estimate(recording, name)
        corrections = heading_corrections_rad(found, recording)
        tilts = rotation(found.q_nb)[1:] * rotation(found.q_nb)[:-1].inv()
        assert np.abs(corrections[1:]).max() < 1e-9  # the first sample may set the attitude
        assert tilts.magnitude().max() > 1e-6


@pytest.mark.parametrize("name", WITH_COVARIANCE)
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("every", [1, 2])
def test_the_variance_of_a_heading_that_nothing_measures_never_falls(name: str, seed: int, every: int) -> None:
    for recording in (wobbling(seed, every), resting(seed)):
        found = estimate(recording, name)
        up_b = rotation(found.q_nb).inv().apply([0.0, 0.0, 1.0])
        variance = np.einsum("ni,nij,nj->n", up_b, found.cov_b_rad2, up_b)
        assert variance.min() > ANY_ANGLE_RAD2 * (1 - 1e-9)
        # And the tilt is known: the trace is that of the heading, and little more.
        assert np.trace(found.cov_b_rad2[-1]) < ANY_ANGLE_RAD2 * 1.1
