"""The graph of a spinning body against the same least squares written out in full, and against known truth."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import solveh_banded
from scipy.stats import chi2

from stillpoint.datasets import Encoder, Spin, SpinGeometry, Unobservable, read, write
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.simulate import spin as simulated
from stillpoint.datasets.simulate.spin_sensor import CONSTANT
from stillpoint.datasets.spin import BENCH
from stillpoint.scripts.disc_flight import disc_flight
from stillpoint.scripts.settings_pages import refreshed
from stillpoint.smoother import reference
from stillpoint.smoother.roll_chain import angles_of, chain_of
from stillpoint.smoother.roll_encoder import readings_of, resolution_rad
from stillpoint.smoother.roll_graph import accuracy_of, eliminated, prior_of, step_of
from stillpoint.smoother.roll_line import Line
from stillpoint.smoother.roll_params import RollCalibration, RollGraphParams, RollNoise
from stillpoint.smoother.roll_rows import fit, mean_weight, roots_of, sizes_of
from stillpoint.smoother.roll_samples import samples_of
from stillpoint.smoother.roll_state import CONSTANTS, COS_A, COS_S, SIN_A, SIN_S, RollState, in_blocks

GIVEN = RollNoise(source="given", accel_sd_radps2=0.12**0.5 / 0.5, squared_sd_rad2ps2=0.8**0.5 / 0.1)
RIG = RollGraphParams(calibration=RollCalibration(accel_bias_sd_mps2=0.1, lever_arm_sd=1e-3))  # 10 mg, 0.1 %
X, Y, Z = np.eye(3)
SQUARE = SpinGeometry(np.array([0.1 * Z, 0.5 * Z]), np.array([Z, -Y]), np.empty((0, 3)), None, fixed_axis=True)


def calibrated(noise):
    """Nothing is unknown but the rate."""
    known = RollCalibration(accel_bias_sd_mps2=1e-6, accel_bias_walk=1e-7, lever_arm_sd=1e-7)
    return RollGraphParams(noise=noise, calibration=known, rate_limit_radps=1e-9)


def tilted(tilt_deg, seed, geometry=BENCH):
    """The constant bench on a tilted shaft, with errors as the prior of RIG says, one draw per recording."""
    white = CONSTANT["white"]
    wrong = {"bias_mg": 0.1 / 9.80665e-3, "arm_error": 1e-3}
    sensor = replace(
        white,
        name="tilted",
        tilt_deg=float(tilt_deg),
        radial=replace(white.radial, **wrong),
        tangential=replace(white.tangential, **wrong),
    )
    return simulated.spinning("tilted", replace(simulated.CONSTANT, geometry=geometry), sensor, seed, 0.5, 250.0)


def absolute_error(made, recording):
    """Of the angle, whole turns aside."""
    error = made.angle_rad - recording.roll_truth.angle_rad
    return error - 2 * np.pi * np.round(np.median(error) / (2 * np.pi))


def errors(recording):
    """RMSE of angle and rate of its reference, deg and deg/s; the angle counts from the first sample."""
    made, truth = reference(recording), recording.roll_truth
    angle, rate = made.angle_rad - truth.angle_rad, made.rate_radps - truth.rate_radps
    return [float(np.rad2deg(np.sqrt(np.mean(one**2)))) for one in (angle - angle[0], rate)]


def drawn_glitches(recording):
    return json.loads(recording.info.extra["sensor_drawn"])["accelerometers"][0]["glitches"]


def small(seconds=1.0, seed=1, **sensor):
    """A second of a horizontal bench with everything: gravity, an encoder on its own clock, a gap, bad samples."""
    recording = simulate("spin-constant", seed=seed, minutes=seconds / 60, sensor="white", **sensor)
    spin = recording.spin
    kept = np.delete(np.arange(len(spin.t_ns)), [90, 91, 92])
    accel = spin.accel_mps2[kept].copy()
    accel[30, 0] = np.nan
    accel[60, 1] = np.nan
    accel += 5.0 * np.cos(recording.roll_truth.angle_rad[kept])[:, None]
    encoder = Encoder(recording.encoder.t_ns + 1_700_000, recording.encoder.angle_rad, recording.encoder.rate_radps)
    return replace(recording, spin=Spin(spin.t_ns[kept], accel, spin.gyro_radps[kept], spin.geometry), encoder=encoder)


@pytest.fixture(scope="module")
def problem():
    """Chain, a state near the truth, and the prior, with all unknowns in play."""
    recording, params = small(), RollGraphParams()
    samples = samples_of(recording, params.noise)
    readings = readings_of(recording.encoder, samples.t_ns, params.encoder)
    chain = chain_of(samples, readings, 16, 0.5, params.noise)
    rng = np.random.default_rng(3)
    n = len(samples)
    truth = np.interp(samples.t_ns, recording.roll_truth.t_ns, recording.roll_truth.angle_rad)
    rates = np.diff(truth, prepend=truth[0] - 0.141) / samples.step_s
    constants = np.tile(
        [0.3, -0.1, 1e-3, -2e-3, 5.0, 0.02, 6e-4, 1.0, -0.5, 0.2, 0.3], (int(chain.constants_of[-1]) + 1, 1)
    )
    constants += 1e-4 * rng.standard_normal(constants.shape)
    state = RollState(-0.14, np.append(rates, rates[-1]) + 0.05 * rng.standard_normal(n + 1), constants)
    line = Line("gravity", "", 0j, 0j, 100.0, 5.0, 5.0, 5.0, 0.0, 35.0, np.zeros(n))
    prior = prior_of(samples, line, True, 0.01, params)
    # A vibration beside gravity, along an angle of its own: all columns of the Jacobian are in use.
    shaken = [COS_S, SIN_S, COS_A, SIN_A]
    free = np.zeros(len(CONSTANTS))
    free[shaken] = [2.0, 2.0, 0.5, 0.5]
    prior = replace(prior, cov=prior.cov + np.diag(free**2), walk_cov=prior.walk_cov + np.diag((0.3 * free) ** 2))
    slow = np.linspace(0.0, 30.0, n)
    chain = replace(chain, shaken=np.stack([in_blocks(part, 16, 0.0) for part in (np.cos(slow), np.sin(slow))]))
    return chain, state, prior, params


def as_vector(state):
    return np.concatenate([[state.start_angle_rad], state.mean_rate_radps, state.constants.ravel()])


def as_state(z, chain):
    n = len(chain.samples)
    return RollState(float(z[0]), z[1 : n + 2], z[n + 2 :].reshape(-1, len(CONSTANTS)))


def whitened(z, chain, prior, roots):
    """All residuals of the problem, predicted less measured, with weights held: nothing of gtsam, nothing of blocks."""
    state = as_state(z, chain)
    at = fit(chain, state)
    n = len(chain.samples)
    walk = np.linalg.inv(np.linalg.cholesky(prior.walk_cov))
    return -np.concatenate(
        [
            (roots.accel * at.accel_residual).ravel()[:n],
            (roots.squared * at.squared_residual).ravel()[:n],
            roots.encoder * at.encoder_residual,
            [(prior.angle_rad - angles_of(chain, state)[0]) / prior.angle_sd_rad],
            np.linalg.inv(np.linalg.cholesky(prior.cov)) @ (prior.mean - state.constants[0]),
            *(-walk @ change for change in np.diff(state.constants, axis=0)),
        ]
    )


def differences(z, function, size=1e-6):
    columns = []
    for k in range(len(z)):
        step = np.zeros_like(z)
        step[k] = size
        columns.append((function(z + step) - function(z - step)) / (2 * size))
    return np.column_stack(columns)


def test_step_and_covariance_are_those_of_the_full_problem(problem):
    """Gauss-Newton's step and all standard deviations, against a dense system whose Jacobian is made by differences."""
    chain, state, prior, params = problem
    at = fit(chain, state)
    roots = roots_of(chain, at, sizes_of(chain, at, params.noise))
    z = as_vector(state)
    jacobian_full = differences(z, lambda one: whitened(one, chain, prior, roots))
    step, *_ = np.linalg.lstsq(jacobian_full, -whitened(z, chain, prior, roots), rcond=None)
    cov = np.linalg.inv(jacobian_full.T @ jacobian_full)

    linear = eliminated(chain, at, roots, prior, "test")
    found = as_vector(step_of(chain, linear, len(state.constants)))
    sd = np.sqrt(np.diag(cov))
    assert np.abs((found - step) / sd).max() < 1e-3

    n = len(chain.samples)
    by_rates = np.tril(np.ones((n, n))) * chain.step_s[:-1]
    of_angle = np.hstack([np.ones((n, 1)), by_rates, np.zeros((n, len(z) - n - 1))])
    accuracy = accuracy_of(chain, linear, "test")
    expected = np.sqrt(np.einsum("ij,jk,ik->i", of_angle, cov, of_angle))
    np.testing.assert_allclose(accuracy.angle_sd_rad, expected, rtol=1e-3)
    p = chain.before.ravel()[:n]
    of_rate = np.zeros((n, len(z)))
    of_rate[np.arange(n), 1 + np.arange(n)], of_rate[np.arange(n), 2 + np.arange(n)] = p, 1 - p
    expected = np.sqrt(np.einsum("ij,jk,ik->i", of_rate, cov, of_rate))
    np.testing.assert_allclose(accuracy.rate_sd_radps, expected, rtol=1e-3)
    np.testing.assert_allclose(accuracy.constants_sd, sd[n + 2 : n + 2 + len(CONSTANTS)], rtol=1e-3)


