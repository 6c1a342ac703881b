"""Simulated spins: the truth against itself, the noise against the paper's variances, the physics against eq (1)."""

import json
from dataclasses import replace

import numpy as np
import pytest

from stillpoint.datasets import BadParameter, read, write
from stillpoint.datasets.simulate import SIMULATIONS, simulate
from stillpoint.datasets.simulate.spin_sensor import CONSTANT, EncoderModel, SpinAccel, SpinSensor
from stillpoint.datasets.spin import BENCH, channels, measure

COMMON = ["white", "vibration", "vibration-f4", "glitch", "replica", "adxl345", "perfect"]
KINDS = ["spin-constant", "spin-variable", "spin-flight"]
PERFECT = CONSTANT["perfect"]


def true_at(recording):
    """True rates (N,) at the samples of the accelerometers, rad/s."""
    at = np.searchsorted(recording.roll_truth.t_ns, recording.spin.t_ns)
    return recording.roll_truth.rate_radps[at]


def variances(recording):
    """D4 and D5 by the truth: Asghari et al. 2018, eqs (28) and (30)."""
    spin, rate = recording.spin, true_at(recording)
    d1, d2 = BENCH.accel_r_b_m[0, 2], BENCH.accel_r_b_m[1, 1]
    turning = np.gradient(rate, spin.t_ns / 1e9)
    return np.var(d1 * rate**2 + spin.accel_mps2[:, 0]), np.var(d2 * turning - spin.accel_mps2[:, 1])


@pytest.mark.parametrize("kind", KINDS)
def test_the_observations_of_a_perfect_sensor_are_the_truth(kind):
    """Of the five in flight too, where the axis cones and the centre is braked: the geometry takes it all out."""
    recording = simulate(kind, 3, sensor="perfect")
    samples = measure(recording.spin, channels(recording.spin.geometry))
    assert np.sqrt(samples.omega_squared_radps2) == pytest.approx(true_at(recording), abs=1e-9)
    assert samples.omega_dot_radps2 == pytest.approx(np.gradient(true_at(recording), 0.004, edge_order=2), abs=0.05)
    assert samples.omega_squared_valid.all()
    assert samples.omega_dot_valid.all()


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_true_angle_is_the_integral_of_the_true_rate(kind):
    truth = simulate(kind, 1, rate_hz=2000.0).roll_truth
    steps = 0.5 * (truth.rate_radps[1:] + truth.rate_radps[:-1]) * np.diff(truth.t_ns) / 1e9
    assert truth.angle_rad[0] == 0
    assert truth.angle_rad == pytest.approx(np.concatenate([[0], np.cumsum(steps)]), abs=1e-4)


def test_the_scenarios_are_the_papers():
    """Table 1: T = 4 ms, 30 s at 2000 to 2050 deg/s, 60 s at 1500 to 2100 deg/s."""
    for kind, length, low, high in (("spin-constant", 30, 2000, 2050), ("spin-variable", 60, 1500, 2100)):
        for seed in range(10):
            recording = simulate(kind, seed)
            rate = np.rad2deg(recording.roll_truth.rate_radps)
            assert len(recording.spin.t_ns) == length * 250
            assert (np.diff(recording.spin.t_ns) == 4_000_000).all()
            assert low - 1 < rate.min() < rate.max() < high + 1
    assert np.ptp(rate) > 500


@pytest.mark.parametrize(("kind", "d4", "d5"), [("spin-constant", 0.8, 0.12), ("spin-variable", 0.4, 3.0)])
def test_white_noise_has_the_papers_variances(kind, d4, d5):
    """A variance of 4 x 7500 samples has a standard deviation of 0.8 %."""
    found = np.mean([variances(simulate(kind, seed)) for seed in range(4)], axis=0)
    assert found == pytest.approx((d4, d5), rel=0.03)


def test_glitches_are_as_many_and_as_large_as_stated():
    """Two in 30 s: 40 in 20 trials, +-6; each 4 to 8 g unless the range cuts it."""
    sizes = []
    for seed in range(20):
        recording = simulate("spin-constant", seed, sensor="glitch")
        error = recording.spin.accel_mps2[:, 0] + 0.1 * true_at(recording) ** 2
        sizes += list(error[np.abs(error) > 15] / 9.80665)
    sizes = np.array(sizes)
    assert 22 <= len(sizes) <= 58
    assert sizes.max() == pytest.approx(8, abs=0.5)
    assert sizes[sizes > 0].min() > 3.9
    assert -3.5 < sizes.min() < -3.2  # from 12.5-12.8 g to the range of 16 g


def test_a_residual_shifts_the_replica_alone():
    glitch, replica = (simulate("spin-constant", 2, sensor=sensor).spin.accel_mps2 for sensor in ("glitch", "replica"))
    assert np.mean(replica - glitch, axis=0) == pytest.approx((0.009, 0), abs=1e-3)


def test_a_tilted_shaft_turns_gravity_through_both():
    """F4 and F5 lie along z: both feel g sin(tilt) cos(angle)."""
    level, tilted = (simulate("spin-constant", 0, sensor=replace(PERFECT, tilt_deg=tilt)) for tilt in (0.0, 30.0))
    harmonic = 9.80665 * 0.5 * np.cos(level.roll_truth.angle_rad)
    difference = tilted.spin.accel_mps2 - level.spin.accel_mps2
    assert difference == pytest.approx(np.column_stack([harmonic, harmonic]), abs=1e-9)


