"""``python -m stillpoint.scripts.pages.calibration_page BOARD``: write what a calibrated input gives each estimator.

BOARD is the folder of a leaderboard over raw phones with both inputs: ``stillpoint leaderboard PHONES -e all
--calibration none,reference -o BOARD``. Errors are RMSE against optical truth with the heading aligned.
"""

import json
import re
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from stillpoint.datasets.errors import BadParameter
from stillpoint.filters import ESTIMATORS
from stillpoint.scripts.program import run_program
from stillpoint.studies.leaderboard import Leaderboard
from stillpoint.studies.leaderboard.board import Run
from stillpoint.studies.leaderboard.study import NONE, REFERENCE

_PAGE = Path("docs/estimator-accuracy.md")
_BETWEEN_MARKS = re.compile(r"(<!-- calibrated phones -->\n).*?(<!-- end -->)", re.DOTALL)
_HEADINGS = (
    "estimator",
    "heading, raw: median",
    "calibrated: median",
    "calibrated / raw: median",
    "worst",
    "inclination, raw: median",
    "calibrated: median",
    "total, calibrated: median",
    "mean",
    "worst",
)


def main(board: Path, page: Path = _PAGE) -> None:
    """Rewrite the table of the page from a leaderboard."""
    content = json.loads((board / "leaderboard.json").read_text(encoding="utf-8"))
    table = make_table(Leaderboard.from_json(content).runs)
    text = page.read_text(encoding="utf-8")
    page.write_text(_BETWEEN_MARKS.sub(lambda match: f"{match[1]}{table}{match[2]}", text), encoding="utf-8")


def make_table(runs: Sequence[Run]) -> str:
    """Return a row for each estimator of the table that has both inputs, least total error first.

    Raises :class:`BadParameter` when no estimator has both.
    """
    found: dict[str, dict[str, dict[str, Run]]] = defaultdict(lambda: defaultdict(dict))
    for run in runs:
        if run.error is None and run.estimator in ESTIMATORS:
            found[run.estimator][run.calibration][run.recording] = run
    both = {name: (kinds[NONE], kinds[REFERENCE]) for name, kinds in found.items() if {NONE, REFERENCE} <= set(kinds)}
    if not both:
        raise BadParameter("no estimator has both inputs; make the leaderboard with --calibration none,reference")
    rows = [_make_row(name, raw, calibrated) for name, (raw, calibrated) in both.items()]
    rows.sort(key=lambda row: float(row[-2]))
    lines = [_HEADINGS, ["---"] * len(_HEADINGS), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def _make_row(name: str, raw: dict[str, Run], calibrated: dict[str, Run]) -> list[str]:
    """Return the row of an estimator: medians over the phones, before and after calibration."""
    phones = sorted(set(raw) & set(calibrated))

    def list_errors(runs: dict[str, Run], figure: str) -> list[float]:
        return [getattr(runs[phone], f"{figure}_rmse_deg") for phone in phones]

    before, after = list_errors(raw, "heading"), list_errors(calibrated, "heading")
    ratios = [late / early for early, late in zip(before, after, strict=True)]
    total = list_errors(calibrated, "total")
    return [
        f"`{name}`" + (" (peer)" if ESTIMATORS[name].is_peer else ""),
        f"{np.median(before):.1f}",
        f"{np.median(after):.1f}",
        f"{np.median(ratios):.2f}",
        f"{max(ratios):.2f}",
        f"{np.median(list_errors(raw, 'inclination')):.2f}",
        f"{np.median(list_errors(calibrated, 'inclination')):.2f}",
        f"{np.median(total):.2f}",
        f"{np.mean(total):.2f}",
        f"{max(total):.2f}",
    ]


if __name__ == "__main__":
    run_program(main)
