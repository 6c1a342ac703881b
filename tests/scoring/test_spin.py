"""Scores of angle and rate about a spin axis: errors planted, found again; clocks, gaps, zeros; verbs."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stillpoint.datasets import BadParameter, BadRecording, Unobservable, write
from stillpoint.datasets.mcap.store import read_recording, sha256
from stillpoint.datasets.recording import Encoder
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.trajectory import Estimate, SpinReference
from stillpoint.filters import estimate
from stillpoint.scoring.spin import choose_zero, compare_spin, score_roll, spin_score_row

T_NS = np.arange(0, 2_000_000_000, 4_000_000)
T_S = T_NS / 1e9


def truth(t_ns=T_NS) -> Encoder:
    """35 rad/s with a ripple of 0.5 rad/s at 3 Hz."""
    t = t_ns / 1e9
    w = 6 * np.pi
    return Encoder(t_ns, 35 * t - 0.5 / w * np.cos(w * t), 35 + 0.5 * np.sin(w * t))


def made(angle_error=0.0, rate_error=0.0, t_ns=T_NS, **fields) -> Estimate:
    at = truth(t_ns)
    return Estimate(
        t_ns, "planted", angle_rad=at.angle_rad + angle_error, rate_radps=at.rate_radps + rate_error, **fields
    )


@given(st.floats(-10, 10), st.floats(-0.1, 0.1), st.floats(-1, 1))
def test_planted_errors_are_found(offset, drift, rate_error):
    s = score_roll(made(offset + drift * T_S, rate_error), truth())
    assert s.angle_offset_deg == pytest.approx(np.rad2deg(offset), abs=1e-9)
    assert s.angle_max_deg == pytest.approx(np.rad2deg(abs(drift) * T_S[-1]), abs=1e-6)
    assert s.angle_end_deg == pytest.approx(np.rad2deg(drift * T_S[-1]), abs=1e-6)
    assert s.angle_rmse_deg == pytest.approx(np.rad2deg(abs(drift) * np.sqrt(np.mean(T_S**2))), abs=1e-6)
    assert s.rate_max_degps == pytest.approx(np.rad2deg(abs(rate_error)), abs=1e-9)
    assert s.rate_rmse_degps == pytest.approx(np.rad2deg(abs(rate_error)), abs=1e-9)
    assert s.rate_mean_degps == pytest.approx(np.rad2deg(rate_error), abs=1e-9)


def test_what_is_taken_off_the_angle():
    planted = made(0.3 + 0.1 * T_S)
    assert score_roll(planted, truth(), "none").angle_max_deg == pytest.approx(np.rad2deg(0.3 + 0.1 * T_S[-1]))
    assert score_roll(planted, truth(), "mean").angle_offset_deg == pytest.approx(np.rad2deg(0.3 + 0.1 * T_S.mean()))
    with pytest.raises(BadParameter, match="start, mean, turns, none"):
        score_roll(planted, truth(), "middle")


def from_gravity(angle_error, diagnostics="from gravity: 0 where the z axis points up most") -> SpinReference:
    at, sd = truth(), np.full(len(T_NS), np.deg2rad(0.4))
    return SpinReference(
        name="planted",
        method="roll-graph",
        t_ns=T_NS,
        angle_rad=at.angle_rad + angle_error,
        rate_radps=at.rate_radps,
        angle_sd_rad=sd,
        rate_sd_radps=sd,
        diagnostics={"angle": diagnostics},
    )


def test_an_angle_from_gravity_is_judged_as_what_it_says_to_be():
    """Its first sample's error is no zero: 1 deg there and nothing after is 1 deg at one sample, not at all others."""
    reference = from_gravity(np.where(T_NS == 0, np.deg2rad(1.0), 0.0) + 4 * np.pi)
    drifting = from_gravity(0.0, "from 0 at the first sample; the angle drifts")
    zero = choose_zero(reference, truth(), "truth")
    assert zero == "turns"
    found = score_roll(reference, truth(), zero)
    assert found.angle_offset_deg == pytest.approx(720)
    assert found.angle_max_deg == pytest.approx(1.0)
    assert found.angle_nees == pytest.approx(1 / 0.4**2 / len(T_NS), rel=1e-6)
    assert choose_zero(reference, truth(), "encoder") == "mean"  # whose zero is its index
    assert choose_zero(reference, reference) == "turns"
    assert choose_zero(reference, drifting) == "start"
    assert choose_zero(drifting, truth(), "truth") == "start"
    assert choose_zero(made(), truth(), "truth") == "start"


