"""A spinning body: eq (1) against differences, the weights against the paper's eqs (2)-(5) and (25)-(27)."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stillpoint.datasets import BadParameter, BadRecording, Encoder, Recording, Spin, SpinGeometry, Unobservable
from stillpoint.datasets.spin import (
    BENCH,
    FIVE_ACCELEROMETERS,
    TERMS,
    bench,
    channels,
    coefficients,
    compute_specific_force,
    find_misplaced,
    find_saturated,
    make_five_accelerometers,
    measure,
)

D = np.array([0.1, 0.2, 0.3, 0.8, 0.12])  # (m/s^2)^2
X, Y, Z = np.eye(3)
vectors = st.lists(st.floats(-3, 3), min_size=3, max_size=3).map(np.array)


def spin_of(geometry, accel, gyro=None):
    accel = np.atleast_2d(np.asarray(accel, float))
    gyro = np.zeros((len(accel), len(geometry.gyro_axis_b))) if gyro is None else np.atleast_2d(gyro)
    return Spin(np.arange(len(accel)) * 4_000_000, accel, gyro, geometry)


def feel(geometry, centre, rate, accel):
    """What the accelerometers of a geometry read, (k,)."""
    return np.sum(compute_specific_force(geometry.accel_r_b_m, centre, rate, accel) * geometry.accel_axis_b, axis=1)


@given(vectors, vectors, vectors, vectors, vectors)
def test_eq_1_is_the_second_derivative_of_the_points_place(r, turn, first, second, third):
    """A point fixed to a body with q = exp(turn + first t) exp(second t^2): its place is differentiated twice."""

    def attitude(t):
        return Rotation.from_rotvec(turn + first * t) * Rotation.from_rotvec(second * t**2)

    def rate(t, h=1e-4):
        return (attitude(t - h).inv() * attitude(t + h)).as_rotvec() / (2 * h)

    def place(t):
        return third * t**3 + first * t**2 + attitude(t).apply(r)

    t, h = 0.3, 1e-3
    force = attitude(t).inv().apply((place(t + h) - 2 * place(t) + place(t - h)) / h**2)
    centre = attitude(t).inv().apply(6 * third * t + 2 * first)
    accel = (rate(t + h) - rate(t - h)) / (2 * h)
    assert compute_specific_force(r, centre, rate(t), accel) == pytest.approx(force, abs=2e-3, rel=2e-4)


@given(vectors, vectors, vectors, vectors, vectors.filter(lambda v: np.linalg.norm(v) > 0.1))
def test_the_coefficients_are_eq_1_along_an_axis(r, centre, rate, accel, axis):
    axis = axis / np.linalg.norm(axis)
    (x, y, z), geometry = rate, SpinGeometry(r[None], axis[None], np.empty((0, 3)))
    terms = [*centre, *accel, x * x, y * y, z * z, x * y, x * z, y * z]
    assert coefficients(geometry)[0] @ terms == pytest.approx(feel(geometry, centre, rate, accel)[0], abs=1e-9)


def test_the_five_give_the_papers_equations():
    """(4): w' = (F5 - F3)/d2 - g1 g2; (5): w^2 = (F3 - F4)/d1 - g1^2; (25): Q = (D3 + D5)/d2^2, R = (D3 + D4)/d1^2."""
    by = channels(FIVE_ACCELEROMETERS, D)
    assert by.omega_dot.accel == pytest.approx(np.array([0, 0, -1, 0, 1]) / 0.5, rel=1e-12)
    assert by.omega_dot.products == pytest.approx([0, 0, -1], rel=1e-12)
    assert by.omega_squared.accel == pytest.approx(np.array([0, 0, 1, -1, 0]) / 0.1, rel=1e-12)
    assert by.omega_squared.products == pytest.approx([-1, 0, 0], rel=1e-12)
    assert by.q_rad2ps4 == pytest.approx((0.3 + 0.12) / 0.25, rel=1e-12)
    assert by.r_rad2ps4 == pytest.approx((0.3 + 0.8) / 0.01, rel=1e-12)
    assert by.misplaced == ()
    assert by.omega_xy is None


def test_the_bench_gives_the_papers_equations():
    """(26): w' = F5/d2, w^2 = -F4/d1; (29): R = 80, (31): Q = 0.48."""
    by = channels(BENCH, [0.8, 0.12])
    assert by.omega_dot.accel == pytest.approx([0, 2], rel=1e-12)
    assert by.omega_squared.accel == pytest.approx([-10, 0], rel=1e-12)
    assert (by.r_rad2ps4, by.q_rad2ps4) == pytest.approx((80, 0.48), rel=1e-12)
    assert not by.omega_dot.products.any()
    assert not by.omega_squared.products.any()


