"""What the writer and the reader of MCAP files share: heads of records as dtypes, gather and scatter, atomic files.

The record classes of the ``mcap`` package read and write all records but two: messages and message indexes, of which
a file has millions, go through the dtypes below as whole columns.
"""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.errors import BadFile

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
def atomic(path: Path) -> Iterator[IO[bytes]]:
    """Open a binary file that appears under its name whole, on disk, or not at all. Raises :class:`BadFile`."""
    target = path.resolve()
    if target.exists() and not target.is_file():
        raise BadFile(f"{path}: is there already and is no ordinary file; name another")
    temporary = target.with_name(f"{target.name}.{secrets.token_hex(4)}.part")
    try:
        with open(temporary, "xb", buffering=1 << 20) as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, target)
    except BaseException as error:
        temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise BadFile(
                f"{path}: cannot be written ({error.strerror}); check the disk and the folder {target.parent}"
            ) from error
        raise
    _sync_folder(target.parent)


def _sync_folder(folder: Path) -> None:
    """Make the new name itself durable; some file systems do not offer it, and the file is whole without."""
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError:
        return
    try:
        os.fsync(handle)
    except OSError:
        pass
    finally:
        os.close(handle)
