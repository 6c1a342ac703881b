"""Observation, EKF and AEKF of paper 000: by hand, by closed form, beside a plain version, and what comes of them."""

import pickle
from dataclasses import replace
from math import sqrt

import numpy as np
import pytest
from scipy.stats import chi2
from spins import CONSTANT, VARIABLE, exact, spoilt

from stillpoint.datasets import BadParameter, BadRecording, Imu, Info, Recording, read, write
from stillpoint.datasets.recording import Spin, SpinGeometry
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.spin import BENCH, FIVE_ACCELEROMETERS, channels, measure, specific_force
from stillpoint.filters import estimate, roll_ekf, roll_front
from stillpoint.filters.roll_noise import spin_channels
from stillpoint.filters.roll_stream import RollStream
from stillpoint.filters.table import ROLLS
from stillpoint.scoring.roll import compare_roll, score_roll

T, Q, R = 0.004, 0.5, 80.0
PAPER = {**CONSTANT, "first_rate": "first"}


def bench(f4, f5, dt_s=T) -> Recording:
    t_ns = np.round(np.arange(len(f4)) * dt_s * 1e9).astype(np.int64)
    return Recording("bench", spin=Spin(t_ns, np.column_stack([f4, f5]), np.empty((len(f4), 0)), BENCH))


def plain(f4, f5, mode=None, window=5, over=5, literal=False) -> tuple[list[float], list[float]]:
    """Eqs (12), (13), (15)-(23) one by one, as a student would write them; rate and variance."""
    x = sqrt(-f4[0] / 0.1)
    p = R / (2 * x) ** 2
    rates, variances, squares = [x], [p], []
    for k in range(1, len(f4)):
        x, p = x + T * f5[k - 1] / 0.5, p + (Q if literal else T * T * Q)
        h, e = 2 * x, -f4[k] / 0.1 - x * x
        c = h * p * h + R
        squares.append(e * e)
        alpha = fade = 1.0
        if mode and len(squares) >= window:
            alpha = max(1.0, sum(squares[-window:]) / over / c)
            if mode == "system":
                fade = max(1.0, (alpha * h * p * h + (alpha - 1) * R) / (h * p * h))
        gain = fade / alpha * p * h / c
        x, p = x + gain * e, (1 - gain * h) * fade * p
        rates.append(x)
        variances.append(p)
    return rates, variances


def test_two_steps_of_the_ekf_by_hand():
    """F4 = -122.5, -124 and F5 = 1: x0 = 35, P0 = 80 / 70^2; x- = 35.008, P- = P0 + 8e-6; H = 70.016."""
    found = estimate(bench([-122.5, -124.0], [1.0, 0.0]), "roll-ekf", PAPER)
    p = 80 / 4900 + 8e-6
    gain = p * 70.016 / (70.016**2 * p + 80)
    assert found.rate_radps == pytest.approx([35.0, 35.008 + gain * (1240 - 35.008**2)], rel=1e-14)
    assert found.rate_sd_radps[1] ** 2 == pytest.approx((1 - gain * 70.016) * p, rel=1e-12)
    assert found.angle_rad == pytest.approx([0.0, T * found.rate_radps.mean()], rel=1e-14)
    assert found.innovation[1, 0] == pytest.approx((1240 - 35.008**2) / sqrt(70.016**2 * p + 80), rel=1e-12)


@pytest.mark.parametrize(
    ("name", "settings", "keywords"),
    [
        ("roll-ekf", {}, {}),
        ("roll-ekf", {"process_noise": "literal"}, {"literal": True}),
        ("roll-aekf", {"mode": "observation"}, {"mode": "observation"}),
        ("roll-aekf", {"mode": "observation", "mean": "literal"}, {"mode": "observation", "over": 4}),
        (
            "roll-aekf",
            {"mode": "system", "window": 10, "largest_lambda": 1e12},
            {"mode": "system", "window": 10, "over": 10},
        ),
        (
            "roll-aekf",
            {"mode": "system", "process_noise": "literal", "mean": "literal"},
            {"mode": "system", "literal": True, "over": 4},
        ),
    ],
)
def test_the_compiled_filters_are_the_equations(name, settings, keywords):
    spin = simulate("spin-constant", seed=4, sensor="glitch").spin
    f4, f5 = spin.accel_mps2.T
    kept = np.abs(f4) < 156  # saturated samples are not used, which the plain version does not know
    found = estimate(bench(f4[kept], f5[kept]), name, {**PAPER, **settings})
    rates, variances = plain(f4[kept], f5[kept], **keywords)
    assert found.rate_radps == pytest.approx(rates, rel=1e-9)
    assert found.rate_sd_radps**2 == pytest.approx(variances, rel=1e-6)


