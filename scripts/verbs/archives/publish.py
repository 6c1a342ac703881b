"""``stillpoint archive export``, ``import`` and ``bundle``: what leaves an archive, and what comes into it."""

import json as json_text
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from stillpoint.datasets.archive import Archive, Entry
from stillpoint.datasets.archive.bundle import STUDY_SUFFIX, bundle_files
from stillpoint.datasets.archive.pack import LARGEST_BUNDLE, open_bundle, write_bundle
from stillpoint.datasets.archive.selection import About, Item, select_items
from stillpoint.datasets.errors import BadParameter, require_known
from stillpoint.datasets.mcap.store import read, read_estimate, read_recording
from stillpoint.datasets.trajectory import Reference, SpinReference
from stillpoint.scripts.shared.flags import Whole, split_names
from stillpoint.scripts.shared.output import STDOUT, JsonFile, print_line, write_json
from stillpoint.scripts.verbs.archives.common import ArchiveDir, open_named
from stillpoint.studies.leaderboard import Leaderboard, Study, format_study
from stillpoint.studies.one_file import write_one_file
from stillpoint.studies.publish.page import make_page_html


def export(
    query: str,
    /,
    *,
    out: Annotated[Path, Parameter(name=["--out", "-o"])],
    archive: ArchiveDir = None,
    title: str | None = None,
    description: str = "",
    author: Annotated[list[str] | None, Parameter(negative=())] = None,
    url: str = "",
    date: str = "",
    allow_unlicensed: Annotated[bool, Parameter(negative="")] = False,
    alone: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Write a bundle for Zenodo or Hugging Face: a folder, or one .zip or .tar file.

    It holds what the query finds, what that was made from, and what was made from nothing else; with hashes, licences,
    CITATION.cff, RO-Crate and Croissant metadata, and a script that remakes all results. Needs the extra publish.

    Parameters
    ----------
    query
        As for archive find.
    out
        A new folder, or NAME.zip or NAME.tar.
    archive
        The archive; by default STILLPOINT_ARCHIVE.
    title
        Title of the dataset; by default the name of the output.
    description
        What it is, in one paragraph.
    author
        An author; may be given several times.
    url
        Where it will be found.
    date
        Date of publication, YYYY-MM-DD; by default today.
    allow_unlicensed
        Also export files whose licence is not stated.
    alone
        Leave out what was made from the files that the query finds.
    """
    about = About(title or out.name.removesuffix(out.suffix), description, tuple(author or ()), url, date)
    if out.exists():
        raise BadParameter(f"--out {out}: is there already; name a new folder, .zip or .tar")
    with open_named(archive) as opened:
        items = select_items(opened, query, allow_unlicensed, alone)
        files = bundle_files(items, about, _find_leaderboard_files(items))
        write_bundle(files, out)
    counts = Counter(item.entry.kind for item in items)
    size = sum(item.entry.size for item in items) / 1e6
    what = ", ".join(f"{count} {kind}{'s' * (count > 1)}" for kind, count in counts.items())
    print_line(f"{out}: {what}; {size:.1f} MB")


def _find_leaderboard_files(items: Sequence[Item]) -> dict[str, bytes]:
    """Return the page of each leaderboard and the study that repeats it, by their paths in the bundle."""
    recordings = {item.entry.sha256: item.path for item in items if item.entry.kind == "recording"}
    files: dict[str, bytes] = {}
    for item in items:
        if item.entry.kind != "leaderboard":
            continue
        board = Leaderboard.from_json(json_text.loads(item.source.read_bytes()))
        stem = item.path.removesuffix(".json")
        files[f"{stem}.html"] = make_page_html(board).encode()
        known = {each.name for each in fields(Study)}
        settings = {name: _to_tuple(value) for name, value in board.study.items() if name in known}
        paths = tuple(f"../../{recordings[one.sha256]}" for one in board.sources if one.sha256 in recordings)
        study = Study(**{**settings, "recordings": paths, "sha256": {}})
        files[f"{stem}{STUDY_SUFFIX}"] = format_study(study, board.version).encode()
    return files


def _to_tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def import_(
    bundle: Path,
    /,
    *,
    archive: ArchiveDir = None,
    max_bytes: Whole = LARGEST_BUNDLE,
    json: JsonFile = None,
) -> int:
    """Take a bundle into the archive, with its tags and metadata; every hash is checked.

    Parameters
    ----------
    bundle
        A folder, .zip or .tar that archive export wrote.
    archive
        The archive; by default STILLPOINT_ARCHIVE.
    max_bytes
        The largest size, unpacked, that is taken in.
    json
        Also write what became of each file as JSON to this file; - is the standard output.
    """
    with open_named(archive) as opened, open_bundle(bundle, max_bytes) as contents:
        added = list(opened.add_given(contents.read_objects()))
    refused = [one for one in added if one.status == "refused"]
    for one in refused:
        print_line(f"stillpoint: {one.reason}", file=sys.stderr)
    if json != STDOUT:
        for status, count in Counter(one.status for one in added).items():
            print_line(f"{count} {'already there' if status == 'present' else status}")
    rows = [
        {"file": str(one.source), "id": one.sha256 or None, "kind": one.kind, "status": one.status} for one in added
    ]
    write_json(json, [{**row, "error": one.reason or None} for row, one in zip(rows, added, strict=True)])
    return 2 if refused else 0


def bundle(
    identity: str,
    /,
    *,
    out: Annotated[Path, Parameter(name=["--out", "-o"])],
    archive: ArchiveDir = None,
    estimators: Annotated[str | None, Parameter(name=["--estimators", "-e"])] = None,
) -> None:
    """Write a recording with its reference, estimates and their errors as one MCAP file, with a layout for Foxglove.

    Foxglove, PlotJuggler, rerun and ros2 bag open it; stillpoint reads it as the recording. The reference and the
    estimates are the latest that were made from the recording.

    Parameters
    ----------
    identity
        The recording, or anything that was made from it: an ID, the beginning of one, or a file name.
    out
        The file, NAME.mcap; NAME.foxglove.json is written beside it.
    archive
        The archive; by default STILLPOINT_ARCHIVE.
    estimators
        Names with commas between; by default all that the archive has.
    """
    if out.suffix != ".mcap" or not out.absolute().parent.is_dir():
        raise BadParameter(f"--out {out}: name a file NAME.mcap in a folder that is there")
    with open_named(archive) as opened:
        entry = _find_recording(opened, opened.resolve(identity))
        children = {child.sha256: child for child in opened.children(entry.sha256)}.values()
        references = [child for child in children if child.kind in ("reference", "roll reference")]
        found = {str(child.columns["estimator"]): child for child in children if child.kind == "estimate"}
        named = list(found) if estimators is None else split_names(estimators)
        for name in named:
            require_known(name, found, f"estimate of {entry.name}")
        recording = read_recording(opened.find_path(entry))
        reference = read(opened.find_path(references[-1])) if references else None
        estimates = [read_estimate(opened.find_path(found[name])) for name in named]
    if not isinstance(reference, Reference | SpinReference | None):
        raise BadParameter(f"{references[-1].file_name}: is not a reference; name one")
    reasons = write_one_file(out, recording, reference, estimates)
    print_line(
        f"{out}: {entry.name}, reference: {'yes' if reference else 'no'}, estimates: {', '.join(named) or 'none'}"
    )
    for name, reason in reasons.items():
        print_line(f"without error ({name}): {reason}")


def _find_recording(archive: Archive, entry: Entry) -> Entry:
    """Return the recording that an object is, or was made from."""
    if entry.kind == "recording":
        return entry
    kept = [archive.entry(parent) for _, parent in archive.parents(entry.sha256)]
    found = [parent for parent in kept if parent is not None and parent.kind == "recording"]
    if len(found) != 1:
        raise BadParameter(f"{entry.file_name}: was made from {len(found)} recordings of the archive; name one of them")
    return found[0]
