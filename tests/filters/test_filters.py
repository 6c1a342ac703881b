"""Every filter of the table over the same suite of motions with exact truth, batch and streaming."""

import pickle
from dataclasses import asdict, replace
from functools import cache

import numpy as np
import pytest
from motions import (
    GRAVITY_N,
    errors_deg,
    feed,
    jittered,
    record,
    regular,
    resting,
    turning,
    untidy,
    wobble,
)
from numpy.typing import NDArray
from quick import mark_slow_except
from scipy.spatial.transform import Rotation

from stillpoint.datasets import BadParameter, Gps, Imu, Info, Mag, Recording
from stillpoint.datasets.frames import heading_rotation, rotation
from stillpoint.filters import ESTIMATORS, Stream, estimate
from stillpoint.filters.precision import Precision
from stillpoint.filters.table import Estimator, SpinEstimator

FILTERS = [name for name, entry in ESTIMATORS.items() if isinstance(entry, Estimator)]
# Streams in single precision are compiled anew for each estimator, which takes longer than what is tested with them.
# One without arrays in its state, one with covariances, one with arrays stand for all; each runs in batch.
STREAMED_SINGLE: list[tuple[str, Precision]] = [("cf", "single"), ("ekf", "single"), ("acc-ma", "single")]
# What the courses give stands in front of every estimator, and its streams are compiled anew for each. The same kinds.
BY_COURSE: list[tuple[str, Precision]] = [("cf", "double"), ("ekf", "double"), ("acc-ma", "double"), ("cf", "single")]
ATTITUDE = [name for name, entry in ESTIMATORS.items() if not isinstance(entry, SpinEstimator)]
FOLLOWING = [name for name in FILTERS if name != "acc-ma"]  # acc-ma is late by half its window, by design
# The Euler rates of cf-literal, which nothing corrects, are not defined at a pitch of 90 deg.
ON_THE_ROTATION = [name for name in FOLLOWING if name != "cf-literal"]


@pytest.mark.slow
@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("heading_deg", [0, 90, 179.9, -179.9, -60])
def test_a_level_rest_stays_where_it_is(name: str, heading_deg: float) -> None:
    pose = resting(heading_rotation(np.deg2rad(heading_deg)))
    recording = record(pose, regular(12))
    found = estimate(recording, name)
    assert errors_deg(found.q_nb, recording, pose).max() < 1e-5  # the arc cosine of 1 - 1e-16 is 1e-6 deg
    assert found.ready is not None
    assert found.ready[-1]


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (1, 1, 0), (3, -1, 0.2)])
def test_an_upside_down_start_is_no_special_case(name: str, axis: tuple[float, float, float]) -> None:
    pose = resting(Rotation.from_rotvec(np.pi * np.array(axis) / np.linalg.norm(axis)))
    recording = record(pose, regular(8))
    assert errors_deg(estimate(recording, name).q_nb, recording, pose).max() < 1e-5


@pytest.mark.parametrize("name", ON_THE_ROTATION)
@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, -1), (1, 2, 3)])
def test_two_whole_turns_through_every_wrap(name: str, axis: tuple[float, float, float]) -> None:
    spin = turning(axis, 90.0, Rotation.from_euler("ZYX", [170, 20, -30], degrees=True))
    recording = record(spin, regular(8))
    # The low pass (9) delays acc by 0.3 of a sample; the fields change direction by at most 90 deg/s.
    late_deg = 0.3 * 90.0 / 100.0 * 1.5
    assert errors_deg(estimate(recording, name).q_nb, recording, spin).max() < late_deg


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1)])
def test_the_moving_average_of_a_steady_turn_is_late_by_half_its_window(axis: tuple[float, float, float]) -> None:
    spin = turning(axis, 20.0)
    recording = record(spin, regular(36))  # two turns, past +-180 deg
    found = estimate(recording, "acc-ma", {"window_s": 7.0, "kappa": 1.0})
    delayed = turning(axis, 20.0, Rotation.from_rotvec(-np.deg2rad(20.0) * 3.495 * np.array(axis)))  # (700 - 1) / 2
    assert errors_deg(found.q_nb, recording, delayed)[700:].max() < 1e-5
    assert not found.ready[699]
    assert found.ready[700]


@pytest.mark.parametrize("name", FOLLOWING)
def test_jitter_of_the_clock_costs_nothing(name: str) -> None:
    recording = record(wobble, jittered(12))
    late_deg = 0.3 * np.rad2deg(2.0) * 0.018 * 1.5  # 2 rad/s at most, steps of 18 ms at most, see above
    assert errors_deg(estimate(recording, name).q_nb, recording, wobble).max() < late_deg