def test_the_scalar_chain_is_that_of_a_banded_solver():
    """Without biases, gravity and encoder only rates are left: Gauss-Newton on the tridiagonal system, by LAPACK."""
    recording, params = simulate("spin-constant", seed=4, sensor="white"), calibrated(noise=GIVEN)
    samples = samples_of(recording, params.noise)
    y, u, step = samples.squared_rad2ps2, samples.accel_radps2, 0.004
    x = np.full(len(y) + 1, np.sqrt(np.median(y)))
    for _ in range(40):
        squared, accel = y - ((x[1:] + x[:-1]) / 2) ** 2, u - np.diff(x) / step
        w_s, w_a = (weight(squared, params, GIVEN.squared_sd_rad2ps2), weight(accel, params, GIVEN.accel_sd_radps2))
        slope = (x[1:] + x[:-1]) / 2  # d rate^2 / dx, by either neighbour
        banded = np.zeros((2, len(x)))
        banded[1, :-1] = w_s * slope**2 + w_a / step**2
        banded[1, 1:] += w_s * slope**2 + w_a / step**2
        banded[0, 1:] = w_s * slope**2 - w_a / step**2
        right = np.zeros(len(x))
        right[:-1] = w_s * slope * squared - w_a * accel / step
        right[1:] += w_s * slope * squared + w_a * accel / step
        x = x + solveh_banded(banded, right)
    made = reference(recording, params=params)
    # The step that is left when it stops, 1e-9 rad/s, and constants that are held within 1e-6: nothing else.
    np.testing.assert_allclose(made.rate_radps, (x[1:] + x[:-1]) / 2, rtol=0, atol=1e-5)


