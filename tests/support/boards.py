"""A made-up leaderboard with curves, for tests of what is made of leaderboards."""

import math
from typing import Any

import numpy as np

from stillpoint.scoring.report.curves import encode_curve, reduce_series
from stillpoint.studies.leaderboard import Leaderboard, Pair, Row, Run, Source, Summary, Table

HOSTILE = "<script>alert(1)</script>"


def make_board(recordings: int = 6, estimators: int = 4, failures: int = 2) -> Leaderboard:
    """Estimator k has about (k + 1) deg; the last of them fails on the first recordings."""
    rng = np.random.default_rng(1)
    labels = [f"estimator-{k}" for k in range(estimators - 1)] + [HOSTILE]
    names = [f"run & {k:02d}" for k in range(recordings)]
    runs = []
    for k, label in enumerate(labels):
        for place, name in enumerate(names):
            if label == HOSTILE and place < failures:
                runs.append(Run(name, label, "none", label, "truth", error="ValueError: no <b>field</b>"))
                continue
            total = (k + 1) * float(np.exp(0.3 * rng.normal()))
            runs.append(
                Run(
                    name,
                    label,
                    "none",
                    label,
                    "truth",
                    total_rmse_deg=total,
                    heading_rmse_deg=0.9 * total,
                    inclination_rmse_deg=0.4 * total,
                    total_p95_deg=2 * total,
                    total_max_deg=3 * total,
                    samples=1000,
                    ns_per_sample=100.0 * 3**k,
                    nees_per_dof=1.1 if k == 0 else None,
                    coverage95=0.94 if k == 0 else None,
                    aligned_heading_deg=1.5,
                    parameters={"tau_s": 2.0},
                )
            )
    rows = tuple(_row(k, label, [run for run in runs if run.label == label]) for k, label in enumerate(labels))
    pairs = tuple(
        Pair(a.label, b.label, "truth", 0.5, (0.4, 0.6), "a") for k, a in enumerate(rows) for b in rows[k + 1 :]
    )
    table = Table("", "truth", "total", "", rows, pairs, True, recordings, tuple(names), "estimator-0 is best.")
    group = Table("slow", "truth", "total", "", rows[:2], (), False, 2, tuple(names[:2]), "On these recordings only.")
    sources = tuple(
        Source(n, f"{n}.mcap", "ab" * 32, "made up", "MIT", "nobody", "phone", "walk", ("slow",), "calibrated", True)
        for n in names
    )
    return Leaderboard("truth", "heading", (table,), (group,), tuple(runs), sources, "0.1.0", {"align": "heading"})


def make_entries(board: Leaderboard, columns: int = 400, samples: int = 6000) -> dict[str, Any]:
    """Curves of every run: the sine of an error of the right size, with one peak of 77 deg that must stay visible."""
    rng = np.random.default_rng(2)
    t_ns = np.arange(samples) * 10_000_000
    entries: dict[str, Any] = {}
    for run in board.runs:
        if run.total_rmse_deg is None:
            continue
        error_deg = run.total_rmse_deg * np.abs(1 + 0.5 * np.sin(t_ns / 3e9) + 0.2 * rng.normal(size=samples))
        error_deg[samples // 2] = 77.0
        curve = encode_curve(reduce_series(t_ns, error_deg, 0, columns, "rms"), "log")
        entry = entries.setdefault(
            run.recording,
            {"span": [0.0, (samples - 1) / 100], "rests": [[0.0, 5.0]], "curves": {"total": {}}},
        )
        entry["curves"]["total"][run.label] = curve
    return entries


def _row(k: int, label: str, runs: list[Run]) -> Row:
    sizes = [run.total_rmse_deg for run in runs if run.total_rmse_deg is not None]
    failed = len(runs) - len(sizes)
    typical = math.exp(sum(map(math.log, sizes)) / len(sizes))

    def summary(factor: float) -> Summary:
        ordered = sorted(factor * size for size in sizes)
        low, high = 0.8 * factor * typical, 1.25 * factor * typical
        middle = ordered[len(ordered) // 2]
        return Summary(factor * typical, (low, high), factor * sum(sizes) / len(sizes), middle, ordered[-1])

    return Row(
        label=label,
        estimator=label,
        calibration="none",
        against="truth",
        parameters="defaults",
        rank=None if failed else (k + 1, k + 1),
        recordings=len(runs),
        failed=failed,
        total_rmse_deg=summary(1.0),
        heading_rmse_deg=summary(0.9),
        inclination_rmse_deg=summary(0.4),
        ns_per_sample=100.0 * 3**k,
        nees_per_dof=1.1 if k == 0 else None,
        coverage95=0.94 if k == 0 else None,
    )
