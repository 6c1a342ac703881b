"""The report: what is on the page, that it needs no network, that a browser shows it, that thinning keeps peaks."""

import re
from dataclasses import replace

import numpy as np
import pytest
from browser import open_page
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure
from matplotlib.image import imread
from scipy.spatial.transform import Rotation

from stillpoint.datasets import BasePoseReturn, Calibration, Estimate, Imu, Recording, Reference, Truth
from stillpoint.datasets.frames import quaternion, rotation
from stillpoint.scoring.report.figures import break_line, draw_angles, draw_errors, draw_scores, make_view, thin_line
from stillpoint.scoring.report.page import Material, judge, make_report_html

pytestmark = pytest.mark.ink
BIASES = ("bias_x", "bias_y", "bias_z")


@pytest.fixture(scope="module")
def material():
    """40 s with two rests, a reference with a covariance, and two estimates, one of them with a hostile name."""
    n = 4000
    t_ns = np.arange(n) * 10_000_000
    t_s = np.clip(t_ns / 1e9, 5, 35) - 5
    angles = np.stack([2.5 * np.sin(0.5 * t_s), 0.7 * np.sin(1.1 * t_s), 0.5 * np.sin(1.7 * t_s)], axis=1)
    q_nb = quaternion(Rotation.from_euler("ZYX", angles))
    still = (t_ns < 5e9) | (t_ns > 35e9)
    rng = np.random.default_rng(0)

    def turned(sd_rad):
        return quaternion(rotation(q_nb) * Rotation.from_rotvec(rng.normal(scale=sd_rad, size=(n, 3))))

    imu = Imu(t_ns, np.zeros((n, 3)), np.tile([0.0, 0.0, 9.81], (n, 1)))
    recording = Recording("run & 7", imu=imu, truth=Truth(t_ns, q_nb, ~still))
    rests_ns = np.array([[t_ns[0], t_ns[499]], [t_ns[3501], t_ns[-1]]])
    cov = np.tile(np.eye(3) * 0.01**2, (n, 1, 1))
    params = {"rest": {"window_s": 1.0}, "axes": "body"}
    reference = Reference(
        t_ns, turned(0.01), cov, np.zeros((n, 3)), "redistribution", "run & 7", rests_ns=rests_ns, params=params
    )
    estimates = (
        Estimate(t_ns, "steady", q_nb=turned(0.05), recording="run & 7", params={"kappa": 0.7}),
        Estimate(t_ns, "<script>alert(1)</script>", q_nb=turned(0.2), recording="run & 7"),
    )
    return Material("run & 7", recording, (reference,), estimates, {"run & 7.mcap": "0123456789abcdef" * 4})


@pytest.fixture(scope="module")
def verdicts(material):
    return judge(material)


@pytest.fixture(scope="module")
def page(material, verdicts):
    return make_report_html(material, verdicts)


@pytest.mark.slow
def test_everything_is_judged_by_reference_and_truth(verdicts):
    """Estimates against the reference; the reference and the estimates against the truth."""
    by_reference, by_truth = verdicts
    names = ["steady", "<script>alert(1)</script>"]
    assert [s.estimated for s in by_reference.scores] == names
    assert [s.estimated for s in by_truth.scores] == ["reference (redistribution)", *names]
    assert by_truth.scores[0].coverage95 == pytest.approx(0.95, abs=0.02)
    assert all(s.samples == 3001 for verdict in (by_reference, by_truth) for s in verdict.scores)


@pytest.mark.slow
def test_page_shows_the_scores_that_were_found(verdicts, page):
    for verdict in verdicts:
        for s in verdict.scores:
            assert f">{s.total_rmse_deg:.2f}" in page
            assert f"{s.roll_rmse_deg:.2f} <span" in page


def test_page_says_how_it_came_about(page):
    for said in ("0123456789abcdef" * 4, "rest.window_s = 1", "kappa = 0.7", "stillpoint 0.", "aligned by heading"):
        assert said in page
    assert "Only independent truth shows accuracy" in page