@pytest.mark.parametrize("name", FOLLOWING)
def test_a_magnetometer_may_be_slower_and_have_its_own_clock(name: str) -> None:
    slow_turn = turning((0, 0, 1), 5.0)
    recording = record(slow_turn, regular(20), np.arange(0.0031, 20, 0.1))
    held_deg = 5.0 * (0.1 + 0.01 + 0.03)  # acc holds a field in body axes for one period; its low pass, a third more
    assert errors_deg(estimate(recording, name).q_nb, recording, slow_turn)[10:].max() < held_deg


@pytest.mark.parametrize("name", FILTERS)
def test_after_a_gap_the_attitude_is_found_again(name: str) -> None:
    t_s = regular(30)
    spin = turning((0.2, 0.1, 1), 33.0)
    recording = record(spin, t_s[(t_s < 5) | (t_s > 9.3)])
    still = resting(spin(np.array([9.31]))[0])
    rest = record(still, regular(12) + 9.31)
    imu, later = recording.require_imu(), rest.require_imu()
    before = imu.t_ns < 5e9
    joined = Recording(
        "gap",
        Imu(
            np.concatenate([imu.t_ns[before], later.t_ns]),
            np.concatenate([imu.gyro_b_radps[before], np.zeros_like(later.gyro_b_radps)]),
            np.concatenate([imu.accel_b_mps2[before], later.accel_b_mps2]),
        ),
        mag=rest.mag,
        info=Info(units_unchecked=True),
    )
    found = estimate(joined, name)
    assert found.diagnostics["n_imu_gaps"] == 1
    if name != "gyro":  # nothing ever tells the gyro what happened in the gap
        assert np.rad2deg((rotation(found.q_nb[-1]) * still(np.zeros(1))[0].inv()).magnitude()) < 0.1


def test_the_gyro_bridges_a_gap_with_the_rate_at_its_end() -> None:
    t_s = regular(30)
    spin = turning((0.2, 0.1, 1), 33.0)
    recording = record(spin, t_s[(t_s < 5) | (t_s > 9.3)])
    turned = turning((0.2, 0.1, 1), 33.0)
    found = estimate(recording, "gyro")
    assert found.diagnostics["n_gaps"] == 1
    # record() made the rate over the gap from the attitudes at its ends, so holding it is exact.
    assert errors_deg(found.q_nb, recording, turned).max() < 1e-5


def test_the_trapezoidal_rule_is_exact_for_instant_samples_of_a_ramp() -> None:
    t_s = regular(10)
    rate_radps = 0.3 * t_s  # at the instant of the stamp; the angle is 0.15 t^2
    gyro = np.column_stack([np.zeros_like(t_s), np.zeros_like(t_s), rate_radps])
    imu = Imu(np.round(t_s * 1e9).astype(np.int64), gyro, np.tile(GRAVITY_N, (len(t_s), 1)))
    ramp = Recording("ramp", imu, info=Info(units_unchecked=True))

    def turned_rad(rule: str) -> float:
        q_nb = rotation(estimate(ramp, "gyro", {"rule": rule}).q_nb)
        return float((q_nb[-1] * q_nb[0].inv()).as_rotvec()[2] % (2 * np.pi))

    exact = 0.15 * t_s[-1] ** 2 % (2 * np.pi)
    assert turned_rad("trapezoidal") == pytest.approx(exact, abs=1e-9)
    late_by_half_a_step = 0.5 * 0.3 * t_s[-1] * 0.01
    assert turned_rad("rectangular") - exact == pytest.approx(late_by_half_a_step, rel=1e-6)


@cache
def stream_untidy(name: str) -> tuple[NDArray[np.float64], dict[str, int]]:
    """Return the quaternions of a stream that gets the untidy recording, and its counts."""
    stream = Stream(name)
    return feed(stream, untidy()), stream.counts


@pytest.mark.parametrize("name", FILTERS)
def test_streaming_and_batch_agree_bit_for_bit(name: str) -> None:
    streamed, counts = stream_untidy(name)
    batch = estimate(untidy(), name)
    assert (streamed == batch.q_nb).all()
    for what, count in counts.items():
        assert count == batch.diagnostics.get(what, 0), what


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("cut", [1, 2, 777, 1400])
def test_two_halves_are_the_whole_bit_for_bit(name: str, cut: int) -> None:
    recording = untidy()
    whole, _ = stream_untidy(name)
    first = Stream(name)
    head = feed(first, recording, last=cut)
    saved = pickle.loads(pickle.dumps(first.save()))
    feed(first, recording, first=cut)  # going on must not reach into what was saved
    tail = feed(Stream(name, saved=saved), recording, first=cut)
    assert (np.concatenate([head, tail]) == whole).all()


