"""A leaderboard over simulated recordings: rows, failures, reuse, own estimators, files and judges."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stillpoint.datasets import BadParameter, Estimate, read, write
from stillpoint.datasets.importers.trajectories import format_tum
from stillpoint.datasets.simulate import simulate
from stillpoint.studies import leaderboard
from stillpoint.studies.job_runner import run_here
from stillpoint.studies.leaderboard import Leaderboard, Study, entrants, format_study, read_study, run_study

OWN = '''
import numpy as np
from stillpoint.datasets import Estimate

class Still:
    """Always level, with heading east."""
    def update(self, t_s, gyro_b_radps, accel_b_mps2, mag_b_ut):
        return [1.0, 0.0, 0.0, 0.0]

class Broken:
    def update(self, t_s, gyro_b_radps, accel_b_mps2, mag_b_ut):
        return 1 / (t_s - t_s)

def truth(recording):
    return Estimate(recording.truth.t_ns, "any name", q_nb=recording.truth.q_nb)

def short(recording):
    return np.ones((3, 4))

def settling(recording):
    t_ns, q_nb = recording.truth.t_ns, recording.truth.q_nb
    return Estimate(t_ns, "settling", q_nb=q_nb, ready=t_ns - t_ns[0] > 60e9)
'''


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Four recordings with truth, one of them with a TUM file beside it, and estimators of one's own."""
    place = tmp_path_factory.mktemp("recordings")
    for seed in range(4):
        made = simulate("phone-3", seed=seed, minutes=1.5, rate_hz=50)
        extra = {**made.info.extra, "tags": "even" if seed % 2 == 0 else "odd"}
        write(place / f"run{seed}.mcap", replace(made, name=f"run{seed}", info=replace(made.info, extra=extra)))
        if seed == 0:
            (place / "run0.slam.tum").write_text(format_tum(made.truth.t_ns, made.truth.q_nb))
    (place / "own.py").write_text(OWN)
    return place


@pytest.fixture(scope="module")
def files(folder):
    return sorted(folder.glob("run?.mcap"))


@pytest.fixture(scope="module")
def board(folder, files, tmp_path_factory):
    names = ["gyro", f"{folder}/own.py:Still", f"{folder}/own.py:truth", f"{folder}/own.py:Broken"]
    return leaderboard(files, names, tmp_path_factory.mktemp("out"), align="none")


def row_of(board, name):
    return next(row for row in board.tables[0].rows if row.estimator == name)


@pytest.mark.slow
def test_perfect_estimator_is_first_and_error_free(board):
    assert row_of(board, "truth").rank == (1, 1)
    assert row_of(board, "truth").total_rmse_deg.worst < 1e-3, "single precision is kept: 7e-6 deg"


def test_exception_in_own_code_is_the_error_of_its_row(board):
    row = row_of(board, "Broken")
    assert row.rank is None
    assert row.failed == row.recordings == 4
    errors = {run.error for run in board.failures if run.estimator == "Broken"}
    assert len(errors) == 1
    assert "ZeroDivisionError" in errors.pop()


def test_file_beside_one_recording_is_found_and_listed_unranked(board):
    row = row_of(board, "slam")
    assert (row.rank, row.failed) == (None, 3)
    assert row.total_rmse_deg.mean < 1e-4
    assert "slam failed on 3 of 4" in board.tables[0].conclusion


def test_estimate_of_another_recording_is_refused(files, tmp_path):
    made = simulate("phone-3", seed=9, minutes=1.5, rate_hz=50)
    write(tmp_path / "run.mcap", made)
    other = Estimate(made.truth.t_ns, "mine", q_nb=made.truth.q_nb, made_from={"other.mcap": "00"})
    write(tmp_path / "run.mine.estimate.mcap", other)
    board = leaderboard([tmp_path / "run.mcap"], ["mine"], tmp_path / "out")
    assert "was made from another recording" in board.failures[0].error


def test_every_run_is_listed(board):
    assert len(board.runs) == 4 * 5
    assert {run.samples for run in board.runs if run.recording == "run1" and run.error is None} != {None}


def test_all_estimators_of_a_recording_are_scored_on_the_same_samples(board):
    for name in ("run0", "run1"):
        assert len({run.samples for run in board.runs if run.recording == name and run.error is None}) == 1


@pytest.mark.slow
def test_an_estimator_that_settles_for_a_minute_takes_10_s_from_the_others(folder, files):
    alone = leaderboard(files[:1], [f"{folder}/own.py:truth"])
    both = leaderboard(files[:1], [f"{folder}/own.py:truth", f"{folder}/own.py:settling"])
    assert not both.failures, "it is scored as all others are"
    truth = read(files[0]).truth
    started = truth.t_ns - truth.t_ns[0] <= 10e9
    lost = alone.runs[0].samples - both.runs[0].samples
    assert lost == pytest.approx(int((truth.moving & started).sum()), abs=2), "10 s of samples at most"


