"""``python -m stillpoint.scripts.pages.consistency [SEEDS]``: check covariances where the truth is known exactly.

Each simulated phone with as many seeds as asked for; docs/accuracy.md holds the table.
"""

from functools import partial
from statistics import mean

from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.trajectory import Reference
from stillpoint.scoring import score
from stillpoint.scoring.score import Score
from stillpoint.scripts.program import run_program
from stillpoint.scripts.shared.flags import LOCAL, Whole
from stillpoint.scripts.shared.jobs import run_jobs
from stillpoint.smoother import reference

_MINUTES = {"phone-1": 2.0, "phone-2": 4.0, "phone-3": 4.0}
_HEAD = "| | seeds | total, deg | worst total | in 95 % | NEES/3 | of single seeds | refused |"


def main(seeds: Whole = 30) -> None:
    """Print a Markdown table, one row per kind of phone."""
    print(f"{_HEAD}\n|{'---|' * _HEAD.count('| ')}")
    for kind in _MINUTES:
        outcomes = run_jobs(partial(_score_seed, kind), list(range(seeds)), LOCAL, kind)
        scores = [outcome.value for outcome in outcomes if outcome.value is not None]
        print(f"| {kind} | {seeds} | {' | '.join(_format_cells(scores))} | {seeds - len(scores)} |", flush=True)


def _score_seed(kind: str, seed: int) -> Score:
    """Return the score of the reference of one simulated recording against its truth."""
    recording = simulate(kind, seed=seed, minutes=_MINUTES[kind])
    assert recording.truth is not None
    made = reference(recording)
    assert isinstance(made, Reference)
    return score(made, recording.truth, "heading")


def _format_cells(scores: list[Score]) -> list[str]:
    """Return means over the seeds, and the range of NEES/3."""
    totals = [s.total_rmse_deg for s in scores]
    inside = [s.coverage95 for s in scores if s.coverage95 is not None]
    nees = sorted(s.nees_per_dof for s in scores if s.nees_per_dof is not None)
    if not nees:
        return ["–"] * 5
    spread = f"{nees[0]:.2f} … {nees[-1]:.2f}"
    return [f"{mean(totals):.2f}", f"{max(totals):.2f}", f"{mean(inside):.2f}", f"{mean(nees):.2f}", spread]


if __name__ == "__main__":
    run_program(main)
