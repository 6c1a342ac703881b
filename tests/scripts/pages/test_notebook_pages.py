"""The notebooks of the documentation run from the first cell to the last, and their pages show what the cells say."""

import json
import re
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[3] / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_draws(path):
    pages = pytest.importorskip("stillpoint.scripts.pages.notebook_pages", reason="nbclient is not installed")
    text, figures = pages.make_page(path)
    assert figures, "a notebook without a figure teaches little"
    assert all(content.startswith(b"\x89PNG") for content in figures.values())
    shown = set(re.findall(r"\((?:\.\./figures/notebooks/)([^)]*)\)", text))
    assert shown == set(figures)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_kept_without_results_and_its_page_has_its_code(path):
    cells = [cell for cell in json.loads(path.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == "code"]
    assert not any(cell["outputs"] for cell in cells)
    page = path.with_suffix(".md").read_text(encoding="utf-8")
    for cell in cells:
        assert "".join(cell["source"]).strip() in page, "run python -m stillpoint.scripts.pages.notebook_pages"