def weight(residual, params, sd):
    """Geman-McClure's, of mean 1 over normal noise, by the variance."""
    robust = params.noise.robust
    return 1 / (1 + (residual / (robust * sd)) ** 2) ** 2 / mean_weight(robust) / sd**2


@pytest.mark.parametrize("block", [4, 17, 40])
def test_the_result_does_not_depend_on_the_blocks(block):
    """Rates between keys are taken out exactly, so where the keys are says nothing."""
    recording = small(2.0)
    one, other = (reference(recording, params={"block": b, "rate_limit_radps": 1e-10}) for b in (24, block))
    np.testing.assert_allclose(other.rate_radps, one.rate_radps, rtol=0, atol=1e-6)
    np.testing.assert_allclose(other.angle_rad, one.angle_rad, rtol=0, atol=1e-6)
    np.testing.assert_allclose(other.angle_sd_rad, one.angle_sd_rad, rtol=1e-3)
    np.testing.assert_allclose(other.rate_sd_radps, one.rate_sd_radps, rtol=1e-3)


def test_white_noise_reaches_the_figures_of_the_issue():
    """Means over trials; a hundred trials with the noise known have .757 and 1.52 deg/s."""
    for kind, limit, trials in (("spin-constant", 0.78, 10), ("spin-variable", 1.55, 4)):
        rate = [errors(simulate(kind, seed=seed, sensor="white"))[1] for seed in range(trials)]
        assert np.mean(rate) <= limit


