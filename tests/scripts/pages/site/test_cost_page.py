"""The table of what estimators cost takes its rows from the benches."""

from stillpoint.scripts.pages.site.cost_page import make_table


def test_each_estimator_has_one_row_with_batch_and_stream_the_fastest_first() -> None:
    """Rows of other programs, of single precision, and second comparisons of the same run make no row."""
    names = ["vqf", "madgwick (a hundredth, times 100)", "ahrs Tilt (a hundredth, times 100)", "ekf", "ekf"]
    names += ["ekf, a call of a stream", "roll-ekf", "roll-ekf, single precision"]
    times_ns = [1000.0, 170_000.0, 1.0, 500.0, 500.0, 5000.0, 250.0, 1.0]
    rows = [
        {"name": name, "per_sample_ns": 2 * ns, "median_s": 0.2, "min_s": 0.1}
        for name, ns in zip(names, times_ns, strict=True)
    ]
    assert make_table(rows).splitlines() == [
        "| estimator | batch, µs | stream, µs |",
        "|---|---|---|",
        "| `roll-ekf` | 0.25 | – |",
        "| `ekf` | 0.50 | 5.00 |",
        "| `vqf` (peer) | 1.00 | – |",
        "| `madgwick` (peer) | 170.00 | – |",
    ]
