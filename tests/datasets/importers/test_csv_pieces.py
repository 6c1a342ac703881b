"""A long log that is imported in pieces gives the bytes of one that is read whole."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from stillpoint.datasets.errors import BadSource
from stillpoint.datasets.importers import csv_pieces
from stillpoint.datasets.importers.csv_log import CsvOptions
from stillpoint.datasets.importers.csv_pieces import read_csv_pieces
from stillpoint.datasets.importers.table import IMPORTERS
from stillpoint.datasets.mcap.store import write, write_pieces

OPTIONS = CsvOptions(time="t:s", gyro="gx,gy,gz:deg/s", accel="ax,-ay,az:g", mag="mx,my,mz:uT", place="48,11")
HEADER = "t,gx,gy,gz,ax,ay,az,mx,my,mz"


@pytest.fixture(autouse=True)
def _small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(csv_pieces, "PIECE_BYTES", 20_000)


def _make_rows(n: int = 3000, first_s: float = 1_700_000_000.0) -> list[list[str]]:
    """Rows of a level sensor at 100 Hz, whose magnetometer has a value in every second row."""
    rng = np.random.default_rng(8)
    gyro, accel = rng.normal(size=(n, 3)), rng.normal([0.0, 0.0, 1.0], 0.001, (n, 3))
    mag = rng.normal([0.0, 20.0, -44.0], 1.0, (n, 3))
    return [
        [f"{first_s + k / 100:.4f}", *(f"{x:.6f}" for x in (*gyro[k], *accel[k])),
         *(f"{x:.3f}" if k % 2 else "" for x in mag[k])]
        for k in range(n)
    ]  # fmt: skip


def _write_log(folder: Path, rows: list[list[str]], before: str = f"{HEADER}\n", end: str = "\n") -> Path:
    file = folder / "log.csv"
    file.write_text(before + end.join(",".join(row) for row in rows) + end, newline="")
    return file


def _same_bytes(folder: Path, file: Path, options: CsvOptions) -> bool:
    """Return whether the log comes in pieces; then its file must be that of the whole."""
    long = read_csv_pieces(file, options)
    if long is None:
        return False
    write(folder / "whole.mcap", IMPORTERS["csv"].read_one(file, options).recording)
    write_pieces(folder / "pieces.mcap", long.head, long.pieces)
    assert len(list(long.pieces())) > 5
    assert (folder / "pieces.mcap").read_bytes() == (folder / "whole.mcap").read_bytes()
    return True


@pytest.mark.slow
@pytest.mark.parametrize("before", [f"{HEADER}\n", f"Device 7\nApp 2\n\n{HEADER}\ns,,,,,,,,,\n", f"# note\n{HEADER}\n"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_log_in_pieces_has_the_bytes_of_the_whole(tmp_path: Path, before: str, end: str) -> None:
    assert _same_bytes(tmp_path, _write_log(tmp_path, _make_rows(), before, end), OPTIONS)


@pytest.mark.slow
def test_blank_lines_comments_and_rows_without_a_gyro_are_counted_over_all_pieces(tmp_path: Path) -> None:
    rows = _make_rows()
    rows[1000:1000] = [[""], ["# a mark"]]
    for k in (5, 777, 2900):
        rows[k][1:7] = [""] * 6
    file = _write_log(tmp_path, rows)
    assert _same_bytes(tmp_path, file, OPTIONS)
    long = read_csv_pieces(file, OPTIONS)
    assert long is not None
    assert "gyro: 3 of 3000 rows without a number dropped" in long.head.info.notes


def _step_back(rows: list[list[str]]) -> None:
    rows[1500][0] = rows[1400][0]


def _lose_accel(rows: list[list[str]]) -> None:
    rows[700][4] = ""


def _quote(rows: list[list[str]]) -> None:
    rows[2000][1] = f'"{rows[2000][1]}"'


def _write_text(rows: list[list[str]]) -> None:
    rows[2500][2] = "lost"


def _jump(rows: list[list[str]]) -> None:
    for row in rows[2990:]:
        row[0] = str(float(row[0]) + 90_000)


@pytest.mark.parametrize("spoil", [_step_back, _lose_accel, _quote, _write_text, _jump])
def test_what_only_the_whole_can_tell_is_left_to_it(tmp_path: Path, spoil: Callable[[list[list[str]]], None]) -> None:
    rows = _make_rows()
    spoil(rows)
    assert read_csv_pieces(_write_log(tmp_path, rows), OPTIONS) is None


def test_wrong_units_are_refused_as_of_the_whole(tmp_path: Path) -> None:
    file = _write_log(tmp_path, _make_rows())
    wrong = CsvOptions(**{**vars(OPTIONS), "accel": "ax,ay,az:m/s2"})
    with pytest.raises(BadSource) as pieces:
        read_csv_pieces(file, wrong)
    with pytest.raises(BadSource) as whole:
        IMPORTERS["csv"].read_one(file, wrong)
    assert str(pieces.value) == str(whole.value)


@pytest.mark.parametrize("given", [{"rate": 100.0, "time": None}, {"gps": "mx,my"}, {"truth": "gx,gy,gz,ax"}])
def test_other_clocks_fixes_and_truths_need_the_whole(tmp_path: Path, given: dict[str, object]) -> None:
    file = _write_log(tmp_path, _make_rows())
    assert read_csv_pieces(file, CsvOptions(**{**vars(OPTIONS), **given})) is None