def test_the_steady_gain_is_that_of_the_riccati_equation():
    """At a constant rate P-^2 / (P- + R / H^2) = T^2 Q has the root below; K H = 0.022 for the paper's constants."""
    found = estimate(bench(np.full(4000, -124.3), np.zeros(4000)), "roll-ekf", CONSTANT)
    q, r = T * T * Q, R / (4 * 1243.0)
    ahead = (q + sqrt(q * q + 4 * q * r)) / 2
    assert found.rate_sd_radps[-1] ** 2 == pytest.approx(ahead - q, rel=1e-9)
    assert (1 - (ahead - q) / ahead) == pytest.approx(0.022, abs=5e-4)


def test_with_q_as_printed_the_ekf_is_the_observation():
    """K H = 0.97 at constant, 0.999 at variable speed: findings on paper 000, table A1."""
    recording = simulate("spin-variable", seed=1, sensor="white")
    literal = score_roll(
        estimate(recording, "roll-ekf", {**VARIABLE, "process_noise": "literal"}), recording.roll_truth
    )
    raw = score_roll(estimate(recording, "roll-obs", VARIABLE), recording.roll_truth)
    assert literal.rate_rmse_degps == pytest.approx(raw.rate_rmse_degps, rel=0.002)


def test_lambda_twice_loses_the_variance_and_is_refused_in_one_line():
    recording = simulate("spin-variable", seed=0, sensor="white")
    settings = {**VARIABLE, "mode": "system", "window": 10}
    with pytest.raises(BadParameter, match=r"variance is not positive at sample \d+ .* fading = once") as refusal:
        estimate(recording, "roll-aekf", {**settings, "fading": "literal", "first_rate": "first"})
    assert "\n" not in str(refusal.value)
    stream = RollStream("roll-aekf", BENCH, {**settings, "fading": "literal"})
    answers = [
        stream.update(int(t), row) for t, row in zip(recording.spin.t_ns, recording.spin.accel_mps2, strict=True)
    ]
    assert stream.counts["n_variance_not_positive"] > 0
    assert not answers[-1].ready
    assert np.isfinite([answer.rate_radps for answer in answers]).all()


@pytest.mark.parametrize("mode", ["observation", "system"])
@pytest.mark.parametrize("sensor", ["white", "glitch", "adxl345"])
def test_lambda_once_never_loses_it(mode, sensor):
    for process_noise in ("per-step", "literal"):
        recording = simulate("spin-variable", seed=2, sensor=sensor)
        found = estimate(recording, "roll-aekf", {**VARIABLE, "mode": mode, "process_noise": process_noise})
        assert (found.rate_sd_radps > 0).all()
        assert np.isfinite(found.rate_radps).all()


def test_alpha_is_1_until_as_many_innovations_are_there():
    """A glitch among the first four samples after the start finds a plain EKF, one after them does not."""
    for place, same in ((3, True), (40, False)):
        recording = spoilt(lambda accel, place=place: accel.__setitem__((place, 0), accel[place, 0] + 60.0))
        ekf, aekf = (estimate(recording, name, PAPER).rate_radps for name in ("roll-ekf", "roll-aekf"))
        assert (ekf[place] == aekf[place]) == same


def test_the_paper_s_numbers_of_white_noise():
    """R / (2 omega) alone gives 7.25 and 5.84 deg/s; the Riccati equation 1.08 and 2.09 for the EKF."""
    for kind, settings, ekf, raw in (("spin-constant", CONSTANT, 1.06, 7.25), ("spin-variable", VARIABLE, 2.08, 5.84)):
        recordings = [simulate(kind, seed=seed, sensor="white") for seed in range(10)]
        assert rms(recordings, "roll-obs", settings, "rate_rmse_degps") == pytest.approx(raw, abs=0.1)
        assert rms(recordings, "roll-ekf", settings, "rate_rmse_degps") == pytest.approx(
            ekf, abs=0.05 if kind == "spin-constant" else 0.1
        )


