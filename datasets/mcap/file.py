"""The parts that the writer and the reader of MCAP files share: heads of records, gather and scatter, atomic files.

The record classes of the ``mcap`` package read and write all records but two: messages and message indexes, of which
a file has millions, go through the dtypes below as whole columns.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.errors import BadFile
from stillpoint.datasets.files.atomic import write_atomically

MAGIC = b"\x89MCAP0\r\n"
RECORD_HEAD = np.dtype([("opcode", "u1"), ("length", "<u8")])
MESSAGE_HEAD = np.dtype(
    [*RECORD_HEAD.descr, ("channel", "<u2"), ("sequence", "<u4"), ("log_time", "<u8"), ("publish_time", "<u8")]
)
INDEX_ENTRY = np.dtype([("log_time", "<u8"), ("offset", "<u8")])
FOOTER_SIZE = RECORD_HEAD.itemsize + 20 + len(MAGIC)  # the footer record and the magic that ends the file


def windows(buffer: Any, size: int) -> NDArray[np.void]:
    """Return every run of ``size`` bytes of a buffer as an overlapping array; indexing it copies whole records."""
    count = max(len(buffer) - size + 1, 0)
    return np.ndarray((count,), np.dtype((np.void, size)), buffer=buffer, strides=(1,))


def find_step(offsets: NDArray[np.int64]) -> int:
    """Return the bytes between neighbouring offsets; 0 where they differ, or where there are none."""
    if len(offsets) < 2:
        return 0
    step = int(offsets[1] - offsets[0])
    return step if bool((np.diff(offsets) == step).all()) else 0


def take_records(buffer: Any, size: int, offsets: NDArray[np.int64]) -> NDArray[np.void]:
    """Return the ``size`` bytes at each offset: a view where the offsets rise evenly, else a copy.

    The messages of one topic nearly always lie evenly in a chunk. Raises ``IndexError`` for offsets beyond the buffer.
    """
    step = find_step(offsets)
    if step <= 0:
        return windows(buffer, size)[offsets]
    if offsets[0] < 0 or offsets[-1] + size > len(buffer):
        raise IndexError(f"records of {size} bytes from {offsets[0]} to {offsets[-1]} in {len(buffer)} bytes")
    return np.ndarray((len(offsets),), np.dtype((np.void, size)), buffer, int(offsets[0]), (step,))


@contextmanager
def write_file(path: Path, leaves_cache: bool = False) -> Iterator[IO[bytes]]:
    """Open a binary file that appears under its name whole, on disk, or not at all.

    ``leaves_cache`` is that of :func:`~stillpoint.datasets.files.atomic.write_atomically`. Raises :class:`BadFile`.
    """
    target = path.resolve()
    if target.exists() and not target.is_file():
        raise BadFile(f"{path}: is there already and is not an ordinary file; name another")
    try:
        with write_atomically(path, leaves_cache) as file:
            yield file
    except OSError as error:
        raise BadFile(
            f"{path}: cannot be written ({error.strerror}); check the disk and the folder {target.parent}"
        ) from error
