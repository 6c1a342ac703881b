"""A score as a small table: text for ``print``, HTML for notebooks, a pandas frame."""

from html import escape
from typing import TYPE_CHECKING

from stillpoint.datasets.errors import BadParameter

if TYPE_CHECKING:
    import pandas as pd

    from stillpoint.scoring.score import Score

_PARTS = ("total", "heading", "inclination", "roll", "pitch", "yaw")
_FIGURES = {"rmse": "rmse_deg", "mean": "mean_deg", "50 %": "p50_deg", "95 %": "p95_deg", "max": "max_deg"}


def format_score(score: "Score") -> str:
    """Return the table of a score in deg, with a title and a line about samples and alignment."""
    lines = [f"{'':12}{''.join(f'{title:>9}' for title in _FIGURES)}"]
    lines += [f"{part:12}{''.join(f'{value:9.3f}' for value in _list_figures(score, part))}" for part in _PARTS]
    return "\n".join([_make_title(score), *lines, _make_footer(score)])


def format_score_html(score: "Score") -> str:
    """Return the table of a score as HTML."""
    head = "".join(f"<th>{title}</th>" for title in _FIGURES)
    rows = "".join(
        f"<tr><th>{part}</th>{''.join(f'<td>{value:.3f}</td>' for value in _list_figures(score, part))}</tr>"
        for part in _PARTS
    )
    return (
        f"<table><caption>{escape(_make_title(score))}</caption><thead><tr><th></th>{head}</tr></thead>"
        f"<tbody>{rows}</tbody></table><p>{escape(_make_footer(score))}</p>"
    )


def make_score_frame(score: "Score") -> "pd.DataFrame":
    """Return the table of a score as a pandas frame: a row per part, a column per figure in deg.

    Raises :class:`BadParameter` when pandas is not installed.
    """
    try:
        import pandas as pd
    except ImportError:
        raise BadParameter("to_frame: pandas is not installed; install it: pip install pandas") from None
    rows = [_list_figures(score, part) for part in _PARTS]
    return pd.DataFrame(rows, index=pd.Index(_PARTS, name="part"), columns=list(_FIGURES.values()))


def _list_figures(score: "Score", part: str) -> list[float]:
    return [getattr(getattr(score, part), figure) for figure in _FIGURES.values()]


def _make_title(score: "Score") -> str:
    return f"{score.estimated} on {score.recording or 'a recording'} against the {score.against}: error in deg"


def _make_footer(score: "Score") -> str:
    """Return samples, alignment and consistency of a score in one line."""
    parts = [f"{score.samples} samples, aligned by {score.alignment.kind}", f"Euler angles {score.frame.upper()}"]
    if score.reference_sd_deg is not None:
        parts.append(f"the reference's own sd is {score.reference_sd_deg:.2f} deg")
    if score.nees_per_dof is not None and score.coverage95 is not None:
        parts.append(f"NEES/3 {score.nees_per_dof:.2f}, {100 * score.coverage95:.0f} % within the stated 95 %")
    return "; ".join(parts)
