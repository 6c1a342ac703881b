"""The place of each number of a ROS message in its bytes, so that whole columns are read and written at once.

CDR (XCDR1, OMG DDSI-RTPS), the encoding of ROS 2, aligns each primitive to its own size, counted from the byte after
the 4-byte encapsulation; the encoding of ROS 1 has neither encapsulation nor alignment. In both, strings and sequences
carry a length word. Messages of one topic nearly always agree in these lengths: then every leaf has one offset, and a
numpy structured dtype views all messages. :class:`Layout` holds that dtype and the length words that a message must
have for the dtype to fit it. Leaves are named by their path: ``orientation.x``, ``name[0]``.
"""

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

PRIMITIVES = {
    "bool": "u1", "byte": "u1", "octet": "u1", "char": "u1", "uint8": "u1", "int8": "i1", "uint16": "u2", "int16": "i2",
    "uint32": "u4", "int32": "i4", "uint64": "u8", "int64": "i8", "float32": "f4", "float64": "f8",
}  # fmt: skip
_ENCAPSULATION = 4  # bytes before the body: 0, kind, and two of options
_MOST_LEAVES = 4096  # a message with more parts (a list of detections, say) is no table of numbers
_BUILTIN = {
    "builtin_interfaces/msg/Time": (("sec", "int32"), ("nanosec", "uint32")),
    "builtin_interfaces/msg/Duration": (("sec", "int32"), ("nanosec", "uint32")),
}


class Undecodable(Exception):
    """These bytes, or this type, have no layout; ``str`` says why."""


@dataclass(frozen=True)
class Layout:
    """The dtype of messages that agree with one message in all lengths."""

    dtype: np.dtype[Any]  # of the whole message, encapsulation included; one field per leaf
    words: tuple[tuple[int, bytes], ...]  # (offset, bytes): what a message must hold for the dtype to fit


@dataclass(frozen=True)
class MessageType:
    """A parsed message definition: its name and the fields of it and of every type it is made of."""

    name: str
    definitions: Mapping[str, Sequence[tuple[str, Any]]]
    encoding: str = "cdr"  # of its messages: cdr or ros1


@lru_cache(maxsize=1)
def _load_typestore() -> Any:
    return get_typestore(Stores.ROS2_HUMBLE)


@lru_cache(maxsize=64)
def get_definition(type_name: str) -> str:
    """Return the full concatenated ros2msg text of a common type, such as ``sensor_msgs/msg/Imu``."""
    return str(_load_typestore().generate_msgdef(type_name, ros_version=2)[0])


@lru_cache(maxsize=256)
def parse(type_name: str, encoding: str, text: str) -> MessageType:
    """Return the type that a schema's text describes (``ros2msg``, ``ros2idl`` or ``ros1msg``).

    Recorders write an empty text where they do not find the definition: a common type is then known by its name.
    Raises :class:`Undecodable`.
    """
    parts = type_name.split("/")
    name = "/".join((parts[0], "msg", parts[-1]))
    if encoding not in ("ros2msg", "ros2idl", "ros1msg"):
        raise Undecodable(f"its schema is {encoding or 'none'}, not ros2msg, ros2idl or ros1msg")
    wire = "ros1" if encoding == "ros1msg" else "cdr"
    if not text.strip():
        encoding, text = "ros2msg", _find_common_definition(name, wire)
    try:
        types = get_types_from_idl(text) if encoding == "ros2idl" else get_types_from_msg(text, name)
    except Exception as error:  # the parser raises many kinds of errors on damaged text
        raise Undecodable(f"its definition cannot be parsed ({' '.join(str(error).split())[:80]})") from error
    if name not in types:
        raise Undecodable(f"its schema does not define {name}")
    return MessageType(name, {key: tuple(fields) for key, (_, fields) in types.items()}, wire)


def _find_common_definition(name: str, wire: str) -> str:
    """Return the text of a common type; raises :class:`Undecodable` for any other."""
    store = get_typestore(Stores.ROS1_NOETIC) if wire == "ros1" else _load_typestore()
    if name not in store.fielddefs:
        raise Undecodable("its definition is empty, and it is no common type")
    return str(store.generate_msgdef(name, ros_version=1 if wire == "ros1" else 2)[0])


def find_layout(message_type: MessageType, body: bytes) -> Layout:
    """Return the layout that fits this message; raises :class:`Undecodable` for cut bytes and for other encodings."""
    ros1 = message_type.encoding == "ros1"
    if not ros1 and (len(body) < _ENCAPSULATION or body[0] != 0 or body[1] not in (0, 1)):
        raise Undecodable(f"its messages are not plain CDR (they start with {body[:2].hex() or 'nothing'})")
    order = "<" if ros1 or body[1] else ">"

    def length_at(leaf: str, offset: int, _: int) -> int:
        """Return the length word at an offset of the message; raises :class:`Undecodable` where it ends before."""
        try:
            return int(struct.unpack_from(order + "I", body, offset)[0])
        except struct.error:
            raise Undecodable(f"a message ends within {leaf}") from None

    layout = _Walk(order, length_at, size=len(body), ros1=ros1).layout(message_type)
    return layout if ros1 else Layout(layout.dtype, ((0, body[:2]), *layout.words))


