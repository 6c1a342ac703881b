"""The compiled quaternion functions against scipy, for all rotations and vectors, in both precisions."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stillpoint.datasets import compiled
from stillpoint.filters import rotation

number = st.floats(-10, 10, allow_subnormal=False)
vectors = st.tuples(number, number, number)
lengths = st.tuples(number, number, number).filter(lambda v: np.linalg.norm(v) > 1e-3)


def unit(q: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(float(x) for x in np.array(q) / np.linalg.norm(q))


quaternions = st.tuples(number, number, number, number).filter(lambda q: np.linalg.norm(q) > 1e-3).map(unit)


def of(q: tuple[float, ...]) -> Rotation:
    return Rotation.from_quat(q, scalar_first=True)


def same(p: tuple[float, ...], rot: Rotation, atol: float = 1e-12) -> bool:
    return bool((of(p) * rot.inv()).magnitude() < atol * 10) and abs(np.linalg.norm(p) - 1) < atol


@given(quaternions, quaternions, vectors)
def test_products_inverses_and_turned_vectors_are_scipys(p, q, v) -> None:
    assert same(rotation.multiply(p, q), of(p) * of(q))
    assert same(rotation.conjugate(q), of(q).inv())
    assert np.allclose(rotation.rotate(q, v), of(q).apply(v), atol=1e-12)


@pytest.mark.slow
@given(vectors)
@example((1e-3, 0.0, 0.0))  # where the series takes over
@example((0.0, 0.0, 0.0))
@example((1e-9, -1e-9, 0.0))
def test_exp_is_scipys_and_has_length_1(v) -> None:
    assert same(rotation.exp(v), Rotation.from_rotvec(v))


@given(lengths, st.floats(0, np.pi - 1e-6))
@example((1.0, 0.0, 0.0), 1e-3)
@example((1.0, 2.0, 3.0), 1e-7)
def test_log_undoes_exp_on_either_sign_of_the_quaternion(axis, angle) -> None:
    v = tuple(angle * np.array(axis) / np.linalg.norm(axis))
    q = rotation.exp(v)
    assert np.allclose(rotation.log(q), v, atol=1e-9)
    assert np.allclose(rotation.log(tuple(-x for x in q)), v, atol=1e-9)


@given(quaternions)
def test_log_is_never_longer_than_half_a_turn(q) -> None:
    assert np.linalg.norm(rotation.log(q)) <= np.pi + 1e-12
    assert same(rotation.exp(rotation.log(q)), of(q))


@given(lengths, lengths)
@example((0.0, 0.0, 1.0), (0.0, 0.0, -2.0))
@example((0.0, 3.0, 0.0), (0.0, -1.0, 0.0))
@example((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0))
@example((1.0, 1.0, 1.0), (-1.0, -1.0, -1.0))
def test_between_takes_one_direction_to_the_other_by_the_smallest_turn(u, v) -> None:
    q = rotation.rotation_between(u, v)
    a, b = np.array(u) / np.linalg.norm(u), np.array(v) / np.linalg.norm(v)
    assert np.allclose(of(q).apply(a), b, atol=1e-6)
    assert of(q).magnitude() == pytest.approx(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b), abs=1e-6)


@given(quaternions)
@example((0.0, 1.0, 0.0, 0.0))
@example((0.0, 0.0, 1.0, 0.0))
@example((0.0, 0.0, 0.0, 1.0))
def test_from_rows_is_the_inverse_of_the_matrix(q) -> None:
    rows = tuple(tuple(float(x) for x in row) for row in of(q).as_matrix())
    assert same(rotation.quaternion_from_rows(*rows), of(q), atol=1e-11)


@given(st.floats(-20, 20))
def test_a_rotation_about_up_turns_counter_clockwise(angle) -> None:
    assert np.allclose(
        rotation.rotate(rotation.rotation_about_up(angle), (1.0, 0.0, 0.0)), (np.cos(angle), np.sin(angle), 0)
    )


def test_single_precision_stays_single_in_every_function() -> None:
    v, q = tuple(np.float32([0.1, -0.2, 0.3])), tuple(np.float32(unit((1, 2, 3, 4))))
    results = (
        rotation.exp(v),
        rotation.exp(tuple(x * np.float32(1e-4) for x in v)),
        rotation.log(q),
        rotation.multiply(q, q),
        rotation.rotate(q, v),
        rotation.rotation_between(v, (v[1], v[2], v[0])),
        rotation.rotation_about_up(v[0]),
        rotation.normalise(q),
        rotation.quaternion_from_rows(*(tuple(np.float32(row)) for row in np.eye(3))),
        rotation.blend(v, v, v[2]),
    )
    for result in results:
        assert all(float(np.float32(x)) == x for x in result), result


def test_machine_code_of_other_sources_is_forgotten_once(tmp_path) -> None:
    (tmp_path / compiled.STAMP).write_text("of another version")
    old = tmp_path / "complementary.step-1.py311.nbi"
    old.write_bytes(b"index")
    compiled.drop_stale(tmp_path, Path(rotation.__file__))
    assert not old.exists()
    old.write_bytes(b"written by these sources")
    compiled.drop_stale(tmp_path, Path(rotation.__file__))
    assert old.exists()


def test_where_nothing_can_be_written_it_compiles_without_a_cache(monkeypatch) -> None:
    njit = compiled.njit

    def nowhere(cache: bool = False, **options: object):
        if cache:
            raise RuntimeError("cannot cache function: no locator available")
        return njit(**options)

    monkeypatch.setattr(compiled, "njit", nowhere)
    assert compiled.compiled(lambda x: x + 1)(2.0) == 3.0
