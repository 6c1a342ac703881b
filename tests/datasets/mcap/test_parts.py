"""Parts of a recording make the whole one again, bit for bit, whatever streams and gaps it has."""

from dataclasses import replace

import numpy as np
import pytest
from anything import recordings
from hypothesis import given
from hypothesis import strategies as st
from shelf import write_recording

from stillpoint.datasets import Imu, Recording, read, write
from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.mcap.parts import join_recordings, read_parts, split_recording


def assert_written_alike(one, other, folder):
    """The same input gives the same bytes, so equal files mean equal recordings, facts and all."""
    for name, recording in (("one", one), ("other", other)):
        write(folder / name, recording)
    assert (folder / "one").read_bytes() == (folder / "other").read_bytes()


@pytest.mark.slow
@given(recordings(), st.floats(0.02, 5.0))
def test_split_and_join_give_the_whole_recording(tmp_path_factory, recording, share):
    span_s = max(recording.duration_s * share, 1e-6)
    parts = split_recording(recording, span_s) if recording.duration_s / span_s < 200 else [recording]
    if len(parts) > 1:
        assert_written_alike(join_recordings(parts[::-1]), recording, tmp_path_factory.mktemp("parts"))


def test_a_recording_without_a_name_is_joined_too(tmp_path):
    """The name of the whole is then the empty string, which must not be taken for no name in the file."""
    nameless = replace(read(write_recording(tmp_path / "run.mcap", n=1000)), name="")
    assert_written_alike(join_recordings(split_recording(nameless, 3.0)), nameless, tmp_path)


def test_parts_lie_between_multiples_of_the_length(tmp_path):
    recording = read(write_recording(tmp_path / "run.mcap", n=1000))
    parts = split_recording(recording, 3.0)
    assert [part.name for part in parts] == ["run-001", "run-002", "run-003", "run-004"]
    assert [len(part.imu.t_ns) for part in parts] == [300, 300, 300, 100]
    assert split_recording(recording, 100.0) == [recording]


def test_a_part_without_samples_is_joined_to_the_one_before():
    t_ns = np.concatenate([np.arange(100), np.arange(900, 1000)]) * 10_000_000
    imu = Imu(t_ns, np.zeros((200, 3)), np.tile([0, 0, 9.81], (200, 1)))
    parts = split_recording(Recording("gap", imu), 2.0)
    assert [len(part.imu.t_ns) for part in parts] == [100, 100]


def test_missing_foreign_and_doubled_parts_are_refused(tmp_path):
    parts = split_recording(read(write_recording(tmp_path / "run.mcap", n=1000)), 3.0)
    others = split_recording(read(write_recording(tmp_path / "other.mcap", n=1000)), 3.0)
    for given_parts, says in (
        (parts[:2] + parts[3:], "part 3 of 4 is missing"),
        (parts[:3] + others[3:], "not parts of one recording"),
        ([*parts, parts[0]], "given twice"),
        ([read(tmp_path / "run.mcap")], "not parts of one recording"),
    ):
        with pytest.raises(BadParameter, match=says):
            join_recordings(given_parts)


def test_import_writes_parts_and_join_makes_one(call, tmp_path):
    lines = ["t,gx,gy,gz,ax,ay,az", *(f"{k / 100},0,0,0,0,0,9.81" for k in range(1000))]
    (tmp_path / "log.csv").write_text("\n".join(lines))
    columns = ["--time", "t:s", "--gyro", "gx,gy,gz:rad/s", "--accel", "ax,ay,az:m/s2"]
    assert call("import", "csv", tmp_path / "log.csv", *columns, "-o", tmp_path / "whole") == 0
    assert call("import", "csv", tmp_path / "log.csv", *columns, "--split", "4s", "-o", tmp_path / "parts") == 0
    assert len(list((tmp_path / "parts").glob("*.mcap"))) == 3
    assert call("join", tmp_path / "parts", "-o", tmp_path / "back") == 0
    (whole,), (back,) = (tmp_path / "whole").glob("*.mcap"), (tmp_path / "back").glob("*.mcap")
    assert back.read_bytes() == whole.read_bytes()
    assert read_parts(sorted((tmp_path / "parts").glob("*.mcap"))).name == read(whole).name
    assert call("import", "csv", tmp_path / "log.csv", *columns, "--split", "often", "-o", tmp_path / "x") == 2
