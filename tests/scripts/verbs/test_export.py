"""Text out and in: what other programs read of our files, and trajectories of other programs that we score."""

import csv
import json
import re
from dataclasses import replace
from math import radians

import numpy as np
import pytest
from anything import estimates, quaternions, recordings, references, stamps
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stillpoint.datasets import BadSource, Truth, read, write
from stillpoint.datasets.exporters.tables import format_csv, make_tables
from stillpoint.datasets.frames import rotation, to_xyzw
from stillpoint.datasets.importers.trajectories import format_tum, read_poses
from stillpoint.datasets.simulate import simulate
from stillpoint.filters import Stream, estimate
from stillpoint.scripts.streaming.lines import Lines

POSE = "0.5 1 2 3 0 0 0.6 0.8\n"


@st.composite
def trajectories(draw):
    t = draw(stamps())
    return t, draw(quaternions(len(t)))


@pytest.mark.slow
@given(trajectories())
def test_a_tum_trajectory_is_read_back_with_its_stamps_and_attitudes(tmp_path_factory, poses):
    t_ns, q_nb = poses
    path = tmp_path_factory.mktemp("tum") / "a.tum"
    path.write_text(format_tum(t_ns, q_nb))
    found = read_poses(path)
    np.testing.assert_array_equal(found.t_ns, t_ns)
    np.testing.assert_allclose(found.q_nb, q_nb, atol=1e-15)
    assert found.moving.all()


def test_a_pose_is_the_body_in_the_world_with_w_last(tmp_path):
    """z, w = 0.6, 0.8 is a turn about up by 2 atan2(0.6, 0.8) = 73.7 deg; with w first it would be 106.3 deg."""
    path = tmp_path / "a.tum"
    path.write_text("# comment\n\n" + POSE)
    found = read_poses(path)
    turned = Rotation.from_euler("z", 2 * np.arctan2(0.6, 0.8)).apply([1.0, 0.0, 0.0])
    np.testing.assert_allclose(rotation(found.q_nb[0]).apply([1.0, 0.0, 0.0]), turned, atol=1e-12)
    assert found.t_ns.tolist() == [500_000_000]
    assert found.position_n_m.tolist() == [[1.0, 2.0, 3.0]]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is empty"),
        ("1 2 3\n", "first line has 3 words; a TUM pose is eight"),
        (POSE + "1.0 1 2 3 0 0 x 1\n", "line 2, column '7': 'x' is not a number"),
        (POSE + "soon 1 2 3 0 0 0 1\n", "line 2: 'soon' is not a time"),
        (POSE + "1.0 1 2 3 0 0 0 0.5\n", "line 2: the quaternion has the length 0.5"),
        (POSE + "1.0 1 2 3 nan 0 0 1\n", "line 2: the quaternion has the length nan"),
        (POSE + POSE, "does not rise"),
    ],
)
def test_what_is_no_trajectory_is_named_with_its_line(tmp_path, text, says):
    path = tmp_path / "a.tum"
    path.write_text(text)
    with pytest.raises(BadSource, match=says):
        read_poses(path)


