"""``kf-axis`` against a hand-computed case, a plain matrix Kalman filter, and its own covariance."""

import numpy as np
import pytest
from from_python import from_python
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from stillpoint.datasets import Estimate, Imu, Info, Mag, Recording
from stillpoint.datasets.frames import euler, quaternion, rotation
from stillpoint.datasets.recording import Floats
from stillpoint.filters import Stream, estimate
from stillpoint.filters.euler_axes import STEEP, covariance, euler_frame
from stillpoint.filters.kalman.kf_axis import GIMBAL, Params, remove_coriolis

G = 9.81
NORTH = np.array([0.0, 20.0, 0.0])  # a level field: tilt errors do not leak into the heading
SEEDS = 50


def recorded(t_s: Floats, gyro: Floats, accel: Floats, mag: Floats | None = None) -> Recording:
    t_ns = np.round(t_s * 1e9).astype(np.int64)
    field = None if mag is None else Mag(t_ns, mag)
    return Recording("test", Imu(t_ns, gyro, accel), mag=field, info=Info(units_unchecked=True))


def rolled(angle_rad: Floats) -> Floats:
    """Specific force of a body that lies rolled by these angles."""
    return G * np.column_stack([np.zeros_like(angle_rad), np.sin(angle_rad), np.cos(angle_rad)])


def test_two_steps_agree_with_a_calculation_by_hand() -> None:
    """P starts as 1e-4 I; with dt = 1, R = 1e-4, Q = 0 both gains are (2/3, -1/3), as a sheet of paper shows.

    P- = [[2, -1], [-1, 1]], S = 3, P+ = [[2/3, -1/3], [-1/3, 2/3]]; then P- = [[2, -1], [-1, 2/3]], S = 3,
    P+ = [[2/3, -1/3], [-1/3, 1/3]], all times 1e-4.
    """
    params = {
        "gyro_noise_rad_rts": 2e-8,
        "bias_walk_radps_rts": 0.0,
        "tilt_sd_rad": 0.01,
        "bias_sd_radps": 0.01,
    }
    gyro = np.array([[0.5, 0, 0], [0.1, 0, 0], [0.2, 0, 0]])  # the first describes no interval
    accel = rolled(np.array([0.0, 0.103, 0.309]))
    found = estimate(recorded(np.arange(3.0), gyro, accel), "kf-axis", params)
    roll = euler(found.q_nb, "enu")[:, 0]
    # 0.1 predicted, 0.103 seen: angle 0.102, bias -0.001. Then 0.102 + 0.2 + 0.001 = 0.303 predicted, 0.309 seen.
    assert roll == pytest.approx([0.0, 0.102, 0.307], abs=1e-12)
    assert found.gyro_bias_b_radps[:, 0] == pytest.approx([0.0, -0.001, -0.003], abs=1e-12)
    assert found.innovation[1:, 0] == pytest.approx([0.003 / np.sqrt(3e-4), 0.006 / np.sqrt(3e-4)], rel=1e-9)
    assert np.isnan(found.innovation[0]).all()
    stream = Stream("kf-axis", params)
    for k, p_expected in enumerate([(1, 0, 1), (2 / 3, -1 / 3, 2 / 3), (2 / 3, -1 / 3, 1 / 3)]):
        stream.update(k * 10**9, gyro[k], accel[k])
        assert stream.save().state.roll == pytest.approx(1e-4 * np.array(p_expected), abs=1e-14)


def matrix_filter(t_s: Floats, rate: Floats, seen: Floats, p: Params) -> tuple[Floats, Floats, Floats]:
    """Eqs (8)-(12) as algorithm 1 prints them, with matrices."""
    H, R = np.array([[1.0, 0.0]]), p.tilt_sd_rad**2
    x, P = np.array([seen[0], 0.0]), np.diag([R, p.bias_sd_radps**2])
    out = [(x[0], x[1], P[0, 0])]
    for k in range(1, len(t_s)):
        dt = t_s[k] - t_s[k - 1]
        A = np.array([[1.0, -dt], [0.0, 1.0]])
        x = A @ x + np.array([dt * rate[k], 0.0])
        P = A @ P @ A.T + np.diag([p.gyro_noise_rad_rts**2, p.bias_walk_radps_rts**2]) * dt
        K = P @ H.T / (H @ P @ H.T + R)
        x = x + K[:, 0] * (seen[k] - x[0])
        P = P - K @ H @ P
        out.append((x[0], x[1], P[0, 0]))
    columns = np.array(out).T
    return columns[0], columns[1], columns[2]


