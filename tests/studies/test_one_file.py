"""One file holds a recording with all that was made from it, for every reader of MCAP."""

import json
from collections import Counter

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation
from shelf import write_recording, write_reference

from stillpoint.datasets import Estimate, read
from stillpoint.datasets.frames import quaternion
from stillpoint.studies.one_file import make_layout, write_one_file

N = 400


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A level recording, its reference, and an estimate that leans by 2 deg about north."""
    folder = tmp_path_factory.mktemp("one")
    recording = write_recording(folder / "run.mcap", n=N)
    reference = write_reference(folder / "run.reference.mcap", recording, n=N)
    lean = quaternion(Rotation.from_euler("y", np.full((N, 1), 2.0), degrees=True))
    estimates = [Estimate(np.arange(N, dtype=np.int64) * 10_000_000, "lean", q_nb=lean, recording="run")]
    path = folder / "all.mcap"
    assert write_one_file(path, read(recording), read(reference), estimates) == {}
    return path, read(recording)


def test_the_official_reader_decodes_every_topic_in_order_of_time(written):
    path, _ = written
    counts, last = Counter(), 0
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            counts[channel.topic] += 1
            assert message.log_time >= last
            last = message.log_time
            if channel.topic == "/error/lean":
                assert (decoded.vector.x, decoded.vector.z) == (pytest.approx(2.0), pytest.approx(2.0))
                assert decoded.vector.y == pytest.approx(0.0, abs=1e-9)
            if channel.topic == "/reference/attitude":
                assert decoded.orientation_covariance[0] == 1e-4
    assert {"/imu/data_raw", "/truth/pose", "/reference/attitude", "/estimate/lean/attitude"} <= set(counts)
    assert counts["/error/lean"] == counts["/imu/data_raw"] == N


def test_rosbags_reads_it_as_a_bag_of_ros_2(written):
    path, _ = written
    with AnyReader([path]) as bag:
        stamps = [t_ns for _, t_ns, _ in bag.messages()]
        assert stamps == sorted(stamps)
        assert bag.topics["/estimate/lean/pose"].msgcount == N


def test_stillpoint_reads_it_as_the_recording(written):
    path, recording = written
    back = read(path)
    assert back.name == "run"
    assert back.imu.gyro_b_radps.tobytes() == recording.imu.gyro_b_radps.tobytes()


def test_the_layout_shows_topics_of_the_file(written):
    path, _ = written
    layout = json.loads(path.with_name("all.foxglove.json").read_text())
    with open(path, "rb") as file:
        topics = {channel.topic for channel in make_reader(file).get_summary().channels.values()}
    panels = layout["configById"]
    shown = {series["value"].split(".")[0] for panel in panels.values() for series in panel.get("paths", [])}
    assert {"/error/lean", "/imu/data_raw", "/imu/mag"} == shown
    assert shown | set(panels["3D!poses"]["topics"]) <= topics
    assert set(panels) == set(_leaves(layout["layout"]))


def _leaves(node):
    return [node] if isinstance(node, str) else _leaves(node["first"]) + _leaves(node["second"])


def test_a_layout_needs_no_errors():
    assert make_layout(["/imu/data_raw"])["layout"]["second"] == "Plot!0"