@pytest.mark.slow
def test_page_says_what_the_reference_found_and_which_returns_it_used(material, verdicts):
    backs = (
        BasePoseReturn(int(8e9), int(9e9), 0.01, True, "gravity fits"),
        BasePoseReturn(int(20e9), int(21e9), 0.2, False, "gravity is 11.5 deg off"),
    )
    calibration = Calibration(gyro_matrix=np.eye(3) * 1.0123, gyro_matrix_sd=np.full((3, 3), 0.0042))
    said = {"closing_squares": [0.73], "iterations": 7, "heading": "true north"}
    (plain,) = material.references
    rich = replace(plain, returns=backs, calibration=calibration, diagnostics=said, heading_sd_rad=np.deg2rad(0.31))
    shown = replace(material, references=(rich,))
    page = make_report_html(shown, judge(shown))
    for words in ("1 of 2 to the base pose used", "gravity is 11.5 deg off", "1.0123 ± 0.0042", "0.73", "true north"):
        assert words in page
    assert "0.31 deg, an error all samples share" in page
    assert "±" not in make_report_html(material, verdicts).partition("The reference (redistribution)</h2>")[2][:2000]


@pytest.mark.slow
def test_further_references_are_judged_by_the_first(material):
    (first,) = material.references
    second = replace(first, method="graph")
    by_reference, _ = judge(replace(material, references=(first, second)))
    assert by_reference.truth is first
    assert by_reference.scores[0].estimated == "reference (graph)"


def test_page_asks_nothing_of_the_network(page):
    """No address is fetched: outside the scripts every src, href and url() stays inside the page."""
    text = re.sub(r"<script>.*?</script>", "", page, flags=re.DOTALL)
    assert not re.search(r"""(src|href)\s*=\s*["'](?!#|data:)""", text)
    assert not re.search(r"url\((?!#|data:)", text)
    assert "@import" not in text


def test_names_are_escaped(page):
    assert "<script>alert" not in page
    assert "&lt;script&gt;alert" in page
    assert "run &amp; 7" in page


@pytest.mark.slow
def test_same_material_same_bytes(material, page):
    assert make_report_html(material, judge(material)) == page


def test_recording_without_truth_has_one_verdict(material):
    blind = Material("blind", None, material.references, material.estimates)
    (verdict,) = judge(blind)
    assert isinstance(verdict.truth, Reference)


@pytest.fixture(scope="module")
def shown(page, tmp_path_factory):
    """The page in a browser."""
    file = tmp_path_factory.mktemp("page") / "page.html"
    file.write_text(page, encoding="utf-8")
    with open_page(file, tmp_path_factory.mktemp("profile")) as opened:
        opened.wait("window.stillpointPlots")
        yield opened


@pytest.mark.slow
def test_browser_finds_a_row_per_estimate_and_no_fault(shown):
    rows = "[...document.querySelectorAll('table.scores')].map((table) => table.tBodies[0].rows.length)"
    assert shown.evaluate(rows) == [2, 3]
    assert shown.complaints == []
    assert shown.requests == []


@pytest.mark.slow
def test_plots_show_every_panel_with_the_judges_angles(shown):
    """Errors, angles and errors about the axes; the roll of the judge lies on that of the material."""
    panels = shown.evaluate("window.stillpointPlots[0].figures.map((one) => one.panel.key)")
    assert panels == ["total", "heading", "inclination", "roll", "pitch", "yaw", "east", "north", "up", *BIASES]
    curve = "window.stillpointPlots[0].figures[3].judge.source.data.middle.filter(Number.isFinite)"
    assert shown.evaluate(f"Math.max(...{curve})") == pytest.approx(0.5 * 180 / np.pi, abs=2)


@pytest.mark.slow
def test_judges_can_be_changed(shown):
    """Against the truth the reference is scored too; against itself there is none."""
    choice = "document.getElementById('recording-choice')"
    drawn = "window.stillpointPlots[0].figures[0].drawn.map((one) => one.source.data.t.length > 0)"
    series = shown.evaluate("window.stillpointPlots[0].series")
    seen = {}
    for judge_name in ("reference (redistribution)", "truth"):
        shown.evaluate(f"{choice}.value = '{judge_name}'; {choice}.dispatchEvent(new Event('change'))")
        seen[judge_name] = dict(zip(series, shown.evaluate(drawn), strict=True))
    assert seen["truth"] == dict.fromkeys(series, True)
    assert not seen["reference (redistribution)"]["reference (redistribution)"]


