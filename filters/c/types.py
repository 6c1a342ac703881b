"""The types of the compiled steps as C types: numbers, tuples, named tuples and arrays of a known shape."""

import inspect
import re
from dataclasses import dataclass, field
from math import prod
from typing import Any, TypeAlias

import numpy as np


@dataclass(frozen=True)
class Scalar:
    """A number or a truth value by its name in C."""

    name: str


REAL, INT, BOOL, NOTHING = Scalar("sp_real"), Scalar("int"), Scalar("bool"), Scalar("void")


@dataclass(frozen=True)
class Array:
    """An array of reals, passed by address; ``shape`` has one or two lengths."""

    shape: tuple[int, ...]


@dataclass(frozen=True)
class Tuple:
    """A tuple, in C a structure with an array ``v`` where all parts have one type."""

    parts: "tuple[CType, ...]"

    @property
    def is_even(self) -> bool:
        """Whether all parts have one type."""
        return len(set(self.parts)) == 1


@dataclass(frozen=True)
class Struct:
    """A named tuple; ``names`` and ``parts`` are those of the fields that C keeps."""

    of: type
    names: tuple[str, ...]
    parts: "tuple[CType, ...]"


CType: TypeAlias = Scalar | Array | Tuple | Struct


def type_of(value: Any) -> CType:
    """Return the C type of a value of a compiled step; fields that are None are left out of structures."""
    if isinstance(value, bool | np.bool_):
        return BOOL
    if isinstance(value, int | np.integer):
        return INT
    if isinstance(value, float | np.floating):
        return REAL
    if isinstance(value, np.ndarray):
        return Array(tuple(value.shape))
    if hasattr(value, "_asdict"):
        kept = {name: type_of(part) for name, part in value._asdict().items() if part is not None}
        return Struct(type(value), tuple(kept), tuple(kept.values()))
    if isinstance(value, tuple):
        return Tuple(tuple(type_of(part) for part in value))
    raise TypeError(f"{value!r} has no type in C")


def parts_of(kind: CType) -> tuple[CType, ...]:
    """Return the types of the parts of a tuple or structure; none for others."""
    return kind.parts if isinstance(kind, Tuple | Struct) else ()


def holds_array(kind: CType) -> bool:
    """Return whether a value of this type holds the address of an array."""
    return isinstance(kind, Array) or any(holds_array(part) for part in parts_of(kind))


def select_part(text: str, kind: CType, k: int) -> str:
    """Return the C expression of part ``k`` of a tuple or structure."""
    if isinstance(kind, Struct):
        return f"{text}.{kind.names[k]}"
    return f"{text}.v[{k}]" if isinstance(kind, Tuple) and kind.is_even else f"{text}.f{k}"


def write_real(value: float) -> str:
    """Return a constant in the precision of the build."""
    if np.isnan(value):
        return "(sp_real)NAN"
    if np.isinf(value):
        return "(sp_real)INFINITY" if value > 0 else "-(sp_real)INFINITY"
    return f"REAL({float(value)!r})"


@dataclass
class TypeTable:
    """The structures of one filter, by their names in C, and their definitions in order of use."""

    prefix: str
    names: dict[CType, str] = field(default_factory=dict)
    definitions: list[str] = field(default_factory=list)

    def name(self, kind: CType) -> str:
        """Return the name of a type, and define it at its first use."""
        if isinstance(kind, Scalar):
            return kind.name
        if isinstance(kind, Array):
            return "sp_real *"
        if kind not in self.names:
            members = self._list_members(kind)
            name = self._choose_name(kind)
            self.names[kind] = name
            self.definitions.append("typedef struct {\n" + "".join(members) + f"}} {name};\n")
        return self.names[kind]

    def _list_members(self, kind: Tuple | Struct) -> list[str]:
        if isinstance(kind, Struct):
            comments = _read_field_comments(kind.of)
            named = zip(kind.names, kind.parts, strict=True)
            return [
                f"    {declare(self.name(part), name)};"
                + (f" /* {comments[name]} */" if name in comments else "")
                + "\n"
                for name, part in named
            ]
        if kind.is_even:
            return [f"    {declare(self.name(kind.parts[0]), 'v')}[{len(kind.parts)}];\n"]
        return [f"    {declare(self.name(part), f'f{k}')};\n" for k, part in enumerate(kind.parts)]

    def _choose_name(self, kind: Tuple | Struct) -> str:
        if isinstance(kind, Tuple):
            known = {REAL: "real", INT: "int", BOOL: "bool"}
            if kind.is_even and kind.parts[0] in known:
                name = f"{self.prefix}_{known[kind.parts[0]]}{len(kind.parts)}"
            else:
                name = f"{self.prefix}_tuple{sum(isinstance(one, Tuple) for one in self.names)}"
            return name
        snake = re.sub(r"(?<!^)(?=[A-Z])", "_", kind.of.__name__).lower()
        name = f"{self.prefix}_{snake}"
        taken = set(self.names.values())
        return f"{self.prefix}_{kind.of.__module__.rpartition('.')[2]}_{snake}" if name in taken else name

    def write_value(self, value: Any) -> str:
        """Return the initialiser of a value; arrays, which lie elsewhere, are NULL."""
        if isinstance(value, bool | np.bool_):
            return "true" if value else "false"
        if isinstance(value, int | np.integer):
            return str(int(value))
        if isinstance(value, float | np.floating):
            return write_real(float(value))
        if isinstance(value, np.ndarray):
            return "NULL"
        inner = ", ".join(self.write_value(part) for part in value if part is not None)
        kind = type_of(value)
        return f"{{{{{inner}}}}}" if isinstance(kind, Tuple) and kind.is_even else f"{{{inner}}}"


def declare(kind: str, name: str) -> str:
    """Return the declaration of a variable."""
    return f"{kind}{name}" if kind.endswith("*") else f"{kind} {name}"


def _read_field_comments(of: type) -> dict[str, str]:
    """Return the comments beside the fields of a named tuple: units and meaning."""
    found = re.findall(r"^    (\w+): .*?  # (.*)$", inspect.getsource(of), flags=re.MULTILINE)
    return {name: comment.replace("*/", "").replace("noqa", "") for name, comment in found}


def count_reals(shape: tuple[int, ...]) -> int:
    """Return how many reals an array of this shape has."""
    return prod(shape)
