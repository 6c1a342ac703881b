"""Repair an archive: damaged objects from a copy, damaged records from a copy or from the catalogue."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from stillpoint.datasets.archive.archive import Archive
from stillpoint.datasets.archive.incoming import Given, Incoming, Wanted
from stillpoint.datasets.archive.record import Record, record_from_bytes, record_key
from stillpoint.datasets.archive.storage import FolderStorage, Storage, open_storage, read_key
from stillpoint.datasets.archive.verify import Fault
from stillpoint.datasets.errors import BadFile, BadParameter, StillpointError
from stillpoint.datasets.files.remote import hash_file, open_binary


class Copies:
    """Where sound copies may be: another archive, or any folder of files."""

    def __init__(self, place: str | Path) -> None:
        """Open the place of copies; raises :class:`BadParameter` where there is no such folder."""
        self.storage: Storage = open_storage(place)
        if isinstance(self.storage, FolderStorage) and not self.storage.root.is_dir():
            raise BadParameter(f"--from {place}: there is no such folder; name another archive or a folder of files")
        self._by_size: dict[int, list[Path]] | None = None

    def find_object(self, record: Record) -> Path | None:
        """Return a file with the bytes of this object: its hash is the right one."""
        candidates = [self.storage.path(record.object_key)] if self.storage.has(record.object_key) else []
        for path in [*candidates, *self._find_files(record.size)]:
            try:
                if hash_file(path) == record.sha256:
                    return path
            except (OSError, BadFile):
                continue
        return None

    def find_record(self, sha256: str) -> Record | None:
        """Return a sound record of this object."""
        key = record_key(sha256)
        if not self.storage.has(key):
            return None
        try:
            return record_from_bytes(read_key(self.storage, key), key)
        except BadFile:
            return None

    def _find_files(self, size: int) -> list[Path]:
        """Return the files of this size below the folder, which is listed once."""
        if not isinstance(self.storage, FolderStorage):
            return []
        if self._by_size is None:
            self._by_size = {}
            for path in sorted(self.storage.root.rglob("*")):
                if path.is_file() and not path.is_symlink():
                    self._by_size.setdefault(path.stat().st_size, []).append(path)
        return self._by_size.get(size, [])


def repair_archive(archive: Archive, faults: Sequence[Fault], copies: Copies | None) -> tuple[list[str], list[Fault]]:
    """Repair what can be repaired; return one line for each repair, and the faults that are left.

    A record comes from the copy or, when that has none, from the catalogue; the catalogue is made anew at the end when
    anything was wrong with it. An object comes from a copy whose SHA-256 is right, or stays as it is.
    """
    done: list[str] = []
    left: list[Fault] = []
    for fault in [fault for fault in faults if fault.level == "record"]:
        record = _find_record(archive, fault.sha256, copies) if fault.sha256 else None
        if record is None:
            left.append(fault)
            continue
        _put(archive, record, None)
        done.append(f"record of {record.file_name} restored")
    for fault in [fault for fault in faults if fault.level == "object"]:
        line = _repair_object(archive, fault, copies)
        if line is None:
            left.append(fault)
        else:
            done.append(line)
    derived = [fault for fault in faults if fault.level in ("catalogue", "link")]
    if done or derived:
        archive.rebuild()
        done += [f"{fault.level} made again: {fault.what}" for fault in derived]
    return done, [*left, *(fault for fault in faults if fault.level in ("content", "provenance", "remade"))]


def _find_record(archive: Archive, sha256: str, copies: Copies | None) -> Record | None:
    """Return the record of an object from the copies, else from the catalogue."""
    found = copies.find_record(sha256) if copies is not None else None
    return found or archive.read_catalogued_record(sha256)


def _repair_object(archive: Archive, fault: Fault, copies: Copies | None) -> str | None:
    """Restore a damaged or missing object; return what was done, or None where no intact copy is known."""
    try:
        record = archive.read_record(fault.sha256) if fault.sha256 else None
    except StillpointError:
        return None
    if record is None or record.freed:
        return None
    misnamed = Path(fault.where)
    if misnamed != archive.storage.path(record.object_key) and isinstance(archive.storage, FolderStorage):
        if hash_file(misnamed) != record.sha256:
            return None
        archive.storage.move_in(misnamed, record.object_key)
        return f"{misnamed.name} renamed to {record.object_key}"
    if archive.storage.has(record.object_key) and hash_file(archive.storage.path(record.object_key)) == record.sha256:
        return f"{record.file_name} is there again"
    source = None if copies is None else copies.find_object(record)
    if source is None:
        return None
    _put(archive, record, source)
    return f"{record.file_name} fetched from {source}"


def _put(archive: Archive, record: Record, source: Path | None) -> None:
    """Write a record, and its object when a source is given, over what is there."""
    incoming = Incoming(archive.home)
    try:
        if source is not None:
            copy, sha256, _ = incoming.copy(Given(source, partial(open_binary, source), record.file_name))
            if sha256 != record.sha256:
                raise BadFile(f"{source}: changed while it was read; run the repair again")
            archive.storage.move_in(copy, record.object_key)
        (change,) = incoming.stage([Wanted(record, None, replaces=True)])
        archive.storage.move_in(change.record_file, record.record_key)
    finally:
        incoming.close()
