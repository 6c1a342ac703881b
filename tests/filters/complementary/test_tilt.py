"""``acc`` and ``acc-ma`` against Elmi Aziz and Mohseni Araste's equations, written out as printed."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stillpoint.datasets import Imu, Info, Mag, Recording
from stillpoint.datasets.frames import euler, from_euler, heading_rotation, quaternion, rotation, wrap
from stillpoint.filters import estimate
from stillpoint.filters.fields import level_attitude, level_vector, north_error, tilt_error
from stillpoint.filters.rotation import exp, multiply, rotate, rotation_about_up

number = st.floats(-20, 20, allow_subnormal=False)
vectors = st.tuples(number, number, number).filter(lambda v: np.linalg.norm(v) > 1.0)


def passive(axis: int, angle: float) -> np.ndarray:
    """R_i of eq (3)."""
    c, s = np.cos(angle), np.sin(angle)
    return {
        1: np.array([[1, 0, 0], [0, c, s], [0, -s, c]]),
        2: np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]),
        3: np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]),
    }[axis]


def papers_angles(a: np.ndarray, b: np.ndarray, declination_west: float) -> tuple[float, float, float]:
    """Eqs (4)-(8); the arc tangents of (4) and (6) with their quadrant."""
    roll, pitch = np.arctan2(-a[1], a[2]), np.arcsin(a[0] / np.linalg.norm(a))
    level_field = passive(2, pitch) @ passive(1, roll) @ b
    return roll, pitch, np.arctan2(level_field[1], level_field[0]) - declination_west


@given(vectors, vectors, st.floats(-0.5, 0.5))
def test_acc_is_the_papers_equations_4_to_8(accel, mag, declination_east) -> None:
    a, b = np.array(accel), np.array(mag)
    roll, pitch, yaw = papers_angles(a, b, -declination_east)  # (7): D = atan(b_W / b_N) counts west
    assume(abs(pitch) < 1.5)
    assume(np.linalg.norm(np.cross(a, b)) > 0.05 * np.linalg.norm(a) * np.linalg.norm(b))
    q_level = level_attitude(accel)
    turn, found = north_error(rotate(q_level, mag), declination_east)
    q_nb = np.array(multiply(rotation_about_up(turn), q_level))
    assert found
    assert np.abs(wrap(euler(q_nb, "nwu") - np.array([roll, pitch, yaw]))).max() < 1e-9


@given(vectors)
def test_without_a_field_the_papers_yaw_is_0(accel) -> None:
    a = np.array(accel)
    assume(abs(a[0]) < 0.999 * np.linalg.norm(a))
    roll, pitch = np.arctan2(-a[1], a[2]), np.arcsin(a[0] / np.linalg.norm(a))
    assert np.abs(wrap(euler(np.array(level_attitude(accel)), "nwu") - np.array([roll, pitch, 0]))).max() < 1e-7


@given(vectors, vectors)
def test_levelling_is_the_smallest_turn_to_the_true_up(up, v) -> None:
    unit = tuple(float(x) for x in np.array(up) / np.linalg.norm(up))
    assume(unit[2] > -0.999)
    q_upright = exp((*tilt_error(up), 0.0))
    assert rotate(q_upright, unit) == pytest.approx((0, 0, 1), abs=1e-12)
    assert level_vector(v, unit) == pytest.approx(rotate(q_upright, v), abs=1e-9)


def test_levelling_from_straight_down_turns_about_x() -> None:
    down, v = (0.0, 0.0, -1.0), (3.0, 4.0, 5.0)
    assert level_vector(v, down) == (3.0, -4.0, -5.0)
    assert rotate(exp((*tilt_error(down), 0.0)), v) == pytest.approx((3, -4, -5))


@pytest.mark.parametrize("up", [(9.81, 0.0, 0.0), (-9.81, 0.0, 0.0), (9.81, 1e-9, -1e-9)])
def test_a_vertical_x_axis_has_an_attitude_too(up: tuple[float, float, float]) -> None:
    q_nb = np.array(level_attitude(up))
    assert np.linalg.norm(q_nb) == pytest.approx(1.0, abs=1e-12)
    assert rotation(q_nb).apply(up)[2] == pytest.approx(9.81)


def test_the_kinematics_as_printed_10_turn_against_the_angles_of_4_to_8() -> None:
    """Eq (10) is the kinematics of active rotations; the paper's own (2)-(6) are passive: every sign is opposite."""
    draw = np.random.default_rng(1)
    for angles in draw.uniform(-1.2, 1.2, (20, 3)):
        rate_b = draw.normal(size=3)
        roll, pitch = angles[:2]
        q_nb = from_euler(angles, "nwu")
        step_s = 1e-6
        later = quaternion(rotation(q_nb) * Rotation.from_rotvec(rate_b * step_s))
        rates = wrap(euler(later, "nwu") - euler(q_nb, "nwu")) / step_s
        printed = np.array(
            [
                [1, np.sin(roll) * np.tan(pitch), -np.cos(roll) * np.tan(pitch)],
                [0, np.cos(roll), np.sin(roll)],
                [0, -np.sin(roll) / np.cos(pitch), np.cos(roll) / np.cos(pitch)],
            ]
        )
        assert np.allclose(rates, -printed @ rate_b, atol=1e-4)