@pytest.mark.parametrize("axis", [0, 1])
def test_roll_and_pitch_are_the_matrix_filter_of_the_paper(axis: int) -> None:
    draw = np.random.default_rng(4)
    t_s = np.round(np.cumsum(draw.uniform(0.004, 0.016, 3000)), 9)
    true = np.deg2rad(60) * np.sin(1.3 * t_s)
    rate = np.diff(true, prepend=true[0]) / np.diff(t_s, prepend=t_s[0] - 0.01) + 0.02 + draw.normal(0, 0.02, 3000)
    seen = true + draw.normal(0, 0.05, 3000)
    gyro = np.zeros((3000, 3))
    gyro[:, axis] = rate
    force = np.column_stack([np.zeros(3000), np.sin(seen), np.cos(seen)])
    accel = G * (force if axis == 0 else np.column_stack([-np.sin(seen), np.zeros(3000), np.cos(seen)]))
    found = estimate(recorded(t_s, gyro, accel), "kf-axis")
    angle, bias, variance = matrix_filter(t_s, rate, seen, Params())
    if axis == 0:
        assert euler(found.q_nb, "enu")[:, 0] == pytest.approx(angle, abs=1e-9)
    else:
        assert euler(found.q_nb, "enu")[:, 1] == pytest.approx(angle, abs=1e-9)
    assert found.gyro_bias_b_radps[:, axis] == pytest.approx(bias, abs=1e-9)
    if axis == 1:  # that of roll has the heading's in it, seen from the body
        assert found.cov_b_rad2[:, 1, 1] == pytest.approx(variance, rel=1e-9)


def matched(seed: int, params: Params, seconds: float = 60.0) -> tuple[Recording, Floats, Floats]:
    """A recording whose noise is what the filter assumes; the true attitude and bias at its samples.

    It turns about up while tilted by so little that Euler rates are body rates, and a constant bias is one of either.
    """
    draw = np.random.default_rng(seed)
    dt, n = 0.01, int(seconds * 100)
    t_s = np.arange(1, n + 1) * dt
    angles = np.column_stack([0.01 * np.sin(0.7 * t_s), 0.01 * np.sin(0.5 * t_s + 1), 1.5 * np.sin(0.2 * t_s)])
    true = Rotation.from_euler("ZYX", angles[:, ::-1])
    bias = draw.normal(0, params.bias_sd_radps, 3) + np.vstack(
        [np.zeros(3), np.cumsum(draw.normal(0, params.bias_walk_radps_rts * np.sqrt(dt), (n - 1, 3)), axis=0)]
    )
    before = np.vstack([bias[:1], bias[:-1]])  # the bias at the start of an interval acts in it, as in A
    rate = np.vstack([np.zeros(3), (true[:-1].inv() * true[1:]).as_rotvec() / dt])
    gyro = rate + before + draw.normal(0, params.gyro_noise_rad_rts / np.sqrt(dt), (n, 3))
    accel = true.inv().apply([0, 0, G]) + draw.normal(0, params.tilt_sd_rad * G, (n, 3))
    mag = true.inv().apply(NORTH) + draw.normal(0, params.heading_sd_rad * NORTH[1], (n, 3))
    return recorded(t_s, gyro, accel, mag), true.as_quat(scalar_first=True), bias


MATCHED = Params(tilt_sd_rad=0.02, heading_sd_rad=0.02, bias_sd_radps=0.005, bias_walk_radps_rts=2e-4)


@pytest.fixture(scope="module")
def runs() -> list[tuple[Estimate, Floats, Floats]]:
    made = (matched(seed, MATCHED) for seed in range(SEEDS))
    return [(estimate(recording, "kf-axis", MATCHED), true, bias) for recording, true, bias in made]


def band(degrees_of_freedom: int) -> tuple[float, float]:
    low, high = chi2.ppf([0.025, 0.975], degrees_of_freedom) / degrees_of_freedom
    return float(low), float(high)


