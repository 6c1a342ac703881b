"""A part of a file, read through its index, is that part of the whole, and little else is fetched."""

import numpy as np
import pytest
from shelf import write_recording

from stillpoint.datasets.errors import BadFile
from stillpoint.datasets.mcap.indexed import LocalFile, Window, read_part
from stillpoint.datasets.mcap.reader import read_log


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return write_recording(tmp_path_factory.mktemp("indexed") / "run.mcap", 3, n=30_000)


class Counting(LocalFile):
    fetched = 0

    def fetch(self, start, end):
        self.fetched += end - start
        return super().fetch(start, end)


def assert_same_topic(part, whole, rows=slice(None)):
    assert (part.t_ns == whole.t_ns[rows]).all()
    for leaf in whole.parts[0].columns:
        assert part.column(leaf).tobytes() == whole.column(leaf)[rows].tobytes()


def test_one_topic_is_that_of_the_whole_file_for_its_share_of_the_bytes(path):
    whole = read_log(path)
    source = Counting(path)
    part = read_part(path, ["/imu/mag"], source=source)
    assert_same_topic(part.topics["/imu/mag"], whole.topics["/imu/mag"])
    assert set(part.topics) == {"/imu/mag"}
    assert part.metadata == whole.metadata
    assert source.fetched < 0.35 * source.size


def test_a_range_of_time_is_that_of_the_whole_file(path):
    whole = read_log(path)
    source = Counting(path)
    t_ns = whole.topics["/imu/data_raw"].t_ns
    part = read_part(path, window=Window(int(t_ns[5000]), int(t_ns[6000])), source=source)
    for name, topic in part.topics.items():
        stamps = whole.topics[name].t_ns
        rows = np.flatnonzero((stamps >= t_ns[5000]) & (stamps <= t_ns[6000]))
        assert_same_topic(topic, whole.topics[name], rows)
    assert source.fetched < 0.4 * source.size


def test_a_window_without_messages_is_empty(path):
    assert read_part(path, ["/imu/mag"], Window(10**15, 10**15 + 1)).topics == {}


@pytest.mark.parametrize("place", [0.5, 0.97, -5])
def test_damage_where_it_reads_gives_one_line_error(path, tmp_path, place):
    data = bytearray(path.read_bytes())
    data[place if place < 0 else int(len(data) * place)] ^= 1
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(data)
    with pytest.raises(BadFile, match="is damaged") as caught:
        read_part(broken)
    assert "\n" not in str(caught.value)


def test_a_cut_file_has_no_index(path, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[:-1000])
    with pytest.raises(BadFile, match="it has no end"):
        read_part(cut)
