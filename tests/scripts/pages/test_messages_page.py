"""The page of all messages is made from the code."""

import pytest

from stillpoint.scripts.pages.messages_page import find_messages, make_page


@pytest.mark.slow
def test_the_page_shows_what_the_code_raises():
    page = make_page()
    assert "`datasets/importers/ros.py`" in page
    assert "- {source}: there is no such file or folder" in page
    assert max(map(len, page.splitlines())) < 1000


def test_filled_in_parts_are_shown_by_their_names(tmp_path):
    file = tmp_path / "x.py"
    file.write_text(
        'raise BadSource(f"{file.name}, line {line}: {len(cells)} cells; " "mend it")\nraise ValueError("no")'
    )
    assert list(find_messages(file)) == ["{name}, line {line}: … cells; mend it"]
