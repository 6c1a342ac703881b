"""The one door for quaternions and frames: inverses, known attitudes, and agreement with the papers' formulas."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from stillpoint.datasets import frames

finite = st.floats(-1.0, 1.0)
quaternions = (
    st.tuples(finite, finite, finite, finite)
    .filter(lambda q: np.linalg.norm(q) > 0.1)
    .map(lambda q: q / np.linalg.norm(q))
)


def same_rotation(a: np.ndarray, b: np.ndarray) -> float:
    """Angle between two attitudes, rad."""
    return float(np.max((frames.rotation(a).inv() * frames.rotation(b)).magnitude()))


@given(quaternions)
def test_orders_are_inverse_to_the_bit(q_wxyz: np.ndarray) -> None:
    assert (frames.from_xyzw(frames.to_xyzw(q_wxyz)) == q_wxyz).all()


def test_scalar_is_last_on_the_ros_side() -> None:
    assert frames.to_xyzw(np.array([0.1, 0.2, 0.3, 0.4])).tolist() == [0.2, 0.3, 0.4, 0.1]
    columns = np.arange(8.0).reshape(2, 4)
    assert frames.to_xyzw(columns).tolist() == [[1, 2, 3, 0], [5, 6, 7, 4]]


def test_q_nb_takes_body_vectors_to_east_north_up() -> None:
    east_from_forward = frames.quaternion(Rotation.from_euler("z", -90, degrees=True))
    vector_n = frames.rotation(east_from_forward).apply([0.0, 1.0, 0.0])
    assert vector_n == pytest.approx([1.0, 0.0, 0.0], abs=1e-12)


@pytest.mark.parametrize(
    "shapes", [((50, 4), (50, 4)), ((4,), (50, 4)), ((50, 4), (4,)), ((4,), (4,)), ((0, 4), (0, 4))]
)
def test_composed_rotations_are_the_product_of_scipy_to_the_bit(shapes: tuple[tuple[int, ...], ...]) -> None:
    rng = np.random.default_rng(0)
    second, first = (frames.rotation(rng.normal(size=shape)) for shape in shapes)
    np.testing.assert_array_equal(frames.compose(second, first).as_quat(), (second * first).as_quat(), strict=True)


@pytest.mark.filterwarnings("ignore:Gimbal lock")
@given(quaternions, st.sampled_from(frames.EULER_FRAMES))
def test_euler_angles_are_inverse_to_from_euler(q_nb: np.ndarray, frame: frames.EulerFrame) -> None:
    back = frames.from_euler(frames.euler(q_nb, frame), frame)
    assert same_rotation(q_nb, back) < 1e-6  # scipy's own accuracy beside a pitch of 90 deg


@pytest.mark.filterwarnings("ignore:Gimbal lock")
@given(quaternions)
def test_nwu_angles_are_those_of_the_phone_paper(q_nb: np.ndarray) -> None:
    """Eqs (4)-(6) of Elmi Aziz and Mohseni Araste 2021, literally, on this attitude's gravity and field."""
    from_nwu = frames.rotation(q_nb).inv() * frames.local_from_enu("nwu").inv()
    a1, a2, a3 = from_nwu.apply([0.0, 0.0, 9.81])
    field_b = from_nwu.apply([20.0, 0.0, -40.0])
    roll, pitch = np.arctan2(-a2, a3), np.arcsin(np.clip(a1 / 9.81, -1, 1))
    if np.cos(pitch) < 1e-3:
        return
    r1 = np.array([[1, 0, 0], [0, np.cos(roll), np.sin(roll)], [0, -np.sin(roll), np.cos(roll)]])
    r2 = np.array([[np.cos(pitch), 0, -np.sin(pitch)], [0, 1, 0], [np.sin(pitch), 0, np.cos(pitch)]])
    level = r2 @ r1 @ field_b
    yaw = np.arctan2(level[1], level[0])
    assert frames.wrap(frames.euler(q_nb, "nwu") - [roll, pitch, yaw]) == pytest.approx([0, 0, 0], abs=1e-6)


def test_nwu_yaw_is_the_azimuth_of_the_x_axis() -> None:
    """Phone flat, top (y) to the north: its x axis points east, azimuth 90 deg."""
    assert np.rad2deg(frames.euler(np.array([1.0, 0, 0, 0]), "nwu")) == pytest.approx([0, 0, 90])


def test_ned_angles_are_the_aerospace_ones() -> None:
    """A forward-right-down body that heads east, nose 10 deg up, banked 20 deg right."""
    forward, right, down = np.eye(3)
    q_nb = frames.from_euler(np.deg2rad([20.0, 10.0, 90.0]), "ned")
    body = frames.rotation(q_nb)
    assert body.apply(forward) == pytest.approx([np.cos(np.deg2rad(10)), 0, np.sin(np.deg2rad(10))], abs=1e-12)
    assert body.apply(right)[2] < 0, "banked right: the right wing is down"
    assert body.apply(down)[2] < 0


@given(st.floats(-1e4, 1e4))
def test_wrap_keeps_the_angle_and_bounds_it(angle: float) -> None:
    wrapped = float(frames.wrap(angle))
    assert -np.pi < wrapped <= np.pi
    assert np.exp(1j * wrapped) == pytest.approx(np.exp(1j * angle), abs=1e-9)


def test_half_a_turn_is_wrapped_to_plus_pi() -> None:
    assert frames.wrap([np.pi, -np.pi, 3 * np.pi, 0.0]).tolist() == [np.pi, np.pi, np.pi, 0.0]


@given(st.lists(quaternions, min_size=2, max_size=6), st.lists(st.floats(0, 1), min_size=1, max_size=5))
def test_slerp_agrees_with_scipy(q_nb: list[np.ndarray], shares: list[float]) -> None:
    t_ns = np.arange(len(q_nb), dtype=np.int64) * 10_000_000
    at_ns = (np.array(shares) * t_ns[-1]).astype(np.int64)
    q = np.array(q_nb)
    halves = np.abs(np.sum(q[1:] * q[:-1], axis=1)) < 1e-3
    if halves.any():  # opposite attitudes have no shortest path
        return
    expected = Slerp(t_ns / 1e9, frames.rotation(q))(at_ns / 1e9)
    assert same_rotation(frames.slerp(t_ns, q, at_ns), frames.quaternion(expected)) < 1e-6


def test_slerp_refuses_to_extrapolate() -> None:
    t_ns = np.array([0, 10], dtype=np.int64)
    q = np.tile([1.0, 0, 0, 0], (2, 1))
    with pytest.raises(ValueError, match="outside"):
        frames.slerp(t_ns, q, np.array([11], dtype=np.int64))
