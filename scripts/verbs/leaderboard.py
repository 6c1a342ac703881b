"""``stillpoint leaderboard``: score many estimators over many recordings and say which are better."""

import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from stillpoint.datasets.archive import resolve_paths
from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.files.result_store import ResultStore
from stillpoint.scoring.align import AlignKind
from stillpoint.scripts.shared import inputs
from stillpoint.scripts.shared.batch import parse_assignments
from stillpoint.scripts.shared.children import Outcome
from stillpoint.scripts.shared.flags import LOCAL, Columns, SetFlag, Workers, split_names
from stillpoint.scripts.shared.jobs import run_jobs
from stillpoint.scripts.shared.output import STDOUT, JsonFile, print_line, write_document, write_text
from stillpoint.scripts.shared.tables import print_refusals, print_table
from stillpoint.studies.leaderboard import Leaderboard, Row, Study, Summary, Table, format_study, read_study, run_study
from stillpoint.studies.leaderboard.run import find_study_entrants
from stillpoint.studies.leaderboard.series import RESULTS
from stillpoint.studies.leaderboard.study import Against, map_own_file
from stillpoint.studies.publish.curves import read_entries
from stillpoint.studies.publish.page import make_page_html
from stillpoint.studies.publish.paper import write_paper
from stillpoint.studies.publish.run_pages import write_run_pages

_DEFAULT_OUT = Path("leaderboard")
_COLUMNS = (
    "rank",
    "estimator",
    "deg",
    "95 %",
    "heading",
    "incl.",
    "worst",
    "ns",
    "failed",
    "mean",
    "median",
    "NEES/3",
    "in 95 %",
    "parameters",
)
_EXAMPLE = "cf.omega0_radps=0.3"
_MOST_FIRST = 4  # estimators that the line of a group names
_MOST_FAILED = 3  # recordings that a line about a failure names; of more it gives the number


def leaderboard(
    paths: Annotated[list[str] | None, Parameter(negative=(), allow_leading_hyphen=True)] = None,
    /,
    *,
    estimators: Annotated[str | None, Parameter(name=["--estimators", "-e"])] = None,
    out: Annotated[Path, Parameter(name=["--out", "-o"])] = _DEFAULT_OUT,
    against: Against | None = None,
    align: AlignKind | None = None,
    calibration: str | None = None,
    groups: str | None = None,
    set_: SetFlag = None,
    study: Annotated[Path | None, Parameter(name=["--study", "-c"])] = None,
    archive: Annotated[str | None, Parameter(name="--archive")] = None,
    workers: Workers = LOCAL,
    force: Annotated[bool, Parameter(negative=())] = False,
    paper: Annotated[Path | None, Parameter(negative=())] = None,
    columns: Columns = None,
    json: JsonFile = None,
) -> int:
    """Score many estimators over many recordings and say which are better.

    Makes the references, estimates and scores that are missing and reuses the others, so that a run that was stopped
    goes on where it was. Writes leaderboard.json, study.toml, index.html (a page that needs no network) and a page for
    each recording to the output folder. Verdicts come with 95 % intervals; docs/leaderboard.md explains them. Exit
    code 2 when nothing could be scored.

    Parameters
    ----------
    paths
        Recordings: MCAP files, folders or globs; - reads names from the standard input.
    estimators
        Names with commas between, as for estimate, or all; NAME@FILE.toml with parameters of tune; one's own as
        FILE.py:NAME or MODULE:NAME. By default all of attitude. Files NAME.LABEL.tum, .csv, .mcap or .bag beside
        NAME.mcap always take part.
    out
        Folder for results.
    against
        What judges: truth, reference, or both with a table each. By default (auto) truth where a recording has it,
        the reference elsewhere.
    align
        What may differ without being an error: none, heading (the default), heading+mounting or
        heading+mounting+time.
    calibration
        Input of the estimators, with commas between for rows of each: none (as recorded, the default), reference
        (corrected by what the reference found about the sensor), or a file NAME.reference.mcap.
    groups
        Tags and devices that get a table of their own, with commas between; by default all.
    set_
        A parameter, ESTIMATOR.NAME=VALUE, for example cf.omega0_radps=0.3; can be given several times.
    study
        A study.toml that names all of this; the other flags override it.
    archive
        The archive whose objects the paths name, by ID or file name, as the lines of archive find do; of these, the
        recordings take part.
    force
        Delete the results in the output folder and compute everything again.
    paper
        Also write the table as LaTeX, CSV and Markdown, and figures as PDF and SVG, to this folder.
    columns
        Columns of the table to show: names with commas between, or all. By default those that fit the terminal.
    json
        Also write the leaderboard as JSON to this file; - is the standard output.
    """
    asked = _make_study(paths, estimators, against, align, calibration, groups, set_, study, archive)
    find_study_entrants(asked)  # a wrong name ends the command before anything is written

    computed: list[int] = []

    def run(function: Callable[[Any], Any], items: Sequence[Any], what: str) -> list[Outcome[Any]]:
        computed.append(len(items))
        return run_jobs(function, items, workers, what)

    folder = inputs.make_output_dir(out)
    if force:
        ResultStore(folder / RESULTS).clear()
    board = run_study(asked, folder, run, publish=lambda partial: _write(partial, folder))
    if sum(computed) == 0:
        kept = "all results are kept from an earlier run, nothing to compute (--force computes again)"
        print_line(f"leaderboard: {kept}", file=sys.stderr)
    _write(board, folder)
    pages = write_run_pages(folder, board, run)
    _write(board, folder, pages.links)
    for name, error in pages.errors.items():
        print_line(f"no page of {name}: {error}", file=sys.stderr)
    write_document(json, board.to_json())
    if json != STDOUT:
        _print_leaderboard(board, columns)
        print_line()
        what = f"index.html, runs/*.html ({len(pages.links)}), leaderboard.json, study.toml"
        print_line(f"written to {folder}: {what}")
    if paper is not None:
        for file in write_paper(inputs.make_output_dir(paper), board):
            print_line(file, file=sys.stderr if json == STDOUT else sys.stdout)
    return 0 if any(run.error is None for run in board.runs) else 2