@pytest.mark.slow
@pytest.mark.parametrize("at", [500, 2000, 5999])
def test_the_attitude_error_is_as_large_as_its_covariance(runs: list, at: int) -> None:
    nees = []
    for found, true, _ in runs:
        d = (rotation(found.q_nb[at]).inv() * Rotation.from_quat(true[at], scalar_first=True)).as_rotvec()
        nees.append(d @ np.linalg.solve(found.cov_b_rad2[at], d))
    low, high = band(3 * SEEDS)
    assert low < np.mean(nees) / 3 < high


def test_the_innovations_are_as_large_as_their_covariance_and_white(runs: list) -> None:
    nu = np.array([found.innovation[100:] for found, _, _ in runs])
    low, high = band(nu[:, ::600].size)  # every 6 s: independent from run to run and from each other
    assert low < np.mean(nu[:, ::600] ** 2) < high
    # All of them: the band of so many is 0.2 % wide, and the filter knows small angles only.
    assert np.mean(nu**2) == pytest.approx(1.0, abs=0.02)
    following = np.mean(nu[:, 1:] * nu[:, :-1]) / np.mean(nu**2)
    assert abs(following) < 0.01


def test_the_bias_is_found_as_well_as_p_says(runs: list) -> None:
    off = np.array([found.gyro_bias_b_radps[-1] - bias[-1] for found, _, bias in runs])
    # Steady state of the two-state filter: P of the bias from its Riccati equation, solved by running it.
    _, p_bias = steady_p(MATCHED)
    low, high = band(3 * SEEDS)
    assert low < np.mean(off**2) / p_bias < high


def steady_p(p: Params) -> tuple[float, float]:
    P, dt, R = np.diag([p.tilt_sd_rad**2, p.bias_sd_radps**2]), 0.01, p.tilt_sd_rad**2
    A, Q = np.array([[1.0, -dt], [0.0, 1.0]]), np.diag([p.gyro_noise_rad_rts**2, p.bias_walk_radps_rts**2]) * dt
    for _ in range(6000):
        P = A @ P @ A.T + Q
        P = P - np.outer(P[:, 0], P[0]) / (P[0, 0] + R)
    return float(P[0, 0]), float(P[1, 1])


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["double", "single"])
def test_p_stays_positive_over_hours(precision: str) -> None:
    n = 3 * 360_000
    draw = np.random.default_rng(0)
    gyro = draw.normal(0, 0.5, (n, 3))
    accel = np.array([0.0, 0.0, G]) + draw.normal(0, 2.0, (n, 3))
    mag = NORTH + draw.normal(0, 3.0, (n, 3))
    found = estimate(
        recorded(np.arange(n) / 100, gyro, accel, mag), "kf-axis", {"bias_walk_radps_rts": 1e-9}, precision
    )
    cov = found.cov_b_rad2[::1000]
    assert (cov == cov.transpose(0, 2, 1)).all()
    assert np.linalg.eigvalsh(cov).min() > 0
    assert np.isfinite(found.gyro_bias_b_radps).all()


def test_a_start_that_is_sure_of_everything_needs_the_reset() -> None:
    """The paper's remark: without noise of the bias P falls to nothing, and a bias that changes is not followed."""
    n = 60_000
    t_s = np.arange(n) / 100
    gyro = np.zeros((n, 3))
    gyro[t_s > 300, 0] = np.deg2rad(0.5)  # the bias changes after five minutes of rest
    accel = np.tile([0.0, 0.0, G], (n, 1))
    sure = {"bias_walk_radps_rts": 0.0, "gyro_noise_rad_rts": 2e-6, "tilt_sd_rad": 0.05}
    recording = recorded(t_s, gyro, accel)
    never, each_minute = (estimate(recording, "kf-axis", sure | {"reset_s": s}) for s in (0.0, 60.0))
    off_deg = [abs(np.rad2deg(euler(found.q_nb, "enu")[-1, 0])) for found in (never, each_minute)]
    assert off_deg[0] > 5
    assert off_deg[1] < 0.05


