"""Print lines, write text files, and write JSON for machines: ``--json FILE``, ``-`` for standard output."""

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, TextIO

from cyclopts import Parameter

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.files.atomic import write_atomically
from stillpoint.datasets.names import make_printable

STDOUT = "-"


def check_writable(_: Any, target: str | None) -> None:
    """Raise ``ValueError`` before the work starts where the file could not be written after it."""
    if target in (None, STDOUT):
        return
    path = Path(str(target))
    if path.is_dir():
        raise ValueError("It is a folder; name a file.")
    if not path.absolute().parent.is_dir():
        raise ValueError("Its folder does not exist; make it, or name another file.")


# A lone hyphen would be read as an option otherwise.
JsonFile = Annotated[str | None, Parameter(name="--json", allow_leading_hyphen=True, validator=check_writable)]


def print_line(text: object = "", file: TextIO | None = None, flush: bool = False) -> None:
    """Print one line to the standard output, or to ``file``; letters that are not printable are escaped.

    Everything that verbs print goes through here or through a table, so that no name of a file can steer a terminal.
    """
    print(make_printable(text), file=file, flush=flush)


def print_cells(cells: Iterable[object]) -> None:
    """Print a line of cells with tabs between, for other programs; their letters are escaped as in other lines."""
    print("\t".join(map(make_printable, cells)))


def write_json(target: str | None, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write ``{"rows": [...]}`` to a file or to the standard output; nothing when ``target`` is None.

    A number that is not finite becomes null. Raises :class:`BadParameter` when the file cannot be written.
    """
    write_document(target, {"rows": rows})


def write_document(target: str | None, content: Mapping[str, Any]) -> None:
    """Write an object as JSON to a file or to the standard output, as :func:`write_json` does with rows."""
    if target is None:
        return
    text = json.dumps(_to_plain(content), indent=2, ensure_ascii=False, allow_nan=False)
    if target == STDOUT:
        for line in text.split("\n"):
            print(line if line.isprintable() else "".join(map(_escape_in_json, line)))
        return
    write_text(Path(target), text + "\n")


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text, the whole file or none of it; raises :class:`BadParameter` when it cannot be written."""
    with open_text(path) as put:
        put(text)


@contextmanager
def open_text(path: Path) -> Iterator[Callable[[str], object]]:
    """Open a file of UTF-8 text, and give the function that adds to it; it appears, whole, when the block ends.

    Raises :class:`BadParameter` when it cannot be written.
    """
    try:
        if path.exists() and not path.is_file():  # a pipe or a device
            with open(path, "w", encoding="utf-8", newline="") as pipe:
                yield pipe.write
        else:
            with write_atomically(path) as file:
                yield lambda text: file.write(text.encode())
    except OSError as error:
        raise BadParameter(f"{path}: cannot be written ({error.strerror}); name another place") from None


def _escape_in_json(letter: str) -> str:
    return letter if letter.isprintable() else json.dumps(letter)[1:-1]


def _to_plain(value: Any) -> Any:
    """Return a value as plain JSON, with None for every number that is not finite."""
    if isinstance(value, Mapping):
        return {str(key): _to_plain(item) for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_to_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