def test_glitches_do_not_reach_the_rate_or_the_angle():
    """Two samples of the radial accelerometer in 30 s are off by 4 to 8 g, some 300 sd."""
    trials = [simulate("spin-constant", seed=seed, sensor="glitch") for seed in range(10)]
    angle, rate = np.max([errors(one) for one in trials], axis=0)
    assert rate <= 0.17
    assert angle <= 0.35
    spoilt = reference(trials[0]).diagnostics
    # One of them goes beyond the range, and is not valid to begin with.
    assert spoilt["n_squared_glitches"] + spoilt["n_squared_missing"] == drawn_glitches(trials[0])


@pytest.mark.parametrize(
    ("tilt_deg", "geometry", "limit_deg"), [(90, SQUARE, 0.35), (90, BENCH, 0.40), (30, BENCH, 0.6)]
)
def test_gravity_makes_the_angle_absolute(tilt_deg, geometry, limit_deg):
    """Biases of 10 mg and lever arms off by 0.1 %, none of them known; the angle is compared as it stands.

    The paper's bench has both accelerometers along z, where the standard deviation that the graph states is 0.30 deg
    on a horizontal axis; with the second one square to the first it is 0.25 deg.
    """
    worst = 0.0
    for seed in range(10):
        recording = tilted(tilt_deg, seed, geometry)
        made = reference(recording)
        assert made.diagnostics["angle"].startswith("from gravity")
        amplitude, sd = made.diagnostics["gravity_mps2"]
        assert amplitude == pytest.approx(9.80665 * np.sin(np.deg2rad(tilt_deg)), abs=4 * sd)
        worst = max(worst, np.rad2deg(np.sqrt(np.mean(absolute_error(made, recording) ** 2))))
    assert worst <= limit_deg


def test_stated_accuracy_is_met_where_the_model_is_right():
    """Mean normalised errors squared over seeds, each thinned to samples that are nearly independent.

    Biases and arms are drawn as the prior of RIG says, so angles on a vertical axis are one draw per recording:
    chi-squared of 16 of them. Rates with gravity are correlated over about 0.1 s: 300 draws in a recording.
    """
    vertical, rates = [], []
    for seed in range(16):
        recording = tilted(0.0, seed)
        made = reference(recording, params=RIG)
        end = made.angle_rad[-1] - recording.roll_truth.angle_rad[-1]
        vertical.append((end / made.angle_sd_rad[-1]) ** 2)
    assert chi2.ppf(0.005, 16) < np.sum(vertical) < chi2.ppf(0.995, 16)
    angles = []
    for seed in range(20, 26):
        recording = tilted(90.0, seed)
        made = reference(recording, params=RIG)
        rates.append(((made.rate_radps - recording.roll_truth.rate_radps) / made.rate_sd_radps)[::50] ** 2)
        angles.append((absolute_error(made, recording) / made.angle_sd_rad)[::750] ** 2)
    for squares in (np.concatenate(rates), np.concatenate(angles)):
        assert chi2.ppf(0.005, len(squares)) < np.sum(squares) < chi2.ppf(0.995, len(squares))


def test_what_the_samples_do_not_tell_is_held_and_said():
    """On a vertical axis nothing tells a lever arm or the radial bias; on a horizontal one gravity counts the turns."""
    vertical, horizontal = (reference(tilted(tilt, 0), params=RIG).diagnostics for tilt in (0.0, 90.0))
    assert vertical["not_told"] == ["bias_squared_rad2ps2", "arm_squared", "arm_accel"]
    assert vertical["arm_squared"][0] == pytest.approx(0.0, abs=1e-9)
    assert vertical["arm_squared"][1] == pytest.approx(1e-3, rel=0.01)
    assert horizontal["not_told"] == ["arm_accel"]


