"""Arrays in a temporary file without a name: what several passes need, and the memory may not hold."""

import tempfile
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

IN_MEMORY = 8 << 20  # bytes that are held before a file is used


class ScratchStore:
    """Keeps arrays of one type and gives them again, in their order and lengths.

    The file lies in the folder for temporary files (``TMPDIR``) and is gone with this object, or with the process.
    Raises ``OSError`` when that folder is full.
    """

    def __init__(self) -> None:
        self._file = tempfile.SpooledTemporaryFile(IN_MEMORY)  # noqa: SIM115
        self._dtype: np.dtype[Any] = np.dtype(np.float64)
        self._shapes: list[tuple[int, ...]] = []

    def append(self, rows: NDArray[Any]) -> None:
        """Keep one more array."""
        self._dtype = rows.dtype
        self._file.seek(0, 2)
        self._file.write(np.ascontiguousarray(rows).tobytes())
        self._shapes.append(rows.shape)

    def __iter__(self) -> Iterator[NDArray[Any]]:
        """Yield all arrays, from the first; several passes can run side by side."""
        at = 0
        for shape in self._shapes:
            size = int(np.prod(shape)) * self._dtype.itemsize
            self._file.seek(at)
            yield np.frombuffer(self._file.read(size), self._dtype).reshape(shape)
            at += size
