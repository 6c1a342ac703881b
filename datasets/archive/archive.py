"""An archive of datasets: objects named by their SHA-256, a record beside each, a catalogue that is made from both.

    ARCHIVE/objects/ab/cdef….mcap    the bytes, never rewritten
    ARCHIVE/records/ab/cdef….json    file name, tags, metadata, when it was added or removed
    ARCHIVE/names/run7.mcap          links to the objects under the names that they were added with
    ARCHIVE/catalogue.sqlite         what queries read; `rebuild` makes it from the rest
    ARCHIVE/incoming/                changes under way

Of a remote archive (an fsspec URL) the objects and records are remote; catalogue and incoming lie in a local cache.
"""

import hashlib
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import partial
from itertools import islice
from pathlib import Path

from stillpoint.datasets.archive.catalogue import (
    FILE,
    Catalogue,
    Entry,
    digest_rows,
    make_content_rows,
    put_labels,
    put_object,
)
from stillpoint.datasets.archive.describe import Description, describe_object
from stillpoint.datasets.archive.incoming import Change, Given, Incoming, Wanted, finish_dead_changes, sync_files
from stillpoint.datasets.archive.locks import hold_lock
from stillpoint.datasets.archive.query import parse_query
from stillpoint.datasets.archive.record import (
    Record,
    choose_suffix,
    extract_sha256,
    now,
    record_from_bytes,
    record_key,
)
from stillpoint.datasets.archive.storage import FolderStorage, Storage, open_storage, read_key
from stillpoint.datasets.errors import BadFile, BadParameter, StillpointError
from stillpoint.datasets.files.remote import get_url, open_binary

MARK = "stillpoint-archive.txt"
_MARK_TEXT = """This folder is an archive of stillpoint, format 1.
objects/ab/cdef...  files, named by the SHA-256 of their bytes (abcdef...); sha256sum checks them
records/ab/cdef...  JSON beside each object: its file name, tags, metadata, when it was added or removed
names/              links to the objects under the names they were added with
catalogue.sqlite    answers queries; made from the rest by `stillpoint archive rebuild`
"""
_BATCH = 64  # files that `add` copies before it moves them in, in one transaction of the catalogue
_SHORTEST_ID = 4  # characters of a hash that name an object


@dataclass(frozen=True)
class Added:
    """The outcome for one file given to :meth:`Archive.add`."""

    source: Path
    sha256: str  # "" when it was refused
    kind: str
    status: str  # added, present, restored, refused
    reason: str = ""  # why it was refused


