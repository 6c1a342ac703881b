"""A name is data wherever it appears: in every figure, on every page, and in what every verb prints."""

import json
import os
import re
from dataclasses import replace

import numpy as np
import pytest
from boards import make_board
from matplotlib.figure import Figure
from matplotlib.text import Text

from stillpoint.datasets import write
from stillpoint.datasets.calibration.allan import find_allan_deviation
from stillpoint.datasets.simulate import simulate
from stillpoint.filters import estimate
from stillpoint.scoring import compare, score_of
from stillpoint.scoring.report.figures import draw_angles, draw_errors, draw_scores, make_view
from stillpoint.scoring.report.pictures import make_picture
from stillpoint.scoring.report.printed import write_figure
from stillpoint.scoring.report.spin_figures import RateSeries, draw_rates
from stillpoint.scripts.verbs import allan
from stillpoint.studies.fidelity import Fidelity, JudgedTwice, JudgeFidelity
from stillpoint.studies.fidelity_figure import draw_fidelity
from stillpoint.studies.leaderboard import Leaderboard
from stillpoint.studies.publish.figures import draw_map, draw_ranking
from stillpoint.studies.publish.page import make_page_html
from stillpoint.studies.tune import ParamRange, TunedTrial, Tuning
from stillpoint.studies.tune_figure import draw_tuning

# Mathematics that never ends, an escape sequence that turns a terminal red, and the start of bold text in HTML.
NAME = "$\\frac{$ \x1b[31m <b>"
DRAWN = r"$\frac{$ \x1b[31m <b>"


@pytest.fixture(scope="module")
def recording():
    return replace(simulate("phone-1", minutes=0.6), name=NAME)


@pytest.fixture(scope="module")
def comparisons(recording):
    return [replace(compare(estimate(recording, "cf"), recording.truth), estimated=NAME)]


@pytest.fixture(scope="module")
def board():
    """A leaderboard of which every name is the hostile one."""
    text = json.dumps(make_board().to_json())
    for name in ("estimator-0", "run & 01", "slow"):
        text = text.replace(json.dumps(name), json.dumps(NAME))
    return Leaderboard.from_json(json.loads(text))


def _draw_on_axes(count, draw):
    figure = Figure()
    draw(list(np.atleast_1d(figure.subplots(count))))
    figure.legend(*figure.axes[0].get_legend_handles_labels())
    return figure


def _draw_attitudes(draw, count):
    def make(request):
        comparisons, recording = request.getfixturevalue("comparisons"), request.getfixturevalue("recording")
        truth = replace(recording.truth)
        return _draw_on_axes(count, lambda axes: draw(axes, make_view(comparisons, truth, "nwu", 0)))

    return make


def _draw_scores(request):
    scores = [score_of(one) for one in request.getfixturevalue("comparisons")]
    return _draw_on_axes(1, lambda axes: draw_scores(axes[0], [replace(one, estimated=NAME) for one in scores]))


def _draw_rates(request):
    t_s = np.linspace(0.0, 1.0, 50)
    series = RateSeries(t_s, t_s, {NAME: t_s + 0.1})
    return _draw_on_axes(2, lambda axes: draw_rates(axes, series, {NAME: 0}, NAME))


def _draw_ranking(request):
    return _draw_on_axes(1, lambda axes: draw_ranking(axes[0], request.getfixturevalue("board").tables[0]))


def _draw_map(request):
    return _draw_on_axes(1, lambda axes: draw_map(axes[0], request.getfixturevalue("board")))


def _draw_tuning(count):
    def make(request):
        ranges = tuple(ParamRange(f"{NAME}{k}", 0.1, 1.0, False) for k in range(count))
        trials = [
            TunedTrial({one.name: 0.1 + 0.1 * number for one in ranges}, (1.0 + number,), 1.0 + number)
            for number in range(5)
        ]
        best = trials[0]
        return draw_tuning(Tuning(NAME, "total", (NAME,), {}, NAME, ranges, tuple(trials), best, best, (best,), (1.0,)))

    return make


def _draw_fidelity(request):
    judge = JudgeFidelity(NAME, 1, 0, 1.0, 1.0, 1.0, 0.1, 1, 0, 1, 0, {NAME: 1.0})
    rows = (JudgedTwice(NAME, NAME, NAME, 1.0, 1.1), JudgedTwice(NAME, "cf", NAME, 2.0, 2.1))
    return draw_fidelity(Fidelity((judge,), rows, "heading", 1))


MAKERS = {
    "angles": _draw_attitudes(draw_angles, 3),
    "errors": _draw_attitudes(draw_errors, 1),
    "scores": _draw_scores,
    "rates": _draw_rates,
    "ranking": _draw_ranking,
    "map": _draw_map,
    "tuning of one parameter": _draw_tuning(1),
    "tuning of two parameters": _draw_tuning(2),
    "fidelity": _draw_fidelity,
}


@pytest.mark.parametrize("maker", MAKERS)
def test_every_figure_shows_the_name_as_text(request, maker):
    figure = MAKERS[maker](request)
    figure.canvas.draw()  # raises for mathematics that never ends
    texts = [text.get_text() for text in figure.findobj(Text)]
    hostile = [text for text in texts if "frac" in text]
    assert hostile
    for text in hostile:
        assert text.replace("\n", "").isprintable()
        assert DRAWN in text.replace(r"\$", "$")


@pytest.mark.slow
@pytest.mark.parametrize("ending", [".svg", ".pdf", ".png"])
def test_printed_figures_hold_the_name(board, tmp_path, ending):
    write_figure(tmp_path / f"a{ending}", 1, 2.0, lambda axes: draw_ranking(axes[0], board.tables[0]))
    assert (tmp_path / f"a{ending}").stat().st_size > 1000
    if ending == ".svg":
        assert r"$\frac{$ \x1b[31m &lt;b&gt;" in (tmp_path / "a.svg").read_text()


