"""The summary of a file from its index: the same facts as from all samples, from a few chunks only."""

import json

import numpy as np
import pytest

from stillpoint.datasets import BadFile, Imu, Mag, Recording, read, write
from stillpoint.datasets.mcap.summary import CHUNKS_PER_TOPIC, summarise
from stillpoint.datasets.recording import rate_hz
from stillpoint.datasets.simulate import simulate
from stillpoint.filters import estimate
from stillpoint.scripts.verbs import info as info_verb


@pytest.fixture(scope="module")
def long_file(tmp_path_factory):
    """Half an hour at 200 Hz: 60 chunks and more."""
    n = 360_000
    t_ns = np.arange(n, dtype=np.int64) * 5_000_000 + 7
    rng = np.random.default_rng(0)
    imu = Imu(t_ns, rng.normal(0, 1e-3, (n, 3)), rng.normal((0, 0, 9.81), 0.02, (n, 3)))
    mag = Mag(t_ns[::4], rng.normal((0, 20, -42), 0.3, (n // 4, 3)))
    path = tmp_path_factory.mktemp("long") / "long.mcap"
    write(path, Recording("long", imu, mag))
    return path


@pytest.mark.slow
def test_streams_have_the_counts_spans_and_rates_of_all_samples(long_file):
    recording, summary = read(long_file), summarise(long_file)
    found = {one.name: one for one in summary.streams}
    assert set(found) == {name for name, _ in recording.streams()}
    for name, t_ns in recording.streams():
        assert (found[name].samples, found[name].first_ns, found[name].last_ns) == (len(t_ns), t_ns[0], t_ns[-1])
        assert 1e9 / found[name].step_ns == pytest.approx(rate_hz(t_ns))


def test_few_chunks_are_read(long_file):
    summary = summarise(long_file)
    assert summary.chunks > 4 * CHUNKS_PER_TOPIC
    assert summary.chunks_read <= 3 * CHUNKS_PER_TOPIC


def test_estimate_is_named_with_its_kind(tmp_path):
    path = tmp_path / "phone.gyro.estimate.mcap"
    write(path, estimate(simulate("phone-1", minutes=2), "gyro"))
    summary = summarise(path)
    assert summary.kind == "estimate"
    assert [one.samples for one in summary.streams] == [len(read(path).t_ns)]


def test_damaged_chunk_that_is_read_is_reported(long_file, tmp_path):
    data = bytearray(long_file.read_bytes())
    data[40_000] ^= 1  # in the first chunk, behind the schemas
    path = tmp_path / "damaged.mcap"
    path.write_bytes(data)
    with pytest.raises(BadFile, match="damaged"):
        summarise(path)


def test_cut_file_is_refused(long_file, tmp_path):
    path = tmp_path / "cut.mcap"
    path.write_bytes(long_file.read_bytes()[:-100])
    with pytest.raises(BadFile, match="no end"):
        summarise(path)


@pytest.mark.slow
def test_info_of_a_large_file_says_what_it_did_not_look_for(long_file, call, capsys, monkeypatch):
    monkeypatch.setattr(info_verb, "LARGE_BYTES", 1 << 20)
    assert call("info", long_file, "--json", "-") == 0
    summarised = json.loads(capsys.readouterr().out)["rows"][0]
    assert call("info", long_file, "--full", "--json", "-") == 0
    full = json.loads(capsys.readouterr().out)["rows"][0]
    assert summarised["rests"] is None
    assert "--full" in summarised["summarised"]
    assert full["rests"]
    same = ("file", "kind", "name", "duration_s", "sha256", "source")
    assert {key: summarised[key] for key in same} == {key: full[key] for key in same}
