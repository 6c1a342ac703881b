"""API pages: comments of fields become their docstrings, Sphinx roles become code."""

from pathlib import Path

import griffe
import markdown

import stillpoint.datasets.recording
from stillpoint.scripts.pages.site.api_pages import FieldComments, RoleExtension


def test_a_field_takes_the_comment_behind_it_and_the_lines_that_continue_it(tmp_path):
    (tmp_path / "sample.py").write_text(
        "class Sample:\n"
        '    """A class."""\n'
        "\n"
        "    t_ns: int\n"
        "    rate_radps: float  # (N,) of the body\n"
        "    turn: float = 0.0  # of all samples,\n"
        "    # which share it\n"
    )
    module = griffe.load("sample", search_paths=[tmp_path], extensions=griffe.load_extensions(FieldComments))
    found = {name: each.docstring and each.docstring.value for name, each in module["Sample"].attributes.items()}
    assert found == {
        "t_ns": None,
        "rate_radps": "(N,) of the body",
        "turn": "of all samples, which share it",
    }


def test_every_array_of_a_stream_says_its_shape():
    folder = Path(stillpoint.datasets.recording.__file__).parent
    module = griffe.load("recording", search_paths=[folder], extensions=griffe.load_extensions(FieldComments))
    for name in ("Imu", "Mag", "Gps", "Truth"):
        for field, attribute in module[name].attributes.items():
            if str(attribute.annotation) == "Floats":
                assert attribute.docstring is not None, f"{name}.{field}"
                assert attribute.docstring.value.startswith("(N,"), f"{name}.{field}"


def test_roles_become_code():
    text = "Raises :class:`BadFile`; see :func:`~stillpoint.datasets.read`, and `:class:` stays."
    made = markdown.markdown(text, extensions=[RoleExtension()])
    assert made == "<p>Raises <code>BadFile</code>; see <code>read</code>, and <code>:class:</code> stays.</p>"
