"""Delimited text becomes columns of numbers; messages name file, line and column."""

import csv
import io
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import overload

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.errors import BadSource
from stillpoint.datasets.files.limits import LARGEST_LINE, raise_limit
from stillpoint.datasets.importers.clock import BLANK, Clock, parse_times
from stillpoint.datasets.recording import Floats, Times

_DELIMITERS = ("\t", ";", "|", ",")  # before commas, which may also be decimal signs
_ROWS_AT_ONCE = 50_000  # that become numbers together
_SAMPLED = 30  # lines at the end of a file that tell its delimiter and its number of columns


class _SplitLines(Sequence[list[str]]):
    """Lines that are split into cells when asked for; as lists of texts a file would take 15 times its size."""

    def __init__(self, lines: list[str], delimiter: str) -> None:
        self.lines, self.delimiter = lines, delimiter

    def __len__(self) -> int:
        """Return the number of lines."""
        return len(self.lines)

    @overload
    def __getitem__(self, place: int) -> list[str]: ...
    @overload
    def __getitem__(self, place: slice) -> "_SplitLines": ...
    def __getitem__(self, place: int | slice) -> "list[str] | _SplitLines":
        """Return the cells of a line, or some of the lines."""
        if isinstance(place, slice):
            return _SplitLines(self.lines[place], self.delimiter)
        return self._split(self.lines[place])

    def __iter__(self) -> Iterator[list[str]]:
        """Yield the cells of each line."""
        return map(self._split, self.lines)

    def take_column(self, place: int) -> list[str]:
        """Return the cells of one column, "" where a line ends before it, without splitting the rest of the lines."""
        delimiter = None if self.delimiter == " " else self.delimiter
        try:
            return [line.split(delimiter, place + 1)[place].strip() for line in self.lines]
        except IndexError:
            return [row[place] if place < len(row) else "" for row in self]

    def load_floats(self, places: list[int]) -> Floats | None:
        """Return some columns as (N, k); None where a line ends before one, or a cell is no plain number."""
        try:
            delimiter = None if self.delimiter == " " else self.delimiter
            return np.loadtxt(self.lines, comments=None, delimiter=delimiter, usecols=places, ndmin=2)
        except (ValueError, IndexError):
            return None

    def _split(self, line: str) -> list[str]:
        if self.delimiter == " ":
            return line.split()
        return [cell.strip() for cell in line.split(self.delimiter)]


