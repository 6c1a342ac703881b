"""The ranking of a leaderboard as a table for papers and spreadsheets: LaTeX, CSV, Markdown, HTML, pandas.

Names of estimators and files may hold any character. In every text those that are not printable are escaped, and then
those that the format itself would read.
"""

import csv
import io
from html import escape
from typing import TYPE_CHECKING, Any

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.names import make_printable
from stillpoint.studies.leaderboard import Leaderboard, Row, Summary, Table

if TYPE_CHECKING:
    import pandas as pd

_ERRORS = ("total", "heading", "inclination")
_STATISTICS = ("typical", "mean", "median", "worst")
_SHORT = {"total": "total", "heading": "heading", "inclination": "incl."}
_LATEX = {
    "\\": r"\textbackslash{}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "–": "--",
}
_MARKDOWN = str.maketrans({letter: f"\\{letter}" for letter in "\\`*_[]<>|~$&"})


def format_latex(board: Leaderboard) -> str:
    """Return the tables of the leaderboard in LaTeX, ruled by the package booktabs; errors in degrees."""
    return "\n".join(_format_latex_table(table) for table in board.tables)


def format_csv(board: Leaderboard) -> str:
    """Return one line per row of each table, every figure in full, errors in degrees."""
    rows = list_rows(board)
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]) if rows else ["estimator"], lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: _make_plain(value) for name, value in row.items()} for row in rows)
    return text.getvalue()


def format_markdown(board: Leaderboard) -> str:
    """Return the tables of the leaderboard in Markdown, each with its conclusion."""
    parts = []
    for table in board.tables:
        headings = _list_headings(table)
        rows = [[cell.translate(_MARKDOWN) for cell in cells] for cells in _list_cells(table)]
        aligned = ["---" if k == 1 else "---:" for k in range(len(headings))]
        lines = [headings, aligned, *rows]
        text = "\n".join(f"| {' | '.join(line)} |" for line in lines)
        parts.append(f"{text}\n\n{f'{_make_caption(table)} {_conclude(table)}'.translate(_MARKDOWN)}\n")
    return "\n".join(parts)


def format_html(board: Leaderboard) -> str:
    """Return the tables of the leaderboard as HTML, for notebooks."""
    parts = []
    for table in board.tables:
        head = "".join(f"<th>{escape(title)}</th>" for title in _list_headings(table))
        body = "".join(
            f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in cells)}</tr>" for cells in _list_cells(table)
        )
        parts.append(
            f"<table><caption>{escape(_make_caption(table))}</caption><thead><tr>{head}</tr></thead>"
            f"<tbody>{body}</tbody></table><p>{escape(_conclude(table))}</p>"
        )
    return "".join(parts)


def format_text(board: Leaderboard) -> str:
    """Return the tables of the leaderboard as aligned text."""
    parts = []
    for table in board.tables:
        lines = [_list_headings(table), *_list_cells(table)]
        widths = [max(len(line[k]) for line in lines) for k in range(len(lines[0]))]
        padded = ["  ".join(_pad(line[k], width, k) for k, width in enumerate(widths)).rstrip() for line in lines]
        parts.append("\n".join([_make_caption(table), *padded, _conclude(table)]))
    return "\n\n".join(parts)


def list_rows(board: Leaderboard) -> list[dict[str, Any]]:
    """Return flat figures of every row of every table; None where there is no figure."""
    rows = []
    for table in board.tables:
        for row in table.rows:
            flat: dict[str, Any] = {
                "estimator": row.estimator,
                "label": row.label,
                "calibration": row.calibration,
                "against": row.against,
                "parameters": row.parameters,
                "ranked_by": table.ranked_by,
                "rank_best": None if row.rank is None else row.rank[0],
                "rank_worst": None if row.rank is None else row.rank[1],
                "recordings": row.recordings,
                "failed": row.failed,
            }
            for error in _ERRORS:
                flat |= _flatten_summary(error, getattr(row, f"{error}_rmse_deg"))
            flat |= {name: getattr(row, name) for name in ("ns_per_sample", "nees_per_dof", "coverage95")}
            rows.append(flat)
    return rows


