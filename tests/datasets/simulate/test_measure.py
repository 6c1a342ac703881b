"""The sensor model: every number of the data sheet is found again in the samples."""

import json
from dataclasses import replace

import numpy as np
import pytest

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.simulate import PERFECT, PHONE, Sensor, simulate
from stillpoint.datasets.simulate.measure import (
    ALLAN_TOP,
    Axes,
    add_sensor_errors,
    draw_field_disturbances_n_ut,
    draw_gauss_markov,
)
from stillpoint.datasets.simulate.phone import IN_HAND, draw_path
from stillpoint.datasets.simulate.sensor import AccelModel, ClockModel, GyroModel, MagModel

QUIET = Axes(noise_density=0, bias=0, scale_error=0, misalignment_rad=0, limit=None, bits=None)


def allan_deviation(values, step_s, time_s):
    """Non-overlapping Allan deviation per axis of values (N, 3) for clusters of ``time_s``."""
    size = round(time_s / step_s)
    means = values[: len(values) // size * size].reshape(-1, size, 3).mean(axis=1)
    return np.sqrt(0.5 * np.mean(np.diff(means, axis=0) ** 2, axis=0))


@pytest.mark.parametrize("step_s", [0.01, 0.0025])
def test_white_noise_has_the_density_of_the_data_sheet(step_s):
    noise, _ = add_sensor_errors(np.zeros((200_000, 3)), replace(QUIET, noise_density=0.007), step_s, 0, "gyro")
    # Allan deviation of white noise is density / sqrt(time); 2000 clusters of 1 s (500 at 400 Hz) know it to 2-4 %.
    np.testing.assert_allclose(allan_deviation(noise, step_s, 1.0), 0.007, rtol=0.12)
    np.testing.assert_allclose(noise.std(axis=0), 0.007 / np.sqrt(step_s), rtol=0.01)


def test_bias_instability_is_the_top_of_the_allan_deviation():
    process = draw_gauss_markov(1.0 / ALLAN_TOP, 10.0, 0.1, 400_000, 3, "gyro")
    times = 10.0 * np.array([0.5, 1.0, 1.89, 4.0, 8.0])
    deviations = np.array([allan_deviation(process, 0.1, time).mean() for time in times])
    assert deviations.argmax() == 2
    assert deviations[2] == pytest.approx(1.0, rel=0.05)
    # The closed form of the Gauss-Markov process (IEEE Std 952, annex C).
    tau = times / 10.0
    closed = np.sqrt(2 / tau * (1 - (3 - 4 * np.exp(-tau) + np.exp(-2 * tau)) / (2 * tau))) / ALLAN_TOP
    np.testing.assert_allclose(deviations, closed, rtol=0.08)


def test_wandering_bias_is_stationary_from_its_first_sample():
    firsts = np.array([draw_gauss_markov(2.0, 200.0, 0.01, 2, seed, "gyro")[0] for seed in range(300)])
    assert firsts.std() == pytest.approx(2.0, rel=0.1)


def test_converter_has_the_stated_steps_and_range():
    ideal = np.linspace(-3, 3, 9000).reshape(-1, 3)
    out, drawn = add_sensor_errors(ideal, replace(QUIET, limit=2.0, bits=8), 0.01, 0, "accel")
    step = 4.0 / 256
    assert np.abs(out).max() == 2.0
    assert drawn["samples_at_range"] == int((np.abs(ideal) > 2).any(axis=1).sum())
    inside = np.abs(ideal) < 2
    assert np.abs(out - ideal)[inside].max() <= step / 2 * (1 + 1e-9)
    np.testing.assert_allclose(out / step, np.round(out / step), atol=1e-9)


def test_constants_have_the_stated_spread():
    axes = replace(QUIET, bias=0.1, scale_error=0.005, misalignment_rad=0.003)
    drawn = [add_sensor_errors(np.zeros((1, 3)), axes, 0.01, seed, "gyro")[1] for seed in range(400)]
    response = np.array([unit["response"] for unit in drawn])
    off = ~np.eye(3, dtype=bool)
    assert np.std([unit["bias"] for unit in drawn]) == pytest.approx(0.1, rel=0.1)
    assert (response[:, ~off] - 1).std() == pytest.approx(0.005, rel=0.1)
    assert response[:, off].std() == pytest.approx(0.003, rel=0.1)


def test_what_was_drawn_explains_the_samples():
    """Without noise, the constants in ``Info.extra`` turn perfect samples into the recorded ones."""
    sensor = Sensor(
        "still",
        GyroModel(turn_on_bias_degps=0.5, scale_error=0.01, misalignment_deg=1.0, g_sensitivity_degps_g=0.1),
        AccelModel(turn_on_bias_mg=20.0, scale_error=0.01, misalignment_deg=1.0),
        MagModel(hard_iron_ut=5.0, soft_iron=0.05, misalignment_deg=1.0),
    )
    perfect = simulate("phone-3", 2, minutes=1.5, sensor=PERFECT)
    flawed = simulate("phone-3", 2, minutes=1.5, sensor=sensor)
    drawn = json.loads(flawed.info.extra["sensor_drawn"])
    accel, gyro, mag = perfect.imu.accel_b_mps2, perfect.imu.gyro_b_radps, perfect.mag.mag_b_ut
    gyro = gyro + accel @ np.array(drawn["gyro"]["g_sensitivity"]).T
    mag = mag @ (np.eye(3) + np.array(drawn["mag"]["soft_iron"])).T
    for ideal, recorded, name in (
        (gyro, flawed.imu.gyro_b_radps, "gyro"),
        (accel, flawed.imu.accel_b_mps2, "accel"),
        (mag, flawed.mag.mag_b_ut, "mag"),
    ):
        expected = ideal @ np.array(drawn[name]["response"]).T + drawn[name]["bias"]
        np.testing.assert_allclose(recorded, expected, atol=1e-12)
        assert np.abs(recorded - ideal).max() > 1e-3


@pytest.mark.parametrize("part", ["gyro", "accel", "mag"])
def test_a_lag_shifts_its_own_stream_only(part):
    """One sample of lag at 100 Hz: every sample shows what the one before it showed without lag."""
    plain = simulate("phone-3", 1, minutes=1.5, sensor=PERFECT)
    late = simulate(
        "phone-3", 1, minutes=1.5, sensor=replace(PERFECT, **{part: replace(getattr(PERFECT, part), lag_s=0.01)})
    )
    streams = {
        "gyro": lambda recording: recording.imu.gyro_b_radps,
        "accel": lambda recording: recording.imu.accel_b_mps2,
        "mag": lambda recording: recording.mag.mag_b_ut,
    }
    for name, stream in streams.items():
        if name == part:
            np.testing.assert_allclose(stream(late)[1:], stream(plain)[:-1], atol=1e-9)
        else:
            np.testing.assert_array_equal(stream(late), stream(plain))


@pytest.mark.slow
def test_clock_has_the_stated_rate_jitter_and_skew():
    clock = ClockModel(rate_error=0.01, jitter_s=0.5e-3, skew_ppm=50.0)
    rates = []
    for seed in range(20):
        recording = simulate("phone-1", seed, minutes=0.7, sensor=replace(PERFECT, imu_clock=clock))
        late_s = (recording.imu.t_ns - recording.truth.t_ns) / 1e9
        elapsed_s = (recording.truth.t_ns - recording.truth.t_ns[0]) / 1e9
        assert (np.diff(recording.imu.t_ns) > 0).all()
        assert np.ptp(np.diff(recording.truth.t_ns)) == 0  # only the stamps jitter
        assert np.polyfit(elapsed_s, late_s, 1)[0] == pytest.approx(50e-6, abs=3e-6)
        assert (late_s - 50e-6 * elapsed_s).std() == pytest.approx(0.5e-3, rel=0.05)
        rates.append(1e9 / np.diff(recording.truth.t_ns)[0])
    assert np.std(rates) == pytest.approx(1.0, rel=0.4)  # 1 % of 100 Hz from 20 draws
    assert np.mean(rates) == pytest.approx(100.0, abs=0.8)


def test_stamps_rise_however_bad_the_jitter():
    clock = ClockModel(jitter_s=0.1)
    recording = simulate("phone-1", 0, minutes=0.7, sensor=replace(PERFECT, imu_clock=clock))
    assert (np.diff(recording.imu.t_ns) > 0).all()


@pytest.mark.slow
def test_disturbances_pass_and_come_as_often_as_stated():
    path = draw_path(IN_HAND, 3600.0, seed=0, kind="phone-3")
    t = np.arange(0, path.duration_s, 0.1)
    mag = MagModel(passings_per_min=1.0, passing_ut=5.0, passing_s=0.3)
    size = np.linalg.norm(draw_field_disturbances_n_ut(path, mag, t, seed=0), axis=1)
    assert (size[t < 50] == 0).all()  # the first rest is undisturbed
    # Bells 0.3 s wide hardly overlap: count the stretches above a hundredth of their peak.
    count = np.count_nonzero(np.diff((size > 0.05).astype(int)) == 1)
    expected = (path.rests_s[1:, 0] - path.rests_s[:-1, 1]).sum() / 60
    assert abs(count - expected) < 4 * np.sqrt(expected)
    assert 3 < size.max() < 25


def test_samples_at_the_range_are_noted():
    sensor = replace(PHONE, gyro=replace(PHONE.gyro, range_degps=250.0))
    recording = simulate("phone-3", 0, minutes=1.5, sensor=sensor)
    limit = np.deg2rad(250.0)
    at_limit = int((np.abs(recording.imu.gyro_b_radps) >= limit * (1 - 1e-9)).any(axis=1).sum())
    assert at_limit > 100
    assert recording.info.notes == (f"gyro: {at_limit} samples at the range of the sensor",)


@pytest.mark.parametrize(
    "broken",
    [
        {"gyro": GyroModel(noise_density_degps_rthz=-1.0)},
        {"accel": AccelModel(scale_error=np.nan)},
        {"mag": MagModel(bits=16)},
        {"imu_clock": ClockModel(jitter_s=np.inf)},
    ],
)
def test_impossible_sensors_are_refused(broken):
    with pytest.raises(BadParameter, match="sensor odd"):
        Sensor("odd", **broken)