@pytest.mark.slow
def test_the_verbs_take_it_so_and_say_it(call, tmp_path, capsys):
    """NEES of the horizontal bench: 6.4 when the first sample's error was taken off, below 1.5 as it is stated."""
    recording = simulate("spin-constant", 0, sensor="horizontal")
    path = tmp_path / "trial.mcap"
    write(path, replace(recording, name="trial"))
    assert call("reference", path, "-o", tmp_path) == 0
    assert call("estimate", path, "-e", "roll-obs", "-o", tmp_path) == 0
    capsys.readouterr()
    assert call("score", tmp_path / "trial.reference.mcap", "--json", tmp_path / "s.json") == 0
    assert "absolute angles, whole turns aside" in capsys.readouterr().out
    (row,) = json.loads((tmp_path / "s.json").read_text())["rows"]
    assert row["zero"] == "turns"
    assert row["angle_nees"] < 1.5
    assert call("report", path, "-o", tmp_path) == 0
    page = (tmp_path / "trial.report.html").read_text()
    assert "reference (roll-graph): absolute angles, whole turns aside" in page
    assert "roll-obs: the angle counts from the first sample" in page


def test_the_truth_is_read_between_its_stamps_and_the_estimate_is_not():
    """A cubic through angles and rates 8 ms apart misses a 3 Hz ripple by 1e-8 rad, a line by 1.4e-3 rad/s."""
    noise = np.random.default_rng(0).normal(0, 0.1, len(T_NS) - 3)
    late = T_NS[1:-2] + 1_300_000
    c = compare_spin(made(0.0, noise, late), truth(T_NS[::2]))
    assert np.abs(c.angle_error_rad).max() < 1e-7
    assert c.rate_error_radps == pytest.approx(noise, abs=1.5e-3)  # (8 ms)^2 / 8 times 178 rad/s^3
    assert c.samples_interpolated == len(late)
    assert compare_spin(made(), truth()).samples_interpolated == 0


def test_every_sample_is_accounted_for():
    kept = np.ones(len(T_NS), dtype=bool)
    kept[100:150] = False  # a gap of the encoder
    kept[:10] = kept[-10:] = False
    ready = np.arange(len(T_NS)) >= 30
    s = score_roll(made(ready=ready), truth(T_NS[kept]))
    assert (s.samples_outside, s.samples_in_gap, s.samples_unready) == (20, 50, 20)
    assert s.samples + 90 == len(T_NS)
    assert s.angle_max_deg < 1e-9
    with pytest.raises(Unobservable, match="500 outside its span"):
        score_roll(made(), truth(T_NS + 10_000_000_000))


def test_errors_of_the_stated_size_have_a_nees_of_1():
    rng = np.random.default_rng(3)
    sd = np.full(len(T_NS), 0.02)
    planted = made(rng.normal(0, 0.02, len(T_NS)), rng.normal(0, 0.04, len(T_NS)), angle_sd_rad=sd, rate_sd_radps=sd)
    s = score_roll(planted, truth(), "mean")
    assert s.angle_nees == pytest.approx(1, abs=0.2)
    assert s.angle_coverage95 == pytest.approx(0.95, abs=0.03)
    assert s.rate_nees == pytest.approx(4, abs=0.8)
    assert s.rate_coverage95 == pytest.approx(0.673, abs=0.06)  # within 0.98 of its own sd
    assert score_roll(made(), truth()).angle_nees is None


