"""Position and velocity of a car by satellites, with covariance: antenna, delay, jumps and tunnels."""

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stillpoint.datasets import write
from stillpoint.datasets.earth import enu_m, to_geodetic
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.simulate.car import CAR, TOWN, Receiver
from stillpoint.scoring import score
from stillpoint.smoother import reference
from stillpoint.smoother.attitude.outside.satellite import find_jumps
from stillpoint.smoother.attitude.params import PRESETS


def drive(**receiver):
    """Two and a half minutes without magnetometer."""
    sensor = replace(CAR, receiver=Receiver(**receiver))
    return replace(simulate("car", seed=1, minutes=2.5, rate_hz=50, sensor=sensor), mag=None)


def make(recording, **settings):
    return reference(recording, params=PRESETS["vehicle"] if not settings else {**VEHICLE, **settings})


VEHICLE = {"motion.position_sd_m": 1000.0, "motion.velocity_sd_mps": 30.0, "motion.integration_sd_m_rts": 0.1}


def position_error_m(made, recording):
    """Errors (N, 3) against the truth, whose origin is known."""
    (offset,) = enu_m(*([value] for value in made.origin_lat_lon_alt), TOWN.place)
    truth = recording.truth
    known = np.stack([np.interp(made.t_ns, truth.t_ns, axis) for axis in truth.position_n_m.T], axis=1)
    return made.position_n_m + offset - known


@pytest.fixture(scope="module")
def plain():
    return drive()


@pytest.fixture(scope="module")
def made(plain):
    return make(plain)


@pytest.mark.slow
def test_position_and_velocity_are_within_their_covariance(plain, made):
    """The fixes wander by 1.5 m; the speed has 0.1 m/s of noise a fix."""
    error = position_error_m(made, plain)
    assert np.sqrt((error**2).mean(axis=0)).max() < 3.0
    assert (np.abs(error) / np.sqrt(np.diagonal(made.position_cov_n_m2, axis1=1, axis2=2))).max() < 3.0
    velocity = np.gradient(plain.truth.position_n_m, plain.truth.t_ns / 1e9, axis=0)
    known = np.stack([np.interp(made.t_ns, plain.truth.t_ns, axis) for axis in velocity.T], axis=1)
    off = (made.velocity_n_mps - known) / np.sqrt(np.diagonal(made.velocity_cov_n_m2ps2, axis1=1, axis2=2))
    assert np.sqrt((off**2).mean(axis=0)).max() < 1.3
    assert made.diagnostics["fixes"]["n_jumps"] == made.diagnostics["fixes"]["n_outages"] == 0


def test_the_heading_is_true_north_without_any_alignment(plain, made):
    found = score(made, plain.truth, align="none")
    assert found.heading_rmse_deg < 1.0
    assert found.coverage95 > 0.9


@pytest.mark.slow
def test_a_perfect_sensor_gives_the_drive():
    """Its stops are rests, and its accelerations must not be taken for turns."""
    drive = replace(simulate("car", seed=1, minutes=2.5, rate_hz=50, sensor="perfect"), mag=None)
    made = make(drive)
    assert score(made, drive.truth, align="none").total_rmse_deg < 0.3
    assert np.abs(position_error_m(made, drive)[:, :2]).max() < 0.5


def test_the_score_has_the_position_error(plain, made):
    found = score(made, plain.truth).position
    error = position_error_m(made, plain)
    expected = np.sqrt(np.mean(np.sum((error - error.mean(axis=0)) ** 2, axis=1)))
    assert found.rmse_m == pytest.approx(expected, rel=0.02)
    assert found.horizontal_rmse_m < found.rmse_m <= found.max_m
    assert found.coverage95 > 0.9
    assert score(made, replace(plain.truth, position_n_m=None)).position is None


@pytest.mark.slow
def test_a_tunnel_widens_the_covariance_and_is_reported(made):
    through = drive(tunnel_start_s=60.0, tunnel_s=50.0)
    dark = make(through)
    facts = dark.diagnostics["fixes"]
    assert (facts["n_outages"], round(facts["longest_outage_s"])) == (1, 51)
    middle = np.searchsorted(dark.t_ns, dark.t_ns[0] + 85_000_000_000)
    assert dark.position_cov_n_m2[middle, 0, 0] > 2 * made.position_cov_n_m2[middle, 0, 0]
    error = np.abs(position_error_m(dark, through))
    assert (error / np.sqrt(np.diagonal(dark.position_cov_n_m2, axis1=1, axis2=2))).max() < 3.0


