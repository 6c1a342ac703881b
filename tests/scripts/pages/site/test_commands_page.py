"""docs/commands.md has a section for every verb, with its options."""

import re

import pytest

from stillpoint.scripts.main import VERBS
from stillpoint.scripts.pages.site.commands_page import PAGE, make_page


@pytest.fixture(scope="module")
def made() -> str:
    return make_page()


@pytest.mark.slow
def test_every_verb_has_a_section_and_a_place_in_the_list(made: str) -> None:
    for text in (made, PAGE.read_text(encoding="utf-8")):
        listed, _, _ = text.partition("\n## ")
        for verb, (_, summary) in VERBS.items():
            assert f"\n## stillpoint {verb}\n" in text
            assert f"* [`{verb}`](#stillpoint-{verb}): {summary}" in listed


def test_options_stand_with_what_they_do(made: str) -> None:
    section = re.search(r"## stillpoint score\n(.*?)\n## ", made, re.DOTALL)
    assert section is not None
    assert re.search(r"`--align CHOICE`: What may differ without being an error", section[1])


def test_no_line_holds_a_path_of_this_machine(made: str) -> None:
    assert not re.search(r"(?<![\w.:/])/(?:home|root|tmp|work)/", made)