@given(vectors, vectors, vectors, st.floats(0.02, 0.3), st.floats(0.05, 0.9))
def test_the_observations_are_exact_without_noise(centre, rate, accel, d1, d2):
    geometry = make_five_accelerometers(d1, d2)
    samples = measure(spin_of(geometry, feel(geometry, centre, rate, accel), rate[1:]), channels(geometry, D))
    assert samples.omega_dot_radps2[0] == pytest.approx(accel[0], abs=1e-9)
    assert samples.omega_squared_radps2[0] == pytest.approx(rate[0] ** 2, abs=1e-9)


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1))
def test_any_set_that_fixes_the_spin_is_unbiased_and_its_variance_is_that_of_its_noise(seed):
    """Twelve accelerometers anywhere: exact on exact input, and var = w' D w, whatever is eliminated."""
    rng = np.random.default_rng(seed)
    axes = rng.standard_normal((12, 3))
    geometry = SpinGeometry(
        rng.uniform(-0.3, 0.3, (12, 3)), axes / np.linalg.norm(axes, axis=1, keepdims=True), np.array([Y, Z])
    )
    variance, (centre, rate, accel) = rng.uniform(0.1, 1, 12), rng.uniform(-3, 3, (3, 3))
    by = channels(geometry, variance)
    samples = measure(spin_of(geometry, feel(geometry, centre, rate, accel), rate[1:]), by)
    assert len(by.misplaced) == 12
    for channel, value, true in (
        (by.omega_dot, samples.omega_dot_radps2, accel[0]),
        (by.omega_squared, samples.omega_squared_radps2, rate[0] ** 2),
        (by.omega_xy, None, rate[0] * rate[1]),
        (by.omega_xz, None, rate[0] * rate[2]),
    ):
        found = channel.value(feel(geometry, centre, rate, accel)[None], rate[None, 1:]) if value is None else value
        assert found[0] == pytest.approx(true, abs=1e-6)
        assert channel.variance == pytest.approx(channel.accel**2 @ variance, rel=1e-9)


@pytest.mark.slow
@given(st.floats(0.03, 0.4), st.floats(0, 2 * np.pi), st.floats(0, 2 * np.pi))
def test_one_more_accelerometer_never_raises_a_variance(d, at, along):
    """A sixth anywhere in the y-z plane: the best weights may leave it out."""
    more = SpinGeometry(
        np.vstack([FIVE_ACCELEROMETERS.accel_r_b_m, d * (np.cos(at) * Y + np.sin(at) * Z)]),
        np.vstack([FIVE_ACCELEROMETERS.accel_axis_b, np.cos(along) * Y + np.sin(along) * Z]),
        FIVE_ACCELEROMETERS.gyro_axis_b,
    )
    five, six = channels(FIVE_ACCELEROMETERS, 0.3), channels(more, 0.3)
    assert six.q_rad2ps4 <= five.q_rad2ps4 * (1 + 1e-9)
    assert six.r_rad2ps4 <= five.r_rad2ps4 * (1 + 1e-9)


def test_a_second_radial_accelerometer_lowers_the_variance():
    """Two opposite radial ones see the centre with equal and the spin with opposite signs: R = D/(2 d1^2)."""
    pair = SpinGeometry(
        np.array([0 * X, 0.1 * Z, -0.1 * Z, 0.5 * Y]), np.array([Z, Z, Z, Z]), np.array([Y, Z])
    )  # fmt: skip
    assert channels(pair, 0.3).r_rad2ps4 == pytest.approx(0.3 / (2 * 0.01), rel=1e-9)
    assert channels(FIVE_ACCELEROMETERS, 0.3).r_rad2ps4 == pytest.approx(2 * 0.3 / 0.01, rel=1e-9)


def test_eq_2_names_the_accelerometer_and_what_it_sees():
    arms = FIVE_ACCELEROMETERS.accel_r_b_m.copy()
    arms[3] += 0.02 * X
    moved = replace(FIVE_ACCELEROMETERS, accel_r_b_m=arms)
    (sentence,) = find_misplaced(moved)
    assert sentence == "accelerometer 4 sees omega_y dot, omega_x omega_z: move it into the y-z plane (r_x = 0)"
    with pytest.raises(Unobservable, match=r"do not fix omega_x\^2: accelerometer 4 sees omega_y dot.*y-z plane"):
        channels(moved)
    assert find_misplaced(FIVE_ACCELEROMETERS) == ()


