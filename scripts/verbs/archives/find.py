"""``stillpoint archive find``, ``list`` and ``show``: what reads an archive."""

import json as json_text
from typing import Annotated, Any

from cyclopts import Parameter
from rich.console import Console
from rich.text import Text
from rich.tree import Tree

from stillpoint.datasets.archive import Archive, Entry
from stillpoint.datasets.archive.catalogue import SCORE_FIGURES, read_facts
from stillpoint.datasets.names import make_printable
from stillpoint.scripts.shared.output import STDOUT, JsonFile, print_line, write_json
from stillpoint.scripts.shared.tables import print_table
from stillpoint.scripts.verbs.archives.common import ArchiveDir, make_entry_row, open_named, print_entries

_DEEPEST = 20  # generations of a provenance tree that are drawn
_WIDTH_OF_PIPES = 200  # where stdout is no terminal, nothing is folded


def find(
    query: str,
    /,
    *,
    archive: ArchiveDir = None,
    json: JsonFile = None,
    paths: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Find objects by their facts, tags and metadata.

    Conditions are FIELD OPERATOR VALUE (= != < <= > >=, ~ contains, !~ does not), has:STREAM, tag:NAME, kind:NAME,
    meta.KEY = VALUE, or a word of the name; joined by and, or, not and brackets. docs/archive.md lists the fields.

    Parameters
    ----------
    query
        For example "rate > 100 and has:mag and tag:fast and duration > 60 and sensor ~ 'iphone'"; all finds all.
    archive
        The archive; by default STILLPOINT_ARCHIVE.
    json
        Write what was found as JSON to this file; - is the standard output.
    paths
        Print the path of each object, for other commands.
    """
    with open_named(archive) as opened:
        entries = opened.find(query)
        if paths:
            for entry in entries:
                print_line(opened.find_path(entry))
        elif json != STDOUT:
            print_entries(opened, f"{len(entries)} found", entries)
        write_json(json, [make_entry_row(opened, entry) for entry in entries] if json else [])


def list_(*, archive: ArchiveDir = None, json: JsonFile = None) -> None:
    """List everything in the archive that is not removed.

    Parameters
    ----------
    archive
        The archive; by default STILLPOINT_ARCHIVE.
    json
        Write the list as JSON to this file; - is the standard output.
    """
    find("all", archive=archive, json=json)


def show(identity: str, /, *, archive: ArchiveDir = None, json: JsonFile = None) -> None:
    """Show one object: its facts, what it was made from, what was made from it, and scores.

    Parameters
    ----------
    identity
        An ID, the beginning of one (4 characters and more), a file name, or the name of a recording.
    archive
        The archive; by default STILLPOINT_ARCHIVE.
    json
        Write the same as JSON to this file; - is the standard output.
    """
    with open_named(archive) as opened:
        entry = opened.resolve(identity)
        facts = read_facts(opened.catalogue.select("SELECT facts FROM objects WHERE sha256 = ?", (entry.sha256,))[0][0])
        streams = [
            dict(row) for row in opened.catalogue.select("SELECT * FROM streams WHERE sha256 = ?", (entry.sha256,))
        ]
        scores = _find_scores(opened, entry)
        if json != STDOUT:
            _print_object(opened, entry, streams, scores)
        parents = [{"name": name, "id": parent} for name, parent in opened.parents(entry.sha256)]
        children = [
            {"kind": child.kind, "name": child.file_name, "id": child.sha256} for child in opened.children(entry.sha256)
        ]
        row = {**make_entry_row(opened, entry), "streams": streams, "made_from": parents, "derived": children}
        write_json(json, [{**row, "scores": scores, "facts": facts}])


def _find_scores(archive: Archive, entry: Entry) -> list[dict[str, Any]]:
    """Return rows of score tables and leaderboards about this object, or about an estimate of this recording."""
    derived = json_text.dumps([one.sha256 for one in archive.find_derived(entry.sha256)] + [entry.sha256])
    rows = archive.catalogue.select(
        "SELECT s.* FROM scores s WHERE s.sha256 IN (SELECT value FROM json_each(?)) "
        "AND (s.sha256 = ? OR s.recording = ?) ORDER BY s.recording, s.estimator, s.against",
        (derived, entry.sha256, entry.name),
    )
    if entry.kind == "estimate":
        rows = [row for row in rows if row["estimator"] == entry.columns.get("estimator")]
    return [dict(row) for row in rows]


def _print_object(archive: Archive, entry: Entry, streams: list[dict[str, Any]], scores: list[dict[str, Any]]) -> None:
    """Print everything about one object: facts, streams, what it was made from and what from it, and scores."""
    row = make_entry_row(archive, entry)
    print_line(f"{entry.file_name}: {entry.kind} {entry.name}")
    for key, value in row.items():
        if key in ("kind", "name", "file_name") or value in (None, "", [], {}):
            continue
        text = ", ".join(value) if isinstance(value, list) else value
        text = ", ".join(f"{name}={item}" for name, item in value.items()) if isinstance(value, dict) else text
        print_line(f"  {key:15} {f'{text:.6g}' if isinstance(text, float) else text}")
    if streams:
        columns = ("stream", "samples", "Hz", "start, s", "length, s", "gaps")
        print_table("streams", columns, [[_format_stream(one) for one in streams]], texts=1)
    console = Console()
    console = console if console.is_terminal else Console(width=_WIDTH_OF_PIPES)
    if archive.parents(entry.sha256):
        console.print(_draw_parents(archive, entry))
    if archive.children(entry.sha256):
        console.print(_draw_children(archive, entry))
    if scores:
        shown = [name for name in SCORE_FIGURES if any(row[name] is not None for row in scores)]
        cells = [
            [
                str(row["recording"]),
                str(row["estimator"]),
                str(row["against"]),
                *(_format_figure(row[name]) for name in shown),
            ]
            for row in scores
        ]
        print_table("scores", ("recording", "estimate", "against", *shown), [cells], texts=3)


def _format_stream(one: dict[str, Any]) -> list[str]:
    """Return the row of a stream as text."""
    numbers = (f"{one[key]:.3f}" for key in ("rate_hz", "start_s", "length_s"))
    return [one["stream"], str(one["samples"]), *numbers, str(one["gaps"])]


def _format_figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _draw_parents(archive: Archive, entry: Entry) -> Tree:
    """Return the chain from an object back to what it was made from."""
    tree = Tree(Text("made from"))
    _add_parents(archive, tree, entry.sha256, _DEEPEST)
    return tree


def _add_parents(archive: Archive, tree: Tree, sha256: str, depth: int) -> None:
    """Add to a tree what an object was made from, down to this depth."""
    for name, parent in archive.parents(sha256):
        kept = archive.entry(parent)
        state = "not in the archive" if kept is None else f"{kept.kind}{', removed' if kept.removed else ''}"
        branch = tree.add(Text(make_printable(f"{parent[:12]}  {name}  ({state})")))
        if kept is not None and depth:
            _add_parents(archive, branch, parent, depth - 1)


def _draw_children(archive: Archive, entry: Entry) -> Tree:
    """Return everything that was made from an object."""
    tree = Tree(Text("derived"))
    _add_children(archive, tree, entry.sha256, _DEEPEST)
    return tree


def _add_children(archive: Archive, tree: Tree, sha256: str, depth: int) -> None:
    """Add to a tree what was made from an object, down to this depth."""
    for child in archive.children(sha256):
        branch = tree.add(Text(make_printable(f"{child.sha256[:12]}  {child.file_name}  ({child.kind})")))
        if depth:
            _add_children(archive, branch, child.sha256, depth - 1)
