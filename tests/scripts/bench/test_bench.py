"""The rows of ``stillpoint bench``; no test asserts a time."""

import json
import sys

import pytest

from stillpoint.datasets import BadParameter, read
from stillpoint.scripts.bench import mcap as bench_mcap
from stillpoint.scripts.bench.timing import Timing
from stillpoint.scripts.verbs import bench as bench_module
from stillpoint.scripts.verbs.bench import bench

CONTRACT = ["name", "median_s", "min_s", "max_s", "runs", "per_sample_ns", "against", "ratio", "ratio_is", "note"]


def test_a_ratio_says_how_many_times_faster_than_the_other_row():
    peer = Timing("peer", [4.0, 2.0, 9.0], samples=1000)
    row = Timing("ours", [0.5, 0.25, 1.0], samples=1000, against=peer).make_row()
    assert list(row) == CONTRACT
    assert (row["median_s"], row["min_s"], row["max_s"], row["runs"]) == (0.5, 0.25, 1.0, 3)
    assert (row["per_sample_ns"], row["against"], row["ratio"]) == (500_000.0, "peer", 8.0)
    assert row["ratio_is"] == "times as fast"
    assert [peer.make_row()[key] for key in ("against", "ratio", "ratio_is")] == [None] * 3


def test_a_slower_row_can_say_how_many_times_as_long_it_takes():
    hour = Timing("1 h", [2.0], samples=360_000)
    row = Timing("4 h", [8.27], samples=1_440_000, against=hour, ratio_is="times as long").make_row()
    assert row["ratio"] == pytest.approx(4.135)
    assert bench_module._format_cells(row)[3] == "4.13 times as long"
    assert bench_module._format_cells({**row, "ratio": 1234.5})[3] == "1234 times as long"


def test_what_handles_no_samples_says_no_time_per_sample():
    row = Timing("stillpoint --help", [0.2], samples=None).make_row()
    assert row["per_sample_ns"] is None
    assert bench_module._format_cells(row)[3:5] == ["", ""]


@pytest.mark.slow
def test_bench_mcap_times_both_ways_and_measures_memory(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(bench_mcap, "HOUR", 500)
    bench("mcap", runs=2, json=str(tmp_path / "b.json"))
    rows = json.loads((tmp_path / "b.json").read_text())["rows"]
    assert [row["name"].split(",")[0] for row in rows] == ["write", "write", "read", "read", "read"]
    assert all(list(row)[: len(CONTRACT)] == CONTRACT for row in rows)
    assert [row["runs"] for row in rows] == [2, 6, 2, 6, 2]
    assert rows[1]["against"] == rows[0]["name"]
    assert rows[-1]["ratio"] == rows[-1]["peak_bytes"] / rows[-1]["array_bytes"]
    assert "bench mcap" in capsys.readouterr().out


def test_the_peer_writes_and_reads_the_same_numbers(tmp_path):
    recording = bench_mcap.make_phone(50)
    peer = bench_mcap.Peer()
    peer.write(tmp_path / "peer.mcap", recording)
    found = peer.read(tmp_path / "peer.mcap")
    assert found["/imu/data_raw"][:, 1:4].tolist() == recording.imu.gyro_b_radps.tolist()
    assert found["/truth/pose"][:, 1:5].tolist() == recording.truth.q_nb.tolist()
    assert bench_mcap._count_bytes(recording) == 50 * 8 * (1 + 6 + 1 + 3 + 1 + 4 + 3) + 50


@pytest.mark.slow
def test_the_measured_process_reads_what_was_written(tmp_path):
    bench_mcap.write(tmp_path / "x.mcap", bench_mcap.make_phone(100_000))
    measured = bench_mcap._measure(tmp_path / "x.mcap")
    assert measured["bytes"] > 0.8 * bench_mcap._count_bytes(read(tmp_path / "x.mcap"))


def test_a_missing_peer_is_named_with_the_remedy(monkeypatch):
    monkeypatch.setitem(sys.modules, "mcap_ros2.decoder", None)
    with pytest.raises(BadParameter, match="pip install mcap-ros2-support"):
        bench("mcap")


def test_an_unknown_bench_is_answered_with_those_there_are():
    with pytest.raises(BadParameter, match="did you mean 'mcap'"):
        bench("mcaps")
    with pytest.raises(BadParameter, match=f"there are {', '.join(bench_module.BENCHES)}"):
        bench("xyzzy")
