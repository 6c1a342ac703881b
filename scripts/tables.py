"""The one table that a verb prints on stdout."""

from collections.abc import Iterable, Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

WIDTH_OF_PIPES = 200  # where stdout is no terminal, nothing should be folded


def print_table(title: str, columns: Sequence[str], sections: Iterable[Iterable[Sequence[str]]]) -> None:
    """Print rows of text under ``columns``, with a line between sections; text to the left in the first two columns."""
    table = Table(title=Text(title), title_justify="left")
    for place, column in enumerate(columns):
        table.add_column(Text(column), justify="left" if place < 2 else "right", overflow="fold")
    for rows in sections:
        for row in rows:
            table.add_row(*map(Text, row))
        table.add_section()
    console = Console()
    (console if console.is_terminal else Console(width=WIDTH_OF_PIPES)).print(table)
