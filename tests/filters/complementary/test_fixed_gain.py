"""``cf-fixed``: Zia's eq (10) by other means, and what it promises."""

from math import atan2, cos, hypot, pi, remainder, sin, tan

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal
from scipy.spatial.transform import Rotation

from stillpoint.datasets import Imu, Info, Mag, Recording
from stillpoint.datasets.earth import local_declination
from stillpoint.datasets.frames import euler, from_euler, rotation, wrap
from stillpoint.datasets.simulate import simulate
from stillpoint.filters import Stream, estimate

STEP_S = 0.01
GAINS = [(1.0, 0.05), (0.3, 0.01), (5.0, 6.25), (0.5, 2.0), (2.0, 0.0)]


@pytest.fixture(scope="module")
def mission():
    """Seven minutes of the vehicle: waves, dive, ascent."""
    return simulate("auv-dolphin", seed=3, minutes=7.0)


def one_axis(axis, acc_angle, rate, mag_every=1):
    """Fields that say ``acc_angle`` and a gyro that says ``rate`` about one axis of n and b alike.

    About a horizontal axis without a magnetometer: levelled by the estimate, its field would turn the heading, too.
    """
    n = len(rate)
    t_ns = np.arange(n, dtype=np.int64) * int(STEP_S * 1e9)
    seen = Rotation.from_rotvec(np.outer(acc_angle, np.eye(3)[axis])).inv()
    gyro = np.zeros((n, 3))
    gyro[:, axis] = rate
    mag = Mag(t_ns[::mag_every], seen.apply([0, 20.0, -44.0])[::mag_every])
    imu = Imu(t_ns, gyro, seen.apply([0, 0, 9.81]))
    return Recording("axis", imu, mag=mag if axis == 2 else None, info=Info(units_unchecked=True))


def angle_of(q_nb, axis):
    return 2 * np.arctan2(q_nb[:, 1 + axis], q_nb[:, 0])


def wandering(seed, n=3000):
    """A measured angle and a rate with a bias."""
    draw = np.random.default_rng(seed)
    rate = 0.8 * np.sin(np.arange(n) * STEP_S) + 0.03
    true = np.concatenate([[0], np.cumsum(rate[1:] - 0.03) * STEP_S])
    return true + draw.normal(0, 0.2, n) * (np.arange(n) > 0), rate


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(("kp", "ki"), GAINS)
def test_about_one_axis_it_is_eq_10_with_a_forward_difference(axis, kp, ki):
    acc_angle, rate = wandering(4)
    x, integral, expected = acc_angle[0], 0.0, [acc_angle[0]]
    for measured, turned in zip(acc_angle[1:], rate[1:], strict=True):
        x += STEP_S * (turned + ki * integral)
        error = measured - x
        x, integral = x + STEP_S * kp * error, integral + STEP_S * error
        expected.append(x)
    found = estimate(one_axis(axis, acc_angle, rate), "cf-fixed", {"kp_per_s": kp, "ki_per_s2": ki})
    assert np.abs(wrap(angle_of(found.q_nb, axis) - expected)).max() < 1e-9


@pytest.mark.parametrize(("kp", "ki"), GAINS)
def test_in_small_steps_it_is_the_transfer_function_11(kp, ki):
    """(11) on a smooth attitude and a constant gyro bias; the error of the discretisation is at most kp T / 2 of it."""
    t = np.arange(4000) * STEP_S
    acc_angle, bias = 0.5 * (1 - np.cos(0.7 * t)), 0.02
    rate = 0.35 * np.sin(0.7 * (t - STEP_S / 2)) + bias
    denominator = [1, kp, ki]
    by_acc = signal.lsim(([kp, ki], denominator), acc_angle, t)[1]
    by_gyro = signal.lsim(([1, 0, 0], denominator), acc_angle + bias * t, t)[1]
    found = estimate(one_axis(2, acc_angle, rate), "cf-fixed", {"kp_per_s": kp, "ki_per_s2": ki})
    assert np.abs(angle_of(found.q_nb, 2) - by_acc - by_gyro).max() < (kp * STEP_S / 2 + 0.005) * 0.1