def test_vibration_has_the_stated_size():
    shaken = replace(PERFECT, radial=SpinAccel(vibration_1x_mps2=0.6, vibration_2x_mps2=0.3))
    difference = simulate("spin-constant", 0, sensor=shaken).spin.accel_mps2
    difference = difference - simulate("spin-constant", 0, sensor=PERFECT).spin.accel_mps2
    assert np.std(difference, axis=0) == pytest.approx((np.hypot(0.6, 0.3), 0), rel=0.02)


def test_errors_of_bias_scale_and_arm_are_those_that_were_drawn():
    loose = replace(PERFECT, radial=SpinAccel(bias_mg=40, scale_error=0.01, arm_error=0.001))
    recording = simulate("spin-constant", 5, sensor=loose)
    drawn = json.loads(recording.info.extra["sensor_drawn"])["accelerometers"][0]
    true = -0.1 * (1 + drawn["arm"]) * true_at(recording) ** 2
    assert recording.spin.accel_mps2[:, 0] == pytest.approx(true * (1 + drawn["scale"]) + drawn["bias"], abs=1e-9)
    assert recording.spin.geometry.accel_r_b_m[0] == pytest.approx((0, 0, 0.1))


def test_lost_samples_are_missing_stamps_and_said():
    recording = simulate("spin-constant", 0, sensor=replace(PERFECT, lost_share=0.05))
    lost = 7500 - len(recording.spin.t_ns)
    assert 300 < lost < 450
    assert recording.info.notes == (f"{lost} samples lost on the way",)
    assert len(recording.roll_truth.t_ns) == 7500
    assert np.sqrt(-recording.spin.accel_mps2[:, 0] / 0.1) == pytest.approx(true_at(recording), abs=1e-9)


def test_saturation_is_flagged_and_counted():
    """At 2000 deg/s F4 reads 12.4 g: a range of 12 g is left."""
    recording = simulate("spin-constant", 0, sensor=replace(PERFECT, range_g=12.0))
    samples = measure(recording.spin, channels(recording.spin.geometry))
    assert not samples.omega_squared_valid.any()
    assert samples.omega_dot_valid.all()
    assert recording.info.notes == ("accelerometer 1: 7500 samples at its range",)


def test_the_encoder_has_its_resolution_and_its_latency():
    """The angle is late by rate x latency and counted down; the mean rate over a step needs no count."""
    model = EncoderModel(counts_per_turn=1000, timer_s=0.0, latency_s=0.002)
    recording = simulate("spin-constant", 0, sensor=replace(PERFECT, encoder=model))
    encoder, truth = recording.encoder, recording.roll_truth
    behind = truth.angle_rad - encoder.angle_rad - 0.002 * truth.rate_radps
    assert behind.min() > -1e-3
    assert behind.max() < 2 * np.pi / 1000 + 1e-3
    assert behind.mean() == pytest.approx(np.pi / 1000, rel=0.05)
    assert np.rad2deg(np.std(encoder.rate_radps[1:] - truth.rate_radps[:-1])) < 0.1
    assert simulate("spin-constant", 0, sensor=replace(PERFECT, encoder=None)).encoder is None


def test_a_longer_trial_begins_like_a_shorter_one():
    short, long = (simulate("spin-variable", 4, minutes=minutes) for minutes in (0.2, 0.4))
    n = len(short.spin.t_ns)
    assert long.spin.accel_mps2[:n] == pytest.approx(short.spin.accel_mps2, abs=1e-6)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("sensor", COMMON)
def test_every_preset_comes_back_from_its_file(kind, sensor, tmp_path):
    made = simulate(kind, 2, minutes=0.05, sensor=sensor)
    write(tmp_path / "a.mcap", made)
    write(tmp_path / "b.mcap", simulate(kind, 2, minutes=0.05, sensor=sensor))
    kept = read(tmp_path / "a.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    assert kept.spin.accel_mps2.tobytes() == made.spin.accel_mps2.tobytes()
    assert kept.roll_truth.angle_rad.tobytes() == made.roll_truth.angle_rad.tobytes()
    assert kept.spin.geometry.accel_range_mps2.tobytes() == made.spin.geometry.accel_range_mps2.tobytes()
    assert kept.spin.geometry.fixed_axis == made.spin.geometry.fixed_axis == (kind != "spin-flight")
    assert kept.info == made.info


def test_every_kind_has_these_presets():
    names = [list(SIMULATIONS[kind].sensors) for kind in KINDS]
    assert names == [[*COMMON, "tilted", "horizontal"]] * 2 + [COMMON]


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: simulate("spin-constant", sensor="phone"), "no sensor of spin-constant 'phone'"),
        (lambda: simulate("spin-constant", sensor=SIMULATIONS["phone-1"].sensors["perfect"]), "takes a SpinSensor"),
        (lambda: simulate("phone-1", sensor=PERFECT), "takes a Sensor"),
        (lambda: SpinSensor("bad", radial=SpinAccel(noise_mps2=-1.0)), "radial.noise_mps2: is -1; give a finite"),
        (lambda: SpinSensor("bad", lost_share=1.0), "give a share below 1"),
    ],
)
def test_impossible_spins_are_refused(make, said):
    with pytest.raises(BadParameter, match=said):
        make()
