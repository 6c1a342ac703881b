"""``stillpoint archive init``, ``add``, ``tag``, ``remove`` and ``gc``: what changes an archive."""

import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from stillpoint.datasets.archive import create_archive
from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.files.remote import is_url
from stillpoint.scripts.shared.batch import parse_assignments
from stillpoint.scripts.shared.flags import Inputs, read_span
from stillpoint.scripts.shared.output import STDOUT, JsonFile, print_line, write_json
from stillpoint.scripts.verbs.archives.common import ArchiveDir, open_named, print_entries, read_ids

Ids = Annotated[list[str], Parameter(negative=(), allow_leading_hyphen=True)]
Tags = Annotated[list[str] | None, Parameter(negative=())]


def init(directory: str, /) -> None:
    """Make an archive in a new or empty folder, or below a URL.

    Parameters
    ----------
    directory
        The folder, or a URL such as s3://bucket/lab (extra cloud).
    """
    with create_archive(directory) as archive:
        print_line(f"{archive.storage.name}: an empty archive; its files are described in the text file in it")


def add(
    files: Inputs,
    /,
    *,
    archive: ArchiveDir = None,
    tag: Tags = None,
    set_: Annotated[list[str] | None, Parameter(name="--set", negative=())] = None,
    json: JsonFile = None,
) -> int:
    """Keep files in the archive: recordings, references, estimates, scores, leaderboards and sources.

    A file that is there already is not stored twice. A damaged MCAP file is refused, the others are kept, and the exit
    code is 2.

    Parameters
    ----------
    files
        Files, or folders whose files are all taken.
    archive
        The archive; by default STILLPOINT_ARCHIVE.
    tag
        A tag for all of them; may be given several times.
    set_
        Metadata for all of them, KEY=VALUE; may be given several times.
    json
        Also write what became of each file as JSON to this file; - is the standard output.
    """
    metadata = parse_assignments(set_, "subject=anna")
    rows: list[dict[str, Any]] = []
    with open_named(archive) as opened:
        for one in opened.add(_expand(files), tag or (), metadata):
            rows.append(
                {"file": str(one.source), "id": one.sha256 or None, "kind": one.kind or None, "status": one.status,
                 "error": one.reason or None}
            )  # fmt: skip
            if one.status == "refused":
                print_line(f"stillpoint: {one.reason}", file=sys.stderr)
    if json != STDOUT:
        for status, count in Counter(row["status"] for row in rows).items():
            kinds = Counter(row["kind"] for row in rows if row["status"] == status and row["kind"])
            what = ", ".join(f"{n} {kind}{'s' * (n > 1)}" for kind, n in kinds.items())
            print_line(f"{count} {'already there' if status == 'present' else status}{f': {what}' if what else ''}")
    write_json(json, rows)
    return 2 if any(row["error"] for row in rows) else 0


def tag(
    ids: Ids,
    /,
    *,
    archive: ArchiveDir = None,
    tag: Tags = None,
    without: Tags = None,
    set_: Annotated[list[str] | None, Parameter(name="--set", negative=())] = None,
) -> None:
    """Give objects tags and metadata.

    Parameters
    ----------
    ids
        IDs, beginnings of IDs, or file names; - reads them from the standard input, as archive find writes them.
    archive
        The archive; by default STILLPOINT_ARCHIVE.
    tag
        A tag to add; may be given several times.
    without
        A tag to take away; may be given several times.
    set_
        Metadata, KEY=VALUE; an empty value deletes the key. The key licence counts for export.
    """
    metadata = parse_assignments(set_, "subject=anna")
    if not (tag or without or metadata):
        raise BadParameter("nothing to change: give --tag, --without or --set KEY=VALUE")
    with open_named(archive) as opened:
        chosen = [opened.resolve(word).sha256 for word in read_ids(ids)]
        print_line(f"{opened.label(chosen, tag or (), without or (), metadata)} of {len(chosen)} objects changed")


def remove(
    ids: Ids,
    /,
    *,
    reason: str,
    archive: ArchiveDir = None,
    with_derived: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Mark objects as removed: they are not found any more; gc deletes their bytes.

    Parameters
    ----------
    ids
        IDs, beginnings of IDs, or file names; - reads them from the standard input.
    reason
        Why; it stays in the archive with the date.
    archive
        The archive; by default STILLPOINT_ARCHIVE.
    with_derived
        Also remove everything that was made from them.
    """
    with open_named(archive) as opened:
        chosen = [opened.resolve(word).sha256 for word in read_ids(ids)]
        removed = opened.remove(chosen, reason, with_derived)
        print_entries(opened, "removed", removed)
    print_line(f"{len(removed)} removed; archive add brings back what gc has not deleted yet", file=sys.stderr)


def gc(
    *,
    archive: ArchiveDir = None,
    older_than: str = "30d",
    yes: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """List the removed objects whose mark is old enough, and delete their bytes with --yes.

    Parameters
    ----------
    archive
        The archive; by default STILLPOINT_ARCHIVE.
    older_than
        Age of the mark of removal: 12h, 30d, 2y.
    yes
        Delete; without it the list is all that happens.
    """
    age = read_span(older_than, "--older-than")
    with open_named(archive) as opened:
        entries = opened.list_removable(age)
        print_entries(opened, f"removed more than {older_than} ago", entries)
        size = sum(entry.size for entry in entries) / 1e6
        if not entries or not yes:
            note = f"; stillpoint archive gc --older-than {older_than} --yes deletes them" if entries else ""
            print_line(f"{len(entries)} objects, {size:.2f} MB{note}", file=sys.stderr)
            return 0
        freed = opened.collect(entries)
    print_line(f"{len(entries)} objects deleted, {freed / 1e6:.2f} MB freed; their records stay", file=sys.stderr)
    return 0


def _expand(paths: Sequence[Path]) -> Iterator[Path]:
    """Yield files as given, and all files of folders, hidden ones aside."""
    for path in paths:
        if is_url(path) or path.is_file():
            yield path
        elif path.is_dir():
            inside = [file for file in sorted(path.rglob("*")) if file.is_file()]
            yield from (file for file in inside if not any(p.startswith(".") for p in file.relative_to(path).parts))
        else:
            raise BadParameter(f"{path}: there is no such file or folder; check the name")
