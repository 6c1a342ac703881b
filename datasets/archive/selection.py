"""Select the contents of a bundle: the objects of a query, their origins, what was made from them, and licences."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath

from stillpoint.datasets.archive.archive import Archive
from stillpoint.datasets.archive.catalogue import Entry
from stillpoint.datasets.archive.record import Record
from stillpoint.datasets.errors import BadParameter

_FOLDERS = {
    "recording": "recordings",
    "reference": "references",
    "roll reference": "references",
    "estimate": "estimates",
    "score": "scores",
    "leaderboard": "leaderboards",
}
INDEX_COLUMNS = (
    "path", "sha256", "size", "kind", "name", "licence", "duration_s", "samples", "rate_hz", "sensor", "source",
    "date", "method", "estimator", "sd_median_deg",
)  # fmt: skip
_LICENCE_KEY = "licence"  # of the metadata: the licence of a file that does not say its own


@dataclass(frozen=True)
class Item:
    """One object of a bundle."""

    entry: Entry
    record: Record
    source: Path  # where its bytes are
    path: str  # in the bundle
    licences: tuple[str, ...]
    parents: tuple[tuple[str, str], ...]  # (file name, sha256)


@dataclass(frozen=True)
class About:
    """The title, authors and other facts that the user gives for a bundle."""

    title: str
    description: str = ""
    authors: tuple[str, ...] = ()
    url: str = ""
    date: str = ""  # of publication, ISO; "" for today

    @property
    def published(self) -> str:
        """The date of publication."""
        return self.date or datetime.now(UTC).date().isoformat()


def select_items(archive: Archive, query: str, allow_unlicensed: bool = False, alone: bool = False) -> list[Item]:
    """Return what a bundle of these objects holds, oldest first.

    Beside what the query finds these are their ancestors, as far as the archive has them, and, unless ``alone``,
    everything that was made from nothing but objects of the bundle. Raises :class:`BadParameter` when the query finds
    nothing, when an object is damaged, or when one has no licence.
    """
    found = {entry.sha256: entry for entry in archive.find(query)}
    if not found:
        raise BadParameter(f"{query}: finds nothing; try stillpoint archive find")
    _add_ancestors(archive, found)
    if not alone:
        _add_descendants(archive, found)
    entries = sorted(found.values(), key=lambda entry: (entry.added, entry.sha256))
    damaged = [entry.file_name for entry in entries if entry.problem]
    if damaged:
        raise BadParameter(f"{', '.join(damaged[:5])}: damaged; run stillpoint archive verify")
    licences = {entry.sha256: _list_licences(archive, entry) for entry in entries}
    bare = [entry.file_name for entry in entries if not licences[entry.sha256]]
    if bare and not allow_unlicensed:
        more = f" and {len(bare) - 5} more" if len(bare) > 5 else ""
        raise BadParameter(
            f"{', '.join(bare[:5])}{more}: no licence; state it (stillpoint archive tag ID --set licence='CC BY 4.0'), "
            "or give --allow-unlicensed"
        )
    paths = _choose_paths(entries)
    return [
        Item(
            entry=entry,
            record=archive.read_record(entry.sha256),
            source=archive.storage.path(archive.object_key(entry.sha256)),
            path=paths[entry.sha256],
            licences=licences[entry.sha256],
            parents=tuple(archive.parents(entry.sha256)),
        )
        for entry in entries
    ]


def _list_licences(archive: Archive, entry: Entry) -> tuple[str, ...]:
    """Return the licences that hold for an object, sorted.

    They are, in this order: its metadata ``licence``, what the file says, those of everything that it was made from;
    for a source file, those of the recordings made from it.
    """
    return tuple(sorted(_find_licences(archive, entry, set())))


def _find_licences(archive: Archive, entry: Entry, seen: set[str]) -> set[str]:
    """Return the licences of an object: its own, else those of what it was made from; ``seen`` ends loops."""
    seen.add(entry.sha256)
    stated = archive.labels(entry.sha256)[1].get(_LICENCE_KEY) or entry.columns.get("licence")
    if stated:
        return {str(stated)}
    near: Iterable[Entry] = [kept for _, parent in archive.parents(entry.sha256) if (kept := archive.entry(parent))]
    if entry.kind == "source":
        near = archive.children(entry.sha256)
    return {licence for one in near if one.sha256 not in seen for licence in _find_licences(archive, one, seen)}


def _add_ancestors(archive: Archive, found: dict[str, Entry]) -> None:
    """Add to the selection all objects from which its objects were made."""
    left = list(found)
    while left:
        for _, parent in archive.parents(left.pop()):
            kept = archive.entry(parent)
            if kept is not None and not kept.removed and parent not in found:
                found[parent] = kept
                left.append(parent)


def _add_descendants(archive: Archive, found: dict[str, Entry]) -> None:
    """Add what was made from objects of the bundle alone, generation by generation."""
    left = list(found)
    while left:
        for child in archive.children(left.pop()):
            parents = {parent for _, parent in archive.parents(child.sha256)}
            if child.sha256 not in found and not child.problem and parents <= set(found):
                found[child.sha256] = child
                left.append(child.sha256)


def _choose_paths(entries: Sequence[Entry]) -> Mapping[str, str]:
    """Return a path in the bundle for each object: a folder per kind, the name of the file, made unlike any other."""
    paths: dict[str, str] = {}
    taken: set[str] = set()
    for entry in entries:
        name = PurePosixPath(entry.file_name.replace("\\", "/")).name or entry.sha256
        path = f"data/{_FOLDERS.get(entry.kind, 'sources')}/{name}"
        if path.lower() in taken:  # file systems that do not tell cases apart count as well
            stem, dot, rest = name.partition(".")
            path = f"data/{_FOLDERS.get(entry.kind, 'sources')}/{stem}~{entry.sha256[:8]}{dot}{rest}"
        taken.add(path.lower())
        paths[entry.sha256] = path
    return paths


def list_citations(items: Sequence[Item]) -> list[str]:
    """Return the citations of the recordings, each once."""
    return sorted({str(text) for item in items if (text := item.entry.columns.get("citation"))})
