"""Formulas of the documentation site become MathML."""

import re
from pathlib import Path

import markdown
import pytest

from stillpoint.scripts.pages.site.formulas import FENCE, INLINE, TAG, BadFormula, MathExtension, convert_formula

PAGES = sorted((Path(__file__).parents[4] / "docs").glob("*.md"))


def test_a_formula_in_a_line_and_one_that_stands_alone():
    text = "The angle $x_k$.\n\n```math\nx_k = x_{k-1} + u\\,dt \\tag{8}\n```\n\nand so on"
    made = markdown.markdown(text, extensions=[MathExtension(), "fenced_code"])
    assert made.count("<math ") == 2
    assert '<span class="equation">(8)</span>' in made
    assert "$" not in made
    assert "\\" not in made


def test_prices_and_code_are_no_formulas():
    made = markdown.markdown("0.05 $ an hour, 0.02 $ a GB, and `$a$`", extensions=[MathExtension()])
    assert "<math" not in made
    assert "<code>$a$</code>" in made


def test_an_unknown_command_is_refused():
    with pytest.raises(BadFormula, match="nosuchcommand"):
        convert_formula(r"a \nosuchcommand b", "inline")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_formula_of_the_pages_converts(page: Path):
    text = page.read_text(encoding="utf-8")
    for formula in FENCE.findall(text):
        convert_formula(TAG.sub("", formula), "block")
    prose = re.sub(r"```.*?```|`[^`]*`", "", text, flags=re.DOTALL)
    for formula in re.findall(INLINE, prose):
        convert_formula(formula, "inline")
