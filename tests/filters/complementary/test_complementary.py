"""``cf`` against scipy's discretisation of Elmi Aziz and Mohseni Araste's eq (11), and what that equation promises."""

import numpy as np
import pytest
from scipy import signal
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from stillpoint.datasets import Imu, Info, Mag, Recording
from stillpoint.datasets.frames import rotation, wrap
from stillpoint.filters import estimate
from stillpoint.filters.complementary.complementary import Params, coefficients, transition_matrix
from stillpoint.filters.fields import LONGEST_HOLD_S

STEP_S = 0.01
DAMPING = [(0.25, 3.0), (1.0, 1.0), (2.0, 0.3), (0.05, 20.0)]


def about(axis: int, angle: np.ndarray) -> Rotation:
    return Rotation.from_rotvec(np.outer(angle, np.eye(3)[axis]))


def one_axis(axis: int, acc_angle: np.ndarray, rate: np.ndarray, mag_every: int = 1) -> Recording:
    """Fields that say ``acc_angle`` and a gyro that says ``rate`` about one axis of n and b alike."""
    n = len(rate)
    t_ns = np.arange(n, dtype=np.int64) * int(STEP_S * 1e9)
    seen = about(axis, acc_angle).inv()
    gyro = np.zeros((n, 3))
    gyro[:, axis] = rate
    mag = Mag(t_ns[::mag_every], seen.apply([0, 20.0, -44.0])[::mag_every])
    return Recording("axis", Imu(t_ns, gyro, seen.apply([0, 0, 9.81])), mag=mag, info=Info(units_unchecked=True))


def angle_of(q_nb: np.ndarray, axis: int) -> np.ndarray:
    return 2 * np.arctan2(q_nb[:, 1 + axis], q_nb[:, 0])


def eq_11(acc_angle: np.ndarray, rate: np.ndarray, w0: float, zeta: float, step_s: float = STEP_S) -> np.ndarray:
    """scipy's zero-order hold of (11): gyro + F(s) (acc - gyro), the difference held over the interval it ends."""
    gyro_angle = acc_angle[0] + np.concatenate([[0], np.cumsum(rate[1:] * step_s)])
    ones = [2 * zeta * w0, w0**2], [1, 2 * zeta * w0, w0**2]
    b, a, _ = signal.cont2discrete(ones, step_s, method="zoh")
    difference = np.concatenate([acc_angle[1:] - gyro_angle[1:], [0]])
    start = np.zeros(2)  # the estimate begins on the acc angle, which is where the gyro angle begins
    return gyro_angle + signal.lfilter(b.ravel(), a, difference, zi=start)[0]


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(("w0", "zeta"), DAMPING)
def test_about_one_axis_cf_is_scipys_discretisation_of_11(axis: int, w0: float, zeta: float) -> None:
    draw = np.random.default_rng(4)
    n = 3000
    rate = 0.8 * np.sin(np.arange(n) * STEP_S) + 0.03  # with a bias
    true = np.concatenate([[0], np.cumsum(rate[1:] - 0.03) * STEP_S])
    acc_angle = true + draw.normal(0, 0.2, n) * (np.arange(n) > 0)
    params = {"omega0_radps": w0, "zeta": zeta, "kappa": 1.0}
    found = estimate(one_axis(axis, acc_angle, rate), "cf", params)
    assert np.abs(wrap(angle_of(found.q_nb, axis) - eq_11(acc_angle, rate, w0, zeta))).max() < 1e-9


def test_it_is_the_same_filter_across_the_wrap() -> None:
    rate = np.full(4000, np.deg2rad(30.0))
    draw = np.random.default_rng(5)
    acc_angle = np.cumsum(rate) * STEP_S + draw.normal(0, 0.1, len(rate))  # 1200 deg
    found = estimate(one_axis(2, acc_angle, rate), "cf", {"kappa": 1.0})
    assert np.abs(wrap(angle_of(found.q_nb, 2) - eq_11(acc_angle, rate, 0.25, 3.0))).max() < 1e-9


def test_a_slower_magnetometer_gives_11_at_its_own_rate() -> None:
    """Each field stands for the time since the one before, so at its stamps the heading is (11) at that step."""
    draw = np.random.default_rng(6)
    n, every = 4000, 20
    rate = 0.4 * np.sin(np.arange(n) * STEP_S) + 0.02
    acc_angle = np.cumsum(rate) * STEP_S + draw.normal(0, 0.1, n)
    found = estimate(one_axis(2, acc_angle, rate, every), "cf", {"kappa": 1.0})
    mean_rate = np.concatenate([[0], rate[1:].cumsum()])[::every]
    coarse = eq_11(acc_angle[::every], np.diff(mean_rate, prepend=0) / every, 0.25, 3.0, STEP_S * every)
    assert np.abs(wrap(angle_of(found.q_nb[::every], 2) - coarse)).max() < 1e-9