@pytest.mark.parametrize(
    ("params", "bias_mps2", "arm", "degps"), [(RIG, 0.1, 1e-3, 1.3), (RollGraphParams(), 0.4, 5e-3, 6.0)]
)
def test_on_a_vertical_axis_the_angle_is_said_to_drift(params, bias_mps2, arm, degps):
    """By what an unknown lever arm and bias are worth: the sd of the angle grows by that each second."""
    made = reference(simulate("spin-constant", seed=0, sensor="white"), params=params)
    assert "the angle drifts" in made.diagnostics["angle"]
    growth_degps = np.rad2deg(made.angle_sd_rad[-1]) / 30
    of_bias = np.rad2deg(bias_mps2 / 0.1 / (2 * np.deg2rad(2020)))
    assert growth_degps == pytest.approx(np.hypot(arm / 2 * 2020, of_bias), rel=0.05)
    assert growth_degps == pytest.approx(degps, abs=0.05)


def test_defaults_cover_a_board_as_it_comes():
    """40 mg, 0.5 % of scale and 0.1 % of the arms, drawn once per trial: chi-squared of the angles at the end."""
    squares = []
    for seed in range(16):
        recording = simulate("spin-constant", seed=seed, sensor="adxl345")
        made, truth = reference(recording), recording.roll_truth
        assert "the angle drifts" in made.diagnostics["angle"]
        end = made.angle_rad[-1] - np.interp(made.t_ns[-1], truth.t_ns, truth.angle_rad)
        squares.append((end / made.angle_sd_rad[-1]) ** 2)
    assert chi2.ppf(0.005, 16) < np.sum(squares) < chi2.ppf(0.995, 16)


def test_in_flight_there_is_no_harmonic_to_find():
    """The accelerometers at the centre take gravity and drag out of the channels: the geometry shows none."""
    recording = simulate("spin-flight", seed=0, sensor="white")
    samples = samples_of(recording, RollNoise())
    assert not samples.accel_gravity.any()
    assert not samples.squared_gravity.any()
    made = reference(recording)
    assert "the angle drifts" in made.diagnostics["angle"]
    error = np.rad2deg(made.rate_radps - recording.roll_truth.rate_radps)
    assert np.abs(error).max() < 5 * np.rad2deg(np.median(made.rate_sd_radps))


def test_an_encoder_fixes_angle_arm_and_latency():
    """It is used only when asked for; its steps, its delay and its zero are found."""
    recording = simulate("spin-variable", seed=3, sensor="white")
    without, made = reference(recording), reference(recording, params={"encoder.use": True})
    np.testing.assert_array_equal(without.angle_rad, reference(replace(recording, encoder=None)).angle_rad)
    found = made.diagnostics
    assert found["encoder_resolution_rad"] == pytest.approx(2 * np.pi / 4096, rel=1e-6)
    latency_s, sd_s = found["encoder_latency_s"]
    assert latency_s == pytest.approx(0.5e-3, abs=4 * sd_s)
    assert found["arm_squared"][1] < 0.5 * without.diagnostics["arm_squared"][1]
    error = made.angle_rad - recording.roll_truth.angle_rad
    assert np.abs(error).max() < 4 * np.median(made.angle_sd_rad)
    assert made.angle_sd_rad[-1] < 0.1 * without.angle_sd_rad[-1]


@pytest.mark.parametrize("counts", [4096, 360, 1000])
def test_the_resolution_is_that_of_the_counts(counts):
    angle = np.arange(5000) * 0.141 + 1e-3 * np.sin(np.arange(5000))
    step = 2 * np.pi / counts
    assert resolution_rad(np.floor(angle / step) * step) == pytest.approx(step, rel=1e-9)
    assert resolution_rad(angle) == 0.0


@pytest.mark.parametrize("tilt_deg", [0, 90])
def test_a_spin_the_other_way_is_the_mirror_image(tilt_deg):
    """Of body and motion in the x-z plane: lever arms and axes change sides, the angle its sign, the forces nothing."""
    recording = tilted(tilt_deg, 2)
    mirror = np.array([1.0, -1.0, 1.0])
    geometry = SpinGeometry(BENCH.accel_r_b_m * mirror, BENCH.accel_axis_b * mirror, np.array([X]), None, True)
    spin = recording.spin
    gyro = -recording.roll_truth.rate_radps[:, None]
    mirrored = replace(recording, spin=Spin(spin.t_ns, spin.accel_mps2, gyro, geometry))
    made, other = reference(recording), reference(mirrored)
    assert other.diagnostics["direction"] == "as a sensor shows it"
    assert made.diagnostics["direction"] == "taken as positive"
    np.testing.assert_allclose(other.rate_radps, -made.rate_radps, atol=1e-6)
    turns = np.round(np.median(other.angle_rad + made.angle_rad) / (2 * np.pi))
    np.testing.assert_allclose(other.angle_rad, 2 * np.pi * turns - made.angle_rad, atol=1e-5)
    blind = replace(mirrored, spin=replace(mirrored.spin, geometry=replace(geometry, gyro_axis_b=np.array([Y]))))
    told = reference(blind, params={"direction": "negative"})
    np.testing.assert_array_equal(told.rate_radps, other.rate_radps)


