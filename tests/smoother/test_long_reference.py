"""A reference in pieces is the whole one, in memory and in a file."""

from dataclasses import fields
from pathlib import Path

import numpy as np

from stillpoint.datasets.mcap.store import write, write_trajectory_pieces
from stillpoint.datasets.trajectory import Calibration, Reference
from stillpoint.smoother.known_calibration import express_in_raw_readings
from stillpoint.smoother.long_reference import LongReference, as_long_reference


def test_pieces_follow_each_other_and_make_the_whole(of_swings: LongReference) -> None:
    pieces, whole = list(of_swings.pieces()), of_swings.whole()
    assert len(pieces) == of_swings.facts["diagnostics"]["windows"] == 3
    assert sum(len(piece.t_ns) for piece in pieces) == of_swings.samples == len(whole.t_ns)
    for name in ("t_ns", "q_nb", "cov_b_rad2", "gyro_bias_b_radps"):
        joined = np.concatenate([getattr(piece, name) for piece in pieces])
        np.testing.assert_array_equal(joined, getattr(whole, name))
    assert (np.diff(whole.t_ns) > 0).all()


def test_a_file_of_pieces_has_the_bytes_of_the_whole(of_swings: LongReference, tmp_path: Path) -> None:
    origin = {"key": "known"}
    write(tmp_path / "whole.mcap", of_swings.whole(), origin=origin)
    write_trajectory_pieces(tmp_path / "pieces.mcap", of_swings.pieces(), of_swings.samples, origin=origin)
    assert (tmp_path / "pieces.mcap").read_bytes() == (tmp_path / "whole.mcap").read_bytes()


def test_a_reference_in_memory_comes_back_from_its_piece(of_swings: LongReference) -> None:
    whole = of_swings.whole()
    again = as_long_reference(whole).whole()
    for each in fields(Reference):
        np.testing.assert_equal(getattr(again, each.name), getattr(whole, each.name))


def test_a_known_calibration_changes_the_bias_of_every_piece(of_swings: LongReference) -> None:
    """A gyro whose readings are twice the rate has twice the bias, and half the matrix."""
    raw = express_in_raw_readings(of_swings, Calibration(gyro_matrix=np.eye(3) / 2)).whole()
    np.testing.assert_allclose(raw.gyro_bias_b_radps, 2 * of_swings.whole().gyro_bias_b_radps, rtol=1e-12)
    matrix = of_swings.facts["calibration"].gyro_matrix
    np.testing.assert_allclose(raw.calibration.gyro_matrix, matrix / 2, rtol=1e-12)