def test_every_row_says_what_its_parameters_were_chosen_on(board, files):
    assert row_of(board, "gyro").parameters == "defaults"
    assert row_of(board, "slam").parameters == "unknown", "a file does not tell"
    assert row_of(board, "Still").parameters == "its own"
    ours = leaderboard(files[:1], ["ekf", "vqf"]).tables[0]
    said = "Parameters: slam: unknown; ekf: defaults, chosen on 12 trials of BROAD; all others: defaults."
    assert ours.origins == said


@pytest.mark.slow
def test_an_estimator_without_a_heading_is_not_ranked_by_the_total_error(files):
    pytest.importorskip("riann")
    table = leaderboard(files[:1], ["gyro", "riann"]).tables[0]
    assert {row.label for row in table.rows if row.rank is None} == {"riann"}
    assert "Not ranked by the total error: riann, whose heading has no meaning." in table.conclusion


def test_tags_get_tables_of_their_own(board):
    assert [(table.name, table.recordings) for table in board.groups] == [
        ("even", ("run0", "run2")),
        ("odd", ("run1", "run3")),
    ]


def test_pairs_exclude_what_is_not_ranked(board):
    assert {name for pair in board.tables[0].pairs for name in (pair.a, pair.b)} == {"gyro", "Still", "truth"}


@pytest.mark.slow
def test_second_run_computes_nothing(folder, files, tmp_path):
    asked = []

    def counted(function, items, what):
        asked.append((what, len(items)))
        return run_here(function, items, what)

    study = Study(tuple(map(str, files[:2])), ("gyro", f"{folder}/own.py:truth"))
    first = run_study(study, tmp_path, counted)
    assert dict(asked)["estimates"] == 2 * 2 + 1, "and the file beside run0"
    asked.clear()
    assert run_study(study, tmp_path, counted).to_json() == first.to_json()
    assert asked == []


@pytest.mark.slow
def test_only_what_changed_is_computed(folder, files, tmp_path):
    asked = []

    def counted(function, items, what):
        asked.append((what, len(items)))
        return run_here(function, items, what)

    study = Study(tuple(map(str, files[1:3])), (f"{folder}/own.py:truth",))
    run_study(study, tmp_path, counted)
    asked.clear()
    run_study(replace(study, estimators=(*study.estimators, f"{folder}/own.py:Still")), tmp_path, counted)
    assert dict(asked)["estimates"] == 2, "the new estimator"
    asked.clear()
    run_study(replace(study, align="none"), tmp_path, counted)
    assert dict(asked)["scores"] == 2


def test_unreadable_recording_keeps_its_rows(folder, files, tmp_path):
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"not an MCAP file")
    board = leaderboard([files[1], files[2], broken], [f"{folder}/own.py:truth"], tmp_path / "out")
    assert next(run.error for run in board.runs if run.recording == "broken").startswith(str(broken))
    assert "Every estimator failed on broken" in board.tables[0].conclusion
    assert row_of(board, "truth").recordings == 2


@pytest.mark.slow
def test_python_objects_are_estimators(files):
    def level(recording):
        t_ns = recording.imu.t_ns
        return Estimate(t_ns, "anything", q_nb=np.tile([1.0, 0, 0, 0], (len(t_ns), 1)))

    board = leaderboard(files[1:3], [level])
    assert row_of(board, "level").failed == 0


def test_instance_is_refused_because_its_state_would_be_kept(files):
    class Keeps:
        def update(self, t_s, gyro_b_radps, accel_b_mps2, mag_b_ut):
            return [1.0, 0, 0, 0]

    with pytest.raises(BadParameter, match="give the class"):
        leaderboard(files[1:2], [Keeps()])


@pytest.mark.slow
def test_example_of_the_page_runs_and_holds_tilt(files, tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "leaderboard.md").read_text(encoding="utf-8")
    example = next(block for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "class Mine" in block)
    (tmp_path / "mine.py").write_text(example)
    row = row_of(leaderboard(files[1:2], [f"{tmp_path}/mine.py:Mine"], tmp_path / "out"), "Mine")
    assert row.failed == 0
    assert row.inclination_rmse_deg.worst < 5, "a hand that swings: several degrees for a filter of 2 s"


def test_entry_point_of_a_package_is_found_by_its_name(folder, files, monkeypatch):
    from importlib.metadata import EntryPoint

    found = EntryPoint("mine", f"{folder}/own.py:truth", "stillpoint.estimators")
    monkeypatch.setattr(entrants, "entry_points", lambda group, name: [found])
    assert row_of(leaderboard(files[1:2], ["mine"]), "mine").failed == 0


def test_wrong_shape_of_own_result_is_said(folder, files):
    board = leaderboard(files[1:2], [f"{folder}/own.py:short"])
    assert "returned shape (3, 4)" in board.failures[0].error


