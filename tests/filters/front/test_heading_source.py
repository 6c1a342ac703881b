"""GPS course as the source of the heading: what an estimator gets, what is learnt of the magnetometer."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from motions import record, regular
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stillpoint.datasets import BadParameter, BadRecording, Gps, Imu, Mag, Recording
from stillpoint.datasets.frames import rotation
from stillpoint.datasets.simulate import simulate
from stillpoint.filters import estimate
from stillpoint.filters.front import front
from stillpoint.filters.front.sources import find_sources, make_raw_log
from stillpoint.filters.precision import to_precision

Course = Callable[[NDArray[np.float64]], NDArray[np.float64]]
HARD_IRON = np.array([3.0, -2.0, 1.5])
SUBMERGED_S = 60.0


def straight(t_s: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.full_like(t_s, 0.7)


def circling(t_s: NDArray[np.float64]) -> NDArray[np.float64]:
    return 0.4 + 0.25 * t_s


def vessel(course: Course) -> Callable[[NDArray[np.float64]], Rotation]:
    """Forward-left-up, x along the track, in a swell."""

    def attitude(t_s: NDArray[np.float64]) -> Rotation:
        t = np.atleast_1d(t_s)
        swell = np.column_stack([np.pi / 2 - course(t), 0.05 * np.sin(0.9 * t), 0.15 * np.sin(1.1 * t)])
        return Rotation.from_euler("ZYX", swell)

    return attitude


def sail(
    course: Course, seconds: float = 120.0, hard_iron: NDArray[np.float64] = HARD_IRON, off_course: float = 0.0
) -> Recording:
    """Perfect sensors but for the hard iron; courses until the vessel submerges."""
    sailed = record(vessel(course), regular(seconds, 50.0), regular(seconds, 25.0))
    at_s = np.arange(0.0, seconds, 1.0)
    n = len(at_s)
    gps = Gps(
        np.round(at_s * 1e9).astype(np.int64),
        np.full(n, 36.9),
        np.full(n, 50.9),
        np.full(n, np.nan),
        course(at_s) + off_course,
        np.full(n, 1.5),
        at_s < SUBMERGED_S,
    )
    assert sailed.mag is not None
    return replace(sailed, mag=Mag(sailed.mag.t_ns, sailed.mag.mag_b_ut + hard_iron), gps=gps)


def given(recording: Recording, **params: float) -> tuple[front.State, NDArray[np.float64], NDArray[np.float64]]:
    """The state at the end, and the stamps (s) and azimuths (deg, clockwise) of the fields that an estimator gets."""
    sources = find_sources(recording, "gps-course", params, None)
    raw, _ = make_raw_log(recording.require_imu(), sources)
    state, log = front.filter_log(raw, front.start(sources.plan.front), sources.plan.front)
    t_s = recording.require_imu().t_ns[log.has_mag] / 1e9
    return state, t_s, log.mag_b_ut[log.has_mag]


def azimuth_deg(attitude: Rotation, field_b: NDArray[np.float64]) -> NDArray[np.float64]:
    field_n = attitude.apply(field_b)
    return np.rad2deg(np.arctan2(field_n[:, 0], field_n[:, 1]))


@pytest.mark.parametrize("course", [straight, circling])
@pytest.mark.parametrize("mounting_yaw_rad", [0.0, 0.6])
def test_on_the_surface_the_compensated_heading_is_the_course(course: Course, mounting_yaw_rad: float) -> None:
    recording = sail(course, off_course=-mounting_yaw_rad)
    _, t_s, field_b = given(recording, mounting_yaw_rad=mounting_yaw_rad)
    led = (t_s > 3) & (t_s < SUBMERGED_S)
    assert led.sum() == 25 * 57 - 1  # every field of the magnetometer
    # True attitude levels the field; the course leads to true north, where the declination of this place is 0.
    assert np.abs(azimuth_deg(vessel(course)(t_s[led]), field_b[led])).max() < 1e-6


def test_a_turn_shows_the_whole_hard_iron() -> None:
    state, t_s, field_b = given(sail(circling))
    learnt = state.heading.calibration.x_ut
    assert np.abs(learnt[3:5] - HARD_IRON[:2]).max() < 0.02
    # The vertical part is told from the Earth's by the swell alone, and the prior of 20 uT holds it there.
    assert abs(learnt[5] - HARD_IRON[2]) < 0.2
    submerged = t_s > SUBMERGED_S + 3
    assert np.abs(azimuth_deg(vessel(circling)(t_s[submerged]), field_b[submerged])).max() < 0.1


def test_one_heading_is_enough_for_that_heading() -> None:
    recording = sail(straight)
    state, t_s, field_b = given(recording)
    submerged = t_s > SUBMERGED_S + 3
    assert np.abs(azimuth_deg(vessel(straight)(t_s[submerged]), field_b[submerged])).mean() < 0.1
    across = state.heading.calibration.x_ut[4] - HARD_IRON[1]
    assert abs(across) < 0.4
    raw_deg = azimuth_deg(vessel(straight)(t_s[submerged]), recording.mag.mag_b_ut[-submerged.sum() :].copy())
    assert np.abs(raw_deg).mean() > 3


def test_without_a_declination_the_courses_lead_to_true_north() -> None:
    east_of_north = np.deg2rad(6.0)
    recording = sail(circling, hard_iron=np.zeros(3))
    # The same fields, but the vessel's true heading is 6 deg more: the needle points 6 deg west of true north.
    turned = replace(recording, gps=replace(recording.gps, course_rad=recording.gps.course_rad + east_of_north))
    state, t_s, field_b = given(turned)
    submerged = t_s > SUBMERGED_S + 3
    found = azimuth_deg(vessel(circling)(t_s[submerged]), field_b[submerged])
    assert np.abs(found + 6.0).max() < 0.1
    assert np.abs(state.heading.calibration.x_ut[3:5]).max() < 0.05


def test_fixes_that_say_nothing_change_nothing() -> None:
    recording = sail(circling)
    slow = replace(recording.gps, speed_mps=np.full(len(recording.gps.t_ns), 0.1))
    mute = replace(recording.gps, course_rad=np.full(len(recording.gps.t_ns), np.nan))
    plain = estimate(recording, "cf")
    for gps in (slow, mute):
        found = estimate(replace(recording, gps=gps), "cf", heading="gps-course")
        assert (found.q_nb == plain.q_nb).all()
        assert found.diagnostics["n_course_used"] == 0
        assert found.diagnostics["n_course_left_out"] == len(gps.t_ns)


def test_what_was_done_is_in_the_diagnostics() -> None:
    found = estimate(sail(circling), "cf", heading="gps-course")
    facts = found.diagnostics
    assert facts["heading"].startswith("true north: gps course while fixes are valid and over 0.5 m/s")
    assert (facts["n_course_used"], facts["n_course_left_out"]) == (60, 60)
    assert facts["n_mag_by_course"] + facts["n_mag_corrected"] + 50 == 25 * 120  # raw for the first two seconds
    assert facts["hard_iron_b_ut"][:2] == pytest.approx(HARD_IRON[:2], abs=0.02)


@pytest.mark.parametrize("name", ["cf", "gyro", "vqf"])
def test_every_estimator_sees_the_courses_only_through_its_samples(name: str) -> None:
    recording = sail(circling, seconds=200)
    by_mag, by_course = (estimate(recording, name, heading=heading) for heading in ("mag", "gps-course"))
    truth = vessel(circling)(recording.require_imu().t_ns / 1e9)

    def heading_deg(q_nb: NDArray[np.float64]) -> NDArray[np.float64]:
        off = (rotation(q_nb) * truth.inv()).as_quat()
        return np.abs(np.rad2deg(2 * np.arctan2(off[:, 2], off[:, 3])))

    last = slice(-1000, None)
    if name == "gyro":  # it looks at the field once, before the courses count
        assert (by_mag.q_nb == by_course.q_nb).all()
    else:
        assert heading_deg(by_mag.q_nb)[last].max() > 1
        assert heading_deg(by_course.q_nb)[last].max() < 0.4


def test_without_a_magnetometer_the_fixes_bring_the_heading() -> None:
    recording = replace(sail(circling, seconds=59.0), mag=None)
    found = estimate(recording, "cf", heading="gps-course")
    truth = vessel(circling)(recording.require_imu().t_ns / 1e9)
    off_deg = np.rad2deg((rotation(found.q_nb) * truth.inv()).magnitude())
    assert off_deg[500:].max() < 0.5
    assert found.diagnostics["n_mag_by_course"] == found.diagnostics["n_course_used"] - 2
    assert "the gyro alone" in found.diagnostics["heading"]


def test_the_bias_is_taken_off_for_an_estimator_that_has_no_state_for_it() -> None:
    recording = sail(circling, seconds=300.0, hard_iron=np.zeros(3))
    imu, bias = recording.require_imu(), np.deg2rad([0.1, -0.05, 0.2])
    gps = replace(recording.gps, valid=np.ones(len(recording.gps.t_ns), dtype=bool))
    drifting = replace(recording, imu=Imu(imu.t_ns, imu.gyro_b_radps + bias, imu.accel_b_mps2), gps=gps)
    truth = vessel(circling)(imu.t_ns / 1e9)

    def drift_deg(gyro_bias: str) -> float:
        settings = {"gyro_bias": gyro_bias}
        off = rotation(estimate(drifting, "gyro", heading="gps-course", heading_params=settings).q_nb) * truth.inv()
        return float(np.rad2deg((off[-1] * off[-5001].inv()).magnitude()))  # over the last 100 s

    assert drift_deg("leave") > 10
    assert drift_deg("remove") < 0.5


@pytest.mark.slow
def test_single_precision_is_single_throughout_and_near_double() -> None:
    recording = sail(circling)
    sources = find_sources(recording, "gps-course", None, None)
    raw, _ = make_raw_log(recording.require_imu(), sources)
    logs = []
    for precision in ("double", "single"):
        c = to_precision(sources.plan.front, precision)
        logs.append(front.filter_log(to_precision(raw, precision), to_precision(front.start(c), precision), c)[1])
    assert logs[1].mag_b_ut.dtype == np.float32
    assert np.abs(logs[0].mag_b_ut - logs[1].mag_b_ut).max() < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_courses_remove_the_heading_error_of_the_dolphin_under_water(seed: int) -> None:
    """Zia 2022: within about 2 deg of GPS; findings B-3: that is its hard iron, and courses take it away."""
    recording = simulate("auv-dolphin", seed=seed, rate_hz=25.0)
    imu, truth, gps = recording.require_imu(), recording.truth, recording.gps
    submerged = np.flatnonzero(~gps.valid)
    ends_ns = gps.t_ns[submerged[-1]] - int(50e9)  # the last 50 s are the ascent and the wait for a fix
    rows = np.flatnonzero((imu.t_ns < ends_ns) & (imu.t_ns > ends_ns - int(30e9)))
    at = np.searchsorted(truth.t_ns, imu.t_ns[rows])

    def heading_deg(heading: str) -> float:
        found = estimate(recording, "cf-fixed", heading=heading)
        off = (rotation(found.q_nb[rows]) * rotation(truth.q_nb[at]).inv()).as_quat()
        return float(np.rad2deg(np.mean(2 * np.arctan2(off[:, 2] * np.sign(off[:, 3]), np.abs(off[:, 3])))))

    assert 1.5 < abs(heading_deg("mag")) < 2.2
    assert abs(heading_deg("gps-course")) < 0.4


def with_fields(recording: Recording, between_s: tuple[float, float], field_ut: tuple[float, ...]) -> Recording:
    """The same with this field from a sensor that is broken for a while."""
    assert recording.mag is not None
    t_s, fields = recording.mag.t_ns / 1e9, recording.mag.mag_b_ut.copy()
    fields[(t_s >= between_s[0]) & (t_s < between_s[1])] = field_ut
    return replace(recording, mag=Mag(recording.mag.t_ns, fields))


@pytest.mark.parametrize("field_ut", [(0.0, 0.0, 0.0), (5e5, 1.0, 1.0)])
@pytest.mark.parametrize("between_s", [(0.0, 30.0), (30.0, 40.0), (80.0, 100.0)])
def test_fields_that_are_none_are_counted_and_neither_learnt_nor_corrected(
    between_s: tuple[float, float], field_ut: tuple[float, ...]
) -> None:
    clean = sail(circling)
    broken = with_fields(clean, between_s, field_ut)
    state, t_s, field_b = given(broken)
    dark = (t_s >= between_s[0]) & (t_s < between_s[1])
    is_zero = (field_b == 0).all(axis=1)
    assert not is_zero[~dark].any()
    assert not (is_zero & (t_s > 3) & (t_s < 60)).all()  # the courses still lead, fix by fix
    submerged = (t_s > SUBMERGED_S + 3) & ~dark
    assert np.abs(azimuth_deg(vessel(circling)(t_s[submerged]), field_b[submerged])).max() < 0.1
    assert np.abs(state.heading.calibration.x_ut[3:5] - HARD_IRON[:2]).max() < 0.05
    counts = estimate(broken, "cf", heading="gps-course").diagnostics
    how_many = round((between_s[1] - between_s[0]) * 25)
    by_fixes = 30 if between_s[1] < 60 else 0  # where a course stands in, at most one a second
    assert how_many - by_fixes <= counts["n_no_field"] + counts["n_bad_mag"] <= how_many
    assert (
        counts["n_mag_learnt"]
        == given(clean)[0].heading.calibration.n_mag_learnt - ({30.0: 28 * 25, 40.0: 250, 100.0: 0}[between_s[1]])
    )


@pytest.mark.parametrize("field_ut", [(3000.0, 0.0, 0.0), (-150.0, 90.0, 80.0)])
@pytest.mark.parametrize("from_s", [2.0, 30.0])  # 2 s: the first field of all
def test_one_wrong_field_hardly_moves_the_calibration(from_s: float, field_ut: tuple[float, ...]) -> None:
    clean = sail(circling)
    state, _, _ = given(clean)
    spiked, _, _ = given(with_fields(clean, (from_s, from_s + 0.04), field_ut))
    moved_ut = spiked.heading.calibration.x_ut - state.heading.calibration.x_ut
    # At the start of a swell it shifts what the swell shows of the vertical parts: within their sd.
    assert np.abs(moved_ut[[0, 1, 3, 4]]).max() < 0.01
    assert np.abs(moved_ut).max() < 0.2


def test_what_cannot_be_done_gives_one_line_error() -> None:
    recording = sail(straight, seconds=5.0)
    with pytest.raises(BadRecording, match="no satellite fixes"):
        estimate(replace(recording, gps=None), "cf", heading="gps-course")
    with pytest.raises(BadParameter, match="did you mean 'gps-course'"):
        estimate(recording, "cf", heading="gps-corse")
    with pytest.raises(BadParameter, match="heading mag has no settings"):
        estimate(recording, "cf", heading_params={"least_speed_mps": 1.0})
    with pytest.raises(BadParameter, match="least_speed_mps"):
        estimate(recording, "cf", heading="gps-course", heading_params={"least_sped_mps": 1.0})
