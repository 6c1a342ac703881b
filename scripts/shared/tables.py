"""Tables on stdout: boxes that fit the window on a terminal, tab-separated text in a pipe.

The columns of a table stand in the order of their importance; on a terminal those on the right that do not fit are left
out, and a line names them.
"""

from collections.abc import Iterable, Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.names import make_printable
from stillpoint.scripts.shared.flags import split_names
from stillpoint.scripts.shared.output import print_cells, print_line

_ALL = "all"
_BORDER = 3  # characters that a column takes besides its text, and one more for the table


def print_table(
    title: str,
    columns: Sequence[str],
    sections: Iterable[Iterable[Sequence[str]]],
    texts: int = 2,
    wanted: str | None = None,
    widest_first: int | None = None,
) -> None:
    """Print rows of text under ``columns``, with a line between sections; the first ``texts`` columns to the left.

    ``wanted`` is the value of --columns: "all", or names of columns with commas between. On a terminal, texts of the
    first column that are longer than ``widest_first`` go on in the next line. Raises :class:`BadParameter` for a name
    that no column has.
    """
    columns = list(map(make_printable, columns))
    rows = [[list(map(make_printable, row)) for row in section] for section in sections]
    title = make_printable(title)
    chosen = range(len(columns)) if wanted in (None, _ALL) else choose_columns(columns, str(wanted))
    console = Console()
    if not console.is_terminal:
        _print_lines(title, columns, rows, chosen)
        return
    shown = list(chosen) if wanted is not None else fit_columns(columns, rows, console.width, widest_first)
    table = Table(title=Text(title), title_justify="left")
    for k in shown:
        widest = widest_first if k == 0 else None
        table.add_column(Text(columns[k]), justify="left" if k < texts else "right", overflow="fold", max_width=widest)
    for section in rows:
        for row in section:
            table.add_row(*(Text(row[k]) for k in shown))
        table.add_section()
    console.print(table)
    hidden = [columns[k] for k in range(len(columns)) if k not in shown]
    if hidden and wanted is None:
        print_line(f"--columns all shows also: {'; '.join(hidden)}")


def choose_columns(columns: Sequence[str], wanted: str) -> list[int]:
    """Return the places of the named columns; a name is a heading, or the part of one before a comma."""
    names: dict[str, int] = {}
    for k, heading in enumerate(columns):
        names.setdefault(heading.partition(",")[0].strip().lower(), k)
    chosen = []
    for name in split_names(wanted):
        if name.lower() not in names:
            raise BadParameter(f"--columns {name}: there is no such column; there are {', '.join(names)}, {_ALL}")
        chosen.append(names[name.lower()])
    return chosen


def fit_columns(
    columns: Sequence[str],
    sections: Sequence[Sequence[Sequence[str]]],
    width: int,
    widest_first: int | None = None,
) -> list[int]:
    """Return the places of the leftmost columns that fit into ``width`` characters, at least the first two."""
    cells = [columns, *(row for section in sections for row in section)]
    taken, fitting = 1, []
    for k in range(len(columns)):
        needed = max(len(line[k]) for line in cells)
        taken += _BORDER + (min(needed, widest_first) if k == 0 and widest_first is not None else needed)
        if taken > width and k >= 2:
            break
        fitting.append(k)
    return fitting


def print_refusals(what: str, refusals: Iterable[tuple[str, str]]) -> None:
    """Print one line per message, with the names of all that were refused for it: ``not made (cf, vqf): ...``."""
    names: dict[str, list[str]] = {}
    for message, name in refusals:
        names.setdefault(message, []).append(name)
    for message, refused in names.items():
        print_line(f"{what} ({', '.join(dict.fromkeys(refused))}): {message}")


def _print_lines(
    title: str, columns: Sequence[str], sections: Sequence[Sequence[Sequence[str]]], chosen: Sequence[int]
) -> None:
    """Print the title behind a hash, the headings, and a line per row, with tabs between the cells."""
    print_line(f"# {title}")
    for line in (columns, *(row for section in sections for row in section)):
        print_cells(" ".join(line[k].split()) for k in chosen)