class Archive:
    """An open archive; use :func:`open_archive` or :func:`create_archive`, and close it, or use ``with``."""

    def __init__(self, storage: Storage, home: Path) -> None:
        self.storage = storage
        self.home = home
        self.catalogue = Catalogue(home / FILE)

    def __enter__(self) -> "Archive":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the catalogue."""
        self.catalogue.close()

    # -- adding -------------------------------------------------------------------------------------------------------

    def add(
        self, files: Iterable[Path], tags: Sequence[str] = (), metadata: Mapping[str, str] | None = None
    ) -> Iterator[Added]:
        """Keep files; yields what became of each, once it is safe on the disk.

        A file that cannot be read, or that claims to be MCAP and is damaged, is refused; the others are kept.
        """
        given = (Given(file, partial(open_binary, file), file.name, tags, metadata or {}) for file in files)
        yield from self.add_given(given)

    def add_given(self, files: Iterable[Given]) -> Iterator[Added]:
        """Add files that state what their records are to hold; otherwise as :meth:`add`."""
        files = iter(files)
        while batch := list(islice(files, _BATCH)):
            with self._open_incoming() as incoming:
                wanted: dict[str, Wanted] = {}
                descriptions: dict[str, Description] = {}
                outcomes = [self._take(incoming, given, wanted, descriptions) for given in batch]
                self._commit(incoming.stage(list(wanted.values())), descriptions)
            yield from outcomes

    def _take(
        self, incoming: Incoming, given: Given, wanted: dict[str, Wanted], descriptions: dict[str, Description]
    ) -> Added:
        """Copy a file and decide what it needs: nothing, a new object, or a record that is not removed any more."""
        try:
            copy, sha256, size = incoming.copy(given)
            if sha256 in wanted:
                return Added(given.source, sha256, descriptions[sha256].kind, "present")
            known = self.find_record(sha256)
            if known is not None and not known.removed and self.storage.has(known.object_key):
                return Added(given.source, sha256, self._find_kind(sha256), "present")
            described = describe_object(copy, given.file_name)
            if described.problem:
                raise BadFile(f"{described.problem.replace(str(copy), str(given.source))}; it is not added")
        except StillpointError as error:
            return Added(given.source, "", "", "refused", str(error))
        descriptions[sha256] = described
        if known is None:
            name, added = given.file_name, given.added or now()
            record = Record(sha256, choose_suffix(name), name, size, added, tuple(given.tags), dict(given.metadata))
        else:
            record = replace(known, removed="", reason="", freed="")
        record = replace(record, described=digest_rows(make_content_rows(record, described)))
        wanted[sha256] = Wanted(record, copy, replaces=known is not None)
        return Added(given.source, sha256, described.kind, "added" if known is None else "restored")

    @contextmanager
    def _open_incoming(self) -> Iterator[Incoming]:
        """Finish interrupted changes, and yield a folder for a new one; it is abandoned where the block raises."""
        self.finish_interrupted()
        incoming = Incoming(self.home)
        try:
            yield incoming
        except BaseException:
            incoming.abandon()  # what is complete happens with the next command
            raise
        incoming.close()

    def finish_interrupted(self) -> int:
        """Complete or delete what killed processes left; return how many changes there were."""
        return finish_dead_changes(self.home, self._commit)

    def _commit(self, changes: Sequence[Change], descriptions: Mapping[str, Description] | None = None) -> None:
        """Move changes to their places and update the catalogue. Repeating it after a kill does no harm."""
        if not changes:
            return
        with hold_lock(self.home / "lock"):
            for change in changes:
                self._move_in(change)
            if isinstance(self.storage, FolderStorage):
                keys = [key for change in changes for key in (change.record.object_key, change.record.record_key)]
                sync_files({self.storage.path(key).parent for key in keys})
            with self.catalogue.change() as connection:
                for change in changes:
                    kept = self.read_record(change.record.sha256)
                    described = (descriptions or {}).get(kept.sha256)
                    if (
                        described is None
                        and change.object_file is None
                        and self._find_kind(kept.sha256)
                        and not kept.freed
                    ):
                        put_labels(connection, kept)
                        continue
                    if described is None:
                        described = self.describe(kept)
                    put_object(connection, kept, described, self._link(kept))

    def _move_in(self, change: Change) -> None:
        """Put object and record in their places; the record stays in the journal until the catalogue has it, too."""
        record = change.record
        if change.object_file is not None and change.object_file.exists() and not self.storage.has(record.object_key):
            self.storage.move_in(change.object_file, record.object_key)
        if change.record_file.exists() and (change.replaces or not self.storage.has(record.record_key)):
            self.storage.copy_in(change.record_file, record.record_key)

    # -- reading ------------------------------------------------------------------------------------------------------

    def find(self, query: str) -> list[Entry]:
        """Return objects that a query finds, oldest first; see :mod:`stillpoint.datasets.archive.query`."""
        condition = parse_query(query)
        return self.catalogue.entries(condition.sql, condition.parameters)

    def resolve(self, text: str) -> Entry:
        """Return the one object that an ID, the beginning of one, a file name or a name stands for.

        Raises :class:`BadParameter` when there is none, or more than one.
        """
        if len(text) >= _SHORTEST_ID and all(letter in "0123456789abcdef" for letter in text.lower()):
            found = self.catalogue.entries("substr(o.sha256, 1, ?) = ?", (len(text), text.lower()))
            if len(found) == 1:
                return found[0]
        found = self.catalogue.entries("(o.file_name = ? OR o.link = ?) AND o.removed = ''", (text, text))
        if not found:
            found = self.catalogue.entries("o.name = ? AND o.kind = 'recording' AND o.removed = ''", (text,))
        if len(found) == 1:
            return found[0]
        if found:
            several = ", ".join(f"{entry.sha256[:12]} ({entry.kind})" for entry in found[:5])
            raise BadParameter(f"{text}: names {len(found)} objects ({several}); give the ID of one")
        raise BadParameter(f"{text}: the archive {self.storage.name} has no such object; see stillpoint archive list")

    def find_path(self, entry: Entry) -> Path:
        """Return a path that :func:`stillpoint.datasets.read` takes: the link with the human name if there is one."""
        if entry.link and isinstance(self.storage, FolderStorage):
            return self.home / "names" / entry.link
        return self.storage.path(self.object_key(entry.sha256))

    def object_key(self, sha256: str) -> str:
        """Return the key under which the bytes of an object are stored."""
        rows = self.catalogue.select("SELECT suffix FROM objects WHERE sha256 = ?", (sha256,))
        return f"objects/{sha256[:2]}/{sha256[2:]}{rows[0]['suffix']}" if rows else self.read_record(sha256).object_key

    def find_record(self, sha256: str) -> Record | None:
        """Return the record of an object, None when there is none; raises :class:`BadFile` when it is damaged."""
        return self.read_record(sha256) if self.storage.has(record_key(sha256)) else None

    def read_record(self, sha256: str) -> Record:
        """Return the record of an object; raises :class:`BadFile` when it is damaged or not there."""
        key = record_key(sha256)
        return record_from_bytes(read_key(self.storage, key), f"{self.storage.name}/{key}")

    def labels(self, sha256: str) -> tuple[list[str], dict[str, str]]:
        """Return tags and metadata of an object."""
        tags = self.catalogue.select("SELECT tag FROM tags WHERE sha256 = ? ORDER BY tag", (sha256,))
        pairs = self.catalogue.select("SELECT key, value FROM metadata WHERE sha256 = ? ORDER BY key", (sha256,))
        return [row["tag"] for row in tags], {row["key"]: row["value"] for row in pairs}

    def parents(self, sha256: str) -> list[tuple[str, str]]:
        """Return (file name, sha256) of what an object was made from, kept here or not."""
        rows = self.catalogue.select("SELECT name, parent FROM parents WHERE child = ? ORDER BY name", (sha256,))
        return [(row["name"], row["parent"]) for row in rows]

    def children(self, sha256: str) -> list[Entry]:
        """Return what was made from an object and is not removed."""
        where = "o.removed = '' AND o.sha256 IN (SELECT child FROM parents WHERE parent = ?)"
        return self.catalogue.entries(where, (sha256,))

    def entry(self, sha256: str) -> Entry | None:
        """Return the object with this hash, None when the catalogue has none."""
        found = self.catalogue.entries("o.sha256 = ?", (sha256,))
        return found[0] if found else None

    # -- changing -----------------------------------------------------------------------------------------------------

    def label(
        self,
        sha256s: Iterable[str],
        tags: Sequence[str] = (),
        without: Sequence[str] = (),
        metadata: Mapping[str, str] | None = None,
    ) -> int:
        """Add and take away tags, and set metadata (a key with the value "" is deleted); returns how many changed."""
        changed = []
        for sha256 in sha256s:
            record = self.read_record(sha256)
            kept = {key: value for key, value in {**record.metadata, **(metadata or {})}.items() if value}
            new = replace(record, tags=tuple(sorted({*record.tags, *tags} - set(without))), metadata=kept)
            if new != record:
                changed.append(new)
        self._replace_records(changed)
        return len(changed)

    def remove(self, sha256s: Sequence[str], reason: str, with_derived: bool = False) -> list[Entry]:
        """Mark objects as removed; their bytes stay until :meth:`collect`. Returns what was marked.

        Raises :class:`BadParameter` when something that is not removed was made from one of them.
        """
        if not reason.strip():
            raise BadParameter("--reason: say why; the reason stays in the archive")
        wanted = dict.fromkeys(sha256s)
        for sha256 in list(wanted):
            derived = [entry for entry in self.find_derived(sha256) if entry.sha256 not in wanted]
            if derived and not with_derived:
                names = ", ".join(entry.file_name for entry in derived[:5])
                raise BadParameter(
                    f"{sha256[:12]}: {len(derived)} objects were made from it ({names}); remove them first, or all "
                    "with --with-derived"
                )
            wanted |= dict.fromkeys(entry.sha256 for entry in derived)
        marked = [record for record in map(self.read_record, wanted) if not record.removed]
        self._replace_records([replace(record, removed=now(), reason=reason.strip()) for record in marked])
        return [entry for record in marked if (entry := self.entry(record.sha256)) is not None]

    def list_removable(self, older_than: timedelta) -> list[Entry]:
        """Return objects whose mark of removal is at least this old and whose bytes are still there."""
        limit = (datetime.now(UTC) - older_than).isoformat(timespec="microseconds").replace("+00:00", "Z")
        return self.catalogue.entries("o.removed != '' AND o.removed <= ? AND o.freed = ''", (limit,))

    def collect(self, entries: Iterable[Entry]) -> int:
        """Delete the bytes of removed objects, keep their records; returns the bytes freed."""
        freed = 0
        for entry in entries:
            record = self.read_record(entry.sha256)
            if not record.removed:
                continue  # somebody added it again meanwhile
            self.storage.delete(record.object_key)
            self._replace_records([replace(record, freed=now())])
            freed += record.size
        return freed

    def find_derived(self, sha256: str) -> list[Entry]:
        """Return everything that was made from an object, and from that in turn, and is not removed."""
        found: dict[str, Entry] = {}
        left = [sha256]
        while left:
            for child in self.children(left.pop()):
                if child.sha256 not in found:
                    found[child.sha256] = child
                    left.append(child.sha256)
        return list(found.values())

    def _replace_records(self, records: Sequence[Record]) -> None:
        """Write changed records in one change of the archive."""
        if not records:
            return
        with self._open_incoming() as incoming:
            self._commit(incoming.stage([Wanted(record, None, replaces=True) for record in records]))

    # -- the catalogue ------------------------------------------------------------------------------------------------

    def rebuild(self) -> list[str]:
        """Make the catalogue again from objects and records; return what could not be read.

        Of a record that is damaged, what the old catalogue knows is kept.
        """
        self.finish_interrupted()
        problems = []
        with hold_lock(self.home / "lock"):
            records = []
            for key, _ in self.storage.keys("records"):
                try:
                    records.append(self.read_record(extract_sha256(key)))
                except BadFile as error:
                    remembered = self.read_catalogued_record(extract_sha256(key))
                    problems.append(f"{error}{'' if remembered is None else '; the catalogue remembers it'}")
                    records += [] if remembered is None else [remembered]
            self.catalogue.close()
            for suffix in ("", "-wal", "-shm"):
                (self.home / f"{FILE}{suffix}").unlink(missing_ok=True)
            self.catalogue = Catalogue(self.home / FILE)
            self._sweep_links()
            records.sort(key=lambda record: (record.added, record.sha256))
            for start in range(0, len(records), _BATCH):
                with self.catalogue.change() as connection:
                    for record in records[start : start + _BATCH]:
                        put_object(connection, record, self.describe(record), self._link(record))
        return problems

    def _sweep_links(self) -> None:
        """Delete links under ``names/`` that lead to no object."""
        folder = self.home / "names"
        if isinstance(self.storage, FolderStorage) and folder.is_dir():
            for link in folder.iterdir():
                if link.is_symlink() and not link.exists():
                    link.unlink()

    def read_catalogued_record(self, sha256: str) -> Record | None:
        """Return the record of an object as the catalogue has it; None when it has none."""
        try:
            rows = self.catalogue.select("SELECT * FROM objects WHERE sha256 = ?", (sha256,))
            tags, metadata = self.labels(sha256)
        except BadFile:
            return None
        if not rows:
            return None
        names = ("suffix", "file_name", "size", "added", "removed", "reason", "freed")
        return Record(sha256, **{name: rows[0][name] for name in names}, tags=tuple(tags), metadata=metadata)

    def describe(self, record: Record) -> Description:
        """Return the description of an object in the archive; damage and absence become its ``problem``."""
        if record.freed:
            return Description("removed", record.file_name)
        if not self.storage.has(record.object_key):
            return Description("missing", record.file_name, problem="its object is not there")
        return describe_object(self.storage.path(record.object_key), record.file_name)

    def _find_kind(self, sha256: str) -> str:
        """Return the kind of an object in the catalogue, "" where it is not there."""
        rows = self.catalogue.select("SELECT kind FROM objects WHERE sha256 = ?", (sha256,))
        return str(rows[0]["kind"]) if rows else ""

    def _link(self, record: Record) -> str:
        """Make or remove the link under ``names/`` to an object, as its record asks; return it, or "" for none."""
        if not isinstance(self.storage, FolderStorage):
            return ""
        folder = self.home / "names"
        target = f"../{record.object_key}"
        stem, dot, rest = record.file_name.partition(".")
        for name in (record.file_name, f"{stem}~{record.sha256[:8]}{dot}{rest}"):
            link = folder / name
            try:
                if record.removed:
                    if link.is_symlink() and os.readlink(link) == target:
                        link.unlink()
                    continue
                folder.mkdir(exist_ok=True)
                if link.is_symlink() and os.readlink(link) == target:
                    return name
                os.symlink(target, link)
                return name
            except FileExistsError:
                continue
            except OSError:  # a file system without links, a name that it does not take
                return ""
        return ""


def create_archive(place: str | Path) -> Archive:
    """Make an archive in a new or empty folder, or below a URL. Raises :class:`BadParameter` otherwise."""
    storage = open_storage(place)
    home = _find_home(storage)
    if storage.has(MARK):
        raise BadParameter(f"{storage.name}: is already an archive; use it, or name another folder")
    taken = isinstance(storage, FolderStorage) and storage.root.exists()
    if taken and not _is_free(home):
        raise BadParameter(f"{storage.name}: is not an empty folder; name a new one for the archive")
    try:
        home.mkdir(parents=True, exist_ok=True)
        (home / "incoming").mkdir(exist_ok=True)
        mark = home / "incoming" / MARK
        mark.write_text(_MARK_TEXT, encoding="utf-8")
        sync_files([mark])
    except OSError as error:
        raise BadParameter(f"{storage.name}: cannot be made ({error.strerror}); name another place") from None
    storage.move_in(mark, MARK)
    return Archive(storage, home)


def _is_free(folder: Path) -> bool:
    """Return whether a folder is empty, or holds no more than an interrupted ``archive init`` left there."""
    if not folder.is_dir():
        return False
    names, incoming = os.listdir(folder), folder / "incoming"
    return not names or (names == ["incoming"] and incoming.is_dir() and set(os.listdir(incoming)) <= {MARK})


def open_archive(place: str | Path) -> Archive:
    """Open an archive; what killed processes left is completed or deleted first. Raises :class:`BadParameter`."""
    storage = open_storage(place)
    if not storage.has(MARK):
        raise BadParameter(f"{storage.name}: is not an archive; make one: stillpoint archive init {storage.name}")
    home = _find_home(storage)
    home.mkdir(parents=True, exist_ok=True)
    is_new = not (home / FILE).exists()
    archive = Archive(storage, home)
    if is_new and next(storage.keys("records"), None) is not None:
        archive.rebuild()
    else:
        archive.finish_interrupted()
    return archive


def resolve_paths(place: str | Path, lines: Iterable[str]) -> list[Path]:
    """Return paths of the objects that IDs, names or the lines of ``archive find`` stand for, in their order.

    The first word of a line counts. Raises :class:`BadParameter`.
    """
    with open_archive(place) as archive:
        words = [line.split()[0] for line in lines if line.strip()]
        return [archive.find_path(archive.resolve(word)) for word in words]


def _find_home(storage: Storage) -> Path:
    """Return the folder of the catalogue: the archive itself, or the user's cache for a remote one."""
    if isinstance(storage, FolderStorage):
        return storage.root
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "stillpoint" / "archives" / hashlib.sha256(get_url(storage.name).encode()).hexdigest()[:16]
