"""The parts of an attitude error: identities, planted turns, BROAD's formulas."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from swings import attitudes

from stillpoint.datasets.frames import from_euler, heading_rotation, quaternion, rotation
from stillpoint.scoring.errors import (
    compute_attitude_error,
    compute_euler_error,
    compute_heading_offset,
    compute_rotation_error_b,
    compute_rotation_error_n,
    find_near_gimbal,
)

small = st.tuples(*[st.floats(-0.9, 0.9)] * 3)


@given(attitudes)
def test_error_with_itself_is_zero(q):
    error = compute_attitude_error(q, -q)
    for name in ("total_rad", "heading_rad", "inclination_rad"):
        assert getattr(error, name) < 1e-14
    assert np.abs(compute_rotation_error_b(q, q)).max() < 1e-14


@given(attitudes, st.floats(-3.1, 3.1))
def test_pure_yaw_is_all_heading(q, yaw):
    turned = quaternion(heading_rotation(yaw) * rotation(q))
    error = compute_attitude_error(turned, q)
    assert error.heading_rad == pytest.approx(abs(yaw), abs=1e-12)
    assert error.total_rad == pytest.approx(abs(yaw), abs=1e-12)
    assert error.inclination_rad < 1e-12
    assert compute_heading_offset(turned, q) == pytest.approx(yaw, abs=1e-12)


@given(attitudes, st.floats(-np.pi, np.pi), st.floats(0, 3.1))
def test_pure_tilt_is_all_inclination(q, azimuth, tilt):
    axis = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    error = compute_attitude_error(quaternion(Rotation.from_rotvec(axis * tilt) * rotation(q)), q)
    assert error.inclination_rad == pytest.approx(tilt, abs=1e-12)
    assert error.heading_rad < 1e-12


@given(attitudes, attitudes)
def test_split_is_a_right_spherical_triangle(p, q):
    """cos(total / 2) = cos(heading / 2) cos(inclination / 2): the two parts make up the whole."""
    error = compute_attitude_error(p, q)
    parts = np.cos(error.heading_rad / 2) * np.cos(error.inclination_rad / 2)
    assert np.cos(error.total_rad / 2) == pytest.approx(parts, abs=1e-12)


@given(attitudes, attitudes)
def test_the_parts_are_those_that_broad_publishes(p, q):
    """Its formulas as they are printed; their arccosines keep half of the digits."""
    (w, x, y, z), (a, b, c, d) = p[0], q[0]  # of p q^-1:
    e_w, e_z = w * a + x * b + y * c + z * d, -w * d - x * c + y * b + z * a
    error = compute_attitude_error(p, q)
    assert error.total_rad == pytest.approx(2 * np.arccos(np.clip(abs(e_w), 0, 1)), abs=1e-7)
    assert error.inclination_rad == pytest.approx(2 * np.arccos(np.clip(np.hypot(e_w, e_z), 0, 1)), abs=1e-7)
    if abs(e_w) > 1e-3:  # it divides by w
        assert error.heading_rad == pytest.approx(2 * np.arctan(abs(e_z / e_w)), abs=1e-9)


@given(attitudes, small)
def test_rotation_errors_are_about_the_axes_that_they_name(q_true, planted_rad):
    """exp(e) q turns about east, north and up; q exp(d) about the body's axes."""
    turn = Rotation.from_rotvec([planted_rad])
    assert compute_rotation_error_n(quaternion(turn * rotation(q_true)), q_true)[0] == pytest.approx(
        planted_rad, abs=1e-12
    )
    q_est = quaternion(rotation(q_true) * turn.inv())
    assert compute_rotation_error_b(q_est, q_true)[0] == pytest.approx(planted_rad, abs=1e-12)


@pytest.mark.parametrize("frame", ["enu", "nwu", "ned"])
def test_gimbal_is_where_the_pitch_is_beyond_80_deg(frame):
    pitch_deg = np.array([-89.0, -80.1, -79.9, 0.0, 79.9, 80.1, 89.0])
    zero = np.zeros_like(pitch_deg)
    q_true = from_euler(np.deg2rad(np.stack([zero + 30.0, pitch_deg, zero - 120.0], axis=1)), frame)
    assert find_near_gimbal(q_true, frame).tolist() == [True, True, False, False, False, True, True]


def test_small_errors_keep_their_digits():
    """2 acos|w| would give 0 or 2e-8 for 1e-9 rad."""
    q = quaternion(Rotation.from_euler("ZYX", [[0.3, -0.7, 2.0]]))
    turned = quaternion(Rotation.from_rotvec([0.0, 3e-10, 4e-10]) * rotation(q))
    error = compute_attitude_error(turned, q)
    assert error.total_rad == pytest.approx(5e-10, rel=1e-5, abs=0)
    assert error.heading_rad == pytest.approx(4e-10, rel=1e-5, abs=0)
    assert error.inclination_rad == pytest.approx(3e-10, rel=1e-5, abs=0)


@pytest.mark.parametrize(("frame", "sign"), [("enu", 1), ("nwu", -1), ("ned", -1)])
def test_euler_yaw_error_wraps_and_has_its_frame_s_sign(frame, sign):
    """From 179 to -179 deg of counter-clockwise heading are 2 deg, not 358; nwu and ned count clockwise."""
    level = np.array([[1.0, 0, 0, 0]]) if frame != "ned" else quaternion(Rotation.from_euler("x", [[np.pi]]))
    before = quaternion(heading_rotation(np.deg2rad(179)) * rotation(level))
    after = quaternion(heading_rotation(np.deg2rad(181)) * rotation(level))
    assert np.rad2deg(compute_euler_error(after, before, frame))[0] == pytest.approx([0, 0, 2 * sign], abs=1e-9)