@pytest.mark.slow
@pytest.mark.ink
def test_pictures_of_pages_hold_the_name_as_text(board):
    picture = make_picture(NAME, "", 1, 100, lambda axes: draw_ranking(axes[0], board.tables[0]), time_axis=False)
    assert r"$\frac{$ \x1b[31m &lt;b&gt;" in picture.wide
    assert "<b>" not in picture.wide


@pytest.mark.slow
def test_allan_deviations_are_drawn_under_the_name(tmp_path):
    t_ns = np.arange(7000, dtype=np.int64) * 10_000_000
    noise = np.random.default_rng(0).normal(size=(7000, 3))
    figures = [allan._Figures(name, find_allan_deviation(t_ns, noise)) for name in ("gyro", "accel")]
    allan._draw(tmp_path / "a.svg", NAME, figures)
    assert (tmp_path / "a.svg").stat().st_size > 1000


def test_the_page_of_a_leaderboard_holds_no_element_of_a_name(board):
    page = re.sub(r"<script>.*?</script>", "", make_page_html(board), flags=re.DOTALL)
    assert "frac" in page
    assert "<b>" not in page.partition("<body")[2]


@pytest.fixture(scope="module")
def folder(tmp_path_factory, recording):
    """A recording, and a cut of it, under the hostile name; every verb writes beside them."""
    place = tmp_path_factory.mktemp("names")
    write(place / f"{NAME}.mcap", recording)
    return place


def _is_safe(text):
    return all(letter.isprintable() or letter in "\n\t" for letter in text)


@pytest.mark.slow
def test_no_verb_prints_a_name_that_steers_the_terminal(call, folder, tmp_path, capsys, monkeypatch):
    """One chain through the verbs; a word that a verb does not know ends with code 2, and must be as harmless."""
    monkeypatch.chdir(folder)
    file, made = f"{NAME}.mcap", f"{NAME}.cf.estimate.mcap"
    table = tmp_path / f"{NAME}.csv"
    table.write_text("t,gx,gy,gz,ax,ay,az\n" + "\n".join(f"{k / 100},0.1,0.2,{k % 7},0.1,9.8,0.2" for k in range(500)))
    columns = ["--time", "t:s", "--gyro", "gx,gy,gz:deg/s", "--accel", "ax,ay,az:m/s2"]
    bundle = tmp_path / "bundle"
    (tmp_path / "empty").mkdir()
    commands = [
        ["info", file],
        ["info", f"{NAME} not there.mcap"],
        ["doctor", file],
        ["estimate", file, "-e", "cf,gyro"],
        ["estimate", file, "-e", NAME],
        ["score", made],
        ["reference", file, "--set", f"{NAME}=1"],
        ["report", file],
        ["plot", file, "--kind", "angles", "-o", f"{NAME}.angles.svg"],
        ["plot", file, "--kind", "errors", "-o", f"{NAME}.errors.png"],
        ["leaderboard", file, "-e", "cf,gyro", "-o", NAME, "--paper", f"{NAME} paper"],
        ["plot", NAME, "--kind", "map", "-o", f"{NAME}.map.pdf"],
        ["plot", NAME, "--kind", "ranking", "-o", f"{NAME}.ranking.svg"],
        ["export", file, "-o", f"{NAME} tables"],
        ["cut", file, "--from", "1", "--to", "20", "-o", f"{NAME} cut"],
        ["import", "csv", table, "-o", f"{NAME} imported", *columns],
        ["import", "csv", f"{table} not there", "-o", f"{NAME} imported", *columns],
        ["recover", file, "-o", f"{NAME} recovered"],
        ["archive", "init", NAME + " archive"],
        ["archive", "add", "--archive", NAME + " archive", file, made, "--tag", NAME, "--set", f"licence={NAME}"],
        ["archive", "add", "--archive", NAME + " archive", f"{NAME} not there.mcap"],
        ["archive", "find", "all", "--archive", NAME + " archive"],
        ["archive", "find", "all", "--archive", NAME + " archive", "--paths"],
        ["archive", "find", f"tag:{NAME}", "--archive", NAME + " archive"],
        ["archive", "show", file, "--archive", NAME + " archive"],
        ["archive", "verify", "--archive", NAME + " archive"],
        ["archive", "export", "all", "--archive", NAME + " archive", "-o", bundle],
        ["archive", "import", bundle, "--archive", NAME + " archive"],
        ["archive", "bundle", file, "--archive", NAME + " archive", "-o", f"{NAME} one.mcap"],
        ["archive", "remove", made, "--archive", NAME + " archive", "--reason", NAME],
        ["archive", "show", NAME, "--archive", NAME + " archive"],
        [NAME],
    ]
    failed = []
    for words in commands:
        code = call(*words)
        shown = capsys.readouterr()
        assert _is_safe(shown.out), words
        assert _is_safe(shown.err), words
        assert "Traceback" not in shown.err, words
        failed += [" ".join(map(str, words))] if code else []
    expected = ("not there", "-e $", "--set $", "tag:$", "archive show $\\frac{$ \x1b[31m <b> --", NAME)
    assert [line for line in failed if not any(word in line for word in expected[:-1]) and line != NAME] == []
    for page in folder.rglob("*.html"):
        text = re.sub(r"<script.*?</script>", "", page.read_text(), flags=re.DOTALL)
        assert "frac" in text
        assert "31m <b>" not in text
    json_text = (folder / NAME / "leaderboard.json").read_text()
    assert NAME in json.dumps(json.loads(json_text), ensure_ascii=False).encode().decode("unicode_escape")
    assert os.listdir(bundle)
