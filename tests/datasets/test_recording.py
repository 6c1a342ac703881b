"""Construction checks once and says what is wrong; afterwards nothing can be changed."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from stillpoint.datasets import BadRecording, Estimate, Gps, Imu, Info, Mag, Recording, Reference, Spin, Truth
from stillpoint.datasets.spin import FIVE_ACCELEROMETERS

N = 500
T_NS = np.arange(N, dtype=np.int64) * 10_000_000
REST = np.tile([0.0, 0.0, 9.81], (N, 1))
ZERO = np.zeros((N, 3))
LEVEL = np.tile([1.0, 0.0, 0.0, 0.0], (N, 1))


def imu(**changes: Any) -> Imu:
    return Imu(**{"t_ns": T_NS, "gyro_b_radps": ZERO, "accel_b_mps2": REST, **changes})


def spoilt(array: np.ndarray, row: int, value: float) -> np.ndarray:
    copy = array.copy()
    copy[row] = value
    return copy


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: imu(gyro_b_radps=np.zeros((N, 2))), r"imu.gyro_b_radps: has shape \(500, 2\)"),
        (lambda: imu(accel_b_mps2=spoilt(REST, 7, np.nan)), "1 rows are not finite, the first is 7"),
        (lambda: imu(t_ns=T_NS / 1e9), "int64 nanoseconds"),
        (lambda: imu(t_ns=spoilt(T_NS, 3, T_NS[2])), r"time does not rise at sample 3 \(0.020000 s from the start\)"),
        (lambda: imu(t_ns=T_NS - 1), "start at 0"),
        (lambda: imu(t_ns=T_NS + 2**31 * 10**9), "start at 0"),
        (lambda: Mag(np.array([2**63 - 1, -(2**63)]), np.ones((2, 3))), "start at 0"),  # their difference is 1
        (lambda: Mag(np.array([0, 2**63 + 5], dtype=np.uint64), np.ones((2, 3))), "start at 0"),
        (lambda: Recording.from_arrays("r", T_NS + 1.7e18, ZERO, REST), "r.t_s: give finite seconds"),
        (lambda: Recording.from_arrays("r", spoilt(T_NS / 1e9, 9, np.nan), ZERO, REST), "r.t_s: give finite seconds"),
        (lambda: imu(t_ns=T_NS[:0], gyro_b_radps=ZERO[:0], accel_b_mps2=REST[:0]), "has no sample"),
        (lambda: Truth(T_NS, LEVEL * 1.01, np.ones(N, bool)), "off unit norm by 0.01"),
        (lambda: Truth(T_NS, spoilt(LEVEL, 7, 0.500002), np.ones(N, bool)), r"off unit norm by 4e-06 \(row 7\)"),
        (lambda: Truth(T_NS, LEVEL, np.ones(N)), "give bool"),
        (lambda: Truth(T_NS, spoilt(LEVEL, 0, np.nan), np.ones(N, bool)), "not finite"),
        (lambda: Recording("r"), "neither gyro and accelerometer"),
        (lambda: Recording("r", imu(), base_pose=np.ones(4)), "base_pose"),
        (lambda: Recording("r", imu(accel_b_mps2=REST / 9.80665)), "looks in g: multiply by 9.80665"),
        (lambda: Recording("r", imu(accel_b_mps2=REST * 100)), "gal"),
        (lambda: Recording("r", imu(accel_b_mps2=REST * 1000 / 9.80665)), "milli-g: multiply by 0.00980665"),
        (lambda: Recording("r", imu(accel_b_mps2=REST * 2)), r"not near 9\.8 m/s\^2; convert it"),
        (lambda: Recording("r", imu(accel_b_mps2=ZERO)), "is 0 at rest, not near 9.8"),
        (lambda: Recording("r", imu(gyro_b_radps=spoilt(ZERO, 4, 250.0))), "looks like deg/s"),
        (
            lambda: Recording("r", imu(), Mag(T_NS, np.tile([0.2, 0, -0.4], (N, 1)))),
            "like gauss: multiply by 100",
        ),
        (lambda: Recording("r", imu(), Mag(T_NS, np.tile([2e-5, 0, -4e-5], (N, 1)))), "looks like tesla"),
        (lambda: Recording("r", imu(), Mag(T_NS, np.tile([2e4, 0, -4e4], (N, 1)))), r"nanotesla: multiply by 0\.001"),
        (lambda: Recording("r", imu(), Mag(T_NS, np.tile([200.0, 0, -400.0], (N, 1)))), "milligauss: multiply by 0.1"),
        (lambda: Recording("r", imu(), Mag(T_NS, np.tile([1e4, 0, 0], (N, 1)))), "mag-uncalibrated"),
        (lambda: Estimate(T_NS, "ekf"), "neither an attitude nor an angle"),
        (lambda: Reference(T_NS, LEVEL, np.zeros((N, 3, 3)), ZERO, "m"), "states its accuracy"),
        (lambda: Estimate(T_NS, "ekf", LEVEL, cov_b_rad2=np.zeros((N, 3, 3))), "leave cov_b_rad2 out where none is"),
        (lambda: Spin(T_NS[:1], [[0.0, 0.0, 0.0, 0.0, 0.0]], [[0.0, np.inf]], FIVE_ACCELEROMETERS), "infinite"),
        (lambda: replace(FIVE_ACCELEROMETERS, gyro_axis_b=[[0, 1.000001, 0], [0, 0, 1]]), "not of length 1"),
        (lambda: replace(FIVE_ACCELEROMETERS, accel_axis_b=1.000001 * np.eye(3)[[0, 1, 2, 2, 2]]), "not of length 1"),
    ],
)
def test_a_broken_rule_is_named(make: Callable[[], object], says: str) -> None:
    with pytest.raises(BadRecording, match=says) as caught:
        make()
    assert "\n" not in str(caught.value)


def test_a_field_outside_the_range_is_allowed_where_the_note_says_so() -> None:
    mag = Mag(T_NS, np.tile([370.0, 0, 0], (N, 1)))
    assert Recording("r", imu(), mag, info=Info(mag_uncalibrated=True)).mag is mag


def test_units_are_not_guessed_when_nothing_is_still() -> None:
    """A fast spin presses constantly outwards: that is no gravity, so its size says nothing."""
    spin = imu(gyro_b_radps=np.tile([0.0, 0, 30.0], (N, 1)), accel_b_mps2=np.tile([60.0, 0, 9.8], (N, 1)))
    shaken = imu(accel_b_mps2=REST * (2 + np.sin(np.arange(N)))[:, None])
    assert Recording("spin", spin).imu is spin
    assert Recording("shaken", shaken).imu is shaken


def test_a_lone_sample_at_the_end_is_no_rest() -> None:
    """One value does not vary; only a second with most of its samples can be calm."""
    shaken = REST * (2 + np.sin(np.arange(N)))[:, None]
    last = imu(t_ns=np.append(T_NS[:-1], T_NS[-1] + 10**9), accel_b_mps2=spoilt(shaken, N - 1, 30.0))
    assert Recording("shaken", last).imu is last


def test_the_doctor_can_open_what_is_implausible() -> None:
    in_g = imu(accel_b_mps2=REST / 9.80665)
    assert Recording("r", in_g, info=Info(units_unchecked=True)).imu is in_g


def test_arrays_are_read_only_and_the_givers_stay_writeable() -> None:
    mine = ZERO.copy()
    stream = imu(gyro_b_radps=mine)
    with pytest.raises(ValueError, match="read-only"):
        stream.gyro_b_radps[0] = 1.0
    assert mine.flags.writeable


def test_from_arrays_keeps_nanoseconds_and_makes_nan_truth_a_gap() -> None:
    t_s = np.arange(N) * 0.0035
    truth = spoilt(LEVEL, 5, np.nan)
    recording = Recording.from_arrays("r", t_s, ZERO, REST, truth_q_nb=truth, date="2024-05-01")
    assert recording.require_imu().t_ns[1:3].tolist() == [3_500_000, 7_000_000]
    assert recording.truth is not None
    assert len(recording.truth.t_ns) == N - 1
    assert 5 * 3_500_000 not in recording.truth.t_ns
    assert recording.info.date == "2024-05-01"
    assert recording.duration_s == pytest.approx((N - 1) * 0.0035)


def test_a_recording_lasts_as_long_as_its_sensors_not_its_truth() -> None:
    truth = Truth(T_NS + 10**9, LEVEL, np.ones(N, bool))
    mag = Mag(T_NS + 5, np.tile([20.0, 0, -40.0], (N, 1)))
    assert Recording("r", imu(), mag, truth=truth).duration_s == pytest.approx((N - 1) * 0.01 + 5e-9, abs=1e-12)


@pytest.mark.parametrize(("lat_deg", "lon_deg"), [(90.1, 0.0), (-90.1, 0.0), (0.0, 360.1), (0.0, -360.1)])
def test_a_valid_fix_lies_on_the_earth(lat_deg: float, lon_deg: float) -> None:
    """Another is taken as it is: receivers write anything where they have none."""
    columns = [np.array([x]) for x in (lat_deg, lon_deg, 0.0, 0.0, 0.0)]
    with pytest.raises(BadRecording, match="check the columns"):
        Gps(T_NS[:1], *columns, np.array([True]))
    assert Gps(T_NS[:1], *columns, np.array([False])).lat_deg == lat_deg


def test_gps_may_miss_course_but_a_valid_fix_has_a_place() -> None:
    t_ns = T_NS[:2]
    nan = np.array([np.nan, np.nan])
    fix = Gps(t_ns, np.array([50.0, np.nan]), np.array([8.0, np.nan]), nan, nan, nan, np.array([True, False]))
    assert fix.valid.tolist() == [True, False]
    with pytest.raises(BadRecording, match="mark it as not valid"):
        Gps(t_ns, np.array([50.0, np.nan]), np.array([8.0, np.nan]), nan, nan, nan, np.array([True, True]))


def test_recordings_and_results_show_themselves_in_one_line() -> None:
    t_ns = np.arange(0, 2_000_000_000, 10_000_000)
    n = len(t_ns)
    q_nb = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    still = np.tile([0.0, 0.0, 9.81], (n, 1))
    recording = Recording("walk", imu=Imu(t_ns, np.zeros((n, 3)), still))
    assert repr(recording) == "<Recording walk: imu 200 samples at 100 Hz, 2.0 s>"
    assert repr(recording.imu) == "<Imu: 200 samples at 100 Hz, 2.0 s>"
    covariance = np.tile(np.diag([3e-4, 4e-4, 5e-4]), (n, 1, 1))  # a total sd of sqrt(12e-4) rad = 1.98 deg
    reference = Reference(t_ns, q_nb, covariance, np.zeros((n, 3)), "graph", "walk", heading_sd_rad=np.deg2rad(4.0))
    for part in ("walk by graph", "sd of the attitude 2 deg (median)", "heading that all share 4 deg", "0 rests"):
        assert part in repr(reference)
    assert "q_nb, cov_b_rad2" in repr(Estimate(t_ns, "mine", q_nb=q_nb, cov_b_rad2=covariance))
