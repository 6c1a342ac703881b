"""``auv-dolphin``: the mission of Zia (2022), its exact truth, and what the sensors make of it."""

import json
from dataclasses import replace

import numpy as np
import pytest

from stillpoint.datasets import read, write
from stillpoint.datasets.earth import compute_magnetic_field_n_ut, enu_m, normal_gravity_mps2
from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.frames import euler, rotation, slerp, wrap
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.simulate.auv import AUV, CALM, WAVES, euler_ned_rad, plan_phases, sail, sum_waves
from stillpoint.datasets.simulate.satellites import GpsModel, receives


@pytest.fixture(scope="module")
def perfect():
    """Seven minutes without errors."""
    return simulate("auv-dolphin", seed=1, minutes=7.0, rate_hz=100.0, sensor="perfect")


@pytest.fixture(scope="module")
def recorded():
    """The whole mission as a vehicle records it."""
    return simulate("auv-dolphin", seed=0)


def phases_s(recording):
    """Seconds from the start, by the name of the phase that begins."""
    return json.loads(recording.info.extra["phases_s"])


def seconds(recording, t_ns):
    """From the start of the mission."""
    start_ns = np.datetime64(recording.info.date[:19], "ns").astype(np.int64)
    return (t_ns - start_ns) / 1e9


@pytest.mark.slow
def test_perfect_gyro_samples_are_the_turns_between_the_true_attitudes(perfect):
    imu, attitude = perfect.imu, rotation(perfect.truth.q_nb)
    steps = imu.gyro_b_radps[1:] * np.diff(imu.t_ns)[:, None] / 1e9
    np.testing.assert_allclose((attitude[:-1].inv() * attitude[1:]).as_rotvec(), steps, atol=1e-12)


def test_the_body_rates_are_those_of_the_papers_euler_kinematics(perfect):
    """Zia 2022, eq (4), inverted: p, q, r from the rates of roll, pitch, heading."""
    angles = np.unwrap(euler(perfect.truth.q_nb, "ned"), axis=0)
    roll, pitch, _ = (angles[1:] + angles[:-1]).T / 2
    d_roll, d_pitch, d_heading = (np.diff(angles, axis=0) / (np.diff(perfect.truth.t_ns)[:, None] / 1e9)).T
    expected = np.column_stack(
        [
            d_roll - np.sin(pitch) * d_heading,
            np.cos(roll) * d_pitch + np.sin(roll) * np.cos(pitch) * d_heading,
            -np.sin(roll) * d_pitch + np.cos(roll) * np.cos(pitch) * d_heading,
        ]
    )
    # Angles at the middle of an interval of 10 ms, rates up to 0.2 rad/s: an error of the third order.
    np.testing.assert_allclose(perfect.imu.gyro_b_radps[1:], expected, atol=2e-6)


def test_specific_force_is_the_second_derivative_of_the_position_less_gravity(perfect):
    second = np.diff(perfect.truth.position_n_m, 2, axis=0) * 1e4
    force_n = rotation(perfect.truth.q_nb).apply(perfect.imu.accel_b_mps2.copy())[1:-1]
    force_n[:, 2] -= normal_gravity_mps2(36.9, -27.0)
    # The second difference over 10 ms of a wave of 0.5 Hz is right to (2 pi 0.5 0.01)^2 / 12 = 1e-4 of it.
    np.testing.assert_allclose(force_n, second, atol=2e-4)


def test_the_field_is_the_world_magnetic_model_all_along(perfect):
    field_n = compute_magnetic_field_n_ut(perfect.info.place_lat_lon_alt, perfect.info.date)
    truth, mag = perfect.truth, perfect.mag
    inside = (mag.t_ns >= truth.t_ns[0]) & (mag.t_ns <= truth.t_ns[-1])
    in_n = rotation(slerp(truth.t_ns, truth.q_nb, mag.t_ns[inside])).apply(mag.mag_b_ut[inside])
    np.testing.assert_allclose(in_n, np.broadcast_to(field_n, in_n.shape), atol=1e-3)


def test_the_vehicle_sails_along_its_x_axis(perfect):
    """But for what the waves add: 0.3 m/s^2 at 0.25 Hz and 0.4 at 0.2 Hz are 0.19 and 0.32 m/s."""
    velocity = np.gradient(perfect.truth.position_n_m, 0.01, axis=0)
    along = rotation(perfect.truth.q_nb).inv().apply(velocity)
    below = np.abs(seconds(perfect, perfect.truth.t_ns) - 210) < 40
    assert np.abs(along[below, 0] - 2.5).max() < 0.05
    assert np.abs(along[below, 1:]).max() < 0.12 * 0.32 + 0.01
    assert np.abs(along[:, 1]).max() < 0.25


