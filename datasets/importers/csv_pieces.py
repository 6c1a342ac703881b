"""A long delimited log in pieces: the recording that :func:`~stillpoint.datasets.importers.csv_log.read_csv` makes.

Each piece of the text is read as a log of its own. That gives the same recording where nothing depends on the whole:
one rising clock, gyro and accelerometer on the same rows, no satellite fixes and no truth. Whatever else a piece shows
(a clock to be mended, quotes, an error) is left to the reading of the whole, which needs memory for the whole.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.errors import BadRecording, BadSource, StillpointError
from stillpoint.datasets.files.scratch import ScratchStore
from stillpoint.datasets.importers.csv_log import CsvOptions, read_csv_table
from stillpoint.datasets.importers.delimited import Table, parse, take_rows
from stillpoint.datasets.importers.delimited_log import apply_config, note_skipped
from stillpoint.datasets.importers.files import digests
from stillpoint.datasets.importers.options import apply_place_and_date, make_info
from stillpoint.datasets.importers.series import Log
from stillpoint.datasets.plausible import UnitCheck
from stillpoint.datasets.recording import Head, Imu, Mag, Piece, Recording
from stillpoint.datasets.running import ClockFacts, RunningClock
from stillpoint.datasets.times import GAP_STEPS

PIECE_BYTES = 8 << 20  # of text that is read at once
_LONGEST_STEP_NS = 3 * 3_600_000_000_000  # a longer one may be a stamp that is wrong, which the whole tells
_RATES_HZ = (4.0, 15_000.0)  # well within those that the whole allows
_LONGEST_NS = 30 * 86_400_000_000_000


class _NotInPiecesError(Exception):
    """Something depends on the whole of the log."""


@dataclass(frozen=True)
class LongRecording:
    """A recording that lies in temporary files, piece by piece."""

    head: Head
    clocks: dict[str, ClockFacts]  # of each stream
    _imu: ScratchStore
    _mag: ScratchStore

    def pieces(self) -> Iterator[Piece]:
        """Yield the pieces; can be called several times."""
        for imu, mag in zip(self._imu, self._mag, strict=True):
            yield Piece(
                imu=Imu(imu[:, 0].view(np.int64), imu[:, 1:4].view(np.float64), imu[:, 4:7].view(np.float64)),
                mag=Mag(mag[:, 0].view(np.int64), mag[:, 1:4].view(np.float64)) if len(mag) else None,
            )


def read_csv_pieces(file: Path, options: CsvOptions) -> LongRecording | None:
    """Return the recording of a log, in memory that does not grow with it; None where it has to be read whole.

    Raises :class:`BadSource` for sizes that do not fit the units.
    """
    given = apply_config(options)
    others = (given.gps, given.truth, given.truth_euler, given.gyro_time, given.accel_time, given.mag_time, given.rate)
    if any(one is not None for one in others):
        return None
    try:
        return _Reader(file, given).read()
    except BadSource as error:
        if isinstance(error.__cause__, BadRecording):
            raise
        return None
    except (StillpointError, UnicodeDecodeError, _NotInPiecesError):
        return None


class _Reader:
    """Reads one log."""

    def __init__(self, file: Path, options: CsvOptions) -> None:
        self._file, self._options = file, options
        self._log = Log()  # of the whole
        self._conversions: list[str] = []  # of the first piece, and so of each
        self._rows, self._lost = 0, dict.fromkeys(("gyro", "accel", "mag"), 0)
        self._clocks: dict[str, RunningClock] = {}
        self._ends_ns: dict[str, int] = {}
        self._imu, self._mag = ScratchStore(), ScratchStore()
        self._units = UnitCheck(file.stem, options.mag_uncalibrated)
        self._first: Recording | None = None

    def read(self) -> LongRecording:
        for table in self._list_tables():
            self._add(table)
        return self._close()

    def _list_tables(self) -> Iterator[Table]:
        """Yield the rows in pieces, as tables with the columns of the whole."""
        texts = _read_lines(self._file)
        begin = next(texts)
        whole = parse(begin + _read_end(self._file), str(self._file), self._options.delimiter)
        note_skipped(whole, self._file, self._log)
        first_line, done = whole.lines[0], 0
        for text in _chain(begin, texts):
            table = take_rows(text, whole, first_line, done)
            done += len(text.splitlines())
            if len(table.rows):
                yield table

    def _add(self, table: Table) -> None:
        """Read one piece, and keep its samples."""
        log = Log()
        recording = read_csv_table(table, self._file, self._options, log)
        assert recording.imu is not None
        if len(log.notes) > len(log.dropped) or log.is_resampled:
            raise _NotInPiecesError
        if self._first is None:
            self._first, self._conversions = recording, log.conversions
        if log.conversions != self._conversions or (recording.mag is None) != (self._first.mag is None):
            raise _NotInPiecesError
        for name, t_ns in recording.streams():
            before_ns = self._ends_ns.get(name, int(t_ns[0]) - 1)
            if t_ns[0] <= before_ns or np.diff(t_ns, prepend=before_ns).max() > _LONGEST_STEP_NS:
                raise _NotInPiecesError
            self._ends_ns[name] = int(t_ns[-1])
            self._clocks.setdefault(name, RunningClock(GAP_STEPS)).add(t_ns)
        self._rows += len(table.rows)
        for what, lost in log.dropped.items():
            self._lost[what] += lost
        imu, mag = recording.imu, recording.mag
        if not self._options.units_unchecked:
            self._units.add(imu, mag)
        self._imu.append(_pack(imu.t_ns, imu.gyro_b_radps, imu.accel_b_mps2))
        self._mag.append(np.empty((0, 4), np.int64) if mag is None else _pack(mag.t_ns, mag.mag_b_ut))

    def _close(self) -> LongRecording:
        """Return the recording with the facts of the whole."""
        if self._first is None or self._first.imu is None:
            raise _NotInPiecesError
        clocks = {name: clock.facts() for name, clock in self._clocks.items()}
        imu = clocks["imu"]
        span_ns = max(one.last_ns for one in clocks.values()) - min(one.first_ns for one in clocks.values())
        apart = any(one.first_ns > imu.last_ns or one.last_ns < imu.first_ns for one in clocks.values())
        if apart or span_ns > _LONGEST_NS or not _RATES_HZ[0] <= 1e9 / max(imu.step_ns, 1.0) <= _RATES_HZ[1]:
            raise _NotInPiecesError
        if not self._options.units_unchecked:
            try:
                self._units.raise_doubt()
            except BadRecording as error:
                raise BadSource(f"{self._file}: {error}") from error
        for line in self._conversions:
            self._log.converted(line)
        for what, lost in self._lost.items():
            self._log.dropped_rows(what, lost, self._rows)
        sha256 = digests([self._file], self._file.parent)
        info = make_info(f"delimited log {self._file.name}", self._options, self._first.imu.t_ns, sha256, self._log)
        info = apply_place_and_date(replace(self._first, info=replace(info, units_unchecked=True)), self._options)
        info = replace(info, units_unchecked=self._options.units_unchecked)
        samples = {name: one.samples for name, one in clocks.items()}
        return LongRecording(Head(self._file.stem, info, samples), clocks, self._imu, self._mag)


def _pack(t_ns: NDArray[np.int64], *columns: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return stamps and columns (N, k) side by side, as the bits of integers."""
    return np.column_stack([t_ns, *(np.ascontiguousarray(column).view(np.int64) for column in columns)])


def _read_lines(file: Path) -> Iterator[str]:
    """Yield the text of a file in UTF-8, cut behind line ends."""
    with open(file, "rb") as opened:
        rest, encoding = b"", "utf-8-sig"
        while data := opened.read(PIECE_BYTES):
            end = data.rfind(b"\n") + 1
            whole, rest = (rest + data[:end], data[end:]) if end else (b"", rest + data)
            if b'"' in data or b"\0" in data:
                raise _NotInPiecesError
            if whole:
                yield whole.decode(encoding)
                encoding = "utf-8"
        if rest:
            yield rest.decode(encoding)


def _read_end(file: Path) -> str:
    """Return the last whole lines of a file."""
    with open(file, "rb") as opened:
        size = opened.seek(0, 2)
        opened.seek(max(size - (64 << 10), 0))
        return opened.read().partition(b"\n")[2].decode()


def _chain(first: str, others: Iterator[str]) -> Iterator[str]:
    yield first
    yield from others