@pytest.mark.slow
@pytest.mark.parametrize("width_px", [1280, 390])
def test_browser_paints_the_page_within_its_window(tmp_path, shown, width_px):
    """The painted page has ink of the first estimate's colour: the plots are shown, not only there."""
    shown.resize(width_px)
    shown.evaluate("document.getElementById('time-plots').scrollIntoView()")
    shown.evaluate("new Promise((done) => setTimeout(done, 500))")
    shown.photograph(tmp_path / "shot.png", whole=False)
    painted = imread(tmp_path / "shot.png")[..., :3]
    assert painted.shape[1] == width_px
    blue = np.abs(painted - np.array([0x00, 0x72, 0xB2]) / 255).max(axis=2) < 0.1
    assert blue.sum() > 100
    assert shown.evaluate("document.documentElement.scrollWidth") <= width_px


# --- pictures


@given(st.integers(1, 3000), st.integers(1, 60), st.integers(0, 2**32 - 1))
def test_thinning_keeps_every_column_s_extremes(n, columns, seed):
    """Least and greatest of each stretch, both ends, the order, and no invented point."""
    rng = np.random.default_rng(seed)
    t, value = np.cumsum(rng.uniform(0.1, 1, n)), rng.normal(size=n)
    kept_t, kept = thin_line(t, value, columns)
    rows = np.searchsorted(t, kept_t)
    assert (t[rows] == kept_t).all()
    assert (value[rows] == kept).all()
    assert (kept_t[0], kept_t[-1]) == (t[0], t[-1])
    assert len(kept) <= max(4 * columns, n if n <= 4 * columns else 0)
    if n > 1:
        column = np.minimum(((t - t[0]) / (t[-1] - t[0]) * columns).astype(int), columns - 1)
        for one in np.unique(column):
            assert value[column == one].max() in kept
            assert value[column == one].min() in kept


def test_lines_break_at_gaps_and_wraps_and_stay_broken_when_thinned():
    t = np.concatenate([np.arange(5000.0), np.arange(5100.0, 9000.0)])
    value = np.where(t < 2000, 170.0, -170.0)
    broken_t, broken = break_line(t, value, longest_step=5, largest_jump=180)
    assert np.flatnonzero(np.isnan(broken)).tolist() == [2000, 5001]
    thin_t, thin = thin_line(broken_t, broken, 50)
    assert np.isnan(thin).sum() == 2
    assert thin_t[np.isnan(thin)].tolist() == [1999.5, 5049.5]
    assert np.nanmax(thin) == 170


def test_angles_are_drawn_in_the_frame_that_is_asked_for(verdicts):
    """The truth's line is on top and shows the NWU yaw, which is 90 deg minus the ENU one."""
    verdict = verdicts[1]
    drawn = {}
    for frame in ("nwu", "enu"):
        axes = Figure().subplots(3, 1)
        draw_angles(axes, make_view(verdict.comparisons, verdict.truth, frame, 0))
        (line,) = [line for line in axes[2].lines if line.get_label() == "truth"]
        assert line.zorder == max(other.zorder for other in axes[2].lines)
        drawn[frame] = line.get_ydata()[0]
    assert drawn["nwu"] == pytest.approx(90 - drawn["enu"], abs=1e-6)


def test_errors_are_drawn_per_estimate_with_rests_and_the_floor(verdicts):
    verdict = verdicts[0]
    view = make_view(verdict.comparisons, verdict.truth, "nwu", 0)
    axes = Figure().subplots(2, 1)
    draw_errors(axes, view)
    for ax, s in zip(axes, verdict.scores, strict=True):
        assert ax.get_title(loc="left") == s.estimated
        moving = (ax.lines[0].get_xdata() > 5) & (ax.lines[0].get_xdata() < 35)
        assert ax.lines[0].get_ydata()[moving].max() == pytest.approx(s.total_max_deg)
        assert len(ax.patches) == 2
        assert len(ax.collections) == 1


def test_busiest_stretch_is_where_the_truth_turns(verdicts):
    view = make_view(verdicts[0].comparisons, verdicts[0].truth, "nwu", 0).find_busiest(4.0)
    first, last = (np.array(view.span_ns) - view.zero_ns) / 1e9
    assert last - first == pytest.approx(4.0, abs=0.011)
    assert 5 <= first <= 31


def test_scores_are_drawn_best_on_top(verdicts):
    ax = Figure().subplots()
    draw_scores(ax, verdicts[1].scores)
    names = [label.get_text() for label in ax.get_yticklabels()]
    assert names == ["<script>alert(1)</script>", "steady", "reference (redistribution)"]