@pytest.mark.parametrize("name", FILTERS)
def test_single_precision_is_single_throughout_and_near_double(name: str) -> None:
    recording = untidy()
    double, single = estimate(recording, name), estimate(recording, name, precision="single")
    assert (single.q_nb.astype(np.float32) == single.q_nb).all()
    assert not (double.q_nb.astype(np.float32) == double.q_nb).all()
    apart_deg = np.rad2deg((rotation(single.q_nb) * rotation(double.q_nb).inv()).magnitude())
    assert apart_deg.max() < 0.01
    assert single.diagnostics["off_double_max_deg"] == pytest.approx(apart_deg.max())
    assert single.diagnostics["off_double_rms_deg"] == pytest.approx(np.sqrt(np.mean(apart_deg**2)))
    assert "off_double_max_deg" not in double.diagnostics


@pytest.mark.parametrize(("name", "precision"), STREAMED_SINGLE)
def test_a_stream_in_single_precision_gives_the_bits_of_the_batch(name: str, precision: Precision) -> None:
    recording = untidy()
    streamed = feed(Stream(name, precision=precision), recording, last=300)
    assert (streamed == estimate(recording, name, precision=precision).q_nb[:300]).all()


@pytest.mark.slow
@pytest.mark.parametrize(("name", "precision"), BY_COURSE)
def test_by_gps_course_too_halves_streams_and_batch_agree_bit_for_bit(name: str, precision: Precision) -> None:
    recording = with_fixes(untidy())
    batch = estimate(recording, name, precision=precision, heading="gps-course")
    first = Stream(name, precision=precision, heading="gps-course")
    head = feed(first, recording, last=900)
    saved = pickle.loads(pickle.dumps(first.save()))
    feed(first, recording, first=900)
    second = Stream(name, precision=precision, heading="gps-course", saved=saved)
    tail = feed(second, recording, first=900)
    assert (np.concatenate([head, tail]) == batch.q_nb).all()
    assert batch.diagnostics["n_mag_by_course"] > 100
    assert batch.diagnostics["n_mag_corrected"] > 20
    for counts in (first.counts, second.counts):
        assert {what: batch.diagnostics[what] for what in counts} == counts


def with_fixes(recording: Recording) -> Recording:
    """Courses of a body that is not where it says, on a clock of their own: some slow, some not valid."""
    draw, t_s = np.random.default_rng(7), np.arange(0.3, 20.0, 0.4)
    n = len(t_s)
    gps = Gps(
        np.round(t_s * 1e9).astype(np.int64),
        np.full(n, 36.9),
        np.full(n, 50.9),
        np.zeros(n),
        draw.uniform(-4, 4, n),
        np.where((t_s > 14) & (t_s < 17), 0.1, draw.uniform(1, 2, n)),
        draw.uniform(size=n) > 0.1,
    )
    return replace(recording, gps=gps)


@pytest.mark.parametrize("name", FILTERS)
def test_free_fall_and_a_missing_field_keep_the_attitude(name: str) -> None:
    stream = Stream(name)
    for k in range(1000):
        falling, dead = 400 <= k < 420, 600 <= k < 650
        out = stream.update(
            k * 10_000_000,
            (0.0, 0.0, 0.0),
            (0.0, 0.0, 0.0) if falling else (0.0, 0.0, 9.81),
            (0.0, 0.0, 0.0) if dead else (0.0, 20.0, -44.0),
        )
        assert np.rad2deg(rotation(out.q_nb).magnitude()) < 1e-5
    if name != "gyro":  # it looks at the fields once
        assert stream.counts["n_free_fall"] == 20
        assert stream.counts["n_no_field"] == 50


@pytest.mark.parametrize("name", FILTERS)
def test_without_a_magnetometer_only_the_tilt_is_corrected(name: str) -> None:
    pose = resting(Rotation.from_euler("ZYX", [40, 10, -20], degrees=True))
    with_field = record(pose, regular(20))
    recording = Recording("6d", with_field.imu, info=Info(units_unchecked=True))
    found = estimate(recording, name)
    up_b = rotation(found.q_nb).inv().apply([0, 0, 1])
    assert np.allclose(up_b, with_field.require_imu().accel_b_mps2 / 9.81, atol=1e-9)
    assert np.ptp(found.q_nb, axis=0).max() < 1e-12
    assert found.diagnostics["heading"] == "arbitrary: there is no magnetometer"