def test_glitches_give_the_paper_s_order():
    recordings = [simulate("spin-constant", seed=seed, sensor="glitch") for seed in range(10)]
    settings = {**CONSTANT, "saturated": "use"}  # as the paper, which has no test for it
    found = {name: [score_roll(estimate(r, name, settings), r.roll_truth) for r in recordings] for name in ROLLS}
    in_order = [
        all(
            getattr(aekf, figure) < getattr(ekf, figure) < getattr(raw, figure)
            for figure in ("rate_rmse_degps", "rate_max_degps")
        )
        for aekf, ekf, raw in zip(found["roll-aekf"], found["roll-ekf"], found["roll-obs"], strict=True)
    ]
    assert sum(in_order) >= 9
    assert sqrt(np.mean([s.rate_rmse_degps**2 for s in found["roll-aekf"]])) <= 0.25
    assert sqrt(np.mean([s.angle_rmse_deg**2 for s in found["roll-aekf"]])) <= 0.6


def test_the_replica_has_the_paper_s_sizes():
    """The paper prints 3 deg, 20.92 and 1.25 deg/s for the worst of its ten trials with the AEKF."""
    printed = {"process_noise": "literal", "first_rate": "first", "mean": "literal", "saturated": "use"}
    scores = []
    for seed in range(10):
        recording = simulate("spin-constant", seed=seed, sensor="replica")
        scores.append(score_roll(estimate(recording, "roll-aekf", {**CONSTANT, **printed}), recording.roll_truth))
    assert max(s.angle_max_deg for s in scores) == pytest.approx(3, abs=1)
    assert 20 <= max(s.rate_max_degps for s in scores) <= 30
    assert 1.2 <= max(s.rate_rmse_degps for s in scores) <= 1.4


def rms(recordings, name, settings, figure) -> float:
    return sqrt(
        np.mean([getattr(score_roll(estimate(r, name, settings), r.roll_truth), figure) ** 2 for r in recordings])
    )


@pytest.mark.parametrize("name", ["roll-obs", "roll-ekf", "roll-guarded"])
def test_the_stated_sd_of_angle_and_rate_fit_white_noise(name):
    """(error / sd)^2 at the ends of 40 runs is chi-square of 40 degrees; the angle's error is a walk, so only its end
    counts."""
    ends = []
    for seed in range(40):
        recording = simulate("spin-constant", seed=seed, minutes=0.1, sensor="white")
        c = compare_roll(estimate(recording, name, CONSTANT), recording.roll_truth)
        ends.append((c.angle_error_rad[-1] / c.angle_sd_rad[-1], c.rate_error_radps[-1] / c.rate_sd_radps[-1]))
    for total in np.sum(np.square(ends), axis=0):
        assert chi2.ppf(0.001, 40) < total < chi2.ppf(0.999, 40)


def untidy() -> Recording:
    """Irregular stamps, lost and saturated values, glitches."""
    recording = simulate("spin-constant", seed=3, minutes=0.02, sensor="glitch")
    spin = recording.spin
    accel = spin.accel_mps2.copy()
    accel[50], accel[60, 1], accel[70:73, 0], accel[80, 0], accel[3, 0] = np.nan, np.nan, -156.9, -20.0, np.nan
    rng = np.random.default_rng(1)
    t_ns = spin.t_ns + rng.integers(0, 1_000_000, len(spin.t_ns))
    kept = rng.random(len(t_ns)) > 0.05
    return Recording("untidy", spin=Spin(t_ns[kept], accel[kept], spin.gyro_radps[kept], spin.geometry))


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("name", ROLLS)
def test_a_stream_is_the_batch_bit_for_bit_also_when_cut_in_two(name, precision):
    spin = untidy().spin
    batch = estimate(untidy(), name, CONSTANT, precision)
    stream = RollStream(name, BENCH, CONSTANT, precision)
    answers = []
    for k, (t_ns, row) in enumerate(zip(spin.t_ns, spin.accel_mps2, strict=True)):
        if k == len(spin.t_ns) // 2:
            stream = RollStream(name, BENCH, CONSTANT, precision, saved=pickle.loads(pickle.dumps(stream.save())))
        answers.append(stream.update(int(t_ns), row))
    for field in ("angle_rad", "rate_radps", "angle_sd_rad", "rate_sd_radps", "ready"):
        assert np.array_equal([getattr(answer, field) for answer in answers], getattr(batch, field)), field
    if batch.innovation is not None:
        assert np.array_equal([answer.innovation for answer in answers], batch.innovation[:, 0], equal_nan=True)
    met = {key: count for key, count in stream.counts.items() if key != "n_out_of_order"}
    assert met.items() <= batch.diagnostics.items()