@pytest.mark.slow
def test_late_fixes_are_found_and_corrected():
    late = drive(late_s=0.5)
    made = make(late)
    assert made.diagnostics["fixes"]["late_s"] == pytest.approx(0.5, abs=0.1)
    assert np.sqrt((position_error_m(made, late) ** 2).mean(axis=0)).max() < 3.0


@pytest.mark.slow
def test_the_antenna_lever_arm_is_taken_off():
    far = drive(antenna_x_m=-6.0, antenna_z_m=2.0)
    told = make(far, **{"gps.lever_x_m": -6.0, "gps.lever_z_m": 2.0})
    assert np.linalg.norm(position_error_m(told, far).mean(axis=0)) < 2.5
    untold = position_error_m(make(far), far)
    assert np.linalg.norm(untold, axis=1).mean() > 4.0


@pytest.mark.slow
def test_fixes_that_jump_are_left_out_and_counted(plain):
    gps = plain.gps
    wrong = np.zeros(len(gps.t_ns), dtype=bool)
    wrong[[20, 47, 48, 90]] = True
    lat_deg = gps.lat_deg + np.where(wrong, 0.005, 0.0)  # 550 m
    jumping = replace(plain, gps=replace(gps, lat_deg=lat_deg))
    made = make(jumping)
    assert made.diagnostics["fixes"]["n_jumps"] == 4
    assert np.sqrt((position_error_m(made, jumping) ** 2).mean(axis=0)).max() < 3.0


@pytest.mark.slow
def test_the_accuracy_that_the_receiver_states_is_used(plain):
    stated = np.full(len(plain.gps.t_ns), 12.0)
    made = make(replace(plain, gps=replace(plain.gps, position_sd_m=stated)))
    assert made.diagnostics["fixes"]["sd_m"] == 12.0
    assert np.sqrt(made.position_cov_n_m2[:, 0, 0]).min() > 12.0


@pytest.mark.slow
@given(st.sets(st.integers(0, 6)), st.booleans(), st.floats(200.0, 1e5))
def test_jumps_are_exactly_the_fixes_that_are_off(groups, in_pairs, far_m):
    """Single fixes, or two in a row, well apart from each other."""
    rows = sorted({row for group in groups for row in (8 * group + 4, 8 * group + 4 + in_pairs)})
    t_s = np.arange(60.0)
    place = np.column_stack([20 * t_s, 100 * np.sin(t_s / 10), 0 * t_s])
    place[rows, 0] += far_m
    assert np.flatnonzero(find_jumps(t_s, place, np.full(60, 3.0))).tolist() == rows


@pytest.mark.slow
def test_a_reference_without_satellites_has_no_position():
    made = reference(simulate("phone-3", seed=1, minutes=1.5, rate_hz=50))
    assert made.position_n_m is None
    assert "fixes" not in made.diagnostics


def test_kml_and_tum_hold_the_path(call, tmp_path, made):
    write(tmp_path / "drive.reference.mcap", made)
    assert call("export", tmp_path / "drive.reference.mcap", "-o", tmp_path, "--format", "kml") == 0
    text = (tmp_path / "drive.reference.kml").read_text()
    points = ElementTree.fromstring(text).find(".//{*}coordinates").text.split()
    lon_deg, lat_deg, _ = map(float, points[0].split(","))
    known_lat, known_lon, _ = to_geodetic(made.position_n_m[:1], made.origin_lat_lon_alt)
    assert (lat_deg, lon_deg) == pytest.approx((known_lat[0], known_lon[0]), abs=1e-8)
    assert 9.5 < len(points) / ((made.t_ns[-1] - made.t_ns[0]) / 1e9) < 10.5
    assert call("export", tmp_path / "drive.reference.mcap", "-o", tmp_path, "--format", "tum") == 0
    pose = np.loadtxt(tmp_path / "drive.reference.tum")
    assert np.array_equal(pose[:, 1:4], made.position_n_m)