@dataclass(frozen=True)
class Table:
    """The rows of a delimited text. Columns go by their names, or by numbers from 1 where there is no header."""

    where: str  # for messages
    columns: tuple[str, ...]
    rows: Sequence[list[str]]
    lines: list[int]  # the line of each row, counted from 1
    decimal_comma: bool
    skipped: int = 0  # lines before the table that belong to no row
    delimiter: str = ","

    @property
    def listed(self) -> str:
        """The columns for a message, the first twenty of them."""
        more = f" and {len(self.columns) - 20} more" if len(self.columns) > 20 else ""
        return ", ".join(name[:40] for name in self.columns[:20])[:300] + more

    @cached_property
    def _places(self) -> dict[str, list[int]]:
        """The numbers of the columns of each name."""
        places: dict[str, list[int]] = {}
        for place, name in enumerate(self.columns):
            places.setdefault(name, []).append(place)
        return places

    @cached_property
    def _clocks(self) -> dict[tuple[str, str, str], Clock]:
        """The clocks that were read: gyro, accelerometer and magnetometer ask for the same."""
        return {}

    def place(self, column: str) -> int:
        """Return the index of a column, by its name or by its number.

        Raises :class:`BadSource` for a name that no column has, or that two have.
        """
        for name in (column, column.lstrip("# ")):  # the second as a comment line writes it
            found = self._places.get(name, [])
            if len(found) > 1:
                first, second = found[0] + 1, found[1] + 1
                raise BadSource(
                    f"{self.where}: two columns are called {name!r} ({first} and {second}); rename one or give numbers"
                )
            if found:
                return found[0]
        if column.isdecimal() and 1 <= int(column[:6]) <= len(self.columns):
            return int(column) - 1
        raise BadSource(f"{self.where}: no column {column!r}; it has {self.listed}")

    def select(self, keep: NDArray[np.bool_]) -> "Table":
        """Return the table with the rows of a mask (N,)."""
        kept = np.flatnonzero(keep).tolist()
        rows: Sequence[list[str]] = [self.rows[k] for k in kept]
        lines = [self.lines[k] for k in kept]
        return Table(self.where, self.columns, rows, lines, self.decimal_comma, self.skipped, self.delimiter)

    def read_floats(self, columns: tuple[str, ...]) -> Floats:
        """Return columns as (N, k); an empty or NaN cell is NaN. Raises :class:`BadSource` for any other text."""
        places = [self.place(column) for column in columns]
        if isinstance(self.rows, _SplitLines) and len(self.rows) and not self.decimal_comma:
            plain = self.rows.load_floats(places)
            if plain is not None and plain.shape == (len(self.rows), len(places)):
                return plain
        values = np.empty((len(self.rows), len(places)))
        for begin in range(0, len(self.rows), _ROWS_AT_ONCE):
            rows = [
                self._pick_cells(row, places, begin + k)
                for k, row in enumerate(self.rows[begin : begin + _ROWS_AT_ONCE])
            ]
            part = values[begin : begin + len(rows)]
            try:
                part[:] = np.array(rows, dtype=np.float64)
            except ValueError:
                part[:] = [
                    [self._parse_number(cell, begin + k, column) for cell, column in zip(row, columns, strict=True)]
                    for k, row in enumerate(rows)
                ]
        return values

    def times(self, column: str, unit: str) -> Times:
        """Return a column of times in s, ms, us, ns or iso as exact nanoseconds; none may be empty."""
        clock = parse_times(self.cells(self.place(column)), unit, self.where, self.lines, column)
        if not clock.known.all():
            line = self.lines[int(clock.known.argmin())]
            raise BadSource(f"{self.where}, line {line}: has no time in {column!r}; remove this line")
        return clock.t_ns

    def clock(self, column: str, unit: str, flag: str = "--time") -> Clock:
        """Return the stamps of a column in s, ms, us, ns or iso, set by ``flag``; empty cells are unknown."""
        key = (column, unit, flag)
        if key not in self._clocks:
            place = self.place(column)
            if isinstance(self.rows, _SplitLines):
                cells = self.rows.take_column(place)
            else:
                cells = [row[place] if place < len(row) else "" for row in self.rows]
            if self.decimal_comma:
                cells = [cell.replace(",", ".") for cell in cells]
            self._clocks[key] = parse_times(cells, unit, self.where, self.lines, column, flag)
        return self._clocks[key]

    def cells(self, place: int) -> list[str]:
        """Return the text of a column; raises :class:`BadSource` for a row that ends before it."""
        return [self._pick_cells(row, [place], k)[0] for k, row in enumerate(self.rows)]

    def _pick_cells(self, row: list[str], places: list[int], number: int) -> list[str]:
        """Return some cells of a row with decimal points; raises :class:`BadSource` where the row is too short."""
        try:
            cells = [row[place] for place in places]
        except IndexError:
            place = next(place for place in places if place >= len(row))
            raise BadSource(
                f"{self.where}, line {self.lines[number]}: has {len(row)} cells, "
                f"column {self.columns[place]!r} is number {place + 1}; remove or complete this line"
            ) from None
        return [cell.replace(",", ".") for cell in cells] if self.decimal_comma else cells

    def _parse_number(self, cell: str, row: int, column: str) -> float:
        """Return a cell as a number, NaN for a blank one; raises :class:`BadSource` with line and column."""
        if cell.strip().lower() in BLANK:
            return np.nan
        try:
            return float(cell)
        except ValueError:
            raise BadSource(
                f"{self.where}, line {self.lines[row]}, column {column!r}: {cell[:40]!r} is not a number; "
                "remove or correct this line"
            ) from None


