"""The rows of ``stillpoint bench filters`` and ``bench start``; no test asserts a time."""

import sys

import pytest

from stillpoint.datasets import BadParameter
from stillpoint.datasets.simulate import simulate
from stillpoint.filters import ESTIMATORS
from stillpoint.filters.table import Estimator
from stillpoint.scripts.bench import filters as bench_filters
from stillpoint.scripts.bench import start as bench_start
from stillpoint.scripts.verbs.bench import bench

OURS = [name for name, entry in ESTIMATORS.items() if isinstance(entry, Estimator)]


def test_every_estimator_of_ours_has_its_kind_in_ahrs():
    assert sorted(bench_filters.KINDS) == sorted(OURS)


@pytest.mark.slow
def test_the_rows_set_an_estimator_beside_vqf_and_its_kind(monkeypatch):
    """Two estimators stand for all: the rows of the others are made by the same loop."""
    kept = {name: entry for name, entry in ESTIMATORS.items() if name in ("cf", "gyro") or entry.is_peer}
    monkeypatch.setattr(bench_filters, "ESTIMATORS", kept)
    monkeypatch.setattr(bench_filters, "MINUTES", 1.4)
    monkeypatch.setattr(bench_filters, "STREAMED", 100)
    rows = [row.make_row() for row in bench_filters.bench_filters(1)]
    peers = [name for name, entry in ESTIMATORS.items() if entry.is_peer]
    named = [row["name"].split(" (")[0] for row in rows]
    assert named[: len(peers)] == peers
    against = {(row["name"], row["against"].split(" (")[0]) for row in rows if row["against"]}
    assert {("cf", "vqf"), ("gyro", "vqf")} <= against
    assert ("cf", "mahony") in against
    assert ("cf", "ahrs Complementary") in against
    assert [row["name"] for row in rows[-2:]] == [f"{name}, a call of a stream" for name in ("gyro", "cf")]
    assert all(row["median_s"] > 0 for row in rows)


def test_a_part_of_a_recording_has_the_fields_until_its_end():
    whole = simulate("phone-3", minutes=2.0)
    part = bench_filters.take_first(whole, 1000)
    assert len(part.imu.t_ns) == 1000
    assert part.mag.t_ns[-1] <= part.imu.t_ns[-1] < whole.mag.t_ns[len(part.mag.t_ns)]


def test_the_measured_estimate_is_made_and_its_time_is_said(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["-c", "gyro"])
    exec(bench_start._FIRST, {})
    assert float(capsys.readouterr().out) > 0


# In place of an estimate, which takes 5 s to compile: one compiled function, and whether it came from the cache.
FIRST = """
import sys
from stillpoint.filters.spin import front
assert sys.argv[1] == "gyro"
front.start()
print(1.0 + sum(front.start.stats.cache_hits.values()))
"""


@pytest.mark.slow
def test_the_start_is_measured_in_processes_of_its_own(monkeypatch, tmp_path):
    monkeypatch.setattr(bench_start, "KERNELS", tmp_path)  # there may be some
    monkeypatch.setattr(bench_start, "ESTIMATORS", {"gyro": ESTIMATORS["gyro"], "vqf": ESTIMATORS["vqf"]})
    monkeypatch.setattr(bench_start, "_FIRST", FIRST)
    made = "simulate phone-1 --minutes 0.6 -o ."
    monkeypatch.setattr(bench_start, "VERBS", (made,))
    rows = bench_start.bench_start(1)
    assert [row.name for row in rows] == [
        "stillpoint --help",
        "first estimate with gyro, nothing compiled",
        "the next process with gyro",
        f"stillpoint {made}, nothing compiled, CPU",
        f"stillpoint {made}, the next process, CPU",
    ]
    assert [len(row.seconds) for row in rows] == [1] * 5
    assert [row.median_s for row in rows[1:3]] == [1.0, 2.0], "the second process finds what the first compiled"
    assert all(row.median_s > 0 for row in rows)


def test_a_missing_package_is_named_with_the_remedy(monkeypatch):
    monkeypatch.setitem(sys.modules, "ahrs", None)
    with pytest.raises(BadParameter, match=r"ahrs is not installed; pip install .stillpoint\[peers\]"):
        bench("filters")