def of_five(n: int = 800) -> Recording:
    """Five accelerometers and gyros about all axes, in a spin that turns over, with values lost and at the range."""
    rng = np.random.default_rng(5)
    geometry = replace(FIVE_ACCELEROMETERS, gyro_axis_b=np.eye(3))
    t_ns = np.cumsum(rng.integers(1_000_000, 6_000_000, n))
    rate = np.column_stack([30 * np.cos(t_ns / 1e9), np.sin(3e-9 * t_ns), np.cos(2e-9 * t_ns)])
    change = np.column_stack([-30 * np.sin(t_ns / 1e9), 3 * np.cos(3e-9 * t_ns), -2 * np.sin(2e-9 * t_ns)])
    force = [specific_force(arm, np.array([0.0, 1.0, 9.0]), rate, change) for arm in geometry.accel_r_b_m]
    accel = np.column_stack([each @ axis for each, axis in zip(force, geometry.accel_axis_b, strict=True)])
    accel += rng.normal(0.0, 0.1, accel.shape)
    gyro = rate + rng.normal(0.0, 0.01, rate.shape)
    accel[rng.random(accel.shape) < 0.01], accel[rng.random(accel.shape) < 0.01] = np.nan, -156.9
    gyro[rng.random(gyro.shape) < 0.01] = np.nan
    return Recording("five", spin=Spin(t_ns, accel, gyro, geometry))


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("saturated", ["skip", "use"])
def test_gyros_and_further_accelerometers_are_the_batch_too(precision, saturated):
    spin = of_five().spin
    params = {"saturated": saturated}
    batch = estimate(of_five(), "roll-ekf", params, precision)
    stream = RollStream("roll-ekf", spin.geometry, params, precision)
    rows = zip(spin.t_ns.tolist(), spin.accel_mps2.tolist(), spin.gyro_radps.tolist(), strict=True)
    answers = np.array([stream.update(*row) for row in rows])
    assert np.array_equal(answers[:, 0], batch.angle_rad)
    assert np.array_equal(answers[:, 3], batch.rate_sd_radps)
    assert stream.counts.items() <= batch.diagnostics.items()
    assert batch.rate_radps.min() < -20  # so the gyro about x took part


@pytest.mark.parametrize("make", [untidy, of_five])
def test_the_compiled_channels_are_those_of_the_doctor_and_the_smoother(make):
    spin, params = make().spin, roll_ekf.Params()
    by = spin_channels(params, spin.geometry)
    seen = measure(spin, by)
    c = roll_front.coefficients(by, params, "double")
    _, log = roll_front.run(spin.t_ns, spin.accel_mps2, spin.gyro_radps, roll_front.start(), c)
    assert np.array_equal(log.has_accel, seen.omega_dot_valid)
    assert np.array_equal(log.has_square, seen.omega_squared_valid)
    assert np.array_equal(log.accel_radps2, seen.omega_dot_radps2, equal_nan=True)
    assert np.array_equal(log.square_rad2ps2, seen.omega_squared_radps2, equal_nan=True)


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("name", ROLLS)
@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan, 1e300, 9e8, -9e8])
def test_no_value_whatever_poisons_a_stream(name, precision, value):
    stream = RollStream(name, replace(BENCH, accel_range_mps2=None), CONSTANT, precision)
    for k in range(200):
        good = (-0.1 * 35**2, 0.0)
        bad = ((value, value), (value, 0.0), (good[0], value), (0.0, 0.0))[k % 4]
        said = stream.update(k * 4_000_000, bad if 50 <= k < 70 else good)
        assert np.isfinite(said[:4]).all()


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("name", ROLLS)
def test_within_the_range_and_gaps_of_a_second_every_answer_is_finite(name, precision):
    rng = np.random.default_rng(0)
    values = [0.0, 1e-300, 1.0, -124.0, 156.0, -156.0, 1e4, -9e8, 1e300, np.nan, np.inf]
    for geometry in (BENCH, FIVE_ACCELEROMETERS) * 10:
        stream, t_ns = RollStream(name, geometry, None, precision), 0
        for _ in range(60):
            t_ns += int(rng.choice([1, 4_000_000, 1_000_000_000], p=[0.05, 0.9, 0.05]))
            accel = rng.choice(values, len(geometry.accel_axis_b))
            said = stream.update(t_ns, accel, rng.choice([0.0, 35.0, -35.0, np.nan], len(geometry.gyro_axis_b)))
            assert np.isfinite(said[:4]).all()


