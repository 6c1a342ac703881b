"""The pages of estimators: a section for each, with what a reader needs."""

import re
from pathlib import Path

import pytest

from stillpoint.filters import ESTIMATORS
from stillpoint.filters.table import Estimator
from stillpoint.scripts.pages.accuracy_page import replace_table
from stillpoint.scripts.pages.settings_pages import FAMILIES, find_family, refresh_tables

DOCS = Path(__file__).parents[3] / "docs"
OVERVIEW = (DOCS / "estimators.md").read_text(encoding="utf-8")
PAGES = {family: (DOCS / f"estimators-{family}.md").read_text(encoding="utf-8") for family in FAMILIES}
ACCURACY = (DOCS / "estimator-accuracy.md").read_text(encoding="utf-8")


def section(name: str) -> str:
    found = re.search(rf"\n## {re.escape(name)}\n(.*?)(?=\n## |\n<!-- new)", PAGES[find_family(name)], re.DOTALL)
    assert found is not None, f"no section ## {name}; run python -m stillpoint.scripts.pages.settings_pages"
    return found[1]


def test_the_generated_parts_are_up_to_date() -> None:
    for page in (OVERVIEW, *PAGES.values()):
        assert refresh_tables(page) == page, "run python -m stillpoint.scripts.pages.settings_pages"


@pytest.mark.parametrize("name", list(ESTIMATORS))
def test_every_entry_has_one_section_with_its_settings(name: str) -> None:
    assert "".join(PAGES.values()).count(f"\n## {name}\n") == 1
    assert f"<!-- settings {name} -->" in section(name)


@pytest.mark.parametrize("name", [name for name, entry in ESTIMATORS.items() if isinstance(entry, Estimator)])
@pytest.mark.parametrize("part", ["*Equations.*", "*Frame.*", "*Readings.*", "*Fails"])
def test_a_section_of_ours_says_what_a_reader_needs(name: str, part: str) -> None:
    assert part in section(name)


@pytest.mark.parametrize("name", [name for name, entry in ESTIMATORS.items() if entry.is_peer])
def test_a_section_of_a_peer_names_its_package_and_version(name: str) -> None:
    said = section(name)
    assert re.search(r"`(vqf|ahrs|imufusion|riann)` \d|of the same package", said)


def test_equations_are_such_that_github_renders_them() -> None:
    """Outside of ```math, Markdown takes a backslash before punctuation for an escape and eats it."""
    text = re.sub(r"```.*?```|`[^`]*`", "", "".join(PAGES.values()), flags=re.DOTALL)
    for paragraph in text.split("\n\n"):
        assert paragraph.count("$") % 2 == 0, paragraph
        for equation in re.findall(r"\$([^$]*)\$", paragraph):
            assert not re.search(r"\\[^A-Za-z]", equation), equation
    assert "$$" not in text


def test_an_entry_without_a_section_gets_one_from_its_module() -> None:
    page = PAGES["kalman"]
    without = re.sub(r"\n## kf-axis\n.*?(?=\n## )", "", page, flags=re.DOTALL)
    again = refresh_tables(without)
    assert again.count("\n## kf-axis\n") == 1
    assert "A = [[1, -dt], [0, 1]]" in again
    assert "| `tilt_sd_rad` |" in again
    assert again != page


def test_the_table_of_accuracy_has_every_estimator_of_attitude_the_best_first() -> None:
    class Trial:
        name = "02_slow"

    made = replace_table("<!-- accuracy -->\n<!-- end -->", [Trial()], {"cf": [3.0], "vqf": [1.0]})
    assert made.splitlines()[1:5] == [
        "| estimator | mean | median | 02 |",
        "|---|---|---|---|",
        "| `vqf` (peer) | 1.00 | 1.00 | 1.0 |",
        "| `cf` | 3.00 | 3.00 | 3.0 |",
    ]
    rows = re.search(r"<!-- accuracy -->\n(.*?)<!-- end -->", ACCURACY, re.DOTALL)[1]
    attitudes = {name for name, entry in ESTIMATORS.items() if isinstance(entry, Estimator) or entry.is_peer}
    assert set(re.findall(r"^\| `([\w-]+)`", rows, re.MULTILINE)) == attitudes