@pytest.mark.slow
@settings(max_examples=20)
@given(recordings() | references() | estimates())
def test_every_number_of_a_table_is_read_back_as_the_same(thing):
    for table in make_tables(thing).values():
        lines = list(csv.reader(format_csv(table).splitlines()))
        assert lines[0] == list(table)
        for column, cells in zip(table.values(), zip(*lines[1:], strict=True), strict=True):
            read_back = [int(c) for c in cells] if column.dtype.kind in "iub" else [float(c) for c in cells]
            np.testing.assert_array_equal(np.array(read_back), column)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A recording with its truth, and an estimate of it."""
    folder = tmp_path_factory.mktemp("export")
    recording = simulate("phone-1", minutes=1.0)
    write(folder / "run.mcap", recording)
    write(folder / "run.gyro.estimate.mcap", estimate(recording, "gyro"))
    return folder


@pytest.mark.slow
def test_the_verb_writes_a_file_per_clock(call, folder, tmp_path, capsys):
    assert call("export", folder, "-o", tmp_path) == 0
    written = {path.name for path in tmp_path.iterdir()}
    assert written == {"run.imu.csv", "run.mag.csv", "run.truth.csv", "run.gyro.estimate.csv"}
    assert {line.rpartition("/")[2] for line in capsys.readouterr().out.splitlines()} == written


@pytest.mark.slow
def test_an_exported_log_comes_back_by_import(call, folder, tmp_path):
    assert call("export", folder / "run.mcap", "-o", tmp_path) == 0
    flags = ("--time", "t_ns:ns", "--gyro", "gx,gy,gz:rad/s", "--accel", "ax,ay,az:m/s^2")
    assert call("import", "csv", tmp_path / "run.imu.csv", *flags, "-o", tmp_path) == 0
    (path,) = tmp_path.glob("*.mcap")
    ours, again = read(folder / "run.mcap").imu, read(path).imu
    np.testing.assert_array_equal(again.gyro_b_radps, ours.gyro_b_radps)
    np.testing.assert_array_equal(again.t_ns - again.t_ns[0], ours.t_ns - ours.t_ns[0])


@pytest.mark.slow
def test_a_trajectory_of_another_program_scores_as_the_same_estimate_does(call, folder, tmp_path, capsys):
    assert call("export", folder / "run.gyro.estimate.mcap", "--format", "tum", "-o", tmp_path) == 0
    capsys.readouterr()
    rows = []
    for file in (tmp_path / "run.gyro.estimate.tum", folder / "run.gyro.estimate.mcap"):
        assert call("score", file, "--against", folder / "run.mcap", "--json", "-") == 0
        rows += json.loads(capsys.readouterr().out)["rows"]
    assert rows[0]["total_rmse_deg"] == pytest.approx(rows[1]["total_rmse_deg"], rel=1e-9)


def test_a_tum_trajectory_can_be_the_judge(call, folder, tmp_path, capsys):
    """Against itself, turned by 30 deg about up: the alignment finds the 30 deg and nothing is left."""
    truth = read(folder / "run.mcap").truth
    turned = Rotation.from_euler("z", 30, degrees=True) * rotation(truth.q_nb)
    for name, xyzw in (("a.tum", to_xyzw(truth.q_nb)), ("b.txt", turned.as_quat())):
        rows = np.column_stack([truth.t_ns / 1e9, np.zeros((len(xyzw), 3)), xyzw])
        np.savetxt(tmp_path / name, rows, fmt="%.9f")
    assert call("score", tmp_path / "b.txt", "--against", tmp_path / "a.tum", "--json", "-") == 0
    (row,) = json.loads(capsys.readouterr().out)["rows"]
    assert row["total_rmse_deg"] < 1e-5
    assert row["found"]["heading_deg"] == pytest.approx(30.0, abs=1e-5)


def test_a_judge_has_to_be_named_for_it(call, folder, tmp_path, capsys):
    (tmp_path / "a.tum").write_text(POSE)
    assert call("score", tmp_path / "a.tum") == 2
    assert "name its judge: --against" in capsys.readouterr().err
    assert call("score", tmp_path / "a.tum", "--against", tmp_path / "nope.mcap") == 2
    assert "there is no such file" in capsys.readouterr().err


def test_what_has_no_poses_is_said(call, tmp_path, capsys):
    bare = simulate("phone-1", minutes=1.0)
    write(tmp_path / "bare.mcap", type(bare)("bare", imu=bare.imu))
    assert call("export", tmp_path / "bare.mcap", "--format", "tum", "-o", tmp_path / "out") == 2
    assert "has no truth" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "heading"), [("phone-1", "mag"), ("auv-dolphin", "mag"), ("auv-dolphin", "gps-course")]
)
def test_what_is_exported_for_stream_makes_the_estimate_again(call, tmp_path, capsys, name, heading):
    """To the last bit, up to the declination: there is not for every double in rad one in deg."""
    file = tmp_path / "run.mcap"
    write(file, simulate(name, minutes=1.0 if name == "phone-1" else 6.0))
    assert call("export", file, "--format", "stream", "-o", tmp_path) == 0
    said = capsys.readouterr().err
    assert "fields are left out as by estimate" in said
    declination_rad = radians(float(re.search(r"--declination (\S+)", said)[1]))
    lines = (tmp_path / "run.stream.csv").read_bytes().splitlines(keepends=True)
    known = estimate(read(file), "ekf", heading=heading)
    assert declination_rad == pytest.approx(known.diagnostics["declination_rad"], abs=1e-15)
    reader, stream = Lines(), Stream("ekf", declination_rad=known.diagnostics["declination_rad"], heading=heading)
    samples = [sample for sample in map(reader.read, lines) if sample is not None]
    assert (np.array([stream.update(*sample).q_nb for sample in samples]) == known.q_nb).all()
    assert [sample.t_ns for sample in samples] == known.t_ns.tolist()
    assert {what: n for what, n in known.diagnostics.items() if what in stream.counts} == stream.counts


def test_what_stream_would_not_use_is_said(call, tmp_path, capsys):
    made = simulate("phone-1", minutes=0.6)
    write(tmp_path / "raw.mcap", replace(made, info=replace(made.info, mag_uncalibrated=True)))
    assert call("export", tmp_path / "raw.mcap", "--format", "stream", "-o", tmp_path) == 0
    assert "the heading is arbitrary: the magnetometer is not calibrated" in capsys.readouterr().err
    assert (tmp_path / "raw.stream.csv").read_text().startswith("t_ns,gx,gy,gz,ax,ay,az\n")


def test_a_spin_is_exported_for_stream_and_an_estimate_is_not(call, folder, tmp_path, capsys):
    write(tmp_path / "spin.mcap", simulate("spin-constant", minutes=0.05))
    assert call("export", tmp_path / "spin.mcap", "--format", "stream", "-o", tmp_path) == 0
    assert (tmp_path / "spin.stream.csv").read_text().startswith("t_ns,a1,a2\n")
    assert call("export", folder / "run.gyro.estimate.mcap", "--format", "stream", "-o", tmp_path) == 2
    assert "holds no samples" in capsys.readouterr().err


def test_an_unknown_position_is_written_as_the_origin():
    """The format has no word for it."""
    truth = Truth(np.array([0]), np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([True]), np.full((1, 3), np.nan))
    line = format_tum(truth.t_ns, truth.q_nb, truth.position_n_m).splitlines()[1]
    assert line == "0.000000000 0.0 0.0 0.0 0.0 0.0 0.0 1.0"
