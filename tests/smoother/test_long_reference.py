"""A reference in pieces is the whole one, in memory and in a file."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from stillpoint.datasets.mcap.store import write, write_trajectory_pieces
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.trajectory import Calibration, Reference
from stillpoint.smoother.attitude.params import HANDHELD
from stillpoint.smoother.known_calibration import express_in_raw_readings
from stillpoint.smoother.long_reference import LongReference, as_long_reference
from stillpoint.smoother.reference import make_reference_in_pieces

WINDOWED = replace(HANDHELD, keys=replace(HANDHELD.keys, window_s=60.0, overlap_s=10.0))


@pytest.fixture(scope="module")
def made() -> LongReference:
    """Return the reference of two minutes in three windows, as pieces."""
    long = make_reference_in_pieces(simulate("phone-3", minutes=2), "graph", WINDOWED)
    assert isinstance(long, LongReference)
    return long


def test_pieces_follow_each_other_and_make_the_whole(made: LongReference) -> None:
    pieces, whole = list(made.pieces()), made.whole()
    assert len(pieces) == made.facts["diagnostics"]["windows"] == 3
    assert sum(len(piece.t_ns) for piece in pieces) == made.samples == len(whole.t_ns)
    for name in ("t_ns", "q_nb", "cov_b_rad2", "gyro_bias_b_radps"):
        joined = np.concatenate([getattr(piece, name) for piece in pieces])
        np.testing.assert_array_equal(joined, getattr(whole, name))
    assert (np.diff(whole.t_ns) > 0).all()


def test_a_file_of_pieces_has_the_bytes_of_the_whole(made: LongReference, tmp_path: Path) -> None:
    origin = {"key": "known"}
    write(tmp_path / "whole.mcap", made.whole(), origin=origin)
    write_trajectory_pieces(tmp_path / "pieces.mcap", made.pieces(), made.samples, origin=origin)
    assert (tmp_path / "pieces.mcap").read_bytes() == (tmp_path / "whole.mcap").read_bytes()


def test_a_reference_in_memory_comes_back_from_its_piece(made: LongReference) -> None:
    whole = made.whole()
    again = as_long_reference(whole).whole()
    for each in fields(Reference):
        np.testing.assert_equal(getattr(again, each.name), getattr(whole, each.name))


def test_a_known_calibration_changes_the_bias_of_every_piece(made: LongReference) -> None:
    """A gyro whose readings are twice the rate has twice the bias, and half the matrix."""
    raw = express_in_raw_readings(made, Calibration(gyro_matrix=np.eye(3) / 2)).whole()
    np.testing.assert_allclose(raw.gyro_bias_b_radps, 2 * made.whole().gyro_bias_b_radps, rtol=1e-12)
    matrix = made.facts["calibration"].gyro_matrix
    np.testing.assert_allclose(raw.calibration.gyro_matrix, matrix / 2, rtol=1e-12)
