"""``gyro`` by the Euler rates of Byambajav et al., eq (1): against a plain loop and against the exact rotation."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stillpoint.datasets import Imu, Info, Recording
from stillpoint.datasets.frames import euler, rotation
from stillpoint.filters import estimate

G_N = np.array([0.0, 0.0, 9.81])


def tumbling(rate_hz: float, seconds: float = 10.0) -> tuple[Recording, Rotation]:
    """Up to 60 deg of pitch; each gyro sample is the exact mean over its interval."""
    t_s = np.arange(0, seconds, 1 / rate_hz)
    angles = np.column_stack([2.0 * np.sin(0.9 * t_s), 1.0 * np.sin(0.7 * t_s), 0.8 * t_s])
    true = Rotation.from_euler("ZYX", angles[:, ::-1])
    rate = (true[:-1].inv() * true[1:]).as_rotvec() * rate_hz
    imu = Imu(np.round(t_s * 1e9).astype(np.int64), np.vstack([np.zeros(3), rate]), true.inv().apply(G_N))
    return Recording("tumbling", imu, info=Info(units_unchecked=True)), true


@pytest.mark.parametrize("rule", ["rectangular", "trapezoidal"])
def test_euler_angles_are_those_of_a_plain_loop_over_eq_1(rule: str) -> None:
    recording, _ = tumbling(100.0)
    imu = recording.require_imu()
    found = estimate(recording, "gyro", {"kinematics": "euler", "rule": rule})
    angles = euler(found.q_nb, "enu")
    phi, theta, psi = angles[0]
    for k in range(1, len(angles)):
        w = imu.gyro_b_radps[k]
        if rule == "trapezoidal":
            w = (imu.gyro_b_radps[k - 1] + w) / 2
        W = np.array(
            [
                [1, np.sin(phi) * np.tan(theta), np.cos(phi) * np.tan(theta)],
                [0, np.cos(phi), -np.sin(phi)],
                [0, np.sin(phi) / np.cos(theta), np.cos(phi) / np.cos(theta)],
            ]
        )
        phi, theta, psi = np.array([phi, theta, psi]) + W @ w * (imu.t_ns[k] - imu.t_ns[k - 1]) / 1e9
        assert np.sin(angles[k] - [phi, theta, psi]) == pytest.approx([0, 0, 0], abs=1e-9)
    assert found.diagnostics["n_gimbal"] == 0


def test_its_error_is_of_the_first_order_in_the_step_and_the_rotation_has_none() -> None:
    off = {}
    for rate_hz in (100.0, 200.0):
        recording, true = tumbling(rate_hz)
        for kinematics in ("euler", "rotation"):
            found = rotation(estimate(recording, "gyro", {"kinematics": kinematics}).q_nb)
            turned, exact = found[0].inv() * found, true[0].inv() * true  # the start knows no heading
            off[kinematics, rate_hz] = (turned * exact.inv()).magnitude().max()
    assert off["rotation", 100.0] < 1e-6
    assert 1e-3 < off["euler", 200.0] == pytest.approx(off["euler", 100.0] / 2, rel=0.1)


def test_through_the_singular_pitch_the_step_is_a_rotation_and_counted() -> None:
    t_s = np.arange(0, 8, 0.01)
    over = Rotation.from_euler("Y", (np.deg2rad(90) * t_s)[:, None])
    gyro = np.tile([0.0, np.deg2rad(90), 0.0], (len(t_s), 1))
    imu = Imu(np.round(t_s * 1e9).astype(np.int64), gyro, over.inv().apply(G_N))
    found = estimate(Recording("over", imu, info=Info(units_unchecked=True)), "gyro", {"kinematics": "euler"})
    q_nb = rotation(found.q_nb)
    assert ((q_nb[0].inv() * q_nb) * over.inv()).magnitude().max() < 1e-6
    assert found.diagnostics["n_gimbal"] > 0