@pytest.mark.slow
def test_it_is_cf_with_the_same_poles(mission):
    """2 zeta w0 = kp, w0^2 = ki; the two take the error over a step differently, which is kp T / 2 = 0.3 % of it."""
    same = {"omega0_radps": 0.1, "zeta": 1.5, "kappa": 1.0, "levelled_by": "estimate"}
    cf = rotation(estimate(mission, "cf", same).q_nb)
    fixed = rotation(estimate(mission, "cf-fixed", {"kp_per_s": 0.3, "ki_per_s2": 0.01}).q_nb)
    assert np.rad2deg((cf * fixed.inv()).magnitude()).max() < 0.05


@pytest.mark.slow
def test_for_a_vehicle_it_is_the_papers_three_euler_angles(mission):
    """Eqs (4)-(10) as printed (with (8) and (9) set right), angle by angle."""
    declination, _ = local_declination(mission.info)
    found = estimate(mission, "cf-fixed", {"kp_per_s": 0.3, "ki_per_s2": 0.01})
    by_angle = per_angle(mission, 0.3, 0.01, declination)
    apart = np.rad2deg((rotation(found.q_nb) * rotation(from_euler(by_angle, "ned")).inv()).magnitude())
    off = np.rad2deg((rotation(found.q_nb) * rotation(mission.truth.q_nb).inv()).magnitude())
    # An integral per Euler angle has to follow when a dive turns the body's axes: the two differ there.
    assert np.sqrt((apart**2).mean()) < 0.03
    assert apart.max() < 0.15
    assert np.sqrt((off**2).mean()) > 1.0


def per_angle(recording, kp, ki, declination):
    """Roll, pitch, heading (N, 3) in North-East-Down, each with its own (10)."""
    imu, mag = recording.imu, recording.mag
    newest = np.maximum(np.searchsorted(mag.t_ns, imu.t_ns, side="right") - 1, 0)
    dt_s = np.diff(imu.t_ns, prepend=imu.t_ns[0]) / 1e9
    out, x, integral = [], None, np.zeros(3)
    for dt, (p, q, r), (ax, ay, az), field in zip(
        dt_s, imu.gyro_b_radps, imu.accel_b_mps2, mag.mag_b_ut[newest], strict=True
    ):
        roll_a, pitch_a = atan2(-ay, -az), atan2(ax, hypot(ay, az))
        if x is None:
            x = np.array([roll_a, pitch_a, compass(field, roll_a, pitch_a) + declination])
        else:
            sr, cr, tp, cp = sin(x[0]), cos(x[0]), tan(x[1]), cos(x[1])
            rates = np.array([p + (q * sr + r * cr) * tp, q * cr - r * sr, (q * sr + r * cr) / cp])
            x = x + dt * (rates + ki * integral)
            measured = np.array([roll_a, pitch_a, compass(field, x[0], x[1]) + declination])
            error = np.array([remainder(d, 2 * pi) for d in measured - x])
            x, integral = x + dt * kp * error, integral + dt * error
        out.append(x)
    return np.array(out)


def compass(field, roll, pitch):
    """Eqs (7), (8)."""
    mx, my, mz = field
    level_x = mx * cos(pitch) + my * sin(roll) * sin(pitch) + mz * cos(roll) * sin(pitch)
    return atan2(-(my * cos(roll) - mz * sin(roll)), level_x)


def test_it_is_the_same_filter_across_the_wrap():
    draw = np.random.default_rng(5)
    rate = np.full(4000, np.deg2rad(30.0))
    turned = np.cumsum(rate) * STEP_S
    noise = draw.normal(0, 0.1, len(rate))
    plain = angle_of(estimate(one_axis(2, noise, np.zeros(len(rate))), "cf-fixed").q_nb, 2)
    turning = angle_of(estimate(one_axis(2, turned + noise, rate), "cf-fixed").q_nb, 2)  # 1200 deg
    assert np.abs(wrap(turning - turned - plain)).max() < 1e-9