@pytest.mark.parametrize(("w0", "zeta"), DAMPING)
@pytest.mark.parametrize("dt_s", [1e-6, 1e-3, 0.01, 0.3, 1.0, 30.0, 3600.0])
def test_the_transition_is_the_matrix_exponential(w0: float, zeta: float, dt_s: float) -> None:
    c = coefficients(Params(omega0_radps=w0, zeta=zeta), 0.0)
    exact = expm(np.array([[-2 * zeta * w0, -1], [w0**2, 0]]) * dt_s)
    assert np.allclose(np.reshape(transition_matrix(dt_s, c), (2, 2)), exact, atol=1e-10)


def test_a_constant_gyro_bias_is_found_and_its_error_vanishes() -> None:
    """F(0) = 1: the steady error of (11) for a constant bias is 0, and -b is that bias, in body axes."""
    n = 30_000
    draw = np.random.default_rng(7)
    rots = Rotation.from_rotvec(np.cumsum(draw.normal(0, 0.002, (n, 3)), axis=0))  # wanders through all attitudes
    t_ns = np.arange(n, dtype=np.int64) * 10_000_000
    gyro = np.vstack([np.zeros(3), (rots[:-1].inv() * rots[1:]).as_rotvec() / STEP_S])
    bias = np.array([0.05, -0.03, 0.02])
    recording = Recording(
        "biased",
        Imu(t_ns, gyro + bias, rots.inv().apply([0, 0, 9.81])),
        mag=Mag(t_ns, rots.inv().apply([0, 20.0, -44.0])),
        info=Info(units_unchecked=True),
    )
    found = estimate(recording, "cf", {"kappa": 1.0})
    assert found.gyro_bias_b_radps is not None
    assert np.allclose(found.gyro_bias_b_radps[-1], bias, atol=2e-4)
    assert np.rad2deg((rotation(found.q_nb[-1]) * rots[-1].inv()).magnitude()) < 0.02


def test_levelled_by_its_own_tilt_the_heading_ignores_accelerations() -> None:
    """Pushed to the side at 5 m/s^2, acc tilts by 27 deg; the dipping field, levelled by that, points elsewhere."""
    n = 1000
    t_ns = np.arange(n, dtype=np.int64) * 10_000_000
    accel = np.tile([5.0, 0.0, 9.81], (n, 1))
    accel[:200] = [0.0, 0.0, 9.81]
    recording = Recording(
        "pushed",
        Imu(t_ns, np.zeros((n, 3)), accel),
        mag=Mag(t_ns, np.tile([0.0, 20.0, -44.0], (n, 1))),
        info=Info(units_unchecked=True),
    )

    def heading_deg(levelled_by: str) -> float:
        q_nb = estimate(recording, "cf", {"levelled_by": levelled_by}).q_nb[215]  # 0.15 s after the push
        return float(abs(np.rad2deg(2 * np.arctan2(q_nb[3], q_nb[0]))))

    assert heading_deg("acc") > 5
    assert heading_deg("estimate") < heading_deg("acc") / 4


@pytest.mark.parametrize(("pause_s", "hold_s"), [(0.5, 0.5), (20.0, LONGEST_HOLD_S)])
def test_after_a_pause_of_the_magnetometer_one_field_counts_for_a_second_at_most(pause_s, hold_s) -> None:
    """A single field, 40 deg off: over 20 s (11) would follow it all the way, over 1 s by 1 - its transition."""
    t_s = np.arange(0, 31 + pause_s, STEP_S)
    t_ns = np.round(t_s * 1e9).astype(np.int64)
    n = len(t_ns)
    first_s = np.arange(0, 30, STEP_S)
    mag_ns = np.append(np.round(first_s * 1e9), round((first_s[-1] + pause_s) * 1e9)).astype(np.int64)
    turned = np.deg2rad(40.0)
    field = np.vstack(
        [np.tile([0.0, 20.0, -44.0], (len(first_s), 1)), [20 * np.sin(turned), 20 * np.cos(turned), -44.0]]
    )
    recording = Recording(
        "paused",
        Imu(t_ns, np.zeros((n, 3)), np.tile([0, 0, 9.81], (n, 1))),
        mag=Mag(mag_ns, field),
        info=Info(units_unchecked=True),
    )
    q_nb = estimate(recording, "cf", {"kappa": 1.0}).q_nb
    at = np.searchsorted(t_ns, mag_ns[-1])
    before, after = angle_of(q_nb[[at - 1, at]], 2)
    left = transition_matrix(hold_s, coefficients(Params(), 0.0))[0]
    assert before == pytest.approx(0.0, abs=1e-9)
    assert after == pytest.approx(turned * (1 - left), rel=1e-6)


def test_ready_means_three_time_constants_after_the_start_and_after_a_gap() -> None:
    t_s = np.arange(0, 20, STEP_S)
    t_s = t_s[(t_s < 8) | (t_s > 10)]
    n = len(t_s)
    imu = Imu(np.round(t_s * 1e9).astype(np.int64), np.zeros((n, 3)), np.tile([0, 0, 9.81], (n, 1)))
    ready = estimate(Recording("ready", imu, info=Info(units_unchecked=True)), "cf").ready
    assert ready is not None
    changes = t_s[np.flatnonzero(np.diff(ready, prepend=False))]
    assert changes == pytest.approx([2.0, 10.01, 12.01], abs=0.011)  # 3 / (2 zeta w0) = 2 s
