"""MATLAB files of version 5 to 7, read in Python: numbers, text, cells and structs.

The loader of scipy trusts what a file claims: damaged files make it reserve room for minutes, or crash the process.
Here every length is checked against the bytes that are there before anything is made of it.
"""

import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stillpoint.datasets.files.limits import LARGEST_MEMBER, raise_limit

_HEADER = 128  # bytes before the first element
_MATRIX, _COMPRESSED = 14, 15  # types of elements that hold others
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_ENCODINGS = {1: "latin-1", 2: "utf-8", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}  # of text, by type
_CELL, _STRUCT, _OBJECT, _CHARACTERS, _FIRST_NUMERIC, _LAST_NUMERIC = 1, 2, 3, 4, 6, 15  # classes of arrays
_COMPLEX = 0x0800  # flag of an array that has an imaginary part
_DEEPEST = 32  # levels of arrays within arrays; a Qualisys export has four


def load_mat(path: Path) -> dict[str, Any]:
    """Return the variables of a file by name.

    Numbers become arrays in their MATLAB shape, text a ``str``, a struct a ``dict`` (several of them a list), a cell a
    list; other classes become None. Raises ``ValueError`` for a damaged file, and for one of another version.
    """
    data = path.read_bytes()
    if len(data) < _HEADER or data[126:128] not in (b"IM", b"MI"):
        raise ValueError("it is no MATLAB file of version 5 to 7; save it with -v7")
    order = "<" if data[126:128] == b"IM" else ">"
    found = {}
    for element in _iterate_elements(data, _HEADER, len(data), order):
        for array in _unpack(element, order):
            name, value = _read_array(array, order, 0)
            found[name] = value
    return found


@dataclass(frozen=True)
class _Element:
    """One element: its type and its bytes."""

    kind: int
    data: bytes


def _iterate_elements(data: bytes, at: int, end: int, order: str) -> Iterator[_Element]:
    """Yield the elements between two offsets of a MAT-file; raises ``ValueError`` for one that claims too much."""
    while at + 8 <= end:
        kind, size = struct.unpack_from(f"{order}II", data, at)
        if kind >> 16:  # a small element, within its tag
            if kind >> 16 > 4:
                raise ValueError("a small element claims more than its four bytes")
            yield _Element(kind & 0xFFFF, data[at + 4 : at + 4 + (kind >> 16)])
            at += 8
            continue
        if at + 8 + size > end:
            raise ValueError("an element claims more bytes than there are")
        yield _Element(kind, data[at + 8 : at + 8 + size])
        at += 8 + size + (0 if kind == _COMPRESSED else -size % 8)


def _unpack(element: _Element, order: str) -> Iterator[bytes]:
    """Yield the arrays in an element, which may be compressed."""
    if element.kind == _MATRIX:
        yield element.data
    elif element.kind == _COMPRESSED:
        longest = raise_limit(LARGEST_MEMBER)
        inner = zlib.decompressobj().decompress(element.data, longest + 1)
        if len(inner) > longest:
            raise ValueError(f"an element unpacks to more than {longest} bytes; give --large if this is right")
        for part in _iterate_elements(inner, 0, len(inner), order):
            if part.kind == _MATRIX:
                yield part.data


def _read_array(data: bytes, order: str, depth: int) -> tuple[str, Any]:
    """Return name and value of an array."""
    if not data:
        return "", np.empty((0, 0))
    if depth > _DEEPEST:
        raise ValueError("its arrays are nested too deeply")
    parts = list(_iterate_elements(data, 0, len(data), order))
    if len(parts) < 3 or len(parts[0].data) < 8 or len(parts[1].data) % 4:
        raise ValueError("an array ends within its head")
    flags = struct.unpack_from(f"{order}I", parts[0].data)[0]
    shape = struct.unpack(f"{order}{len(parts[1].data) // 4}i", parts[1].data)
    if len(shape) < 2 or min(shape) < 0:
        raise ValueError(f"an array has the shape {shape}")
    return parts[2].data.decode("latin-1"), _read_value(flags, shape, parts[3:], order, depth)


def _read_value(flags: int, shape: tuple[int, ...], parts: list[_Element], order: str, depth: int) -> Any:
    """Return an array of a MAT-file by its class: a list for cells, mappings for structures, text, or numbers."""
    kind, count = flags & 0xFF, math.prod(shape)
    if kind == _CELL:
        if count != len(parts):
            raise ValueError(f"a cell claims {count} elements and has {len(parts)}")
        return [_read_array(part.data, order, depth + 1)[1] for part in parts]
    if kind in (_STRUCT, _OBJECT):
        return _read_structs(count, parts[kind == _OBJECT :], order, depth)
    if kind == _CHARACTERS:
        return "" if not parts or not count else _read_text(parts[0], order)
    if not _FIRST_NUMERIC <= kind <= _LAST_NUMERIC:
        return None
    values = [_read_numbers(part, shape, order) for part in parts[: 2 if flags & _COMPLEX else 1]]
    if not values:
        raise ValueError("an array has no values")
    return values[0] if len(values) == 1 else values[0] + 1j * values[1]


def _read_numbers(part: _Element, shape: tuple[int, ...], order: str) -> np.ndarray:
    """Return an element as an array of this shape; raises ``ValueError`` where its size differs."""
    if part.kind not in _NUMBERS:
        raise ValueError(f"an array of numbers holds elements of type {part.kind}")
    dtype = np.dtype(order + _NUMBERS[part.kind])
    if math.prod(shape) * dtype.itemsize != len(part.data):
        raise ValueError(f"an array claims {math.prod(shape)} elements and has {len(part.data) // dtype.itemsize}")
    return np.frombuffer(part.data, dtype).reshape(shape, order="F")


def _read_text(part: _Element, order: str) -> str:
    """Return an element as text, in the encoding that its type states."""
    encoding = _ENCODINGS.get(part.kind, "latin-1")
    if encoding in ("utf-16", "utf-32"):
        encoding += "-le" if order == "<" else "-be"
    return part.data.decode(encoding, "replace")


def _read_structs(count: int, parts: list[_Element], order: str, depth: int) -> Any:
    """Return a struct as a mapping, or several as a list of mappings."""
    if len(parts) < 2 or len(parts[0].data) < 4:
        raise ValueError("a struct has no names of fields")
    length = struct.unpack_from(f"{order}i", parts[0].data)[0]
    if length <= 0 or len(parts[1].data) % length:
        raise ValueError("the names of a struct's fields make no sense")
    text = parts[1].data
    names = [text[k : k + length].split(b"\0")[0].decode("latin-1") for k in range(0, len(text), length)]
    values = parts[2:]
    if count * max(len(names), 1) > max(len(values), 1) or len(values) != count * len(names):
        raise ValueError(f"a struct claims {count} elements of {len(names)} fields and has {len(values)} values")
    structs = []
    for k in range(count):
        own = values[k * len(names) : (k + 1) * len(names)]
        structs.append(
            {name: _read_array(part.data, order, depth + 1)[1] for name, part in zip(names, own, strict=True)}
        )
    return structs[0] if count == 1 else structs
