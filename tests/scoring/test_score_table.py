"""A score as a table: printed, in a notebook, as a frame."""

import sys

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stillpoint.datasets import Estimate, Truth
from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.frames import quaternion
from stillpoint.scoring import score


@pytest.fixture(scope="module")
def scored():
    """An estimate that is off by 2 deg about north: inclination 2, heading 0."""
    t_ns = np.arange(100) * 10_000_000
    turned = quaternion(Rotation.from_rotvec(np.tile([0.0, np.deg2rad(2.0), 0.0], (100, 1))))
    level = np.tile([1.0, 0.0, 0.0, 0.0], (100, 1))
    estimate = Estimate(t_ns, "<mine>", q_nb=turned, recording="run")
    return score(estimate, Truth(t_ns, level, np.ones(100, dtype=bool)), align="none")


def test_print_shows_each_part_with_its_figures(scored):
    lines = str(scored).splitlines()
    assert lines[0] == "<mine> on run against the truth: error in deg"
    table = {line.split()[0]: [float(cell) for cell in line.split()[1:]] for line in lines[2:8]}
    assert table["total"] == pytest.approx([2.0] * 5, abs=1e-3)
    assert table["heading"] == pytest.approx([0.0] * 5, abs=1e-3)
    assert "100 samples, aligned by none" in lines[-1]
    assert max(map(len, lines)) <= 80


def test_notebooks_get_a_table_with_escaped_names(scored):
    html = scored._repr_html_()
    assert html.count("<tr>") == 7
    assert "&lt;mine&gt;" in html
    assert "<mine>" not in html


def test_a_frame_needs_pandas_and_says_so(scored, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(BadParameter, match="pandas is not installed"):
        scored.to_frame()


def test_a_frame_has_a_row_per_part(scored):
    pandas = pytest.importorskip("pandas")
    frame = scored.to_frame()
    assert isinstance(frame, pandas.DataFrame)
    assert frame.loc["total", "rmse_deg"] == pytest.approx(2.0)
    assert list(frame.index) == ["total", "heading", "inclination", "roll", "pitch", "yaw"]