@pytest.mark.slow
def test_the_mission_is_that_of_the_paper(recorded):
    when, t = phases_s(recorded), seconds(recorded, recorded.truth.t_ns)
    up_m, (_, pitch, _) = recorded.truth.position_n_m[:, 2], np.rad2deg(euler(recorded.truth.q_nb, "ned")).T
    surface = (t < when["dive_s"] - 5) | (t > when["surfaced_s"] + 5)
    assert when["ascent_s"] - when["cruise_s"] == pytest.approx(600)
    assert np.abs(up_m[surface]).max() < 1.0
    assert up_m[(t > when["cruise_s"] + 5) & (t < when["ascent_s"] - 5)].max() < -25
    assert pitch[(t > when["dive_s"] + 10) & (t < when["cruise_s"] - 10)].max() < -18
    assert pitch[(t > when["ascent_s"] + 10) & (t < when["surfaced_s"] - 10)].min() > 18
    assert recorded.truth.moving.all()


def test_fixes_come_on_the_surface_only(recorded):
    when, t = phases_s(recorded), seconds(recorded, recorded.gps.t_ns)
    valid = recorded.gps.valid
    assert (np.diff(recorded.gps.t_ns) == 1_000_000_000).all()
    assert valid[(t < when["dive_s"] - 1) | (t > when["surfaced_s"] + 6)].all()
    assert not valid[(t > when["dive_s"] + 10) & (t < when["surfaced_s"] - 6)].any()
    assert np.isnan(recorded.gps.lat_deg[~valid]).all()
    assert np.isnan(recorded.gps.course_rad[~valid]).all()


def test_fixes_are_where_the_vehicle_is_and_point_where_it_goes(recorded, perfect):
    for recording, far_m in ((recorded, 8.0), (perfect, 1e-3)):
        gps, truth = recording.gps, recording.truth
        inside = gps.valid & (gps.t_ns >= truth.t_ns[0]) & (gps.t_ns <= truth.t_ns[-1])
        place = enu_m(gps.lat_deg, gps.lon_deg, gps.alt_m, recording.info.place_lat_lon_alt)[inside]
        true = np.column_stack([np.interp(gps.t_ns[inside], truth.t_ns, axis) for axis in truth.position_n_m.T])
        assert np.abs(place - true).max() < far_m
    velocity = np.gradient(perfect.truth.position_n_m, 0.01, axis=0)
    east, north = (np.interp(gps.t_ns[inside], truth.t_ns, axis) for axis in velocity.T[:2])
    np.testing.assert_allclose(wrap(gps.course_rad[inside] - np.arctan2(east, north)), 0, atol=2e-4)
    np.testing.assert_allclose(gps.speed_mps[inside], np.hypot(east, north), atol=2e-4)


def test_course_scatters_about_the_heading_by_the_waves(recorded):
    """Sway of 0.19 m/s across 1.5 m/s is 7.2 deg at its peak, 5.1 rms; 0.03 m/s of the receiver add 1.1 deg."""
    gps, truth = recorded.gps, recorded.truth
    heading = np.interp(gps.t_ns, truth.t_ns, np.unwrap(euler(truth.q_nb, "ned")[:, 2]))
    off = np.rad2deg(wrap(gps.course_rad - heading)[gps.valid])
    assert abs(off.mean()) < 1.0
    assert 4.5 < off.std() < 6.0


def test_a_receiver_waits_after_surfacing():
    up_m = np.array([0.0, 0.2, -2.0, -3.0, 0.0, 0.0, 0.0, 0.0])
    found = receives(up_m, GpsModel(first_fix_s=2.0), 1.0)
    assert found.tolist() == [True, True, False, False, False, True, True, True]


@pytest.mark.slow
def test_the_gyro_drifts_about_ten_degrees_in_ten_minutes(recorded, perfect):
    """60 deg/h that swing by a quarter: the paper's gyro is 10 deg off after 600 s."""
    for seed in range(3):
        recording = recorded if seed == 0 else simulate("auv-dolphin", seed=seed, minutes=15.0)
        clean = simulate("auv-dolphin", seed=seed, sensor=replace(AUV, drift=replace(AUV.drift, bias_degph=0.0)))
        drift = recording.imu.gyro_b_radps - clean.imu.gyro_b_radps
        in_600_s = np.abs(np.rad2deg(drift.mean(axis=0)) * 600)
        assert (in_600_s > 7.5).all()
        assert (in_600_s < 12.5).all()
        assert np.abs(np.ptp(drift, axis=0) * 3600 * 180 / np.pi - 30).max() < 1.0
    assert json.loads(recorded.info.extra["sensor_drawn"])["drift"]["sign"][0] in (-1.0, 1.0)