def test_another_number_of_values_is_refused_in_one_line():
    stream = RollStream("roll-ekf", BENCH, CONSTANT)
    with pytest.raises(BadParameter, match="3 accelerometers and 0 gyros: the geometry has 2 and 0"):
        stream.update(0, (1.0, 2.0, 3.0))
    other = RollStream("roll-ekf", BENCH, CONSTANT, "single").save()
    with pytest.raises(BadParameter, match="of roll-ekf single, not of roll-ekf double"):
        RollStream("roll-ekf", BENCH, CONSTANT, saved=other)


def test_a_stamp_that_does_not_rise_is_left_out_and_counted():
    stream = RollStream("roll-ekf", BENCH, CONSTANT)
    first = stream.update(1000, (-124.0, 0.0))
    assert np.array_equal(stream.update(1000, (-60.0, 9.0)), first, equal_nan=True)
    assert stream.counts["n_out_of_order"] == 1


@pytest.mark.parametrize("name", ROLLS)
def test_single_precision_holds_the_angle_over_168_turns(name):
    """1057 rad have steps of 1.2e-4 rad in float32; whole turns and a rest do not."""
    recording = simulate("spin-constant", seed=0, sensor="white")
    double, single = (estimate(recording, name, CONSTANT, precision) for precision in ("double", "single"))
    assert double.angle_rad[-1] > 1050
    assert np.rad2deg(np.abs(single.angle_rad - double.angle_rad).max()) < 0.02
    assert single.rate_radps.tolist() == single.rate_radps.astype(np.float32).tolist()


@pytest.mark.parametrize("name", ["roll-obs", "roll-ekf", "roll-aekf"])
def test_perfect_sensors_give_the_truth(name):
    """Spin up by 6 rad/s^2 from 10 rad/s: constant angular acceleration, which the filters integrate exactly."""
    recording = exact(lambda t: 10 + 6 * t, lambda t: np.full(len(t), 6.0))
    s = score_roll(estimate(recording, name, CONSTANT), recording.roll_truth)
    assert s.rate_max_degps < 1e-6
    assert s.angle_max_deg < 1e-3  # the truth of the test is a sum over 0.1 ms


@pytest.mark.parametrize("name", ROLLS)
def test_nothing_poisons_a_filter_and_what_is_left_out_is_counted(name):
    def spoil(accel):
        accel[2000], accel[3000:3010, 0], accel[4000:4050, 1], accel[5000:5003, 0] = np.nan, np.nan, np.nan, -157.0

    recording = spoilt(spoil)
    found = estimate(recording, name, CONSTANT)
    assert score_roll(found, recording.roll_truth).rate_rmse_degps < 1.5
    assert found.diagnostics["n_lost"] == 61
    assert found.diagnostics["n_saturated"] == 3
    assert found.diagnostics["n_no_square"] == 14
    assert found.diagnostics["n_no_accel"] >= 51


def with_gyro(sense: float) -> Recording:
    """The bench with a gyro about the axis that saturates at 17 rad/s, spinning at 30 rad/s."""
    geometry = SpinGeometry(BENCH.accel_r_b_m, BENCH.accel_axis_b, np.array([[1.0, 0, 0]]), fixed_axis=True)
    return exact(
        lambda t: np.full(len(t), 30 * sense),
        np.zeros_like,
        geometry=geometry,
        gyro=lambda t: np.full(len(t), 17 * sense),
    )


@pytest.mark.parametrize("name", ROLLS)
@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_saturated_gyro_still_tells_the_sense(name, sense):
    found = estimate(with_gyro(sense), name, CONSTANT)
    assert found.rate_radps == pytest.approx(30 * sense, rel=1e-9)
    assert found.angle_rad[-1] == pytest.approx(sense * 30 * 0.004 * 999, rel=1e-6)
    assert "gyro" in found.diagnostics["direction"]