def test_what_the_centre_or_the_gyros_would_be_needed_for_is_said():
    loose = replace(BENCH, fixed_axis=False)
    with pytest.raises(Unobservable, match="add gyros about y and z, or set fixed_axis"):
        channels(loose)
    with pytest.raises(Unobservable, match="force at the centre: add accelerometers there, or set fixed_axis"):
        channels(replace(loose, gyro_axis_b=np.array([Y, Z])))
    for gyro, lacking in ((Y, "z"), (Z, "y")):
        with pytest.raises(Unobservable, match=f"omega_y omega_z: add a gyro about {lacking}, or"):
            channels(replace(FIVE_ACCELEROMETERS, gyro_axis_b=np.array([gyro])))
    with pytest.raises(Unobservable, match="none sees omega_x dot; put one off the axis, tangentially"):
        channels(SpinGeometry(np.array([0.1 * Z]), np.array([Z]), np.empty((0, 3)), fixed_axis=True))


def test_a_central_accelerometer_on_a_shaft_takes_gravity_out():
    """On a tilted shaft gravity turns through F4 and F5; with F3 at the centre it cancels."""
    three = SpinGeometry(np.array([0 * X, 0.1 * Z, 0.5 * Y]), np.array([Z, Z, Z]), np.empty((0, 3)), fixed_axis=True)
    gravity, rate = np.array([5.0, 3.0, -7.0]), np.array([35.0, 0, 0])
    for geometry, error in ((three, 0.0), (BENCH, 7 / 0.1)):
        samples = measure(spin_of(geometry, feel(geometry, gravity, rate, 0 * X)), channels(geometry))
        assert samples.omega_squared_radps2[0] - 35.0**2 == pytest.approx(error, abs=1e-9)


def test_a_gyro_of_three_axes_gives_the_two_rates_and_one_alone_does_not():
    for axes in (np.eye(3), Rotation.from_rotvec([0.3, 0.4, -0.5]).as_matrix()):
        by = channels(replace(FIVE_ACCELEROMETERS, gyro_axis_b=axes), D)
        rate = np.array([30.0, 0.4, -0.7])
        assert by.transverse @ (axes @ rate) == pytest.approx(rate[1:], abs=1e-12)
    with pytest.raises(Unobservable):
        channels(replace(FIVE_ACCELEROMETERS, gyro_axis_b=np.array([Z])))


def test_values_at_the_range_and_lost_ones_make_only_their_channel_invalid():
    limit = BENCH.accel_range_mps2[0]
    spin = spin_of(
        BENCH, [[-100, 1], [-limit, 1], [-100, np.nan], [np.nan, 1], [-100, limit * 0.9995], [-limit, limit]]
    )
    samples = measure(spin, channels(BENCH))
    assert samples.omega_squared_valid.tolist() == [True, False, True, False, True, False]
    assert samples.omega_dot_valid.tolist() == [True, True, False, True, False, False]
    assert np.isfinite(samples.omega_squared_radps2[[0, 1, 2, 4, 5]]).all()
    unknown = replace(BENCH, accel_range_mps2=None)
    assert not find_saturated(spin_of(unknown, [[-1e6, 1e6]])).any()


def test_a_lost_gyro_value_spoils_what_needs_it():
    accel = np.tile([0.0, 0, 0, -120, 0], (2, 1))
    samples = measure(spin_of(FIVE_ACCELEROMETERS, accel, [[0.1, 0.1], [np.nan, 0.1]]), channels(FIVE_ACCELEROMETERS))
    assert samples.omega_dot_valid.tolist() == samples.omega_squared_valid.tolist() == [True, False]


@pytest.mark.parametrize("variance", [0.0, -1.0, np.nan, [1.0, 0.0]])
def test_variances_that_are_none_are_refused(variance):
    with pytest.raises(BadParameter, match="positive"):
        channels(BENCH, variance)


def test_the_reach_of_a_radial_accelerometer():
    """Paper, section 3.2: 2000 deg/s at 13 cm reads 16 g, so 10 cm leaves room for ripple."""
    for d1, g in ((0.10, 12.43), (0.13, 16.16)):
        geometry = bench(d1)
        assert -feel(geometry, 0 * X, np.deg2rad(2000) * X, 0 * X)[0] / 9.80665 == pytest.approx(g, abs=0.01)


def test_a_roll_truth_is_no_part_of_the_duration():
    t = np.arange(100) * 4_000_000
    spin, truth = Spin(t, np.zeros((100, 2)), np.empty((100, 0)), BENCH), Encoder(t * 3, t / 1e9, np.ones(100))
    recording = Recording("bench", spin=spin, roll_truth=truth)
    assert recording.duration_s == pytest.approx(0.396)
    assert dict(recording.streams()).keys() == {"spin", "roll_truth"}


def test_a_geometry_and_values_that_cannot_be_are_refused():
    with pytest.raises(BadRecording, match="range is not above 0"):
        replace(BENCH, accel_range_mps2=np.array([10.0, 0.0]))
    with pytest.raises(BadRecording, match="infinite"):
        spin_of(BENCH, [[np.inf, 0]])
    assert len(TERMS) == coefficients(BENCH).shape[1]
