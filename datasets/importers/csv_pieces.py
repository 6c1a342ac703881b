"""A long delimited log in pieces: the recording that :func:`~stillpoint.datasets.importers.csv_log.read_csv` makes.

Each piece of the text is read as a log of its own. That gives the same recording where nothing depends on the whole:
one rising clock, gyro and accelerometer on the same rows, no satellite fixes and no truth. Whatever else a piece shows
(a clock to be mended, quotes, an error) is left to the reading of the whole, which needs memory for the whole.
"""

from collections.abc import Iterator
from itertools import chain
from pathlib import Path

from stillpoint.datasets.errors import BadRecording, BadSource, StillpointError
from stillpoint.datasets.importers.csv_log import CsvOptions, read_csv_table
from stillpoint.datasets.importers.delimited import Table, parse, take_rows
from stillpoint.datasets.importers.delimited_log import apply_config, note_skipped
from stillpoint.datasets.importers.files import hash_files
from stillpoint.datasets.importers.long_recording import Collector, LongRecording, NotInPiecesError
from stillpoint.datasets.importers.series import Log

PIECE_BYTES = 8 << 20  # of text that is read at once


def read_csv_pieces(file: Path, options: CsvOptions) -> LongRecording | None:
    """Return the recording of a log, in memory that does not grow with it; None where it has to be read whole.

    Raises :class:`BadSource` for sizes that do not fit the units.
    """
    given = apply_config(options)
    others = (given.gps, given.truth, given.truth_euler, given.gyro_time, given.accel_time, given.mag_time, given.rate)
    if any(one is not None for one in others):
        return None
    try:
        return _read_long(file, given)
    except BadSource as error:
        if isinstance(error.__cause__, BadRecording):
            raise
        return None
    except (StillpointError, UnicodeDecodeError, NotInPiecesError):
        return None


def _read_long(file: Path, options: CsvOptions) -> LongRecording:
    """Read a log piece by piece; raises :class:`NotInPiecesError` for one that has to be in memory whole."""
    log, found = Log(), Collector(file.stem, options)
    rows, lost = 0, dict.fromkeys(("gyro", "accel", "mag"), 0)
    for table in _list_tables(file, options, log):
        of_piece = Log()
        recording = read_csv_table(table, file, options, of_piece)
        if len(of_piece.notes) > len(of_piece.dropped) or of_piece.is_resampled:
            raise NotInPiecesError
        found.add(recording, of_piece)
        rows += len(table.rows)
        for what, count in of_piece.dropped.items():
            lost[what] += count
    for line in found.conversions:
        log.add_conversion(line)
    for what, count in lost.items():
        log.count_dropped_rows(what, count, rows)
    return found.close(f"delimited log {file.name}", str(file), hash_files([file], file.parent), log)


def _list_tables(file: Path, options: CsvOptions, log: Log) -> Iterator[Table]:
    """Yield the rows in pieces, as tables with the columns of the whole."""
    texts = _read_lines(file)
    begin = next(texts)
    whole = parse(begin + _read_end(file), str(file), options.delimiter)
    note_skipped(whole, file, log)
    first_line, done = whole.lines[0], 0
    for text in chain([begin], texts):
        table, lines = take_rows(text, whole, first_line, done)
        done += lines
        if len(table.rows):
            yield table


def _read_lines(file: Path) -> Iterator[str]:
    """Yield the text of a file in UTF-8, cut behind line ends."""
    with open(file, "rb") as opened:
        rest, encoding = b"", "utf-8-sig"
        while data := opened.read(PIECE_BYTES):
            end = data.rfind(b"\n") + 1
            whole, rest = (rest + data[:end], data[end:]) if end else (b"", rest + data)
            if b'"' in data or b"\0" in data:
                raise NotInPiecesError
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