def test_a_reference_judges_and_is_judged():
    at = truth()
    sd = np.full(len(T_NS), 0.01)
    judge = SpinReference(T_NS, at.angle_rad, at.rate_radps, sd, 2 * sd, "roll-graph", name="x")
    s = score_roll(made(0.1 * T_S), judge)
    assert s.against == "reference (roll-graph)"
    assert s.reference_angle_sd_deg == pytest.approx(np.rad2deg(0.01))
    assert s.reference_rate_sd_degps == pytest.approx(np.rad2deg(0.02))
    own = score_roll(judge, at, against="encoder")
    assert (own.estimated, own.against, own.recording) == ("reference (roll-graph)", "encoder", "x")
    assert own.angle_coverage95 == 1


def test_an_attitude_has_no_angle_to_score():
    attitude = Estimate(T_NS, "cf", q_nb=np.tile([1.0, 0, 0, 0], (len(T_NS), 1)))
    with pytest.raises(BadRecording, match="no angle and rate"):
        score_roll(attitude, truth())


def test_the_row_for_machines_has_every_figure():
    row = spin_score_row(score_roll(made(0.1), truth()))
    assert list(row)[:3] == ["recording", "method", "against"]
    assert {"angle_max_deg", "angle_rmse_deg", "rate_max_degps", "rate_rmse_degps", "error"} <= set(row)
    json.dumps(row)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A recording with truth and encoder, and an estimate of it."""
    monkeypatch.chdir(tmp_path)
    recording = replace(simulate("spin-constant", seed=0, minutes=0.05, sensor="glitch"), name="run")
    write("run.mcap", recording)
    found = replace(estimate(recording, "roll-guarded"), made_from={"run.mcap": sha256("run.mcap")})
    write("run.roll-guarded.estimate.mcap", found)
    return tmp_path


def test_the_verb_scores_against_the_truth_of_the_recording(folder, call, capsys):
    assert call("score", "run.roll-guarded.estimate.mcap", "--json", "s.json") == 0
    (row,) = json.loads((folder / "s.json").read_text())["rows"]
    assert (row["method"], row["against"], row["error"]) == ("roll-guarded", "truth", None)
    assert row["rate_rmse_degps"] < 0.5
    out = capsys.readouterr().out
    assert "roll against the truth" in out
    assert "8 not ready" in out


def test_the_verb_takes_the_encoder_where_there_is_no_truth(folder, call):
    recording = read_recording("run.mcap")
    write("bench.mcap", replace(recording, name="bench", roll_truth=None))
    write("bench.roll-obs.estimate.mcap", estimate(read_recording("bench.mcap"), "roll-obs"))
    assert call("score", "bench.roll-obs.estimate.mcap", "--json", "s.json") == 0
    (row,) = json.loads((folder / "s.json").read_text())["rows"]
    assert row["against"] == "encoder"


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--align", "heading+mounting"], "no mounting"),
        (["--against", "run.roll-guarded.estimate.mcap"], "holds no angle about a spin axis"),
    ],
)
def test_what_an_angle_does_not_have_gives_one_line_error(folder, call, capsys, words, says):
    assert call("score", "run.roll-guarded.estimate.mcap", *words) == 2
    err = capsys.readouterr().err
    assert says in err
    assert len(err.strip().splitlines()) == 1


@pytest.mark.slow
def test_estimate_runs_every_estimator_of_roll_and_only_these(folder, call):
    assert call("estimate", "run.mcap", "-e", "roll", "-o", "out") == 0
    names = sorted(path.name for path in (folder / "out").iterdir())
    assert names == [f"run.roll-{name}.estimate.mcap" for name in ("aekf", "ekf", "guarded", "obs")]
    assert call("estimate", "run.mcap", "-e", "cf") == 2
