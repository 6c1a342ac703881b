"""``python -m stillpoint.scripts.pages.accuracy_page FOLDER``: write BROAD's trials by every estimator into docs.

Total error (RMSE over the moving samples, deg) with the magnetometer, after one heading offset per trial is taken off:
what ``stillpoint estimate`` and ``stillpoint score --align heading`` give.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

from stillpoint.datasets.importers.table import IMPORTERS
from stillpoint.datasets.recording import Recording
from stillpoint.filters import ESTIMATORS, estimate
from stillpoint.filters.table import ATTITUDES
from stillpoint.scoring import score
from stillpoint.scripts.program import run_program

_PAGE = Path("docs/estimator-accuracy.md")
_BETWEEN_MARKS = re.compile(r"(<!-- accuracy -->\n).*?(<!-- end -->)", re.DOTALL)


def main(folder: Path, page: Path = _PAGE) -> None:
    """Rewrite the table of this page from BROAD's trials in ``folder``."""
    trials = [trial for path in sorted(folder.glob("*.mat")) for trial in IMPORTERS["broad"](path)]
    console = Console(stderr=True)
    totals = {name: _score_trials(trials, name) for name in track(ATTITUDES, "BROAD", console=console)}
    page.write_text(replace_table(page.read_text(encoding="utf-8"), trials, totals), encoding="utf-8")


def _score_trials(trials: Sequence[Recording], name: str) -> list[float]:
    """Return the error of one estimator on each trial, with its default parameters."""
    found = []
    for trial in trials:
        assert trial.truth is not None
        found.append(score(estimate(trial, name), trial.truth, align="heading").total_rmse_deg)
    return found


def replace_table(text: str, trials: Sequence[Recording], totals: Mapping[str, Sequence[float]]) -> str:
    """Return the text with a new table between its marks, the best mean first."""
    numbers = [trial.name.split("_")[0] for trial in trials]
    lines = ["| estimator | mean | median | " + " | ".join(numbers) + " |", "|---" * (len(numbers) + 3) + "|"]
    for name in sorted(totals, key=lambda name: float(np.mean(totals[name]))):
        entry, degs = ESTIMATORS[name], totals[name]
        shown = f"`{name}`" + (" (peer, sees the future)" if entry.offline else " (peer)" if entry.is_peer else "")
        cells = [f"{np.mean(degs):.2f}", f"{np.median(degs):.2f}", *(f"{deg:.1f}" for deg in degs)]
        lines.append(f"| {shown} | " + " | ".join(cells) + " |")
    table = "\n".join(lines) + "\n"
    return _BETWEEN_MARKS.sub(lambda match: f"{match[1]}{table}{match[2]}", text)


if __name__ == "__main__":
    run_program(main)