def parse(text: str, where: str, delimiter: str | None = None) -> Table:
    """Read a delimited text whose delimiter, header and first row are found unless given.

    Lines before the header (device data, ``sep=,``) and a row of units below it are skipped and counted. Lines that
    start with ``#`` are comments; where there is no other header, the last of them before the rows is the header if
    it has as many names as the rows have cells. Decimal commas are understood where the comma is not the delimiter.
    Raises :class:`BadSource` for a text without rows.
    """
    lines = _split_lines(text, where)
    content = [k for k, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")]
    if content and lines[content[0]].lower().startswith("sep=") and len(lines[content[0]].strip()) == 5:
        delimiter = delimiter or lines[content[0]].strip()[-1]
        content = content[1:]
    if not content:
        raise BadSource(f"{where}: is empty; export the log again")
    delimiter = delimiter or _find_delimiter([lines[k] for k in content])
    cells, numbers = _split_cells(lines, content, delimiter)
    width = Counter(len(row) for row in cells[-_SAMPLED:]).most_common(1)[0][0]
    decimal_comma = delimiter != "," and "," in "".join(cells[-1])
    start = next((k for k, row in enumerate(cells) if len(row) == width), 0)
    if start and not _has_number(cells[start - 1], decimal_comma) and abs(len(cells[start - 1]) - width) <= 1:
        start -= 1  # a header with one name more or less than the rows have cells
    names, first = _find_header(cells, start, decimal_comma)
    if names is None:
        before = range(numbers[start] - 1)
        names = next((row for k in reversed(before) if (row := _find_comment_names(lines[k], delimiter, width))), None)
    if first >= len(cells):
        raise BadSource(f"{where}: has a header and no rows; export the log again")
    columns = tuple(names) if names else tuple(str(k + 1) for k in range(width))
    skipped = first - (first > start)
    return Table(where, columns, cells[first:], numbers[first:], decimal_comma, skipped, delimiter)


def take_rows(text: str, whole: Table, first_line: int, done: int) -> tuple[Table, int]:
    """Return the rows of one piece of a text as a table with the columns of the whole, and its number of lines.

    ``first_line`` is the line of the first row of the whole, ``done`` the number of lines before the piece. The text
    has no quotes. Raises :class:`BadSource` as :func:`parse`.
    """
    lines = _split_lines(text, whole.where)
    content = [k for k, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")]
    content = [k for k in content if done + k + 1 >= first_line]
    rows = _SplitLines([lines[k] for k in content], whole.delimiter)
    numbers = [done + k + 1 for k in content]
    return Table(whole.where, whole.columns, rows, numbers, whole.decimal_comma, 0, whole.delimiter), len(lines)


def _split_lines(text: str, where: str) -> list[str]:
    """Return the lines of a text; raises :class:`BadSource` for binary content and for lines that are too long."""
    if "\0" in text:
        raise BadSource(f"{where}: is binary, not delimited text; name the log, or another kind of import")
    lines = text.splitlines()
    longest = raise_limit(LARGEST_LINE)
    if len(text) > longest and max(map(len, lines)) > longest:
        at = next(k for k, line in enumerate(lines) if len(line) > longest)
        raise BadSource(f"{where}, line {at + 1}: is longer than {longest} characters; name a log, or give --large")
    return lines


def _find_delimiter(content: list[str]) -> str:
    """Return the character that splits the last lines, and a line before them, into equally many cells."""
    tail = content[-_SAMPLED:]
    found = []
    for order, delimiter in enumerate(_DELIMITERS):
        count, times = Counter(line.count(delimiter) for line in tail).most_common(1)[0]
        if count and times >= 0.6 * len(tail):
            agreeing = [line.split(delimiter) for line in content[:_SAMPLED] if line.count(delimiter) == count]
            has_header = any(not _has_number(row, delimiter != ",") for row in agreeing)
            found.append((has_header, -order, delimiter))
    return max(found)[-1] if found else " "


def _split_cells(lines: list[str], content: list[int], delimiter: str) -> tuple[Sequence[list[str]], list[int]]:
    """Return the cells of the lines, stripped, and the number of the line on which each row starts."""
    if delimiter == " " or not any('"' in lines[k] for k in content):
        return _SplitLines([lines[k] for k in content], delimiter), [k + 1 for k in content]
    rows, numbers = [], []
    reader = csv.reader(io.StringIO("\n".join(lines[k] for k in content)), delimiter=delimiter, skipinitialspace=True)
    before = 0
    for row in reader:
        rows.append([cell.strip() for cell in row])
        numbers.append(content[min(before, len(content) - 1)] + 1)
        before = reader.line_num
    return rows, numbers


def _find_header(cells: Sequence[list[str]], start: int, decimal_comma: bool) -> tuple[list[str] | None, int]:
    """Return the header, or None, and the index of the first row below it."""
    first = cells[start]
    numbers = [_is_number(cell, decimal_comma) for cell in first]
    if all(numbers):
        return None, start
    if start + 1 >= len(cells):
        return first, start + 1
    below = [_is_number(cell, decimal_comma) for cell in cells[start + 1]]
    if not any(numbers) and not any(_is_written_number(cell, decimal_comma) for cell in cells[start + 1]):
        third = cells[start + 2] if start + 2 < len(cells) else []
        if any(_is_written_number(cell, decimal_comma) for cell in third):
            return first, start + 2  # a row of units
    if any(is_below and not is_first for is_first, is_below in zip(numbers, below, strict=False)):
        return first, start + 1
    return (None, start) if any(_is_written_number(cell, decimal_comma) for cell in first) else (first, start + 1)


def _find_comment_names(line: str, delimiter: str, width: int) -> list[str] | None:
    """Return the names in a comment line that has as many of them as the rows have cells."""
    if not line.lstrip().startswith("#"):
        return None
    text = line.lstrip().lstrip("#").strip()
    names = text.split() if delimiter == " " else [name.strip() for name in text.split(delimiter)]
    return names if len(names) == width and width > 1 else None


def _has_number(row: list[str], decimal_comma: bool) -> bool:
    return any(_is_written_number(cell, decimal_comma) for cell in row)


def _is_written_number(cell: str, decimal_comma: bool) -> bool:
    return cell.strip().lower() not in BLANK and _is_number(cell, decimal_comma)


def _is_number(cell: str, decimal_comma: bool) -> bool:
    """Return whether a cell is blank or reads as a number."""
    if cell.strip().lower() in BLANK:
        return True
    try:
        float(cell.replace(",", ".") if decimal_comma else cell)
    except ValueError:
        return False
    return True