def _print_leaderboard(board: Leaderboard, columns: str | None = None) -> None:
    """Print the table of each judge with its conclusion, the groups in short, and the failures by reason."""
    for table in board.tables:
        whose = f", input {table.inputs}" if len(board.tables) > 1 else ""
        title = (
            f"{len(table.recordings)} recordings against {table.against}, {board.align} aligned{whose}; "
            f"typical RMSE of the {table.ranked_by} error"
        )
        names = _shorten_labels(table)
        cells = [_format_cells(row, table, name) for row, name in zip(table.rows, names, strict=True)]
        print_table(title, _COLUMNS, [cells], wanted=columns)
        print_line(table.conclusion)
        print_line(table.origins)
    for group in board.groups:
        best = [row.label for row in group.rows if row.rank is not None and row.rank[0] == 1]
        if best:
            by = "" if group.ranked_by == "total" else f", by {group.ranked_by}"
            whose = f"{group.name} ({len(group.recordings)} recordings, {group.against}{by})"
            more = f" and {len(best) - _MOST_FIRST} more" if len(best) > _MOST_FIRST else ""
            print_line(f"{whose}: first {', '.join(best[:_MOST_FIRST])}{more}")
    print_refusals("failed", _list_failures(board))
    for source in board.sources:
        if source.lost:
            print_line(f"{source.recording}: {source.lost}")


def _list_failures(board: Leaderboard) -> Iterator[tuple[str, str]]:
    """Yield each error with what failed for it: a row on a recording, or on how many where there are many."""
    places: dict[tuple[str, str], list[str]] = {}
    for run in board.failures:
        places.setdefault((str(run.error), run.label), []).append(run.recording)
    for (error, label), names in places.items():
        where = names if len(names) <= _MOST_FAILED else [f"{len(names)} of {len(board.sources)} recordings"]
        for name in where:
            yield error, f"{label} on {name}"