@given(st.floats(-89, 89), st.floats(-180, 180), st.floats(-180, 180))
def test_at_rest_the_exact_form_gives_any_pose(pitch: float, roll: float, heading: float) -> None:
    pose = Rotation.from_euler("ZYX", [heading, pitch, roll], degrees=True)
    stream = Stream("kf-axis")
    for k in range(3):
        out = stream.update(k * 10_000_000, (0, 0, 0), pose.inv().apply([0, 0, G]), pose.inv().apply([0, 20, -40]))
    assert (rotation(np.array(out.q_nb)) * pose.inv()).magnitude() < 1e-7


@pytest.mark.parametrize(("form", "roll_deg"), [("euler", 40.0), ("roots", 40.0), ("printed", 32.73)])
def test_each_form_of_equation_14_gives_its_roll(form: str, roll_deg: float) -> None:
    """Without the roots, in g: arctan(sin 40 deg) = 32.73 deg, and 45 deg is the most it can say."""
    accel = np.tile(rolled(np.deg2rad([40.0])), (20_000, 1))
    found = estimate(
        recorded(np.arange(20_000) / 100, np.zeros((20_000, 3)), accel * 9.80665 / G), "kf-axis", {"tilt": form}
    )
    assert np.rad2deg(euler(found.q_nb, "enu")[-1, 0]) == pytest.approx(roll_deg, abs=0.01)


def test_two_axes_tilted_at_once_tell_the_form_with_roots_from_euler_angles() -> None:
    pose = Rotation.from_euler("ZYX", [0, 30, 40], degrees=True)
    n = 20_000
    recording = recorded(np.arange(n) / 100, np.zeros((n, 3)), np.tile(pose.inv().apply([0, 0, G]), (n, 1)))
    roots = np.rad2deg(euler(estimate(recording, "kf-axis", {"tilt": "roots", "tilt_sd_rad": 0.05}).q_nb, "enu")[-1])
    # The elevation of the y axis: arcsin(sin 40 cos 30) = 33.83 deg. Pitch is one already.
    assert roots[:2] == pytest.approx([33.83, 30.0], abs=0.01)


def test_the_speed_removes_the_acceleration_of_a_steady_circle() -> None:
    """20 m/s on a circle at 0.2 rad/s, level: 4 m/s^2 to the side, which look like 22 deg of roll."""
    n, turn_radps, speed_mps = 6000, 0.2, 20.0
    t_s = np.arange(n) / 100
    level = Rotation.from_euler("Z", (turn_radps * t_s)[:, None])
    gyro = np.tile([0.0, 0.0, turn_radps], (n, 1))
    accel = np.tile([0.0, turn_radps * speed_mps, G], (n, 1))
    recording = recorded(t_s, gyro, accel, level.inv().apply(NORTH))
    without, with_term = (
        np.rad2deg(euler(estimate(recording, "kf-axis", {"speed_mps": v, "tilt_sd_rad": 0.05}).q_nb, "enu")[-1, 0])
        for v in (0.0, speed_mps)
    )
    assert abs(without) > 15
    assert abs(with_term) < 0.6  # the start, upright by an accelerometer that was not corrected, wears off


axes = st.tuples(*[st.floats(-20, 20)] * 3)
force_without_coriolis = from_python(remove_coriolis)


@given(axes, axes, st.floats(0, 50))
def test_the_coriolis_term_is_w_cross_v_about_every_axis(force, rate, speed_mps) -> None:
    """V along body x: a loop presses down as a circle presses to the side."""
    expected = np.subtract(force, np.cross(rate, [speed_mps, 0.0, 0.0]))
    assert force_without_coriolis(force, rate, speed_mps) == pytest.approx(expected, abs=1e-9)


def test_fig_2_takes_the_heading_from_the_compass_as_it_is() -> None:
    pose = Rotation.from_euler("ZYX", [30, 4, -7], degrees=True)
    draw = np.random.default_rng(2)
    field = pose.inv().apply(NORTH) + draw.normal(0, 1.0, (500, 3))
    rest = recorded(np.arange(500) / 100, np.zeros((500, 3)), np.tile(pose.inv().apply([0, 0, G]), (500, 1)), field)
    compass, filtered = (estimate(rest, "kf-axis", {"heading": kind}) for kind in ("compass", "filtered"))
    level = Rotation.from_euler("YX", [4, -7], degrees=True).apply(field)
    assert euler(compass.q_nb, "enu")[:, 2] == pytest.approx(np.arctan2(level[:, 0], level[:, 1]), abs=1e-9)
    assert np.ptp(euler(filtered.q_nb, "enu")[400:, 2]) < 0.2 * np.ptp(euler(compass.q_nb, "enu")[400:, 2])


