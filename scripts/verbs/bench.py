"""``stillpoint bench``: time a part of stillpoint beside its peers."""

from importlib import import_module
from typing import Annotated, Any

from cyclopts import Parameter
from cyclopts.validators import Number

from stillpoint.datasets.errors import require_known
from stillpoint.scripts.shared.flags import Columns, parse_whole_number
from stillpoint.scripts.shared.output import STDOUT, JsonFile, print_line, write_json
from stillpoint.scripts.shared.tables import print_table

# name -> a function from the number of runs to a list of Timing
BENCHES = {
    "filters": "stillpoint.scripts.bench.filters:bench_filters",
    "mcap": "stillpoint.scripts.bench.mcap:bench_mcap",
    "roll": "stillpoint.scripts.bench.spin:bench_spin",
    "roll-filters": "stillpoint.scripts.bench.spin:bench_spin_filters",
    "scale": "stillpoint.scripts.bench.scale:bench_scale",
    "smoother": "stillpoint.scripts.bench.smoother:bench_smoother",
    "start": "stillpoint.scripts.bench.start:bench_start",
}
_COLUMNS = ("what", "against", "median, s", "beside 'against'", "per sample, ns", "min", "max", "runs")


def bench(
    name: str,
    /,
    *,
    runs: Annotated[int, Parameter(converter=parse_whole_number, validator=Number(gte=1))] = 5,
    columns: Columns = None,
    json: JsonFile = None,
) -> None:
    """Time a part of stillpoint beside its peers, run by run in turn, so that a busy machine slows all alike.

    Medians are compared: "14.8 times as long" is 14.8 times the seconds of the row named under "against", "41 times as
    fast" a 41st of them.

    Parameters
    ----------
    name
        What to time: filters (every estimator over 720 000 samples, and sample by sample), mcap (writing and reading an
        hour of a phone's sensors), roll (the graph of a spinning body over 15 000 samples), roll-filters (the
        estimators of roll over 300 000 samples), scale (reference, estimate and score of 16 recordings by local
        processes and by a Dask cluster, once each; needs the extra cluster), smoother (200 s beside offlineVQF, then an
        hour and four hours, once each), start (the help page, and the first estimate and result of each verb after an
        installation, once each).
    runs
        Runs of each row; the table gives their median, least and most.
    columns
        Columns of the table to show: names with commas between, or all. By default those that fit the terminal.
    json
        Also write the rows as JSON to this file; - is the standard output.
    """
    require_known(name, BENCHES, "bench")
    module, function = BENCHES[name].split(":")
    timings = getattr(import_module(module), function)(runs)
    rows = [timing.make_row() for timing in timings]
    if json != STDOUT:
        print_table(f"bench {name}", _COLUMNS, [[_format_cells(row) for row in rows]], wanted=columns)
        for row in rows:
            if row["note"]:
                print_line(f"{row['name']}: {row['note']}")
    write_json(json, rows)


def _format_cells(row: dict[str, Any]) -> list[str]:
    """Return a row of timings as text, in s and ns."""
    median, least, most = (f"{row[key]:.3f}" for key in ("median_s", "min_s", "max_s"))
    per_sample = "" if row["per_sample_ns"] is None else f"{row['per_sample_ns']:.0f}"
    return [row["name"], row["against"] or "", median, _format_ratio(row), per_sample, least, most, str(row["runs"])]


def _format_ratio(row: dict[str, Any]) -> str:
    """Return the ratio in words, for example ``14.8 times as long``, with three digits."""
    ratio = row["ratio"]
    if ratio is None:
        return ""
    return f"{ratio:.0f} {row['ratio_is']}" if ratio >= 100 else f"{ratio:.3g} {row['ratio_is']}"