def _shorten_labels(table: Table) -> list[str]:
    """Return the names of the rows, without the input where the title says it for all of them."""
    names = [row.estimator for row in table.rows]
    alike = len({row.calibration for row in table.rows}) == 1 and len(set(names)) == len(names)
    return names if alike else [row.label for row in table.rows]


def _format_cells(row: Row, table: Table, name: str) -> list[str]:
    """Return a row of the table as text; angles in deg."""
    ranked: Summary | None = getattr(row, f"{table.ranked_by}_rmse_deg")
    rank = "-" if row.rank is None else str(row.rank[0]) if row.rank[0] == row.rank[1] else "{}-{}".format(*row.rank)
    failed = f"{row.failed} of {row.recordings}" if row.failed else ""
    ns = "-" if row.ns_per_sample is None else f"{row.ns_per_sample:.0f}"
    rest = [*(_format_figure(value) for value in (row.nees_per_dof, row.coverage95)), row.parameters]
    if ranked is None or row.heading_rmse_deg is None or row.inclination_rmse_deg is None:
        return [rank, name, "-", "-", "-", "-", "-", ns, failed, "-", "-", *rest]
    low, high = ranked.ci95
    interval = f"{low:.2f}-{high:.2f}" if table.general and low < high else "-"
    figures = (row.heading_rmse_deg.typical, row.inclination_rmse_deg.typical, ranked.worst)
    shown = [f"{ranked.typical:.2f}", interval, *map(_format_figure, figures), ns, failed]
    return [rank, name, *shown, _format_figure(ranked.mean), _format_figure(ranked.median), *rest]


def _format_figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _make_study(
    paths: list[str] | None,
    estimators: str | None,
    against: Against | None,
    align: AlignKind | None,
    calibration: str | None,
    groups: str | None,
    set_: Sequence[str] | None,
    study: Path | None,
    archive: str | None,
) -> Study:
    """Return what the flags ask for, on top of a study file; its recordings as files."""
    if not paths and study is None:
        raise BadParameter("no recordings: name files, folders or globs, or a study: -c study.toml")
    base = read_study(study) if study is not None else None
    if paths:
        names = [line.strip() for line in sys.stdin if line.strip()] if paths == ["-"] else paths
        if archive:
            names = [str(path) for path in resolve_paths(archive, names) if inputs.get_kind(path) == inputs.RECORDING]
        base = Study(tuple(names)) if base is None else replace(base, recordings=tuple(names), sha256={})
    assert base is not None
    given: dict[str, Any] = {"against": against, "align": align}
    for name, text in (("estimators", estimators), ("calibration", calibration), ("groups", groups)):
        given[name] = None if text is None else tuple(part for part in split_names(text) if part)
    params = {name: dict(values) for name, values in base.params.items()}
    for path, value in parse_assignments(set_, _EXAMPLE).items():
        owner, dot, name = path.partition(".")
        if not dot:
            raise BadParameter(f"--set {path}={value}: write ESTIMATOR.NAME=VALUE, for example {_EXAMPLE}")
        params.setdefault(owner, {})[name] = value
    files = tuple(map(str, inputs.find_recordings(base.recordings)))
    changed = {name: value for name, value in given.items() if value is not None}
    return replace(base, recordings=files, params=params, **changed)


def _write(board: Leaderboard, folder: Path, run_pages: Mapping[str, str] | None = None) -> None:
    """Write the leaderboard, its page, and the complete study, with paths relative to the folder."""
    write_document(str(folder / "leaderboard.json"), board.to_json())
    write_text(folder / "index.html", make_page_html(board, read_entries(folder, board), run_pages=run_pages))
    study = Study(**board.study)
    study = replace(
        study,
        recordings=tuple(os.path.relpath(file, folder) for file in study.recordings),
        estimators=tuple(map_own_file(name, partial(os.path.relpath, start=folder)) for name in study.estimators),
        calibration=tuple(
            name if name in ("none", "reference") else os.path.relpath(name, folder) for name in study.calibration
        ),
    )
    write_text(folder / "study.toml", format_study(study, board.version))
