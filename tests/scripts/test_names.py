"""Names of files are data: no verb lets one write to the terminal, and no failure of the output goes unnoticed."""

import shutil

import pytest

from stillpoint.datasets.mcap.store import write
from stillpoint.datasets.names import make_drawable, make_printable
from stillpoint.datasets.simulate import simulate

HOSTILE = ["esc\x1b[2Japed", "two\nlines", "bell\x07", "not\udcffutf8", "reversed\u202egnp", "[x]"]


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("names") / "plain.mcap"
    write(path, simulate("phone-1", minutes=1.0))
    return path


DOCTORED = [pytest.param("doctor", name, marks=pytest.mark.slow) for name in HOSTILE[:2]]


@pytest.mark.parametrize(("verb", "name"), [*(("info", name) for name in HOSTILE), *DOCTORED])
def test_a_hostile_name_is_shown_escaped(call, recording, tmp_path, capsys, verb, name):
    path = tmp_path / f"{name}.mcap"
    shutil.copy(recording, path)
    assert call(verb, path) == 0
    out = capsys.readouterr().out
    first = out.splitlines()[0]
    assert make_printable(name) in first
    assert all(letter.isprintable() or letter in "\n\t" for letter in out)


def test_an_error_about_a_hostile_name_gives_one_line_error(call, tmp_path, capsys):
    assert call("info", tmp_path / "no\x1b[31m\nfile.mcap") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.isprintable()


def test_names_are_readable_escaped_and_drawable():
    assert make_printable("Füße 走る [x]*.mcap") == "Füße 走る [x]*.mcap"
    assert make_printable("a\x1b[31mb\nc\udcff") == "a\\x1b[31mb\\nc\\xff"
    assert make_drawable(r"$\frac{$") == r"\$\frac{\$"


def test_matplotlib_draws_a_name_with_dollars():
    """``$\\frac{$`` alone is mathematics without an end, and ends in an exception when it is drawn."""
    pyplot = pytest.importorskip("matplotlib.figure")
    figure = pyplot.Figure()
    figure.subplots().set_title(make_drawable(r"$\frac{$"))
    figure.canvas.draw()