def still(rot: Rotation, n: int, seed: int = 0, tilt_sd: float = 0.0) -> Recording:
    """``n`` samples at 100 Hz of attitudes scattered about ``rot``."""
    draw = np.random.default_rng(seed)
    rots = rot * Rotation.from_rotvec(draw.normal(0, tilt_sd, (n, 3)))
    t_ns = np.arange(n, dtype=np.int64) * 10_000_000
    imu = Imu(t_ns, np.zeros((n, 3)), rots.inv().apply([0, 0, 9.81]))
    return Recording("still", imu, mag=Mag(t_ns, rots.inv().apply([0, 20.0, -44.0])), info=Info(units_unchecked=True))


def test_the_low_pass_9_weighs_this_raw_sample_and_the_one_before() -> None:
    recording = still(Rotation.identity(), 50, tilt_sd=0.1)
    imu, mag = recording.require_imu(), recording.mag
    assert mag is not None

    def smoothed(x: np.ndarray) -> np.ndarray:
        return np.vstack([x[:1], 0.7 * x[1:] + 0.3 * x[:-1]])

    again = Recording(
        "smoothed",
        Imu(imu.t_ns, imu.gyro_b_radps, smoothed(imu.accel_b_mps2)),
        mag=Mag(mag.t_ns, smoothed(mag.mag_b_ut)),
        info=Info(units_unchecked=True),
    )
    filtered, given_smooth = estimate(recording, "acc"), estimate(again, "acc", {"kappa": 1.0})
    assert np.allclose(filtered.q_nb, given_smooth.q_nb, atol=1e-12)


@pytest.mark.parametrize("heading_deg", [0.0, 180.0, -90.0])
def test_the_moving_average_is_the_mean_rotation_of_its_window(heading_deg: float) -> None:
    pose = heading_rotation(np.deg2rad(heading_deg)) * Rotation.from_euler("ZYX", [0, 20, 60], degrees=True)
    recording = still(pose, 1200, tilt_sd=0.05)
    acc = rotation(estimate(recording, "acc", {"kappa": 1.0}).q_nb)
    averaged = estimate(recording, "acc-ma", {"kappa": 1.0, "window_s": 3.0})
    for k in (0, 1, 150, 299, 300, 750, 1199):
        mean = acc[max(0, k - 299) : k + 1].mean()  # the 300 samples of the last 3 s
        # The two means differ in third order of the scatter of 3 deg (0.05^3 rad = 0.007 deg per sample).
        assert np.rad2deg((rotation(averaged.q_nb[k]) * mean.inv()).magnitude()) < 0.02


def test_the_running_sums_do_not_drift() -> None:
    recording = still(Rotation.identity(), 200_000, tilt_sd=0.3)
    imu, mag = recording.require_imu(), recording.mag
    assert mag is not None
    last = slice(-1000, None)
    tail = Recording(
        "tail",
        Imu(imu.t_ns[last], imu.gyro_b_radps[last], imu.accel_b_mps2[last]),
        mag=Mag(mag.t_ns[last], mag.mag_b_ut[last]),
        info=Info(units_unchecked=True),
    )
    params = {"kappa": 1.0, "window_s": 7.0}
    long, fresh = estimate(recording, "acc-ma", params), estimate(tail, "acc-ma", params)
    assert np.allclose(long.q_nb[-1], fresh.q_nb[-1], atol=1e-12)


def test_a_window_without_room_is_shorter_and_counted() -> None:
    recording = still(Rotation.identity(), 400)
    found = estimate(recording, "acc-ma", {"window_s": 2.0, "room_hz": 50.0})
    assert found.diagnostics["n_cut"] == 400 - 102
    assert estimate(recording, "acc-ma", {"window_s": 2.0}).diagnostics["n_cut"] == 0


def test_a_window_of_0_s_is_acc_itself() -> None:
    recording = still(Rotation.identity(), 100, tilt_sd=0.2)
    mean, single = estimate(recording, "acc-ma", {"window_s": 0.0}), estimate(recording, "acc")
    assert np.allclose((rotation(mean.q_nb) * rotation(single.q_nb).inv()).magnitude(), 0, atol=1e-7)


def test_attitudes_that_cancel_each_other_keep_the_mean_before() -> None:
    n = 400
    rots = Rotation.from_rotvec(np.outer(np.where(np.arange(n) % 2, np.pi, 0.0), [1, 0, 0]))
    t_ns = np.arange(n, dtype=np.int64) * 10_000_000
    imu = Imu(t_ns, np.zeros((n, 3)), rots.inv().apply([0, 0, 9.81]))
    found = estimate(Recording("flip", imu, info=Info(units_unchecked=True)), "acc-ma", {"kappa": 1.0, "window_s": 2.0})
    assert found.diagnostics["n_no_mean"] > 100
    assert np.isfinite(found.q_nb).all()
