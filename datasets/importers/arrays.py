"""Arrays of MATLAB and HDF5 files: real numbers only, and no more memory than the file justifies."""

import math
import struct
import zlib
from collections.abc import Collection
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.io

from stillpoint.datasets.errors import BadSource
from stillpoint.datasets.files.limits import LARGEST_MEMBER, limited
from stillpoint.datasets.recording import Floats

HEADER, MATRIX, COMPRESSED = 128, 14, 15  # of MATLAB 5 files: bytes before the first element, kinds of elements
HOLDS_ARRAYS, SPARSE = (1, 2, 3), 5  # classes of arrays: cells, structs, objects
DEEPEST = 32  # levels of arrays within arrays; a Qualisys export has four


def read_array(dataset: Any, path: Path) -> Floats:
    """Return an HDF5 data set as float64; raises :class:`BadSource` for one that claims too much or is not real."""
    if not isinstance(dataset, h5py.Dataset):
        raise BadSource(f"{path}: {dataset.name} is no array; download the file again")
    claimed = int(np.prod([float(n) for n in dataset.shape])) * 8
    if claimed > limited(LARGEST_MEMBER):
        raise BadSource(f"{path}: {dataset.name} claims {claimed} bytes; give --large if this is right")
    return to_floats(dataset[()], f"{path}: {dataset.name}")


def load_mat(path: Path, names: Collection[str] | None = None, **options: Any) -> dict[str, Any]:
    """Return the variables of a MATLAB file of version 4 to 7; None of ``names`` gives all."""
    _check_mat(path.read_bytes())
    found: dict[str, Any] = scipy.io.loadmat(path, variable_names=None if names is None else list(names), **options)
    return {key: value for key, value in found.items() if not key.startswith("__")}


def _check_mat(data: bytes) -> None:
    """Raise ``ValueError`` where an array in a MATLAB 5 file claims more elements than its bytes can hold.

    The loader makes room for what is claimed before it reads, element by element.
    """
    if len(data) < HEADER or data[126:128] not in (b"IM", b"MI"):
        return  # of another version
    _walk_elements(data, HEADER, len(data), "<" if data[126:128] == b"IM" else ">", 0)


def _walk_elements(data: bytes, at: int, end: int, order: str, depth: int) -> None:
    if depth > DEEPEST:
        raise ValueError("its arrays are nested too deeply")
    while at + 8 <= end:
        kind, size = struct.unpack_from(f"{order}II", data, at)
        body = at + 8
        if kind >> 16:  # a small element, within its tag
            at = body
            continue
        if body + size > end:
            raise ValueError("an element claims more bytes than there are")
        if kind == COMPRESSED:
            longest = limited(LARGEST_MEMBER)
            inner = zlib.decompressobj().decompress(data[body : body + size], longest + 1)
            if len(inner) > longest:
                raise ValueError(f"an element unpacks to more than {longest} bytes; give --large if this is right")
            _walk_elements(inner, 0, len(inner), order, depth + 1)
        elif kind == MATRIX and size:
            _check_matrix(data, body, body + size, order, depth + 1)
        at = body + size + (0 if kind == COMPRESSED else -size % 8)


def _check_matrix(data: bytes, at: int, end: int, order: str, depth: int) -> None:
    """Check the size of one array, and walk through what it holds: flags, dimensions, name, values."""
    if at + 24 > end:
        raise ValueError("an array ends within its head")
    kind = struct.unpack_from(f"{order}I", data, at + 8)[0] & 0xFF
    tag, size = struct.unpack_from(f"{order}II", data, at + 16)
    begin, size = (at + 20, tag >> 16) if tag >> 16 else (at + 24, size)
    if begin + size > end:
        raise ValueError("an array ends within its dimensions")
    count = math.prod(struct.unpack_from(f"{order}{size // 4}i", data, begin))
    room = (end - at) // (8 if kind in HOLDS_ARRAYS else 1)
    if kind != SPARSE and not 0 <= count <= room:
        raise ValueError(f"an array claims {count} elements where {end - at} bytes are left")
    _walk_elements(data, at + 16, end, order, depth)


def to_floats(values: Any, where: str) -> Floats:
    """Return real numbers as float64; raises :class:`BadSource` for complex numbers, text and objects."""
    array = np.asarray(values)
    if array.dtype.kind not in "biuf":
        kind = "complex numbers" if array.dtype.kind == "c" else "no numbers"
        raise BadSource(f"{where}: holds {kind}; export real numbers")
    return np.ascontiguousarray(array, dtype=np.float64)
