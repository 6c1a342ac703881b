"""A recording of a spinning body is served by every verb from the simulator to the page, and refused in one line."""

import importlib.util
import json
import re

import numpy as np
import pytest

from stillpoint.datasets import read, write
from stillpoint.datasets.simulate import simulate
from stillpoint.filters.table import SPINS
from stillpoint.scoring.report.spin_figures import make_rate_series
from stillpoint.scoring.report.spin_page import SpinMaterial, judge_spin, make_spin_report_html
from stillpoint.scoring.spin import compare_spin

NAME = "spin-constant-glitch-seed0"


@pytest.fixture(scope="module")
def folder(call, tmp_path_factory):
    """Recording, reference, and the estimates that no name asked for."""
    where = tmp_path_factory.mktemp("spin")
    words = ("--sensor", "glitch", "--minutes", "0.26", "-o", where)
    assert call("simulate", "spin-constant", *words) == 0
    assert call("reference", where, "-o", where) == 0
    assert call("estimate", where, "-o", where) == 0
    return where


@pytest.fixture(scope="module")
def material(folder):
    estimates = tuple(read(folder / f"{NAME}.{name}.estimate.mcap") for name in SPINS)
    reference = read(folder / f"{NAME}.reference.mcap")
    return SpinMaterial(read(folder / f"{NAME}.mcap"), (reference,), estimates, {"a.mcap": "0123abcd" * 8})


def one_line(capsys):
    said = capsys.readouterr().err.strip()
    assert "\n" not in said
    return said


@pytest.mark.slow
def test_without_names_each_recording_gets_the_estimators_of_its_streams(call, folder, tmp_path):
    phone = tmp_path / "phone.mcap"
    write(phone, simulate("phone-1", minutes=1.4))
    assert call("estimate", phone, folder / f"{NAME}.mcap", "-o", tmp_path) == 0
    made = {path.name for path in tmp_path.glob("*.estimate.mcap")}
    assert made == {"phone.ekf.estimate.mcap", *(f"{NAME}.{name}.estimate.mcap" for name in SPINS)}


@pytest.mark.slow
def test_truth_judges_all_and_the_reference_the_estimates(material):
    by_truth, by_reference = judge_spin(material)
    assert by_truth.against == "truth"
    assert [s.estimated for s in by_truth.scores] == ["reference (roll-graph)", *SPINS]
    assert by_reference.against == "reference (roll-graph)"
    assert [s.estimated for s in by_reference.scores] == list(SPINS)
    best = min(by_truth.scores, key=lambda s: s.rate_rmse_degps)
    assert best.rate_rmse_degps < 0.3  # the glitch alone puts the observation at 10 deg/s or so


def test_an_encoder_judges_where_there_is_no_truth(material):
    recording = simulate("spin-constant", sensor="glitch", minutes=0.1)
    object.__setattr__(recording, "roll_truth", None)
    assert judge_spin(SpinMaterial(recording, (), material.estimates))[0].against == "encoder"


@pytest.mark.slow
def test_the_page_shows_the_scores_and_is_the_same_each_time(material):
    verdicts = judge_spin(material)
    page = make_spin_report_html(material, verdicts)
    for verdict in verdicts:
        for s in verdict.scores:
            assert f">{s.rate_rmse_degps:.2f}<" in page
            assert f">{s.angle_max_deg:.2f}<" in page
    for words in ("nothing fixes it after", "0123abcd" * 8, "arm (0, 0.5, 0) m", "assumed positive", "window = 5"):
        assert words in page
    assert page.count("<svg") == 2 * (1 + 5 + 1)  # rates, a band for each, accelerometers; two widths
    assert make_spin_report_html(material, verdicts) == page


def test_rates_are_drawn_at_the_stamps_that_all_share(material):
    (truth, estimates) = (material.recording.roll_truth, material.estimates)
    compared = [compare_spin(one, truth) for one in estimates]
    series = make_rate_series(truth, compared, 0)
    t_ns = np.round(series.t_s * 1e9).astype(np.int64)
    assert len(t_ns) == min(len(c.t_ns) for c in compared)
    for one in estimates:
        rates = one.rate_radps[np.searchsorted(one.t_ns, t_ns)]
        np.testing.assert_allclose(series.rate_radps[one.name], rates, atol=1e-9)


@pytest.mark.slow
@pytest.mark.ink
def test_report_writes_a_page_that_asks_nothing_of_the_network_and_leaves_attitudes_out(call, folder, tmp_path, capsys):
    assert call("report", folder / f"{NAME}.mcap", "-o", tmp_path) == 0
    page = (tmp_path / f"{NAME}.report.html").read_text(encoding="utf-8")
    assert "Scores against the truth" in page
    assert "Scores against the reference (roll-graph)" in page
    assert page.count('role="img"') == 2 * (1 + 5 + 1)
    assert not re.search(r"""(src|href)\s*=\s*["'](?!#|data:)""", page)
    assert "<script" not in page
    capsys.readouterr()
    assert call("report", folder / f"{NAME}.mcap", "-o", tmp_path, "--align", "heading+mounting") == 2
    assert "no mounting and no clock" in one_line(capsys)


def test_report_without_anything_beside_says_what_to_make(call, tmp_path, capsys):
    write(tmp_path / "alone.mcap", simulate("spin-constant", sensor="white", minutes=0.1))
    assert call("report", tmp_path / "alone.mcap") == 2
    assert "stillpoint reference" in one_line(capsys)


@pytest.mark.slow
def test_validate_scores_reference_and_estimators_by_angle_and_rate(call, folder, tmp_path, capsys):
    facts = tmp_path / "facts.json"
    file = folder / f"{NAME}.mcap"
    assert call("validate", file, "--methods", "roll-graph,roll-obs", "--json", facts) == 0
    rows = {row["method"]: row for row in json.loads(facts.read_text())["rows"]}
    assert rows["reference (roll-graph)"]["rate_rmse_degps"] < 0.3 < rows["roll-obs"]["rate_rmse_degps"]
    capsys.readouterr()
    assert call("validate", file, "--methods", "graph") == 2
    assert "no roll reference method" in one_line(capsys)


def test_a_spin_is_not_replayed_to_estimators_of_attitude(call, folder, capsys):
    """It would wait for a viewer, and then have nothing to show."""
    pytest.importorskip("foxglove")
    assert call("stream", folder / f"{NAME}.mcap", "--foxglove", "0") == 2
    assert "has no gyro and accelerometer" in one_line(capsys)


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("rerun") is None, reason="rerun-sdk is not installed")
def test_view_shows_every_sample_of_rates_angles_and_sds(call, folder, tmp_path):
    from rerun.chunk import RrdReader

    file = tmp_path / "scene.rrd"
    assert call("view", *sorted(folder.glob("*.mcap")), "--save", file) == 0
    rows = {}
    for chunk in RrdReader(file).stream():
        path = chunk.entity_path.strip("/").replace("\\", "")
        rows[path] = rows.get(path, 0) + (0 if chunk.is_static else chunk.num_rows)
    n = len(read(folder / f"{NAME}.mcap").spin.t_ns)
    for quantity, name in (
        ("accelerometers, m/s2", NAME),
        ("spin rate, deg/s", f"{NAME} truth"),
        ("spin angle within a turn, deg", f"{NAME}.reference"),
        ("sd of spin rate, deg/s", f"{NAME}.reference"),
        ("spin rate, deg/s", f"{NAME}.roll-obs.estimate"),
        ("body", f"{NAME} encoder"),
    ):
        assert rows[f"{quantity}/{name}"] == n
