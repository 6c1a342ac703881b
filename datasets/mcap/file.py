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


@contextmanager
def write_file(path: Path) -> Iterator[IO[bytes]]:
    """Open a binary file that appears under its name whole, on disk, or not at all. Raises :class:`BadFile`."""
    target = path.resolve()
    if target.exists() and not target.is_file():
        raise BadFile(f"{path}: is there already and is no ordinary file; name another")
    try:
        with write_atomically(path) as file:
            yield file
    except OSError as error:
        raise BadFile(
            f"{path}: cannot be written ({error.strerror}); check the disk and the folder {target.parent}"
        ) from error
