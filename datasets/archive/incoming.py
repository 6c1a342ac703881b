"""Changes under way: each process writes what it wants to keep into a folder of its own first, then moves it in.

``incoming/TOKEN/`` is a journal. A change is complete when its record lies there; then the object is moved to its
place, the record is copied to its own, and the catalogue is told; after that the folder is deleted. A process that dies
leaves its folder and a lock file that nobody holds: the next command moves in what is complete and deletes the rest, so
that nothing is lost and nothing half done.
"""

import hashlib
import math
import os
import secrets
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from stillpoint.datasets.archive.locks import OwnLock, lock_of_dead_process
from stillpoint.datasets.archive.record import Record, record_from_bytes, record_to_bytes
from stillpoint.datasets.errors import BadFile

_BLOCK = 1 << 20  # bytes that are copied at once
_SYNCS_AT_ONCE = 16


@dataclass(frozen=True)
class Change:
    """A record to be kept, with the bytes of its object when these are new."""

    record: Record
    record_file: Path
    object_file: Path | None  # None: the record alone changes
    replaces: bool  # False: a record that is there already wins


@dataclass(frozen=True)
class Wanted:
    """A record to be kept, and a copy of its object when that is new."""

    record: Record
    copy: Path | None
    replaces: bool = False


@dataclass(frozen=True)
class Given:
    """A file to be kept, and what its record is to say."""

    source: Path  # how messages name it
    open: Callable[[], IO[bytes]]
    file_name: str
    tags: Sequence[str] = ()
    metadata: Mapping[str, str] = field(default_factory=dict)
    added: str = ""  # when another archive took it in; "" for now
    sha256: str = ""  # that it must have; "" for any
    largest: float = math.inf  # bytes


class Incoming:
    """The folder of this process; close it when its changes are moved in."""

    def __init__(self, home: Path) -> None:
        """Make an empty folder below ``incoming/``, and lock it while this process lives."""
        base = home / "incoming"
        base.mkdir(exist_ok=True)
        token = f"{os.getpid()}-{secrets.token_hex(4)}"
        self._lock = OwnLock(base / f"{token}.lock")
        self.folder = base / token
        self.folder.mkdir()

    def abandon(self) -> None:
        """Leave the folder to the next command, which moves in what is complete and deletes the rest."""
        self._lock.release()

    def close(self) -> None:
        """Delete the folder, whose changes are in their places and in the catalogue."""
        shutil.rmtree(self.folder, ignore_errors=True)
        self._lock.release()

    def copy(self, given: Given) -> tuple[Path, str, int]:
        """Copy a file here while its hash is computed; returns the copy, the SHA-256 and the size.

        Raises :class:`BadFile` when it cannot be read, is not what was promised, or the disk is full.
        """
        target = self.folder / f"{secrets.token_hex(8)}.copy"
        digest, size = hashlib.sha256(), 0
        try:
            with given.open() as source, open(target, "xb") as kept:
                while (block := source.read(_BLOCK)) and size <= given.largest:
                    digest.update(block)
                    kept.write(block)
                    size += len(block)
        except OSError as error:
            target.unlink(missing_ok=True)
            raise BadFile(
                f"{given.source}: cannot be copied ({error.strerror}); check the file and the disk"
            ) from error
        if given.sha256 not in ("", digest.hexdigest()):
            target.unlink()
            raise BadFile(
                f"{given.source}: is damaged: its SHA-256 is not the stated {given.sha256[:12]}…; copy it again"
            )
        return target, digest.hexdigest(), size

    def stage(self, wanted: Sequence[Wanted]) -> list[Change]:
        """Make changes complete: they happen even when this process is killed from now on, or the power fails.

        The copies are flushed to disk before the records are written, all together, which costs little more than one.
        """
        sync_files([each.copy for each in wanted if each.copy is not None])
        parts = []
        for each in wanted:
            part = self.folder / f"{each.record.sha256}.part"
            part.write_bytes(record_to_bytes(each.record))
            parts.append(part)
        sync_files(parts)
        changes = []
        for each, part in zip(wanted, parts, strict=True):
            sha256 = each.record.sha256
            object_file = None if each.copy is None else each.copy.rename(self.folder / f"{sha256}.object")
            record_file = part.rename(self.folder / f"{sha256}.{'replace' if each.replaces else 'new'}.json")
            changes.append(Change(each.record, record_file, object_file, each.replaces))
        return changes


def sync_files(paths: Iterable[Path]) -> None:
    """Flush files and folders to the disk, several at once: file systems join such requests."""

    def flush(path: Path) -> None:
        """Write a file or folder to the disk; does nothing where the system cannot."""
        handle = os.open(path, os.O_RDONLY)
        try:
            os.fsync(handle)
        except OSError:  # some file systems offer none for folders
            pass
        finally:
            os.close(handle)

    with ThreadPoolExecutor(_SYNCS_AT_ONCE) as pool:
        list(pool.map(flush, paths))


def finish_dead_changes(home: Path, commit: Callable[[Sequence[Change]], None]) -> int:
    """Commit what dead processes left complete, delete what they left in parts; returns how many folders there were."""
    count = 0
    for name, folder in _list_folders(home):
        lock = home / "incoming" / f"{name}.lock"
        with lock_of_dead_process(lock) as dead:
            if not dead:
                continue
            if folder.is_dir():
                commit(_read_changes(folder))
                shutil.rmtree(folder, ignore_errors=True)
                count += 1
            lock.unlink(missing_ok=True)
    return count


def _list_folders(home: Path) -> Iterator[tuple[str, Path]]:
    """Yield token and folder of each change that was begun and not finished."""
    base = home / "incoming"
    if base.is_dir():
        for name in sorted({entry.name.removesuffix(".lock") for entry in base.iterdir()}):
            yield name, base / name


def _read_changes(folder: Path) -> list[Change]:
    """Return the changes in a folder whose record is whole; a record that cannot be read is passed over."""
    changes = []
    for file in sorted(folder.glob("*.json")):
        try:
            record = record_from_bytes(file.read_bytes(), str(file))
        except BadFile:
            continue  # written by another version, whose process did not report it as done
        object_file = folder / f"{record.sha256}.object"
        replaces = file.name.endswith(".replace.json")
        changes.append(Change(record, file, object_file if object_file.exists() else None, replaces))
    return changes