def make_frame(board: Leaderboard) -> "pd.DataFrame":
    """Return :func:`list_rows` as a pandas frame; raises :class:`BadParameter` when pandas is not installed."""
    try:
        import pandas as pd
    except ImportError:
        raise BadParameter("to_frame: pandas is not installed; install it: pip install pandas") from None
    return pd.DataFrame(list_rows(board))


def _flatten_summary(error: str, summary: Summary | None) -> dict[str, Any]:
    """Return the figures of an error under the names of columns; None for each without a summary."""
    low, high = (None, None) if summary is None else summary.ci95
    statistics = {f"{error}_rmse_{name}_deg": getattr(summary, name, None) for name in _STATISTICS}
    return {**statistics, f"{error}_rmse_low95_deg": low, f"{error}_rmse_high95_deg": high}


def _list_headings(table: Table) -> list[str]:
    """Return the titles of the columns: the error that ranks first, with its interval."""
    others = [_SHORT[error] for error in _ERRORS if error != table.ranked_by]
    lead = _SHORT[table.ranked_by]
    return ["rank", "estimator", lead, "95 % interval", *others, f"worst {lead}", "ns/sample", "failed"]


def _list_cells(table: Table) -> list[list[str]]:
    return [_format_cells(row, table) for row in table.rows]


def _format_cells(row: Row, table: Table) -> list[str]:
    """Return the cells of a row as text; angles in deg."""
    lead: Summary | None = getattr(row, f"{table.ranked_by}_rmse_deg")
    others = [getattr(row, f"{error}_rmse_deg") for error in _ERRORS if error != table.ranked_by]
    return [
        "–" if row.rank is None else "–".join(dict.fromkeys(map(str, row.rank))),
        make_printable(row.label),
        _format_typical(lead),
        "–" if lead is None or lead.ci95[0] == lead.ci95[1] else f"{lead.ci95[0]:.2f}–{lead.ci95[1]:.2f}",
        *map(_format_typical, others),
        "–" if lead is None else f"{lead.worst:.2f}",
        "–" if row.ns_per_sample is None else f"{row.ns_per_sample:.0f}",
        f"{row.failed}/{row.recordings}",
    ]


def _format_typical(summary: Summary | None) -> str:
    return "–" if summary is None else f"{summary.typical:.2f}"


def _make_plain(value: Any) -> Any:
    """Return a figure as it is, and a text in which every letter is printable."""
    return make_printable(value) if isinstance(value, str) else value


def _conclude(table: Table) -> str:
    """Return the sentences below a table: what it decides, and where the parameters come from."""
    return make_printable(f"{table.conclusion} {table.origins}")


def _make_caption(table: Table) -> str:
    """Return judge, recordings, input and order of a table in one sentence."""
    return make_printable(
        f"RMSE in degrees against {table.against} over {len(table.recordings)} recordings, input {table.inputs}, "
        f"ranked by the {table.ranked_by} error; geometric means with 95 % intervals."
    )


def _format_latex_table(table: Table) -> str:
    """Return a table in LaTeX, with its caption."""
    lines = [
        r"\begin{table}",
        r"\centering",
        rf"\caption{{{_escape_latex(_make_caption(table))} {_escape_latex(_conclude(table))}}}",
        r"\begin{tabular}{rlrrrrrrr}",
        r"\toprule",
        f"{' & '.join(map(_escape_latex, _list_headings(table)))} \\\\",
        r"\midrule",
        *(f"{' & '.join(map(_escape_latex, cells))} \\\\" for cells in _list_cells(table)),
        r"\bottomrule",
        r"\end{tabular}",
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"


def _escape_latex(text: str) -> str:
    return "".join(_LATEX.get(letter, letter) for letter in text)


def _pad(cell: str, width: int, column: int) -> str:
    return cell.ljust(width) if column == 1 else cell.rjust(width)