@pytest.mark.parametrize("name", ROLLS)
def test_without_it_the_sense_is_assumed_and_said(name):
    recording = exact(lambda t: np.full(len(t), -30.0), np.zeros_like)
    assert estimate(recording, name, CONSTANT).rate_radps[-1] == pytest.approx(30)
    assert estimate(recording, name, CONSTANT).diagnostics["direction"].startswith("assumed positive")
    assert estimate(recording, name, {"direction": "negative"}).rate_radps[-1] == pytest.approx(-30)


def test_the_sense_is_seen_by_an_accelerometer_off_the_plane():
    """An accelerometer along y at r_x = 0.2 m reads r_x w_x w_y + r_x w_z' - ...; beside w_y it has the sign of w_x."""
    geometry = FIVE_ACCELEROMETERS
    arms = np.vstack([geometry.accel_r_b_m, [0.2, 0, 0], [-0.2, 0, 0], [0, 0.2, 0]])
    axes = np.vstack([geometry.accel_axis_b, [0, 1.0, 0], [0, 0, 1.0], [1.0, 0, 0]])
    wide = SpinGeometry(arms, axes, geometry.gyro_axis_b)
    assert channels(wide).omega_xy is not None or channels(wide).omega_xz is not None
    t_s = np.arange(0, 2, 0.004)
    for sense in (1.0, -1.0):
        rate = np.column_stack([np.full(len(t_s), 30 * sense), 0.5 * np.ones(len(t_s)), 0.3 * np.ones(len(t_s))])
        felt = [
            specific_force(arm, np.zeros(3), rate, np.zeros(3)) @ axis for arm, axis in zip(arms, axes, strict=True)
        ]
        t_ns = np.round(t_s * 1e9).astype(np.int64)
        found = estimate(Recording("wide", spin=Spin(t_ns, np.column_stack(felt), rate[:, 1:], wide)), "roll-ekf")
        assert found.rate_radps[-1] == pytest.approx(30 * sense, rel=1e-3)
        assert "products" in found.diagnostics["direction"]


def test_a_filter_goes_through_zero_by_the_angular_acceleration_and_says_so():
    """From 12 to -12 rad/s: the EKF's gain vanishes with the rate, so it comes out on the right side; the observation
    cannot. Within sqrt(sqrt(R)) = 3 rad/s, half a second of two, the square tells nothing."""
    recording = exact(lambda t: 12 - 12 * t, lambda t: np.full(len(t), -12.0), seconds=2)
    ekf = estimate(recording, "roll-ekf", CONSTANT)
    assert ekf.rate_radps == pytest.approx(recording.roll_truth.rate_radps, abs=1e-6)
    assert ekf.diagnostics["n_near_zero"] == pytest.approx(0.5 * 250, abs=3)
    raw = estimate(recording, "roll-obs", CONSTANT)
    assert raw.rate_radps == pytest.approx(np.abs(recording.roll_truth.rate_radps), abs=1e-6)


def test_an_estimate_of_roll_goes_to_a_file_and_back(tmp_path):
    found = estimate(untidy(), "roll-guarded", CONSTANT)
    write(tmp_path / "x.roll-guarded.estimate.mcap", found)
    back = read(tmp_path / "x.roll-guarded.estimate.mcap")
    for field in ("angle_rad", "rate_radps", "angle_sd_rad", "rate_sd_radps", "ready"):
        assert getattr(back, field).tolist() == getattr(found, field).tolist()
    assert back.q_nb is None
    assert dict(back.params) == dict(found.params)
    assert dict(back.diagnostics) == dict(found.diagnostics)


def test_what_does_not_fit_is_one_line():
    imu = Imu(np.arange(3), np.zeros((3, 3)), np.tile([0, 0, 9.8], (3, 1)))
    with pytest.raises(BadRecording, match="no accelerometers on a spinning body"):
        estimate(Recording("x", imu, info=Info(units_unchecked=True)), "roll-ekf")
    with pytest.raises(BadParameter, match="radial_var_m2ps4"):
        estimate(untidy(), "roll-ekf", {"radial_var_m2ps4": 0.0})
    with pytest.raises(BadParameter, match="estimates an attitude"):
        RollStream("cf", BENCH)
