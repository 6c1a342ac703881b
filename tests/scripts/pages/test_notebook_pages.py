"""The notebooks of the documentation run from the first cell to the last, and their pages show what the cells say."""

import json
import re
from functools import partial
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

from stillpoint.datasets import simulate

FOLDER = Path(__file__).parents[3] / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_cells_of_a_notebook_run_and_draw(path, monkeypatch):
    """The cells run in this process, which has imported all, and on recordings of half the rate."""
    drawn = []
    monkeypatch.setattr(plt, "show", lambda: drawn.append(plt.gcf()))
    monkeypatch.setattr(simulate, "simulate", partial(simulate.simulate, rate_hz=50.0))
    names: dict[str, object] = {"__name__": "__main__"}
    for cell in read_code(path):
        exec(compile(cell, str(path), "exec"), names)
    assert drawn, "a notebook without a figure teaches little"
    assert len(drawn) == path.with_suffix(".md").read_text(encoding="utf-8").count("![Figure of the code above]")
    plt.close("all")


@pytest.mark.slow
def test_the_page_of_a_notebook_has_what_its_cells_show():
    """The kernel is a process of its own, as for the pages; the notebook with the least work stands for all."""
    path = FOLDER / "reference-of-a-phone-log.ipynb"
    pages = pytest.importorskip("stillpoint.scripts.pages.notebook_pages", reason="nbclient is not installed")
    text, figures = pages.make_page(path)
    assert figures
    assert "of the errors lie within two standard deviations" in text.replace(read_code(path)[-1], "")
    assert all(content.startswith(b"\x89PNG") for content in figures.values())
    shown = set(re.findall(r"\((?:\.\./figures/notebooks/)([^)]*)\)", text))
    assert shown == set(figures)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_kept_without_results_and_its_page_has_its_code(path):
    assert not any(cell.get("outputs") for cell in json.loads(path.read_text(encoding="utf-8"))["cells"])
    page = path.with_suffix(".md").read_text(encoding="utf-8")
    for cell in read_code(path):
        assert cell.strip() in page, "run python -m stillpoint.scripts.pages.notebook_pages"


def read_code(path: Path) -> list[str]:
    """Return the text of each cell of code."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
