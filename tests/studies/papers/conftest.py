"""Pages of experiments for tests that read their words and numbers."""

import pytest


@pytest.fixture
def without_ink(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw the pictures but do not write them as SVG, which takes half of the time of a page.

    For tests of what else is on a page; those of each experiment look at its pictures.
    """
    monkeypatch.setattr("stillpoint.scoring.report.pictures._render_svg", lambda figure, title, name: "<svg></svg>")