def make_layout(message_type: MessageType, lengths: Mapping[str, int]) -> Layout:
    """Return the little-endian layout of a message to be written; lengths of strings include their NUL."""
    layout = _Walk("<", lambda leaf, _, empty: lengths.get(leaf, empty)).layout(message_type)
    return Layout(layout.dtype, ((0, b"\0\1"), *layout.words))


class _Walk:
    """Steps through a type, leaf by leaf, and notes where each lies."""

    def __init__(
        self, order: str, length_at: Callable[[str, int, int], int], size: int | None = None, ros1: bool = False
    ) -> None:
        """Begin at the start of a message; ``size`` is that of a message to read, None for one to be written."""
        self.order, self.length_at, self.size = order, length_at, size  # size: of a message that is there to be read
        self.aligned = not ros1
        self.terminated = int(not ros1)  # bytes after a string, which its length counts
        self.end = 0 if ros1 else _ENCAPSULATION
        self.offsets: dict[str, int] = {}  # of each leaf
        self.formats: list[Any] = []
        self.words: list[tuple[int, bytes]] = []

    def layout(self, message_type: MessageType) -> Layout:
        """Return the places of all leaves of a message of this type."""
        self._add_message(message_type.definitions, message_type.name, "", depth=0)
        size = self.end if self.size is None else self.size
        places = {"names": list(self.offsets), "offsets": list(self.offsets.values())}
        spec: Any = {**places, "formats": self.formats, "itemsize": size}
        return Layout(np.dtype(spec), tuple(self.words))

    def _add_message(
        self, definitions: Mapping[str, Sequence[tuple[str, Any]]], name: str, path: str, depth: int
    ) -> None:
        """Add the leaves of a type below a path; raises :class:`Undecodable` for a type that is not defined."""
        if depth > 32:
            raise Undecodable(f"the type {name} holds itself")
        if name in _BUILTIN and name not in definitions:
            for field, primitive in _BUILTIN[name]:
                self._add_leaf(f"{path}.{field}" if path else field, primitive, None)
            return
        if name not in definitions:
            raise Undecodable(f"its schema does not define {name}")
        if not definitions[name] and self.aligned:  # CDR sends a type without fields as one byte
            self._add_leaf(f"{path}.structure_needs_at_least_one_member", "uint8", None)
        for field, node in definitions[name]:
            self._add_node(definitions, node, f"{path}.{field}" if path else field, depth)

    def _add_node(self, definitions: Mapping[str, Sequence[tuple[str, Any]]], node: Any, path: str, depth: int) -> None:
        """Add a field below a path: a message, a primitive, or an array or sequence of these."""
        kind, detail = node
        if kind == Nodetype.NAME:
            self._add_message(definitions, detail, path, depth + 1)
        elif kind == Nodetype.BASE:
            self._add_leaf(path, detail[0], None)
        else:
            inner, count = detail
            if kind == Nodetype.SEQUENCE:
                count = self._find_length(path, empty=0)
            if inner[0] == Nodetype.BASE and inner[1][0] in PRIMITIVES:
                self._add_leaf(path, inner[1][0], count)
                return
            if count > _MOST_LEAVES:
                raise Undecodable(f"a message has {count} elements in {path}")
            for k in range(count):
                self._add_node(definitions, inner, f"{path}[{k}]", depth)

    def _find_length(self, path: str, empty: int) -> int:
        """Return the length word of a string or sequence; an empty string in CDR has 1 for its NUL."""
        self._align(4)
        length = self.length_at(path, self.end, empty)
        self.words.append((self.end, struct.pack(self.order + "I", length)))
        self.end += 4
        return length

    def _add_leaf(self, path: str, primitive: str, count: int | None) -> None:
        """Place one primitive, ``count`` of them in a row, or a string."""
        if primitive == "string":
            length = self._find_length(path, empty=1)
            self._add_place(path, f"S{max(length - self.terminated, 0)}", length)
            return
        if primitive not in PRIMITIVES:
            raise Undecodable(f"its field {path} is of type {primitive}")
        dtype = np.dtype(self.order + PRIMITIVES[primitive])
        if count != 0:  # an empty sequence is not followed by padding
            self._align(dtype.itemsize)
        size = dtype.itemsize * (1 if count is None else count)
        self._add_place(path, dtype if count is None else (dtype, (count,)), size)

    def _align(self, size: int) -> None:
        """Move the end to a multiple of a size, as CDR does and ROS 1 does not."""
        if self.aligned:
            self.end += -(self.end - _ENCAPSULATION) % size

    def _add_place(self, path: str, form: Any, size: int) -> None:
        """Give a leaf the next place.

        Raises :class:`Undecodable` beyond the end of the message, or for a second one.
        """
        if self.size is not None and self.end + size > self.size:
            raise Undecodable(f"a message ends within {path}")
        if len(self.offsets) >= _MOST_LEAVES:
            raise Undecodable(f"a message has more than {_MOST_LEAVES} parts")
        if path in self.offsets:
            raise Undecodable(f"its schema defines {path} twice")
        self.formats.append(form)
        self.offsets[path] = self.end
        self.end += size