@settings(max_examples=40)
@given(
    kp=st.floats(0.0, 10.0),
    ki=st.floats(0.0, 25.0),
    step_s=st.sampled_from([0.002, 0.02, 0.1, 0.5, 1.0]),
    turned=st.floats(-3.1, 3.1),
)
def test_no_gain_is_unstable_at_any_rate(kp, ki, step_s, turned):
    """After a start that is wrong by ``turned`` the error never grows beyond twice that (kp = 0 swings for ever)."""
    stream = Stream("cf-fixed", {"kp_per_s": kp, "ki_per_s2": ki})
    tilted = (0.0, 9.81 * sin(turned), 9.81 * cos(turned))
    for k in range(300):
        out = stream.update(round(k * step_s * 1e9), (0.0, 0.0, 0.0), tilted if k == 0 else (0.0, 0.0, 9.81))
        angle = 2 * atan2(abs(out.q_nb[1]), abs(out.q_nb[0]))
        assert angle <= min(2 * abs(turned), pi) + 1e-6
    if kp >= 0.2 and ki <= kp * kp / 4 and kp * step_s * 300 > 300:
        assert angle < 0.2 * abs(turned) + 1e-9


def test_a_constant_gyro_bias_is_found_and_its_error_vanishes():
    n, draw = 30_000, np.random.default_rng(7)
    rots = Rotation.from_rotvec(np.cumsum(draw.normal(0, 0.002, (n, 3)), axis=0))  # wanders through all attitudes
    t_ns = np.arange(n, dtype=np.int64) * 10_000_000
    gyro = np.vstack([np.zeros(3), (rots[:-1].inv() * rots[1:]).as_rotvec() / STEP_S])
    bias = np.array([0.05, -0.03, 0.02])
    imu = Imu(t_ns, gyro + bias, rots.inv().apply([0, 0, 9.81]))
    mag = Mag(t_ns, rots.inv().apply([0, 20.0, -44.0]))
    found = estimate(Recording("biased", imu, mag=mag, info=Info(units_unchecked=True)), "cf-fixed")
    assert np.allclose(found.gyro_bias_b_radps[-1], bias, atol=2e-4)
    assert np.rad2deg((rotation(found.q_nb[-1]) * rots[-1].inv()).magnitude()) < 0.02


def test_the_bias_is_taken_off_while_the_magnetometer_is_silent():
    """200 s with a field, then 100 s without: a bias of 0.5 deg/s would be 50 deg."""
    rate = np.full(30_000, np.deg2rad(0.5))
    recording = one_axis(2, np.zeros(len(rate)), rate)
    first = recording.mag.t_ns < 200e9
    recording = Recording(
        "silent",
        recording.imu,
        mag=Mag(recording.mag.t_ns[first], recording.mag.mag_b_ut[first]),
        info=Info(units_unchecked=True),
    )
    gains = {"kp_per_s": 1.0, "ki_per_s2": 0.05}
    heading = np.rad2deg(angle_of(estimate(recording, "cf-fixed", gains).q_nb, 2))
    assert abs(heading[-1]) < 0.1


def test_a_slower_magnetometer_gives_eq_10_at_its_own_rate():
    """One field in 20 samples: the recursion over 0.2 s for the heading."""
    draw, every, kp = np.random.default_rng(6), 20, 1.0
    n = 4000
    noise = draw.normal(0, 0.1, n)
    found = estimate(one_axis(2, noise, np.zeros(n), every), "cf-fixed", {"kp_per_s": kp, "ki_per_s2": 0.0})
    x, expected = noise[0], [noise[0]]
    for measured in noise[every::every]:
        x += kp * STEP_S * every * (measured - x)
        expected.append(x)
    assert np.abs(angle_of(found.q_nb[::every], 2) - expected).max() < 1e-9


def test_single_precision_costs_millidegrees_over_a_mission(mission):
    double, single = (estimate(mission, "cf-fixed", precision=precision) for precision in ("double", "single"))
    apart = np.rad2deg((rotation(single.q_nb) * rotation(double.q_nb).inv()).magnitude())
    assert apart.max() < 0.002  # half a unit in the last place of a quaternion is 7e-6 deg
    heading = wrap(euler(single.q_nb, "ned") - euler(double.q_nb, "ned"))[:, 2]
    assert np.rad2deg(np.abs(heading.mean())) < 0.0005
