"""Each factor generator: nothing to say at the truth, the right sign beside it."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, C, M, V, X
from scipy.spatial.transform import Rotation

from stillpoint.datasets import Imu
from stillpoint.smoother.attitude import chain, factors
from stillpoint.smoother.attitude.keys import choose_keys, prepare_motion
from stillpoint.smoother.attitude.linear.elimination import eliminate, optimise
from stillpoint.smoother.attitude.linear.inverse import compute_covariances
from stillpoint.smoother.attitude.linear.rows import flatten, join_rows
from stillpoint.smoother.attitude.linear.structure import find_structure
from stillpoint.smoother.attitude.params import GraphParams, InertialNoise, KeyParams
from stillpoint.smoother.attitude.samples.compound import compound_samples
from stillpoint.smoother.attitude.solve import SIZES

G = 9.80665
PARAMS = GraphParams(inertial=InertialNoise(accel_mps2_rthz=0.2))  # the bounds below are errors over this noise
NO_RESTS = np.empty((0, 2), dtype=np.int64)


def turning(rate_b_radps, seconds=1.0, accel_late_s=0.0):
    """A sensor on the spot that turns steadily: its true attitudes and what it measures at 200 Hz."""
    t_s = np.arange(int(200 * seconds) + 1) / 200
    attitude = Rotation.from_euler("ZYX", [40, 20, -30], degrees=True) * Rotation.from_rotvec(
        np.outer(t_s, rate_b_radps)
    )
    felt = Rotation.from_euler("ZYX", [40, 20, -30], degrees=True) * Rotation.from_rotvec(
        np.outer(t_s - accel_late_s, rate_b_radps)
    )
    gyro = np.tile(rate_b_radps, (len(t_s), 1))
    imu = Imu((t_s * 1e9).astype(np.int64), gyro, felt.inv().apply([0.0, 0.0, G]))
    motion = prepare_motion(imu, NO_RESTS)
    keys = choose_keys(motion, KeyParams(moving_s=0.1))
    return motion, keys, attitude[keys.row]


def values_of(keys, attitude, tilt=None):
    values = gtsam.Values()
    for i in range(len(keys.t_s)):
        turn = attitude[i] if tilt is None or i == 0 else tilt * attitude[i]
        values.insert(X(i), gtsam.Pose3(gtsam.Rot3(turn.as_matrix()), np.zeros(3)))
        values.insert(V(i), np.zeros(3))
        values.insert(C(i), gtsam.imuBias.ConstantBias())
    values.insert(B(0), gtsam.imuBias.ConstantBias())
    values.insert(M(0), np.zeros(factors.CALIBRATION))
    return values


def explicit_chain(motion, keys, bias_b_radps, params=PARAMS):
    """Return the chain with the effective bias of each interval as an unknown of its own."""
    return chain.build_chain(motion, keys, bias_b_radps, G, True, params).with_explicit(range(len(keys.t_s)))


def squares_of(motion, keys, values, params=PARAMS, effective=None):
    """Return the squared residuals of the chain at values, with effective biases (m, 6) that are 0 by default."""
    made = explicit_chain(motion, keys, np.zeros(3), params)
    effective = np.zeros((len(made.interval), 6)) if effective is None else effective
    place = chain.read_place(made, values, effective, range(len(keys.t_s)))
    return chain.split_squares(made, chain.linearise_chain(made, place))


RATE = np.array([0.3, -0.5, 0.4])


def test_imu_factors_are_nought_at_the_truth_and_grow_with_tilt():
    motion, keys, attitude = turning(RATE)
    true, tilted = values_of(keys, attitude), values_of(keys, attitude, Rotation.from_rotvec([0.02, 0.0, 0.0]))
    squares = squares_of(motion, keys, true).imu
    assert len(squares) == len(keys.t_s) - 1
    assert squares.max() < 2e-3
    assert squares_of(motion, keys, tilted).imu[0] > 2.0


def test_a_gyro_sample_describes_the_interval_that_ends_at_it():
    """With a rate that changes from sample to sample, one sample of slip would be an error of 0.01 rad a key."""
    t_s = np.arange(41) / 200
    gyro = np.zeros((41, 3))
    gyro[1:, 2] = np.where(np.arange(1, 41) <= 20, 4.0, 0.0)
    turned = np.cumsum(gyro[:, 2]) / 200
    motion = prepare_motion(Imu((t_s * 1e9).astype(np.int64), gyro, np.tile([0.0, 0.0, G], (41, 1))), NO_RESTS)
    keys = choose_keys(motion, KeyParams(moving_s=0.1))
    attitude = Rotation.from_rotvec(np.outer(turned[keys.row], [0, 0, 1]))
    assert squares_of(motion, keys, values_of(keys, attitude)).imu.max() < 2e-6


def test_a_clipped_axis_may_have_turned_farther_the_others_not():
    """Beyond the reading about the clipped axis costs little, as much about another costs as ever."""
    motion, keys, attitude = turning(RATE)
    clipped = np.where([False, True, False], keys.span_s[:, None] * 4.4, 0.0)
    cut = replace(keys, gyro_clipped_rad=clipped)
    costs = {}
    for axis in range(3):
        farther = attitude * Rotation.from_rotvec(0.05 * np.arange(len(attitude))[:, None] * np.eye(3)[axis])
        for name, of in (("free", keys), ("cut", cut)):
            costs[name, axis] = squares_of(motion, of, values_of(keys, farther)).imu.sum()
    assert costs["cut", 1] < 0.05 * costs["free", 1]
    assert costs["cut", 0] > 0.2 * costs["free", 0]
    assert costs["cut", 2] > 0.2 * costs["free", 2]


@pytest.mark.slow
def test_a_gyro_that_reads_one_per_cent_too_much_has_m_plus_one_per_cent():
    """corrected = gyro_matrix (measured - bias) with gyro_matrix = 1 - M: too much is less than 1."""
    motion, keys, attitude = turning(RATE)
    large = replace(motion, gyro_b_radps=motion.gyro_b_radps * [1.01, 1.0, 1.0])
    loud = replace(keys, gyro_b_radps=keys.gyro_b_radps * [1.01, 1.0, 1.0])
    values = values_of(keys, attitude)
    effective = np.tile([0.0, 0.0, 0.0, 0.01 * RATE[0], 0.0, 0.0], (len(keys.t_s) - 1, 1))
    vector = np.zeros(factors.CALIBRATION)
    vector[9] = 0.01 / 1.01
    values.update(M(0), vector)
    squares = squares_of(large, loud, values, effective=effective)
    assert squares.imu.max() < 2e-3
    assert squares.calibration.max() < 2e-3
    vector[9] = -0.01 / 1.01
    values.update(M(0), vector)
    assert squares_of(large, loud, values, effective=effective).calibration.max() > 200


def test_a_late_accelerometer_has_a_positive_delay():
    motion, keys, attitude = turning(np.array([2.0, 0.5, 0.0]), accel_late_s=0.02)
    on_time, _, _ = turning(np.array([2.0, 0.5, 0.0]))
    difference = motion.accel_b_mps2[keys.row[1:]] - on_time.accel_b_mps2[keys.row[1:]]
    values, effective = values_of(keys, attitude), np.hstack([difference, np.zeros_like(difference)])
    errors = []
    for delay_s in (-0.02, 0.0, 0.02):
        vector = np.zeros(factors.CALIBRATION)
        vector[18] = delay_s
        values.update(M(0), vector)
        errors.append(squares_of(motion, keys, values, effective=effective).calibration.sum())
    assert errors[2] < 0.1 * errors[1] < 0.1 * errors[0]


def test_bias_and_calibration_begin_at_their_start():
    _, keys, attitude = turning(RATE)
    values = values_of(keys, attitude)
    made = list(factors.bias_factors(keys, np.zeros(3), PARAMS))
    assert sum(factor.error(values) for factor in made) == pytest.approx(0.0, abs=1e-12)
    values.update(B(0), gtsam.imuBias.ConstantBias(np.zeros(3), np.full(3, PARAMS.inertial.gyro_bias_sd_radps)))
    assert made[0].error(values) == pytest.approx(1.5)  # one sd on three axes


def test_the_gyros_bias_shifts_between_rest_and_motion_and_walks_otherwise():
    """25 s of motion, 15 s of rest, 12 s of motion: a bias for 10 s at the most, and a new one at each change."""
    motion, _, _ = turning(RATE, seconds=52.0)
    at_rest = (motion.t_s[1:] > 25.0) & (motion.t_s[1:] < 40.0)
    keys = choose_keys(replace(motion, at_rest=np.append(False, at_rest)), KeyParams(resting_s=0.1))
    step = factors.bias_steps(keys, PARAMS)
    begins = np.searchsorted(step, np.arange(step[-1] + 1))
    assert keys.t_s[begins] == pytest.approx([0.0, 10.0, 20.0, 25.0, 35.0, 40.0, 50.0], abs=0.25)
    p, change = PARAMS.inertial, np.full(3, 1e-3)
    for k, factor in enumerate(list(factors.bias_factors(keys, np.zeros(3), PARAMS))[: step[-1]]):
        values = gtsam.Values()
        values.insert(B(k), gtsam.imuBias.ConstantBias())
        values.insert(B(k + 1), gtsam.imuBias.ConstantBias(np.zeros(3), change))
        shift = p.gyro_bias_shift_radps if k in (2, 4) else 0.0
        seconds = keys.t_s[begins[k + 1]] - keys.t_s[begins[k]]
        assert factor.error(values) == pytest.approx(1.5e-6 / (p.gyro_bias_walk**2 * seconds + shift**2), rel=1e-6)


def test_bounds_of_the_motion_ask_for_standstill_at_the_origin():
    """A state that moves by 1 m/s, 2 m away, is off by these over their sd."""
    motion, keys, attitude = turning(RATE)
    values, share = values_of(keys, attitude), 1 / np.sqrt(keys.span_s[3])
    squares = squares_of(motion, keys, values)
    assert squares.speed.sum() == squares.place.sum() == 0.0
    values.update(V(3), np.array([1.0, 0.0, 0.0]))
    values.update(X(3), gtsam.Pose3(gtsam.Rot3(attitude[3].as_matrix()), np.array([0.0, 0.0, 2.0])))
    squares = squares_of(motion, keys, values)
    assert squares.speed.sum() == pytest.approx((PARAMS.motion.velocity_sd_mps * share) ** -2, rel=1e-6)
    assert squares.place.sum() == pytest.approx((2 / (PARAMS.motion.position_sd_m * share)) ** 2, rel=1e-6)


def test_an_interval_says_what_gtsam_says():
    """The preintegrated factor of gtsam from the same measurements: its error, and its information near the optimum.

    gtsam inverts the covariance, of which place and velocity are all but the same: that costs it four digits.
    """
    motion, keys, attitude = turning(RATE)
    bias = np.array([0.01, 0.02, -0.01])
    made = explicit_chain(motion, keys, bias)
    random, n = np.random.default_rng(4), len(keys.t_s)
    values = values_of(keys, attitude * Rotation.from_rotvec(1e-3 * random.normal(size=(n, 3))))
    effective = 1e-3 * random.normal(size=(len(made.interval), 6)) + np.concatenate([np.zeros(3), bias])
    data = chain.linearise_chain(made, chain.read_place(made, values, effective, range(n)))
    measured = compound_samples(motion, keys.row, made.interval, bias)
    noise = gtsam.PreintegrationParams.MakeSharedU(G)
    noise.setGyroscopeCovariance(PARAMS.inertial.gyro_radps_rthz**2 * np.eye(3))
    noise.setAccelerometerCovariance(PARAMS.inertial.accel_mps2_rthz**2 * np.eye(3))
    noise.setIntegrationCovariance(PARAMS.motion.integration_sd_m_rts**2 * np.eye(3))
    for i in range(n - 1):
        between = gtsam.PreintegratedImuMeasurements(noise, gtsam.imuBias.ConstantBias(np.zeros(3), bias))
        parts = zip(measured.accel_b_mps2[i], measured.gyro_b_radps[i], measured.length_s[i], strict=True)
        for accel, gyro, seconds in parts:
            if seconds > 0:
                between.integrateMeasurement(accel, gyro, seconds)
        values.update(C(i), gtsam.imuBias.ConstantBias(effective[i, :3], effective[i, 3:]))
        factor = gtsam.ImuFactor(X(i), V(i), X(i + 1), V(i + 1), C(i), between)
        wanted = factor.linearize(values).augmentedJacobian()
        found = data[225 * i : 225 * (i + 1)].reshape(9, 25)
        there, here = wanted.T @ wanted, found.T @ found
        size = np.sqrt(np.diagonal(there))
        np.testing.assert_allclose(here / np.outer(size, size), there / np.outer(size, size), atol=2e-3)
        ends = values.atPose3(X(i)), values.atVector(V(i)), values.atPose3(X(i + 1)), values.atVector(V(i + 1))
        error = factor.evaluateError(*ends, values.atConstantBias(C(i)))
        np.testing.assert_allclose(-np.linalg.solve(made.whitening[i], found[:, -1]), error, atol=1e-12)


def test_the_chain_linearises_as_central_differences_do():
    """Every column, at attitudes, velocities and biases that are off."""
    motion, keys, attitude = turning(RATE)
    made = explicit_chain(motion, keys, np.array([0.01, 0.02, -0.01]))
    random = np.random.default_rng(4)
    m, n = len(made.interval), len(keys.t_s)
    values = values_of(keys, attitude * Rotation.from_rotvec(0.02 * random.normal(size=(n, 3))))
    at = chain.read_place(made, values, 0.01 * random.normal(size=(m, 6)), range(n))
    rows = made.keys()
    size = {ord("x"): 6, ord("v"): 3, ord("c"): 6, ord("b"): 6, ord("m"): factors.CALIBRATION}

    def residual(step):
        moved = gtsam.Values(values)
        for key, change in step.items():
            kind = chr(gtsam.Symbol(key).chr())
            if kind == "x":
                moved.update(key, values.atPose3(key).retract(change))
            elif kind in "vm":
                moved.update(key, values.atVector(key) + change)
            elif kind == "b":
                bias = values.atConstantBias(key).vector() + change
                moved.update(key, gtsam.imuBias.ConstantBias(bias[:3], bias[3:]))
        effective = at.effective.copy()
        for key, change in step.items():
            if gtsam.Symbol(key).chr() == ord("c"):
                effective[gtsam.Symbol(key).index()] += change
        return split(chain.linearise_chain(made, chain.read_place(made, moved, effective, range(n))))

    def split(data):
        parts, begin = [], 0
        for f, count in enumerate(rows.count.tolist()):
            keys_of = rows.keys[rows.key_first[f] : rows.key_first[f + 1]]
            columns = sum(size[int(key) >> 56] for key in keys_of) + 1
            parts.append(data[begin : begin + count * columns].reshape(count, columns))
            begin += count * columns
        assert begin == len(data)
        return parts

    made_parts, h = residual({}), 1e-6
    for key in {X(2), V(2), X(3), V(3), C(2), B(0), M(0)}:
        for axis in range(size[key >> 56]):
            change = np.eye(size[key >> 56])[axis] * h
            after, before = residual({key: change}), residual({key: -change})
            for f, part in enumerate(made_parts):
                keys_of = rows.keys[rows.key_first[f] : rows.key_first[f + 1]].tolist()
                if key not in keys_of:
                    continue
                column = sum(size[other >> 56] for other in keys_of[: keys_of.index(key)]) + axis
                slope = -(after[f][:, -1] - before[f][:, -1]) / (2 * h)
                np.testing.assert_allclose(part[:, column], slope, atol=1e-5 * max(1.0, np.abs(part[:, :-1]).max()))


@pytest.mark.parametrize("explicit", [[], [2, 3]])
def test_effective_biases_may_be_eliminated_beforehand(explicit):
    """The optimum and its covariances are those with all effective biases as unknowns."""
    motion, keys, attitude = turning(RATE)
    every = explicit_chain(motion, keys, np.array([0.01, 0.02, -0.01]))
    random, n = np.random.default_rng(4), len(keys.t_s)
    values = values_of(keys, attitude * Rotation.from_rotvec(1e-3 * random.normal(size=(n, 3))))
    at = chain.read_place(every, values, 1e-3 * random.normal(size=(n - 1, 6)), range(n))
    known = gtsam.NonlinearFactorGraph()
    known.push_back(gtsam.PriorFactorPose3(X(0), values.atPose3(X(0)), gtsam.noiseModel.Isotropic.Sigma(6, 0.1)))
    known.push_back(gtsam.PriorFactorConstantBias(B(0), gtsam.imuBias.ConstantBias(), _spread(6)))
    known.push_back(gtsam.PriorFactorVector(M(0), np.zeros(factors.CALIBRATION), _spread(factors.CALIBRATION)))
    priors = flatten(known.linearize(values))
    found = []
    for made in (every, every.with_explicit(explicit)):
        data = chain.linearise_chain(made, at)
        rows = join_rows([replace(made.keys(), data=data), priors])
        structure = find_structure(rows, SIZES)
        eliminated = eliminate(structure, rows)
        step = optimise(eliminated)
        change = chain.step_effective(made, at, data, step, chain.find_step_places(made, at, structure))
        covariances = compute_covariances(eliminated, [(X(n - 1), X(n - 1)), (B(0), B(0)), (M(0), M(0))])
        steps = [step[structure.scalars([key], size)[0]] for key, size in ((X(n - 1), 6), (V(3), 3), (M(0), 19))]
        found.append([*steps, change, *covariances])
    for wanted, got in zip(*found, strict=True):
        np.testing.assert_allclose(got, wanted, rtol=1e-6, atol=1e-7 * np.abs(wanted).max())


def test_residuals_of_an_eliminated_bias_are_those_of_the_best_one():
    motion, keys, attitude = turning(RATE)
    every = explicit_chain(motion, keys, np.zeros(3))
    random, n = np.random.default_rng(4), len(keys.t_s)
    values = values_of(keys, attitude * Rotation.from_rotvec(1e-3 * random.normal(size=(n, 3))))
    at = chain.read_place(every, values, 1e-3 * random.normal(size=(n - 1, 6)), range(n))
    eliminated = every.with_explicit([])
    squares = chain.split_squares(eliminated, chain.linearise_chain(eliminated, at))
    of_imu = chain.linearise_chain(every, at)[: 225 * (n - 1)].reshape(-1, 9, 25)
    sd = np.repeat([1e-3, 1e-4], 3)
    for i, rows in enumerate(of_imu):  # bias and calibration are 0, so that the calibration's factor is C / sd
        system = np.concatenate([rows[:, 18:24], np.diag(1 / sd)])
        best = np.linalg.lstsq(system, np.concatenate([rows[:, 24], -at.effective[i] / sd]), rcond=None)[0]
        np.testing.assert_allclose(squares.imu[i], np.sum((rows[:, 18:24] @ best - rows[:, 24]) ** 2), rtol=1e-6)
        np.testing.assert_allclose(squares.calibration[i], np.sum(((at.effective[i] + best) / sd) ** 2), rtol=1e-6)


def test_states_move_as_gtsam_moves_them():
    """A step of the arrays is one of gtsam's values, and the change between two places is that step."""
    motion, keys, attitude = turning(RATE)
    made, n = explicit_chain(motion, keys, np.zeros(3)), len(keys.t_s)
    values, random = values_of(keys, attitude), np.random.default_rng(4)
    at = chain.read_place(made, values, np.zeros((n - 1, 6)), range(n))
    system = gtsam.NonlinearFactorGraph()
    for i in range(n):
        system.push_back(gtsam.PriorFactorPose3(X(i), gtsam.Pose3(), gtsam.noiseModel.Unit.Create(6)))
    anchors = flatten(system.linearize(values))
    structure = find_structure(join_rows([replace(made.keys(), data=chain.linearise_chain(made, at)), anchors]), SIZES)
    step = random.normal(size=structure.first[-1]) * np.repeat([1e-3, 1.0], [30, structure.first[-1] - 30])
    moved = chain.move_place(at, step, chain.find_step_places(made, at, structure))
    vectors = gtsam.VectorValues()
    for key, size in [
        (B(0), 6),
        (M(0), factors.CALIBRATION),
        *((X(i), 6) for i in range(n)),
        *((V(i), 3) for i in range(n)),
    ]:
        vectors.insert(key, step[structure.scalars([key], size)[0]])
    wanted = chain.read_place(made, values.retract(vectors), np.zeros((n - 1, 6)), range(n))
    for name in ("poses", "velocities", "biases", "calibration"):
        np.testing.assert_allclose(getattr(moved, name), getattr(wanted, name), atol=1e-12)
    poses, velocities = chain.find_change(at, moved)
    of_poses = np.concatenate([structure.scalars([X(i)], 6) for i in range(n)])
    small = np.linalg.norm(step[of_poses[:, :3]], axis=1) < np.pi
    np.testing.assert_allclose(poses[small], step[of_poses[small]], atol=1e-9)
    np.testing.assert_allclose(velocities, moved.velocities - at.velocities, atol=1e-12)


def _spread(size):
    return gtsam.noiseModel.Isotropic.Sigma(size, 0.01)


def test_rest_factors_hold_the_attitude():
    _, keys, attitude = turning(np.zeros(3), seconds=3.0)
    still = replace(keys, at_rest=np.ones_like(keys.at_rest))
    made = list(factors.rest_factors(still, PARAMS))
    assert len(made) == len(keys.t_s) - 1
    assert sum(factor.error(values_of(keys, attitude)) for factor in made) == pytest.approx(0.0, abs=1e-12)
    tilted = values_of(keys, attitude, Rotation.from_rotvec([2e-3, 0.0, 0.0]))
    assert made[0].error(tilted) == pytest.approx((2e-3 / PARAMS.motion.rest_turn_sd_rad) ** 2 / 2, rel=0.01)