@pytest.mark.parametrize("name", mark_slow_except(ATTITUDE, *FILTERS, "vqf"))
def test_an_uncalibrated_magnetometer_is_as_none(name: str) -> None:
    pose = resting(Rotation.from_euler("ZYX", [40, 10, -20], degrees=True))
    plain = record(pose, regular(8))
    info = Info(units_unchecked=True, mag_uncalibrated=True, date="2021-06-12", place_lat_lon_alt=(35.8, 51.49, 1600.0))
    raw = Mag(plain.mag.t_ns, plain.mag.mag_b_ut + np.array([300.0, -200.0, 100.0]))
    found = estimate(Recording("raw", plain.imu, mag=raw, info=info), name)
    without = estimate(Recording("none", plain.imu, info=info), name)
    np.testing.assert_array_equal(found.q_nb, without.q_nb)
    assert found.diagnostics["heading"] == "arbitrary: the magnetometer is not calibrated"
    assert found.diagnostics["n_mag_uncalibrated"] == len(raw.t_ns)
    assert found.diagnostics["declination_rad"] == 0.0


@pytest.mark.parametrize("name", mark_slow_except(ATTITUDE, *FILTERS, "vqf"))
def test_the_declination_turns_every_estimator_to_true_north(name: str) -> None:
    pose = resting(Rotation.from_euler("ZYX", [40, 10, -20], degrees=True))
    plain = record(pose, regular(8))
    east = Recording(
        "tehran",
        plain.imu,
        mag=plain.mag,
        info=Info(units_unchecked=True, date="2021-06-12", place_lat_lon_alt=(35.8, 51.49, 1600.0)),
    )
    magnetic, true = estimate(plain, name), estimate(east, name)
    turned = rotation(true.q_nb) * rotation(magnetic.q_nb).inv()
    assert magnetic.diagnostics["heading"].startswith("magnetic north: ")
    assert true.diagnostics["heading"].startswith("true north: ")
    # The magnetic needle points 4.9 deg east of true north there (NOAA), so the body's heading is that much further
    # clockwise than the compass says.
    assert np.rad2deg(turned.as_rotvec()[-1]) == pytest.approx([0, 0, -4.9], abs=0.05)
    assert magnetic.diagnostics["declination_rad"] == 0.0


@pytest.mark.parametrize("name", mark_slow_except(ATTITUDE, *FILTERS, "vqf"))
def test_an_estimate_covers_every_sample_and_says_how_it_was_made(name: str) -> None:
    recording = untidy()
    found = estimate(recording, name)
    assert (found.t_ns == recording.require_imu().t_ns).all()
    assert found.name == name
    assert found.recording == "untidy"
    assert dict(found.params) == asdict(ESTIMATORS[name].params())
    assert found.ns_per_sample > 0
    entry = ESTIMATORS[name]
    if isinstance(entry, Estimator):
        assert (found.gyro_bias_b_radps is not None) == entry.gives_bias


def test_one_sample_is_enough() -> None:
    imu = Imu(np.array([5], dtype=np.int64), np.zeros((1, 3)), GRAVITY_N[None])
    one = Recording("one", imu, info=Info(units_unchecked=True))
    for name in ATTITUDE:
        assert estimate(one, name).q_nb.shape == (1, 4)


@pytest.mark.parametrize(
    ("name", "params", "says"),
    [
        ("cff", None, "did you mean 'cf'"),
        ("cf", {"omega_radps": 0.2}, "omega0_radps"),
        ("cf", {"zeta": -1.0}, "0.01 to 100"),
        ("cf", {"zeta": float("nan")}, "zeta"),
        ("cf", {"levelled_by": "gyro"}, "acc, estimate"),
        ("gyro", {"rule": "simpson"}, "rectangular, trapezoidal"),
        ("acc-ma", {"window_s": "long"}, "window_s"),
        ("vqf", {"magnetometer": 1}, "True, False"),
    ],
)
def test_a_wrong_name_or_parameter_is_refused_in_one_line(name: str, params: dict | None, says: str) -> None:
    with pytest.raises(BadParameter) as caught:
        estimate(untidy(), name, params)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_parameters_of_another_estimator_are_refused() -> None:
    with pytest.raises(BadParameter, match="are not its settings"):
        estimate(untidy(), "cf", ESTIMATORS["vqf"].params())


@pytest.mark.slow
def test_quaternions_keep_length_1_over_a_million_samples() -> None:
    t_ns = np.arange(1_000_000, dtype=np.int64) * 10_000_000
    gyro = np.random.default_rng(0).normal(0, 3.0, (len(t_ns), 3))
    long = Recording("long", Imu(t_ns, gyro, np.tile(GRAVITY_N, (len(t_ns), 1))), info=Info(units_unchecked=True))
    found = estimate(long, "gyro")
    assert np.abs(np.linalg.norm(found.q_nb[::1000], axis=1) - 1).max() < 1e-12
