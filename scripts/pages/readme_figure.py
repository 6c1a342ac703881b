"""``python -m stillpoint.scripts.pages.readme_figure``: draw docs/figures/demo.png from the demo."""

import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stillpoint.datasets.simulate import simulate
from stillpoint.filters import estimate
from stillpoint.scoring.report.figures import draw_angles, draw_scores, make_view
from stillpoint.scoring.report.page import Material, Verdict, judge
from stillpoint.scripts.verbs.demo import KIND, SHOWN
from stillpoint.smoother import attitude_reference

TARGET = Path("docs/figures/demo.png")
CLOSE_UP_S = 12.0
STYLE: dict[Any, Any] = {
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "font.size": 9,
}


def main(target: Path = TARGET) -> None:
    """Simulate, make the reference, run the demo's estimators, and draw angles in close-up beside their scores."""
    recording = simulate(KIND)
    estimates = tuple(estimate(recording, name) for name in SHOWN)
    material = Material(recording.name, recording, (attitude_reference(recording),), estimates)
    target.parent.mkdir(parents=True, exist_ok=True)
    with mpl.rc_context(STYLE):
        _draw_figure(judge(material)[0]).savefig(target, dpi=110, metadata={"Software": None})


def _draw_figure(verdict: Verdict) -> Figure:
    figure = Figure(figsize=(10, 4.6), layout="constrained")
    grid = figure.add_gridspec(3, 2, width_ratios=(1.7, 1))
    first: Axes = figure.add_subplot(grid[0, 0])
    angles = [first, *(figure.add_subplot(grid[row, 0], sharex=first) for row in (1, 2))]
    draw_angles(
        angles,
        make_view(verdict.comparisons, verdict.truth, "nwu", int(verdict.truth.t_ns[0])).find_busiest(CLOSE_UP_S),
    )
    for ax in angles[:2]:
        ax.tick_params(labelbottom=False)
    angles[-1].set_xlabel("time (s)")
    scores: Axes = figure.add_subplot(grid[:, 1])
    draw_scores(scores, verdict.scores)
    scores.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False, handletextpad=0.1)
    legend = figure.legend(*first.get_legend_handles_labels(), loc="outside lower left", ncols=7, frameon=False)
    for line in legend.get_lines():
        line.set_linewidth(3)
    return figure


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
