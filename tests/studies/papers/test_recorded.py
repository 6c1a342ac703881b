"""``stillpoint experiment … --recording``: the papers' protocols on files, here simulated ones with known truth."""

import json
from dataclasses import replace

import numpy as np
import pytest

from stillpoint.datasets import write
from stillpoint.datasets.errors import BadRecording
from stillpoint.datasets.recording import Gps
from stillpoint.datasets.simulate import simulate
from stillpoint.studies.papers.auv import study as auv
from stillpoint.studies.papers.servo import study as servo
from stillpoint.studies.papers.spin.recorded import identify_noise

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def files(call, tmp_path_factory):
    """One short recording of each paper, as ``simulate`` writes it."""
    folder = tmp_path_factory.mktemp("recorded")
    for words in (("phone-1", "--minutes", "1.5"), ("servo-bench", "--minutes", "3.5"), ("spin-constant",)):
        assert call("simulate", *words, "-o", folder) == 0
    return {path.name.split("-")[0]: path for path in folder.glob("*.mcap")}


def test_a_phone_is_judged_by_redistribution_and_graph_and_by_a_truth_that_it_has(call, files, tmp_path):
    words = ("--recording", files["phone"], "-o", tmp_path, "--json", tmp_path / "facts.json")
    assert call("experiment", "phone-1", *words) == 0
    page = (tmp_path / "phone-1.experiment.html").read_text(encoding="utf-8")
    assert "on your own recordings" in page
    assert "4.57" in page  # the printed figures stand beside
    assert "What is reproduced" not in page
    rows = json.loads((tmp_path / "facts.json").read_text())["rows"]
    assert {row["against"] for row in rows if "against" in row} == {"benchmark", "graph", "truth"}
    assert {row["recording"] for row in rows} == {"phone-1-seed0"}


def test_where_the_redistribution_refuses_the_graph_alone_judges(call, tmp_path):
    """A recording that begins in motion has no benchmark; its page is made all the same."""
    assert call("simulate", "phone-1", "--minutes", "2.5", "-o", tmp_path / "whole") == 0
    assert call("cut", tmp_path / "whole", "--from", 30, "-o", tmp_path) == 0
    (moving,) = tmp_path.glob("*.mcap")
    words = ("--recording", moving, "-o", tmp_path, "--json", tmp_path / "facts.json")
    assert call("experiment", "phone-1", *words) == 0
    rows = json.loads((tmp_path / "facts.json").read_text())["rows"]
    assert {row["against"] for row in rows if "against" in row} == {"graph", "truth"}
    assert "The error of the graph" in (tmp_path / "phone-1.experiment.html").read_text(encoding="utf-8")


def test_a_raw_magnetometer_leaves_the_yaw_arbitrary_and_the_page_says_how_to_correct_it(call, tmp_path, capsys):
    recording = simulate("phone-2", seed=0, minutes=1.5, rate_hz=50.0)
    assert recording.mag is not None
    iron_b_ut = np.array([90.0, -60.0, 40.0])
    mag = replace(recording.mag, mag_b_ut=recording.mag.mag_b_ut + iron_b_ut)
    raw = tmp_path / "raw.mcap"
    write(raw, replace(recording, mag=mag, info=replace(recording.info, mag_uncalibrated=True)))
    words = ("experiment", "phone-2", "--recording", raw, "-o", tmp_path)
    yaw_deg = {}
    for calibration in ("none", "reference"):
        assert call(*words, "--calibration", calibration, "--json", tmp_path / "facts.json") == 0
        rows = json.loads((tmp_path / "facts.json").read_text())["rows"]
        (kalman,) = [r for r in rows if r["method"] == "Kalman" and r.get("against") == "truth"]
        yaw_deg[calibration] = kalman["yaw_rmse_deg"]
        page = (tmp_path / "phone-2.experiment.html").read_text(encoding="utf-8")
        assert ("arbitrary in 1 of the recordings" in page) == (calibration == "none")
        assert ("arbitrary in 1 of 1 recordings" in capsys.readouterr().out) == (calibration == "none")
    assert yaw_deg["reference"] < 5 < yaw_deg["none"]
    assert call("experiment", "phone-1", "--calibration", "reference", "-o", tmp_path) == 2


def test_the_swings_of_a_servo_are_found_in_the_rate(files, call, tmp_path):
    recording = simulate("servo-bench", seed=0, minutes=3.5)
    made = servo.score_recording(recording)
    assert [one.judge for one in made] == ["benchmark", "graph", "truth"]
    assert made[0].series.low_hz == pytest.approx(0.1, rel=0.2)
    assert made[0].series.high_hz == pytest.approx(0.4, rel=0.2)
    known = servo.run_trial(0, 3.5).figures
    assert made[2].figures.acc_high_deg == pytest.approx(known.acc_high_deg, rel=0.1)
    assert made[2].figures.kf_high_deg == pytest.approx(known.kf_high_deg, rel=0.1)


def test_a_motor_is_judged_by_its_encoder_with_the_noise_that_it_shows(files, call, tmp_path):
    noise = identify_noise([simulate("spin-constant", seed=0)])
    assert noise["radial_var_m2ps4"] == pytest.approx(0.8, rel=0.1)
    assert noise["tangential_var_m2ps4"] == pytest.approx(0.12, rel=0.1)
    words = ("--recording", files["spin"], "-o", tmp_path, "--json", tmp_path / "facts.json")
    assert call("experiment", "spin-constant", *words) == 0
    rows = json.loads((tmp_path / "facts.json").read_text())["rows"]
    ekf = {row["noise"]: row["rate_rmse_degps"] for row in rows if row["method"] == "EKF"}
    assert set(ekf) == {"against the encoder", "against the graph", "against the truth"}
    assert ekf["against the encoder"] == pytest.approx(ekf["against the truth"], rel=0.1)


def test_a_mission_is_under_water_where_no_fix_is_valid():
    recording = simulate("auv-dolphin-calm", seed=0, minutes=6.0)
    made = auv.score_recording(recording, methods=auv.METHODS[:1])
    known = json.loads(recording.info.extra["phases_s"])
    down_s, up_s = made.series.phases_s["dive_s"], made.series.phases_s["surfaced_s"]
    assert known["dive_s"] < down_s < known["cruise_s"]
    assert known["ascent_s"] < up_s < known["surfaced_s"] + 10
    gps = recording.gps
    columns = (gps.t_ns, gps.lat_deg, gps.lon_deg, gps.alt_m, gps.course_rad, gps.speed_mps, gps.valid)
    ashore = Gps(*(column[:60] for column in columns))
    with pytest.raises(BadRecording, match="record a dive"):
        auv.score_recording(type(recording)("ashore", imu=recording.imu, mag=recording.mag, gps=ashore))


@pytest.mark.parametrize("option", [("--trials", "3"), ("--seed", "1"), ("--hand", "level"), ("--minutes", "5")])
def test_what_only_simulated_trials_have_is_refused_beside_a_recording(call, files, tmp_path, capsys, option):
    assert call("experiment", "phone-3", "--recording", files["phone"], *option, "-o", tmp_path) == 2
    assert option[0] in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_recording_of_another_kind_is_one_line(call, files, tmp_path, capsys):
    assert call("experiment", "spin-constant", "--recording", files["phone"], "-o", tmp_path) == 2
    message = capsys.readouterr().err.strip()
    assert "has no accelerometers on a spinning body" in message