def test_the_iron_of_the_hull_is_worth_two_degrees_on_the_missions_heading(perfect):
    """Iron h across a heading and a horizontal field H: asin(h / H)."""
    field_n = compute_magnetic_field_n_ut(perfect.info.place_lat_lon_alt, perfect.info.date)
    heading = np.deg2rad(40.0) - np.arctan2(field_n[0], field_n[1])  # magnetic
    across = AUV.iron.x_ut * np.sin(heading) + AUV.iron.y_ut * np.cos(heading)
    assert np.rad2deg(across / np.hypot(*field_n[:2])) == pytest.approx(2.0, abs=0.1)


def test_waves_throw_the_vehicle_and_a_calm_sea_does_not():
    when = plan_phases(420.0, "auv-dolphin")
    t = np.arange(5, when.dive_s - 20, 0.1)
    thrown = sail(WAVES, when, 0).acceleration_n_mps2(t)
    calm = sail(CALM, when, 0).acceleration_n_mps2(t)
    assert np.abs(thrown[:, 2]).max() > 0.4
    assert np.sqrt((thrown[:, 2] ** 2).mean()) == pytest.approx(0.4 / np.sqrt(2), rel=0.15)
    # What is left are turns at 1.5 m/s: slalom, yawing by 3 deg at 0.08 Hz, pitching by 2 deg.
    assert np.sqrt((calm**2).mean(axis=0)).max() < 0.08
    np.testing.assert_array_equal(euler_ned_rad(WAVES, when, t, 20.0, 0), euler_ned_rad(CALM, when, t, 20.0, 0))


def test_roll_is_larger_on_the_surface(recorded):
    when, t = phases_s(recorded), seconds(recorded, recorded.truth.t_ns)
    roll = np.rad2deg(euler(recorded.truth.q_nb, "ned")[:, 0])
    expected = 6.0 * np.sqrt((0.6**2 + 0.4**2 + 0.3**2 + 0.15**2) / 2)
    assert roll[t < when["dive_s"] - 20].std() == pytest.approx(expected, rel=0.05)
    below = (t > when["cruise_s"]) & (t < when["ascent_s"])
    assert roll[below].std() == pytest.approx(0.12 * expected, rel=0.05)


@pytest.mark.slow
def test_same_arguments_same_bytes_and_other_seeds_others(recorded):
    again, other = simulate("auv-dolphin", seed=0), simulate("auv-dolphin", seed=1)
    for stream, name in (("imu", "gyro_b_radps"), ("mag", "mag_b_ut"), ("gps", "course_rad"), ("truth", "q_nb")):
        first = getattr(getattr(recorded, stream), name)
        assert first.tobytes() == getattr(getattr(again, stream), name).tobytes()
        assert first.tobytes() != getattr(getattr(other, stream), name).tobytes()
    assert recorded.info == again.info


@pytest.mark.slow
def test_the_sea_does_not_shift_the_draws_of_the_sensors(recorded):
    calm = simulate("auv-dolphin-calm", seed=0)
    assert calm.info.extra["sensor_drawn"] == recorded.info.extra["sensor_drawn"]
    # The ascent ends at the surface, and so is a little steeper or flatter: not the same bits.
    np.testing.assert_allclose(calm.truth.q_nb, recorded.truth.q_nb, atol=1e-4)


def test_it_comes_back_from_its_file(recorded, tmp_path):
    write(tmp_path / "auv.mcap", recorded)
    kept = read(tmp_path / "auv.mcap")
    np.testing.assert_array_equal(kept.gps.valid, recorded.gps.valid)
    for name in ("lat_deg", "lon_deg", "alt_m", "course_rad", "speed_mps"):
        np.testing.assert_array_equal(getattr(kept.gps, name), getattr(recorded.gps, name))
    assert kept.imu.gyro_b_radps.tobytes() == recorded.imu.gyro_b_radps.tobytes()
    assert kept.info == recorded.info


def test_too_short_a_mission_is_refused_in_one_line():
    with pytest.raises(BadParameter, match=r"auv-dolphin needs at least 6\.00") as caught:
        simulate("auv-dolphin", minutes=5.0)
    assert "\n" not in str(caught.value)


def test_a_wave_has_its_components():
    t = np.arange(0, 100, 0.05)
    spectrum = np.abs(np.fft.rfft(sum_waves(((0.5, 0.1), (0.25, 0.4)), t, 3, "roll"))) / len(t) * 2
    assert spectrum[10] == pytest.approx(0.5, abs=1e-9)
    assert spectrum[40] == pytest.approx(0.25, abs=1e-9)
    assert spectrum[20] < 1e-9