def test_uncalibrated_magnetometer_ranks_by_inclination(files, tmp_path):
    made = simulate("phone-3", seed=7, minutes=1.5, rate_hz=50)
    write(tmp_path / "raw.mcap", replace(made, info=replace(made.info, mag_uncalibrated=True)))
    board = leaderboard([tmp_path / "raw.mcap"], ["gyro"], tmp_path / "out")
    table = board.tables[0]
    assert table.ranked_by == "inclination"
    assert "left out for 1 of 1 rows on 1 of 1 recordings" in table.conclusion


@pytest.mark.slow
def test_rows_without_a_magnetometer_are_ranked_apart_by_inclination(files, tmp_path):
    """With calibrated input the heading says something, so these rows keep the total error."""
    made = simulate("phone-3", seed=7, minutes=1.5, rate_hz=50)
    write(tmp_path / "raw.mcap", replace(made, info=replace(made.info, mag_uncalibrated=True)))
    board = leaderboard(
        [files[1], tmp_path / "raw.mcap"], ["cf", "gyro"], tmp_path / "out", calibration=("none", "reference")
    )
    calibrated, raw = board.tables
    assert (calibrated.ranked_by, calibrated.inputs) == ("total", "calibrated by the reference")
    assert {row.label for row in calibrated.rows} == {"cf (calibrated)", "gyro (calibrated)"}
    assert "left out" not in calibrated.conclusion
    assert (raw.ranked_by, raw.inputs) == ("inclination", "as recorded")
    assert "left out for 2 of 2 rows on 1 of 2 recordings" in raw.conclusion
    assert board.common_error == "inclination", "what all four rows may be compared by"
    assert Leaderboard.from_json(json.loads(json.dumps(board.to_json()))).tables == board.tables


def test_a_leaderboard_takes_recordings_in_memory(tmp_path):
    made = simulate("phone-3", seed=3, minutes=1.5, rate_hz=50)
    board = leaderboard([made], [lambda recording: Estimate(made.truth.t_ns, "", q_nb=made.truth.q_nb)])
    assert board.runs[0].total_rmse_deg < 1e-3


def test_unknown_estimator_names_the_nearest(files):
    with pytest.raises(BadParameter, match=r"no estimator 'gyr', and no file NAME\.gyr\.tum"):
        leaderboard(files[:1], ["gyr"])


def test_unknown_parameter_is_refused(files):
    with pytest.raises(BadParameter, match="no setting 'omega'"):
        leaderboard(files[:1], ["cf"], params={"cf": {"omega": 1.0}})


def test_study_survives_its_file(tmp_path):
    study = Study(
        recordings=(str(tmp_path / 'a "b".mcap'),),
        estimators=("ekf", "cf"),
        params={"cf": {"omega0_radps": 0.3, "magnetometer": True}},
        against="both",
        calibration=("none", "reference"),
        groups=("slow",),
        sha256={"a": "00"},
    )
    (tmp_path / "study.toml").write_text(format_study(study, "1.0"))
    assert read_study(tmp_path / "study.toml") == study


def test_study_with_a_wrong_name_says_the_nearest(tmp_path):
    (tmp_path / "study.toml").write_text('recordings = ["a.mcap"]\nestimater = ["ekf"]\n')
    with pytest.raises(BadParameter, match="estimators"):
        read_study(tmp_path / "study.toml")


def test_changed_recording_does_not_pass_for_the_one_of_the_study(folder, files, tmp_path):
    study = Study((str(files[0]),), (f"{folder}/own.py:truth",), sha256={"run0": "00"})
    with pytest.raises(BadParameter, match="has changed since the study"):
        run_study(study, tmp_path)


@pytest.mark.slow
def test_verb_writes_leaderboard_and_study_that_repeats_it(call, capsys, folder, files, tmp_path):
    out, again = tmp_path / "out", tmp_path / "again"
    given = f"{folder}/own.py:truth"
    assert call("leaderboard", files[1], "-e", given, "-o", out, "--json", tmp_path / "f.json") == 0
    printed = capsys.readouterr().out
    assert "truth has the least error" in printed
    first = json.loads((out / "leaderboard.json").read_text())
    assert json.loads((tmp_path / "f.json").read_text()) == first
    assert call("leaderboard", "-c", out / "study.toml", "-o", again) == 0
    second = json.loads((again / "leaderboard.json").read_text())
    for board in (first, second):
        for row in board["rows"]:
            row.pop("ns_per_sample")
    assert second["rows"] == first["rows"]


@pytest.mark.slow
def test_verb_ends_with_2_when_nothing_is_scored(call, folder, files, tmp_path):
    assert call("leaderboard", files[1], "-e", f"{folder}/own.py:Broken", "-o", tmp_path / "out") == 2


def test_a_wrong_estimator_ends_the_verb_before_it_makes_a_folder(call, files, tmp_path, capsys):
    assert call("leaderboard", files[1], "-e", "ekff", "-o", tmp_path / "out") == 2
    assert "did you mean 'ekf'?" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
