"""Queries find what they say, and no text of a user becomes SQL."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from shelf import write_family, write_recording

from stillpoint.datasets.archive import create_archive
from stillpoint.datasets.archive.query import parse_query
from stillpoint.datasets.errors import BadParameter


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("queries")
    with create_archive(folder / "archive") as opened:
        list(opened.add(write_family(folder, "walk", 1, sensor="iPhone 5", date="2024-05-01"), ["fast"]))
        one = write_recording(folder / "04_slow.mcap", 2, n=900, sensor="Nexus 5", licence="")
        list(opened.add([one], ["slow", "lab"], {"subject": "Anna", "height_cm": "171"}))
        yield opened


@pytest.mark.parametrize(
    ("query", "found"),
    [
        ("all", {"walk", "04_slow"}),
        ("kind:recording", {"walk", "04_slow"}),
        ("kind = reference", {"walk"}),
        ("sensor ~ 'iphone' and has:mag and rate > 99", {"walk"}),
        ("duration > 5", {"04_slow"}),
        ("duration < 5 and kind:recording or tag:lab", {"walk", "04_slow"}),
        ("(duration < 5 or tag:lab) and not sensor ~ iphone and kind:recording", {"04_slow"}),
        ("tag:fast and tag:lab", set()),
        ("not tag:fast", {"04_slow"}),
        ("tag ~ fas", {"walk"}),
        ("meta.subject = anna", {"04_slow"}),
        ("meta.height_cm >= 100", {"04_slow"}),
        ("meta.height_cm < 100", set()),
        ("rate.mag = 100 and samples > 800", {"04_slow"}),
        ("has:gps", set()),
        ("04_slow", {"04_slow"}),
        ("'slow'", {"04_slow"}),
        ("licence = '' and kind:recording", {"04_slow"}),
        ("date >= 2024-01-01 and date < 2025-01-01", {"walk"}),
        ("estimator:ekf", {"walk"}),
        ("sd < 2 and method = graph", {"walk"}),
        ("NOT TAG:x AND kind:recording AND name ~ WALK", {"walk"}),
        ("is:removed", set()),
    ],
)
def test_a_query_finds_what_it_says(archive, query, found):
    assert {entry.name for entry in archive.find(query)} == found


@pytest.mark.parametrize(
    ("query", "says"),
    [
        ("rat > 3", "no field 'rat'"),
        ("rate >", "cannot be understood"),
        ("rate > fast", "rate is a number"),
        ("(tag:x", "cannot be understood"),
        ("tga:x", "no label tga:"),
        ("is:broken", "is:removed or is:damaged"),
        ("rate > 3; DROP TABLE objects", "cannot be understood"),
    ],
)
def test_a_query_that_makes_no_sense_gives_one_line_error(archive, query, says):
    with pytest.raises(BadParameter, match=says) as caught:
        archive.find(query)
    assert "\n" not in str(caught.value)


@given(st.text(alphabet=st.characters(exclude_characters="'", exclude_categories=["Cs", "Cc"]), min_size=1))
def test_values_become_parameters_only(text):
    condition = parse_query(f"sensor = '{text}' or tag:'{text}' or meta.x ~ '{text}' or '{text}'")
    plain = parse_query("sensor = 'a' or tag:'a' or meta.x ~ 'a' or 'a'")
    assert condition.sql == plain.sql
    assert text in condition.parameters


@pytest.mark.slow
@given(st.text(max_size=40))
def test_any_text_is_a_query_or_one_line(text):
    try:
        parse_query(text)
    except BadParameter as error:
        assert "\n" not in str(error).replace(text, "")  # noqa: PT017
