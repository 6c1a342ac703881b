"""The parts that the commands of ``stillpoint archive`` share."""

import sys
from collections.abc import Iterable, Sequence
from typing import Annotated, Any

from cyclopts import Parameter

from stillpoint.datasets.archive import Archive, Entry, open_archive
from stillpoint.datasets.errors import BadParameter
from stillpoint.scripts.shared.output import print_cells
from stillpoint.scripts.shared.tables import print_table

_VARIABLE = "STILLPOINT_ARCHIVE"
ArchiveDir = Annotated[str | None, Parameter(name="--archive", env_var=_VARIABLE)]
_COLUMNS = ("id", "kind", "name", "s", "Hz", "MB", "added", "tags")


def open_named(place: str | None) -> Archive:
    """Open the archive that the user named; raises :class:`BadParameter` when none is named."""
    if not place:
        raise BadParameter(f"--archive: name the archive, or set {_VARIABLE}")
    return open_archive(place)


def read_ids(words: Sequence[str]) -> list[str]:
    """Return IDs as they were given; ``-`` stands for the first words of the lines of the standard input."""
    found: list[str] = []
    for word in words:
        found += [line.split()[0] for line in sys.stdin if line.strip()] if word == "-" else [word]
    if not found:
        raise BadParameter("no object: name IDs, file names, or - for the lines of the standard input")
    return found


def make_entry_row(archive: Archive, entry: Entry) -> dict[str, Any]:
    """Return the facts of one object for machines."""
    tags, metadata = archive.labels(entry.sha256)
    return {
        "id": entry.sha256,
        "kind": entry.kind,
        "name": entry.name,
        "file_name": entry.file_name,
        "size": entry.size,
        "added": entry.added,
        "removed": entry.removed or None,
        "problem": entry.problem or None,
        "path": str(archive.find_path(entry)),
        "tags": tags,
        "metadata": metadata,
        **{key: value for key, value in entry.columns.items() if value is not None},
    }


def print_entries(archive: Archive, title: str, entries: Iterable[Entry]) -> None:
    """Print a table on a terminal; elsewhere one line per object: ID, kind and file name with tabs between."""
    if not sys.stdout.isatty():
        for entry in entries:
            print_cells((entry.sha256, entry.kind, entry.file_name))
        return
    rows = [
        [
            entry.sha256[:12],
            entry.kind,
            entry.file_name,
            _format_number(entry.columns.get("duration_s"), ".1f"),
            _format_number(entry.columns.get("rate_hz"), ".1f"),
            f"{entry.size / 1e6:.2f}",
            entry.added[:10],
            ", ".join(archive.labels(entry.sha256)[0]),
        ]
        for entry in entries
    ]
    print_table(title, _COLUMNS, [rows], texts=3)


def _format_number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
