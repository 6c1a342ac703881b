"""The curves of a leaderboard's page: read from the kept results, on one clock, within the page's size."""

import base64
from dataclasses import replace

import numpy as np
import pytest
from boards import make_board

from stillpoint.datasets.files.result_store import ResultStore
from stillpoint.scoring.report.curves import reduce_series
from stillpoint.studies.leaderboard.series import RESULTS, pack_curves
from stillpoint.studies.publish.curves import PAGE_BYTES, read_entries


def keep_runs(out, board, columns=1000):
    """Keep a peak of 50 deg for every run; the k-th label of a recording begins k seconds late."""
    store, runs = ResultStore(out / RESULTS), []
    labels = [row.label for row in board.tables[0].rows]
    for place, run in enumerate(board.runs):
        if run.error is not None:
            runs.append(run)
            continue
        late_ns = labels.index(run.label) * 1_000_000_000
        t_ns = np.arange(6000) * 10_000_000 + late_ns
        error_deg = np.full(6000, 1.0)
        error_deg[(t_ns == 30_000_000_000)] = 50.0
        curve = reduce_series(t_ns, error_deg, late_ns, columns, "rms")
        rests_ns = np.array([[0, 5_000_000_000]])
        packed = pack_curves(dict.fromkeys(("total", "heading", "inclination", "total:sd"), curve))
        store.put(f"key{place}", {}, {"zero_ns": np.array(late_ns), "rests_ns": rests_ns, **packed})
        runs.append(replace(run, score_key=f"key{place}"))
    return replace(board, runs=tuple(runs))


def greatest(encoded):
    """The time and the size of the greatest value of an encoded curve."""
    whole = np.frombuffer(base64.b64decode(encoded["data"]), dtype="<u2").astype(float).reshape(3, -1)
    values = np.exp(encoded["low"] + (whole[1] - 1) * (encoded["high"] - encoded["low"]) / 65533)
    column = int(np.argmax(values))
    return encoded["start"] + (column + 0.5) * encoded["step"], values[column]


def test_every_run_keeps_its_peak_at_its_time(tmp_path) -> None:
    board = keep_runs(tmp_path, make_board())
    entries = read_entries(tmp_path, board)
    assert list(entries) == list(dict.fromkeys(run.recording for run in board.runs))
    for entry in entries.values():
        assert entry["rests"] == [[0.0, 5.0]]
        for encoded in entry["curves"]["total"].values():
            at_s, size_deg = greatest(encoded)
            assert at_s == pytest.approx(30.0, abs=encoded["step"])
            assert size_deg == pytest.approx(50.0, rel=1e-3)
        assert set(entry["curves"]["total:sd"]) == {"judge"}


@pytest.mark.slow
def test_curves_of_a_large_board_stay_within_the_page(tmp_path) -> None:
    """Two times more runs have curves half as fine; what many runs show is the error that ranks."""
    board = keep_runs(tmp_path, make_board(recordings=50, estimators=15, failures=0))
    entries = read_entries(tmp_path, board)
    size = sum(len(c["data"]) for e in entries.values() for of_key in e["curves"].values() for c in of_key.values())
    assert size < 1.1 * PAGE_BYTES
    assert "heading" not in next(iter(entries.values()))["curves"]


def test_results_that_are_gone_leave_a_page_without_plots(tmp_path) -> None:
    assert read_entries(tmp_path, make_board()) == {}