def test_through_the_vertical_the_gyro_alone_is_followed_and_counted() -> None:
    n = 800
    t_s = np.arange(n) / 100
    over = Rotation.from_euler("Y", (np.deg2rad(90) * t_s)[:, None])
    gyro = np.tile([0.0, np.deg2rad(90), 0.0], (n, 1))
    recording = recorded(t_s, gyro, over.inv().apply([0, 0, G]), over.inv().apply([0, 20, -40]))
    found = estimate(recording, "kf-axis")
    assert (rotation(found.q_nb) * over.inv()).magnitude().max() < 1e-6
    vertical = np.abs(np.cos(np.deg2rad(90) * t_s)) < GIMBAL
    assert found.diagnostics["n_gimbal"] == vertical.sum() > 0
    assert np.isnan(found.innovation[vertical][:, :2]).all()


@pytest.mark.parametrize("pitch_deg", [0, 60, 75, 76, 80, 85, 88, 89.5, 90, -80, -88, -90])
def test_the_covariance_is_honest_at_every_pitch(pitch_deg: float) -> None:
    """A minute at rest: three angles on their own say 0.005 deg at 88 deg of pitch, off by 0.3, and 0 at 90."""
    t_s, nees = np.arange(6000) / 100, []
    pose = Rotation.from_euler("ZYX", [20, pitch_deg, 0], degrees=True)
    params = {"tilt_sd_rad": 0.02, "heading_sd_rad": 0.05, "gyro_noise_rad_rts": 1e-3}
    for seed in range(8):
        draw = np.random.default_rng(seed)
        gyro = draw.normal(0, 1e-3, (len(t_s), 3))
        accel = pose.inv().apply([0, 0, G]) + draw.normal(0, 0.05, (len(t_s), 3))
        mag = pose.inv().apply([0, 20, -44]) + draw.normal(0, 0.3, (len(t_s), 3))
        found = estimate(recorded(t_s, gyro, accel, mag), "kf-axis", params)  # refuses a variance that is not positive
        assert np.linalg.eigvalsh(found.cov_b_rad2[::50]).min() > 1e-9
        d = (rotation(found.q_nb[-1]).inv() * pose).as_rotvec()
        nees.append(d @ np.linalg.solve(found.cov_b_rad2[-1], d) / 3)
    assert max(nees) < 1


@pytest.mark.parametrize("precision", ["double", "single"])
def test_a_vertical_x_axis_has_a_positive_covariance(precision: str) -> None:
    """Exactly vertical, where it was singular, and in a stream as in a recording."""
    n = 500
    recording = recorded(
        np.arange(n) / 100, np.zeros((n, 3)), np.tile([G, 0, 0], (n, 1)), np.tile([-44, 20, 0.5], (n, 1))
    )
    found = estimate(recording, "kf-axis", precision=precision)
    assert np.linalg.eigvalsh(found.cov_b_rad2).min() > np.deg2rad(1) ** 2
    stream = Stream("kf-axis", precision=precision)
    for k in range(n):
        out = stream.update(k * 10_000_000, (0, 0, 0), (G, 0, 0), (-44, 20, 0.5))
    assert (np.reshape(out.cov_b_rad2, (3, 3)) == found.cov_b_rad2[-1]).all()


@pytest.mark.slow
def test_the_covariance_goes_over_without_a_step() -> None:
    frames = [
        from_python(euler_frame)(tuple(quaternion(Rotation.from_euler("Y", 75.5 + x, degrees=True)))) for x in (0, 0.1)
    ]
    assert frames[0].cos_pitch > STEEP > frames[1].cos_pitch
    before, after = (np.array(from_python(covariance)(1e-3, 2e-3, 3e-3, frame)) for frame in frames)
    assert np.abs(after - before).max() < 2e-5