def test_lost_saturated_and_missing_samples_are_left_out_and_counted():
    recording = simulate("spin-constant", seed=2, sensor="white")
    spin = recording.spin
    accel = spin.accel_mps2.copy()
    accel[1000:1005, 0] = -spin.geometry.accel_range_mps2[0]
    accel[2000:2003, 1] = np.nan
    accel[5000:5250, 0] = accel[5000, 0]  # hangs for a second
    kept = np.delete(np.arange(len(accel)), np.r_[3000:3010])
    spoilt = replace(recording, spin=Spin(spin.t_ns[kept], accel[kept], spin.gyro_radps[kept], spin.geometry))
    made, whole = reference(spoilt), reference(recording)
    assert made.diagnostics["n_squared_missing"] == 5 + 250
    assert made.diagnostics["n_accel_missing"] == 3
    assert made.diagnostics["n_gaps"] == 1
    assert (np.abs(made.rate_radps - whole.rate_radps[kept]) < 4 * made.rate_sd_radps).all()
    assert made.rate_sd_radps[2995:3005].max() > 1.05 * np.median(made.rate_sd_radps)


def test_what_has_no_rate_in_it_is_refused():
    recording = simulate("spin-constant", seed=2, sensor="white")
    spin = recording.spin
    full = np.column_stack([np.full(len(spin.t_ns), -16 * 9.80665), spin.accel_mps2[:, 1]])
    with pytest.raises(Unobservable, match="0 of 7500 samples give the squared rate"):
        reference(replace(recording, spin=Spin(spin.t_ns, full, spin.gyro_radps, spin.geometry)))
    with pytest.raises(Unobservable, match="has no spin stream"):
        reference(simulate("phone-3", seed=1, minutes=1.5), "roll-graph")
    with pytest.raises(Unobservable, match="has no encoder"):
        reference(replace(recording, encoder=None), params={"encoder.use": True})


def test_the_verb_writes_what_reference_gives(call, tmp_path, capsys):
    recording = simulate("spin-constant", seed=0, minutes=0.1, sensor="white")
    write(tmp_path / "spin.mcap", recording)
    assert call("reference", tmp_path / "spin.mcap", "-o", tmp_path, "--json", tmp_path / "r.json") == 0
    assert "roll-graph" in capsys.readouterr().out
    (row,) = json.loads((tmp_path / "r.json").read_text())["rows"]
    assert row["method"] == "roll-graph"
    made, again = read(tmp_path / "spin.reference.mcap"), reference(recording)
    np.testing.assert_array_equal(made.angle_rad, again.angle_rad)
    np.testing.assert_array_equal(made.rate_sd_radps, again.rate_sd_radps)
    assert made.diagnostics == again.diagnostics
    assert made.params["block"] == 24.0


def test_the_disc_spins_as_its_gyro_says(data_dir):
    """The second half of the flight, in which the graph has not seen the gyro: 0.2 % is 6 deg/s of 3150."""
    flight = disc_flight(data_dir / "disc" / "2025-08-31-001-rb.csv")
    judged = ~flight.taught
    assert judged.sum() > 80
    error = np.rad2deg(flight.reference.rate_radps - flight.gyro_radps)[judged]
    assert np.sqrt(np.mean(error**2)) < 6.0
    assert 0.015 < flight.arm_m[0] < 0.025


def test_the_page_has_the_settings_as_they_are():
    text = (Path(__file__).parents[1] / "docs" / "roll.md").read_text(encoding="utf-8")
    assert refreshed(text) == text, "run python -m stillpoint.scripts.settings_pages"
