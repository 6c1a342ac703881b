"""What estimators of roll make of broken samples: never a number that is none, and everything is counted."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from spins import CONSTANT, STREAMED, spoilt

from stillpoint.datasets import Encoder, Recording, Spin, SpinGeometry
from stillpoint.datasets.spin import BENCH, FIVE_ACCELEROMETERS, channels, compute_specific_force
from stillpoint.filters import estimate
from stillpoint.filters.spin.stream import SpinStream
from stillpoint.filters.table import SPINS
from stillpoint.scoring.spin import score_roll

X, Y, Z = np.eye(3)
# Radial accelerometers on both sides of the axis, tangential ones likewise: the bench with one of each to spare.
DOUBLED = SpinGeometry(
    np.array([0.1 * Z, 0.5 * Y, -0.1 * Z, -0.5 * Y]),
    np.array([Z, Z, -Z, -Z]),
    np.empty((0, 3)),
    np.full(4, 16 * 9.80665),
    fixed_axis=True,
)
HARSH = [
    ("roll-obs", {}),
    ("roll-ekf", {"radial_var_m2ps4": 1e-8, "tangential_var_m2ps4": 1e6}),
    ("roll-ekf", {"process_noise": "literal", "first_rate": "first"}),
    ("roll-aekf", {}),
    ("roll-aekf", {"mode": "system", "largest_alpha": 1e12, "largest_lambda": 1e12, "first_rate": "first"}),
    ("roll-aekf", {"mode": "system", "radial_var_m2ps4": 1e6, "tangential_var_m2ps4": 1e-8}),
    ("roll-guarded", {}),
    ("roll-guarded", {"largest_alpha": 1e6, "bias_sd_radps2": 1e3, "radial_var_m2ps4": 1e-8, "gate_sd": 100.0}),
]
SIZES = st.one_of(st.floats(-200, 200), st.floats(-1e12, 1e12), st.sampled_from([np.nan, 0.0, 1e-300, 1e300]))
STEPS_NS = st.sampled_from([1, 1000, *[4_000_000] * 8, 1_000_000_000, 10**13, 10**16])


@st.composite
def broken(draw) -> Recording:
    """Up to 60 samples of accelerometers without a stated range: any sizes, any steps, some of them good."""
    geometry = replace(draw(st.sampled_from([BENCH, FIVE_ACCELEROMETERS, DOUBLED])), accel_range_mps2=None)
    n, k, m = draw(st.integers(1, 60)), len(geometry.accel_r_b_m), len(geometry.gyro_axis_b)
    good = np.where(np.abs(geometry.accel_axis_b @ Z) * (np.abs(geometry.accel_r_b_m @ Z) > 0), -124.0, 0.0)
    accel = np.where(
        draw(arrays(np.bool_, (n, k))), draw(arrays(np.float64, (n, k), elements=SIZES, fill=st.just(0.0))), good
    )
    gyro = draw(arrays(np.float64, (n, m), elements=st.sampled_from([0.0, 3.0, -35.0, np.nan, 1e8])))
    t_ns = np.cumsum(draw(arrays(np.int64, n, elements=STEPS_NS)))
    return Recording("broken", spin=Spin(t_ns, accel, gyro, geometry))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "params"), HARSH)
@given(broken(), st.sampled_from(["double", "single"]))
@settings(max_examples=40)  # of 60 samples each, which take long to draw
def test_any_samples_give_finite_rates_and_positive_variances(name, params, recording, precision):
    """Also with the hardest settings: finite angles and rates, variances above 0, and no sample that is not counted."""
    found = estimate(recording, name, params, precision)  # refuses columns that are not finite
    assert (found.rate_sd_radps[found.ready] > 0).all()
    assert (found.angle_sd_rad >= 0).all()
    spin = recording.spin
    lost = (~(np.abs(spin.accel_mps2) < 1e7)).any(axis=1)
    if spin.geometry is not FIVE_ACCELEROMETERS:
        assert found.diagnostics["n_lost"] <= lost.sum()
    assert found.diagnostics["n_no_square"] <= len(spin.t_ns)
    assert found.diagnostics.get("n_variance_not_positive", 0) == 0


@pytest.mark.slow
@pytest.mark.parametrize(("name", "precision"), STREAMED)
@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan, 1e300, 9e8, -9e8])
def test_any_value_leaves_a_spin_stream_finite(name, precision, value):
    stream = SpinStream(name, replace(BENCH, accel_range_mps2=None), CONSTANT, precision)
    for k in range(200):
        good = (-0.1 * 35**2, 0.0)
        bad = ((value, value), (value, 0.0), (good[0], value), (0.0, 0.0))[k % 4]
        said = stream.update(k * 4_000_000, bad if 50 <= k < 70 else good)
        assert np.isfinite(said[:4]).all()


@pytest.mark.parametrize("name", SPINS)
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


def of_double(n: int = 2000, seed: int = 0) -> Recording:
    """The bench with one radial and one tangential accelerometer to spare, at 35 rad/s, noise as CONSTANT says."""
    rng = np.random.default_rng(seed)
    rate, change = np.array([35.0, 0, 0]), np.zeros(3)
    force = [
        compute_specific_force(arm, change, rate, change) @ axis for arm, axis in zip(*arms_and_axes(), strict=True)
    ]
    accel = np.array(force) + rng.standard_normal((n, 4)) * np.sqrt([0.8, 0.125, 0.8, 0.125])
    t_ns = np.arange(n, dtype=np.int64) * 4_000_000
    truth = Encoder(t_ns, 35.0 * t_ns / 1e9, np.full(n, 35.0))
    return Recording("double", spin=Spin(t_ns, accel, np.empty((n, 0)), DOUBLED), roll_truth=truth)


def arms_and_axes():
    return DOUBLED.accel_r_b_m, DOUBLED.accel_axis_b


@pytest.mark.parametrize("name", ["roll-obs", "roll-ekf", "roll-aekf", "roll-guarded"])
@pytest.mark.parametrize("value", [np.nan, -157.0])
def test_where_one_of_two_is_lost_or_at_its_range_the_other_goes_on(name, value):
    """As if there were only the other one, to the last digit but rounding: weights and variances are those."""
    recording = of_double()
    accel = recording.spin.accel_mps2.copy()
    accel[:, 2] = value
    found = estimate(replace(recording, spin=replace(recording.spin, accel_mps2=accel)), name, CONSTANT)
    three = SpinGeometry(*(each[[0, 1, 3]] for each in arms_and_axes()), np.empty((0, 3)), None, fixed_axis=True)
    alone = estimate(
        replace(recording, spin=replace(recording.spin, accel_mps2=accel[:, [0, 1, 3]], geometry=three)), name, CONSTANT
    )
    assert found.diagnostics["n_spared"] == len(accel)
    assert found.diagnostics["n_no_square"] == 0
    assert found.diagnostics["n_lost" if np.isnan(value) else "n_saturated"] == len(accel)
    assert found.rate_radps == pytest.approx(alone.rate_radps, rel=1e-9)
    assert found.rate_sd_radps == pytest.approx(alone.rate_sd_radps, rel=1e-9)


def test_without_one_that_nothing_replaces_there_is_no_observation():
    recording = of_double()
    accel = recording.spin.accel_mps2.copy()
    accel[500:600, [0, 2]] = -157.0
    found = estimate(replace(recording, spin=replace(recording.spin, accel_mps2=accel)), "roll-ekf", CONSTANT)
    assert found.diagnostics["n_spared"] == 0
    assert found.diagnostics["n_no_square"] == 100
    assert channels(BENCH).spare_squared[0] is None


@pytest.mark.parametrize("lost", [0, 2])
def test_a_spare_is_the_best_of_the_others(lost):
    """Two opposite radial accelerometers take out gravity, R = D / (2 d^2); one has it from both tangential ones."""
    by = channels(DOUBLED)
    assert by.r_rad2ps4 == pytest.approx(50.0)
    assert by.spare_squared[lost].variance == pytest.approx((1 + 1 / 2) / 0.1**2)
    assert by.spare_squared[lost].accel[lost] == 0.0
    assert by.spare_dot[lost].accel == pytest.approx(by.omega_dot.accel)
