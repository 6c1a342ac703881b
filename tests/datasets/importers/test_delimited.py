"""Tables of delimited text: lines of plain numbers are read at once, and give what their cells give one by one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stillpoint.datasets.errors import BadSource
from stillpoint.datasets.importers import delimited
from stillpoint.datasets.importers.clock import TIME_EXPONENT, _parse_number, _parse_plain
from stillpoint.datasets.importers.delimited import Table, parse, take_rows

ODD_CELLS = [
    "",
    "nan",
    "-nan",
    "NaN",
    "null",
    "inf",
    "-Infinity",
    "1e999",
    "1_0",
    "٣",
    "+.5",
    "5.",
    " 7 ",
    "0x1",
    "1.5.2",
]
NUMBERS = st.floats().map(repr) | st.integers(-(2**70), 2**70).map(str) | st.decimals().map(str)
ROWS = st.lists(st.tuples(*[NUMBERS | st.sampled_from(ODD_CELLS)] * 3), min_size=1, max_size=5)


def read_cells(rows: list[tuple[str, ...]], delimiter: str) -> Table:
    """Return rows as a table whose cells are split already."""
    lines = list(range(1, len(rows) + 1))
    return Table("f", ("a", "b", "c"), [[cell.strip() for cell in row] for row in rows], lines, False, 0, delimiter)


def read_lines(rows: list[tuple[str, ...]], delimiter: str) -> Table:
    whole = read_cells([("1", "2", "3")], delimiter)
    return take_rows("\n".join(delimiter.join(row) for row in rows), whole, 1, 0)[0]


def ask(table: Table, columns: tuple[str, ...]) -> bytes | str:
    """The bits of the numbers, or the message."""
    try:
        return table.read_floats(columns).tobytes()
    except BadSource as error:
        return str(error)


@given(ROWS, st.sampled_from([",", ";", "\t"]))
def test_lines_give_the_same_bits_and_messages_as_cells(rows: list[tuple[str, ...]], delimiter: str) -> None:
    table = read_lines(rows, delimiter)
    rows = [row for row in rows if delimiter.join(row).strip()]
    for columns in (("a",), ("c", "a"), ("b", "b", "c")):
        assert ask(table, columns) == ask(read_cells(rows, delimiter), columns)


def test_plain_lines_are_not_split_into_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(delimited._SplitLines, "_split", lambda *_: pytest.fail("a line was split"))
    table = read_lines([("1700000000000", "0.5", "-1e-3"), ("1700000000005", " 2", "3")], ",")
    np.testing.assert_array_equal(table.read_floats(("c", "b")), [[-1e-3, 0.5], [3, 2]])
    assert table.clock("a", "ms").t_ns.tolist() == [1_700_000_000_000_000_000, 1_700_000_000_005_000_000]


def test_a_line_that_ends_early_is_named() -> None:
    table = parse("a,b,c\n1,2,3\n1,2\n1,2,3\n", "f")
    with pytest.raises(BadSource, match=r"line 3: has 2 cells, column 'c' is number 3"):
        table.read_floats(("c",))
    assert table.clock("b", "s").t_ns.tolist() == [2_000_000_000] * 3
    assert table.clock("c", "s").known.tolist() == [True, False, True]


@given(
    st.lists(
        st.decimals(allow_nan=False, allow_infinity=False, places=9).map(str)
        | st.integers(-(10**20), 10**20).map(str)
        | st.sampled_from([*ODD_CELLS, "-.5", "-0.000001", "1e3", "1.²", "- 1", "-", "1_", "1_.5", str(-(2**63))]),
        min_size=1,
        max_size=3,
    ),
    st.sampled_from(sorted(TIME_EXPONENT)),
)
def test_plain_times_are_those_of_exact_decimals(cells: list[str], unit: str) -> None:
    exponent = TIME_EXPONENT[unit]
    plain_ns = _parse_plain(cells, 9 + exponent)
    if plain_ns is not None:
        assert plain_ns.tolist() == [_parse_number(cell, exponent) for cell in cells]


@pytest.mark.parametrize(("cell", "unit"), [("1700000000.123456789", "s"), ("-5", "us"), ("12.5", "ms"), (".5", "s")])
def test_usual_times_are_plain(cell: str, unit: str) -> None:
    assert _parse_plain([cell], 9 + TIME_EXPONENT[unit]) is not None
