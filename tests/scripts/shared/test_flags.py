"""Verbs read the texts of their common flags in the same way."""

import pytest

from stillpoint.scripts.shared.flags import split_names


@pytest.mark.parametrize(
    ("text", "names"), [("ekf", ["ekf"]), (" vqf, ekf ,vqf", ["vqf", "ekf"]), ("ekf,,cf", ["ekf", "", "cf"])]
)
def test_names_in_a_list_keep_their_order_and_come_once(text, names):
    """A name that is missing between two commas stays, so that the verb refuses it."""
    assert split_names(text) == names
