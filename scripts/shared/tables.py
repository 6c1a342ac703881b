"""What a verb prints on stdout: one table, and one line for what could not be done."""

from collections.abc import Iterable, Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

WIDTH_OF_PIPES = 200  # where stdout is no terminal, nothing should be folded


def print_table(
    title: str, columns: Sequence[str], sections: Iterable[Iterable[Sequence[str]]], texts: int = 2
) -> None:
    """Print rows of text under ``columns``, with a line between sections; the first ``texts`` columns to the left."""
    table = Table(title=Text(title), title_justify="left")
    for place, column in enumerate(columns):
        table.add_column(Text(column), justify="left" if place < texts else "right", overflow="fold")
    for rows in sections:
        for row in rows:
            table.add_row(*map(Text, row))
        table.add_section()
    console = Console()
    (console if console.is_terminal else Console(width=WIDTH_OF_PIPES)).print(table)


def print_refusals(what: str, refusals: Iterable[tuple[str, str]]) -> None:
    """One line per message, with the names of all that were refused for it: ``not made (cf, vqf): ...``."""
    names: dict[str, list[str]] = {}
    for message, name in refusals:
        names.setdefault(message, []).append(name)
    for message, refused in names.items():
        print(f"{what} ({', '.join(dict.fromkeys(refused))}): {message}")
