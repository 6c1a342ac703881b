"""The picture of fidelity: RMSE by each judge over RMSE by optical truth."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stillpoint.datasets.names import make_drawable
from stillpoint.studies.fidelity import Fidelity, JudgeFidelity

_WIDTH_IN = 3.2  # of one panel
_MARKERS = "osD^v<>Ph*Xp8"


def draw_fidelity(fidelity: Fidelity) -> Figure:
    """Return a figure with one panel per judge, logarithmic, a marker per estimator and recording."""
    judged = [judge for judge in fidelity.judges if judge.recordings]
    figure = Figure(figsize=(_WIDTH_IN * max(len(judged), 1), _WIDTH_IN + 0.9), layout="constrained")
    estimators = list(dict.fromkeys(row.estimator for row in fidelity.rows))
    axes = np.atleast_1d(figure.subplots(1, max(len(judged), 1), sharex=True, sharey=True))
    for ax, judge in zip(axes, judged, strict=False):
        _draw_judge(ax, fidelity, judge, estimators)
    axes[0].set_ylabel("RMSE by the judge (deg)")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=7, frameon=False, fontsize=7, handletextpad=0.1)
    return figure


def _draw_judge(ax: Axes, fidelity: Fidelity, judge: JudgeFidelity, estimators: list[str]) -> None:
    """Draw the RMSE by a judge over that by the truth, one point per recording and estimator."""
    for number, estimator in enumerate(estimators):
        rows = [r for r in fidelity.rows if (r.judge, r.estimator) == (judge.judge, estimator) and r.error is None]
        truth = np.array([r.truth_rmse_deg for r in rows], dtype=np.float64)
        judged = np.array([r.judge_rmse_deg for r in rows], dtype=np.float64)
        marker, color = _MARKERS[number % len(_MARKERS)], f"C{number % 10}"
        ax.scatter(
            truth, judged, s=12, alpha=0.7, linewidths=0, label=make_drawable(estimator), marker=marker, color=color
        )
    known = [r.truth_rmse_deg for r in fidelity.rows if r.truth_rmse_deg]
    ends = [min(known) * 0.7, max(known) * 1.4] if known else [0.1, 10.0]
    ax.plot(ends, ends, color="0.5", linewidth=0.8)
    ax.set(xscale="log", yscale="log", xlabel="RMSE by optical truth (deg)")
    tau = "-" if judge.tau_pooled is None else f"{judge.tau_pooled:.3f}"
    wrong = f"tau {tau}, {judge.wrong_verdicts} of {judge.verdicts} verdicts wrong"
    ax.set_title(f"{make_drawable(judge.judge)}\n{wrong}", fontsize=9)
    ax.grid(alpha=0.3)
