"""Delimited text -> columns of numbers; what is wrong is said with file, line and column."""

import csv
import io
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stillpoint.datasets.errors import BadSource
from stillpoint.datasets.importers.clock import cells_to_ns
from stillpoint.datasets.recording import Floats, Times

DELIMITERS = (",", ";", "\t", "|")
BLANK = ("", "nan", "null", "none", "na", "n/a", "-nan")


@dataclass(frozen=True)
class Table:
    """The rows of a delimited text. Columns go by their names, or by numbers from 1 where there is no header."""

    where: str  # for messages
    columns: tuple[str, ...]
    rows: list[list[str]]
    first_line: int  # of the first row, counted from 1
    decimal_comma: bool

    @property
    def listed(self) -> str:
        """The columns for a message, the first twenty of them."""
        more = f" and {len(self.columns) - 20} more" if len(self.columns) > 20 else ""
        return ", ".join(self.columns[:20]) + more

    @cached_property
    def index(self) -> dict[str, int]:
        """Column name -> place; raises :class:`BadSource` for a name that stands twice."""
        places: dict[str, int] = {}
        for place, name in enumerate(self.columns):
            if name in places:
                raise BadSource(
                    f"{self.where}: two columns are called {name!r} ({places[name] + 1} and {place + 1}); rename one"
                )
            places[name] = place
        return places

    def place(self, column: str) -> int:
        """Where a column stands; raises :class:`BadSource` with the columns there are."""
        if column not in self.index:
            raise BadSource(f"{self.where}: no column {column!r}; it has {self.listed}")
        return self.index[column]

    def floats(self, columns: tuple[str, ...]) -> Floats:
        """Columns as (N, k); an empty or NaN cell is NaN. Raises :class:`BadSource` for a cell that is no number."""
        places = [self.place(column) for column in columns]
        values = np.empty((len(self.rows), len(places)))
        for k, place in enumerate(places):
            cells = self._cells(place)
            try:
                values[:, k] = np.array(cells, dtype=np.float64)
            except ValueError:
                values[:, k] = [self._number(cell, row, columns[k]) for row, cell in enumerate(cells)]
        return values

    def times(self, column: str, exponent: int) -> Times:
        """A time column in units of 10^exponent s as exact nanoseconds."""
        return cells_to_ns(self._cells(self.place(column)), exponent, f"{self.where}", self.first_line)

    def _cells(self, place: int) -> list[str]:
        try:
            cells = [row[place] for row in self.rows]
        except IndexError:
            short = next(k for k, row in enumerate(self.rows) if len(row) <= place)
            raise BadSource(
                f"{self.where}, line {self.first_line + short}: has {len(self.rows[short])} cells, "
                f"column {self.columns[place]!r} is number {place + 1}; remove or complete this line"
            ) from None
        return [cell.replace(",", ".") for cell in cells] if self.decimal_comma else cells

    def _number(self, cell: str, row: int, column: str) -> float:
        if cell.strip().lower() in BLANK:
            return np.nan
        try:
            return float(cell)
        except ValueError:
            raise BadSource(
                f"{self.where}, line {self.first_line + row}, column {column!r}: {cell!r} is not a number; "
                "remove or correct this line"
            ) from None


def parse(text: str, where: str, delimiter: str | None = None) -> Table:
    """Read a delimited text. The delimiter is found from the first line unless given; ``#`` starts a comment line.

    A first row with a cell that is no number is the header. Decimal commas are understood where the delimiter is
    not a comma. Raises :class:`BadSource` for a text without rows.
    """
    if "\0" in text:
        raise BadSource(f"{where}: is binary, not delimited text; name the log, or another kind of import")
    lines = text.splitlines()
    skipped = next((k for k, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")), None)
    if skipped is None:
        raise BadSource(f"{where}: is empty; export the log again")
    head = lines[skipped]
    if delimiter is None:
        delimiter = max(DELIMITERS, key=head.count)
        if delimiter not in head:
            delimiter = " "
    rows = [
        [cell.strip() for cell in row]
        for row in csv.reader(io.StringIO("\n".join(lines[skipped:])), delimiter=delimiter, skipinitialspace=True)
        if row
    ]
    if delimiter == " ":
        rows = [[cell for cell in row if cell] for row in rows]
    decimal_comma = delimiter != "," and "," in "".join(rows[-1])
    has_header = any(not _is_number(cell, decimal_comma) for cell in rows[0])
    columns = tuple(rows[0]) if has_header else tuple(str(k + 1) for k in range(len(rows[0])))
    body = rows[1:] if has_header else rows
    if not body:
        raise BadSource(f"{where}: has a header and no rows; export the log again")
    return Table(where, columns, body, skipped + 1 + has_header, decimal_comma)


def _is_number(cell: str, decimal_comma: bool) -> bool:
    if cell.strip().lower() in BLANK:
        return True
    try:
        float(cell.replace(",", ".") if decimal_comma else cell)
    except ValueError:
        return False
    return True
