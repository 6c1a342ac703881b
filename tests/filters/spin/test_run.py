"""A stream of roll is the batch bit for bit, in both precisions; what goes in and what comes out."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from spins import CONSTANT, STREAMED

from stillpoint.datasets import BadParameter, BadRecording, Imu, Info, Recording, read, write
from stillpoint.datasets.recording import Spin
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.spin import BENCH, FIVE_ACCELEROMETERS, compute_specific_force, measure
from stillpoint.filters import estimate
from stillpoint.filters.spin import ekf as spin_ekf
from stillpoint.filters.spin import front as roll_front
from stillpoint.filters.spin.noise import make_channels
from stillpoint.filters.spin.stream import SpinStream
from stillpoint.filters.table import SPINS


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


@pytest.mark.slow
@pytest.mark.parametrize(("name", "precision"), STREAMED)
def test_a_stream_is_the_batch_bit_for_bit_also_when_cut_in_two(name, precision):
    spin = untidy().spin
    batch = estimate(untidy(), name, CONSTANT, precision)
    stream = SpinStream(name, BENCH, CONSTANT, precision)
    answers = []
    for k, (t_ns, row) in enumerate(zip(spin.t_ns, spin.accel_mps2, strict=True)):
        if k == len(spin.t_ns) // 2:
            stream = SpinStream(name, BENCH, CONSTANT, precision, saved=pickle.loads(pickle.dumps(stream.save())))
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
    force = [compute_specific_force(arm, np.array([0.0, 1.0, 9.0]), rate, change) for arm in geometry.accel_r_b_m]
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
    stream = SpinStream("roll-ekf", spin.geometry, params, precision)
    rows = zip(spin.t_ns.tolist(), spin.accel_mps2.tolist(), spin.gyro_radps.tolist(), strict=True)
    answers = np.array([stream.update(*row) for row in rows])
    assert np.array_equal(answers[:, 0], batch.angle_rad)
    assert np.array_equal(answers[:, 3], batch.rate_sd_radps)
    assert stream.counts.items() <= batch.diagnostics.items()
    assert batch.rate_radps.min() < -20  # so the gyro about x took part


@pytest.mark.parametrize("make", [untidy, of_five])
def test_the_compiled_channels_are_those_of_the_doctor_and_the_smoother(make):
    spin, params = make().spin, spin_ekf.Params()
    by = make_channels(params, spin.geometry)
    seen = measure(spin, by)
    c = roll_front.coefficients(by, params, "double")
    _, log = roll_front.filter_log(spin.t_ns, spin.accel_mps2, spin.gyro_radps, roll_front.start(), c)
    assert np.array_equal(log.has_accel, seen.omega_dot_valid)
    assert np.array_equal(log.has_square, seen.omega_squared_valid)
    assert np.array_equal(log.accel_radps2, seen.omega_dot_radps2, equal_nan=True)
    assert np.array_equal(log.square_rad2ps2, seen.omega_squared_radps2, equal_nan=True)


def test_another_number_of_values_is_refused_in_one_line():
    stream = SpinStream("roll-ekf", BENCH, CONSTANT)
    with pytest.raises(BadParameter, match="3 accelerometers and 0 gyros: the geometry has 2 and 0"):
        stream.update(0, (1.0, 2.0, 3.0))
    other = SpinStream("roll-ekf", BENCH, CONSTANT, "single").save()
    with pytest.raises(BadParameter, match="of roll-ekf single, not of roll-ekf double"):
        SpinStream("roll-ekf", BENCH, CONSTANT, saved=other)


def test_a_stamp_that_does_not_rise_is_left_out_and_counted():
    stream = SpinStream("roll-ekf", BENCH, CONSTANT)
    first = stream.update(1000, (-124.0, 0.0))
    assert np.array_equal(stream.update(1000, (-60.0, 9.0)), first, equal_nan=True)
    assert stream.counts["n_out_of_order"] == 1


@pytest.mark.parametrize("name", SPINS)
def test_single_precision_holds_the_angle_over_168_turns(name):
    """1057 rad have steps of 1.2e-4 rad in float32; whole turns and a rest do not."""
    recording = simulate("spin-constant", seed=0, sensor="white")
    double, single = (estimate(recording, name, CONSTANT, precision) for precision in ("double", "single"))
    assert double.angle_rad[-1] > 1050
    assert np.rad2deg(np.abs(single.angle_rad - double.angle_rad).max()) < 0.02
    assert single.rate_radps.tolist() == single.rate_radps.astype(np.float32).tolist()


def test_an_estimate_of_roll_goes_to_a_file_and_back(tmp_path):
    found = estimate(untidy(), "roll-guarded", CONSTANT)
    write(tmp_path / "x.roll-guarded.estimate.mcap", found)
    back = read(tmp_path / "x.roll-guarded.estimate.mcap")
    for field in ("angle_rad", "rate_radps", "angle_sd_rad", "rate_sd_radps", "ready"):
        assert getattr(back, field).tolist() == getattr(found, field).tolist()
    assert back.q_nb is None
    assert dict(back.params) == dict(found.params)
    assert dict(back.diagnostics) == dict(found.diagnostics)


def test_what_does_not_fit_gives_one_line_error():
    imu = Imu(np.arange(3), np.zeros((3, 3)), np.tile([0, 0, 9.8], (3, 1)))
    with pytest.raises(BadRecording, match="no accelerometers on a spinning body"):
        estimate(Recording("x", imu, info=Info(units_unchecked=True)), "roll-ekf")
    with pytest.raises(BadParameter, match="radial_var_m2ps4"):
        estimate(untidy(), "roll-ekf", {"radial_var_m2ps4": 0.0})
    with pytest.raises(BadParameter, match="estimates an attitude"):
        SpinStream("cf", BENCH)
