"""``python -m stillpoint.scripts.pages.figures.demo``: draw the demo's errors into docs/figures, as PNG and SVG."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stillpoint.datasets.simulate import simulate
from stillpoint.filters import estimate
from stillpoint.scoring.report.figures import draw_errors, draw_scores, make_view
from stillpoint.scoring.report.page import Material, Verdict, judge
from stillpoint.scripts.program import run_program
from stillpoint.scripts.verbs.demo import KIND, SHOWN
from stillpoint.smoother import attitude_reference

_TARGET = Path("docs/figures/demo.png")
STYLE: dict[Any, Any] = {
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "font.size": 9,
}


def main(target: Path = _TARGET) -> None:
    """Simulate, make the reference, run the demo's estimators, and draw their errors over time beside their scores."""
    recording = simulate(KIND)
    estimates = tuple(estimate(recording, name) for name in SHOWN)
    material = Material(recording.name, recording, (attitude_reference(recording),), estimates)
    target.parent.mkdir(parents=True, exist_ok=True)
    with mpl.rc_context(STYLE):
        figure = _draw_figure(judge(material)[0])
        figure.savefig(target, dpi=110, metadata={"Software": None})
        figure.savefig(target.with_suffix(".svg"), metadata={"Date": None})


def _draw_figure(verdict: Verdict) -> Figure:
    """Return the figure: the errors of each estimate over time, and the scores beside them."""
    figure = Figure(figsize=(7.2, 5.4), layout="constrained")
    grid = figure.add_gridspec(len(verdict.comparisons), 2, width_ratios=(1.5, 1))
    first: Axes = figure.add_subplot(grid[0, 0])
    errors = [first, *(figure.add_subplot(grid[k, 0], sharex=first) for k in range(1, len(verdict.comparisons)))]
    draw_errors(errors, make_view(verdict.comparisons, verdict.truth, "nwu", int(verdict.truth.t_ns[0])))
    for ax in errors[:-1]:
        ax.tick_params(labelbottom=False)
    errors[-1].set_xlabel("time (s)")
    scores: Axes = figure.add_subplot(grid[:, 1])
    draw_scores(scores, verdict.scores)
    scores.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False, handletextpad=0.1)
    return figure


if __name__ == "__main__":
    run_program(main)
