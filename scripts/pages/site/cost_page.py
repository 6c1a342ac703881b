"""``python -m stillpoint.scripts.pages.site.cost_page FILTERS.json ROLL-FILTERS.json``: write the costs of estimators.

The files are those of ``stillpoint bench filters --json`` and ``stillpoint bench roll-filters --json``.
"""

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from stillpoint.datasets.errors import BadParameter
from stillpoint.filters import ESTIMATORS
from stillpoint.scripts.program import run_program

_PAGE = Path("docs/estimators.md")
_BETWEEN_MARKS = re.compile(r"(<!-- cost -->\n).*?(<!-- end -->)", re.DOTALL)
# "ekf", "madgwick (a hundredth, times 100)" or "ekf, a call of a stream"; of single precision there is no column.
_NAME_OF_ROW = re.compile(r"([\w-]+)(?: \(a hundredth, times 100\))?(, a call of a stream)?")


def main(*benches: Path, page: Path = _PAGE) -> None:
    """Rewrite the table of the page from the rows of the benches. Raises :class:`BadParameter` without a file."""
    if not benches:
        raise BadParameter("cost_page: name JSON files of stillpoint bench")
    rows = [row for bench in benches for row in json.loads(bench.read_text(encoding="utf-8"))["rows"]]
    table = make_table(rows)
    text = page.read_text(encoding="utf-8")
    page.write_text(_BETWEEN_MARKS.sub(lambda match: f"{match[1]}{table}{match[2]}", text), encoding="utf-8")


def make_table(rows: Sequence[dict[str, Any]]) -> str:
    """Return a line for each estimator that the benches timed, the fastest first.

    Each figure is the least of the runs, in µs a sample: other work on the machine only adds time.
    """
    batch: dict[str, float] = {}
    stream: dict[str, float] = {}
    for row in rows:
        found = _NAME_OF_ROW.fullmatch(row["name"])
        if found is not None and found[1] in ESTIMATORS:
            least_us = row["per_sample_ns"] / 1e3 * row["min_s"] / row["median_s"]
            (stream if found[2] else batch)[found[1]] = least_us
    lines = ["| estimator | batch, µs | stream, µs |", "|---|---|---|"]
    for name in sorted(batch, key=lambda name: batch[name]):
        shown = f"`{name}`" + (" (peer)" if ESTIMATORS[name].is_peer else "")
        lines.append(f"| {shown} | {batch[name]:.2f} | {f'{stream[name]:.2f}' if name in stream else '–'} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    run_program(main)
