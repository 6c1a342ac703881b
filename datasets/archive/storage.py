"""Storage of objects and records: a folder, or any place that fsspec reaches. Keys are ``objects/ab/cdef….mcap``."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, Protocol

from stillpoint.datasets.errors import BadFile
from stillpoint.datasets.files.remote import get_url, is_url, open_binary, open_url


class Storage(Protocol):
    """A place that keeps files under keys; a file appears under its key whole or not at all."""

    name: str

    def keys(self, folder: str) -> Iterator[tuple[str, int]]:
        """Return keys below a folder with the sizes of their files, in order."""

    def path(self, key: str) -> Path:
        """Return what :func:`stillpoint.datasets.read` takes to read the file; a URL for a remote one."""

    def open(self, key: str) -> IO[bytes]:
        """Open the file under this key for reading; raises ``OSError`` or :class:`BadFile`."""

    def has(self, key: str) -> bool:
        """Return whether there is a file under this key."""

    def move_in(self, file: Path, key: str) -> None:
        """Keep a local file under this key and delete it where it was; its bytes are on the disk already."""

    def copy_in(self, file: Path, key: str) -> None:
        """Keep a small local file under this key, in place of one that may be there; it stays where it was."""

    def delete(self, key: str) -> None:
        """Delete the file under this key; nothing happens when there is none."""


class FolderStorage:
    """Plain files in a local folder."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.name = str(root)
        self._made: set[Path] = set()

    def keys(self, folder: str) -> Iterator[tuple[str, int]]:
        """Yield keys below a folder with the sizes of their files, in order."""
        base = self.root / folder
        if not base.is_dir():
            return
        for shard in sorted(os.listdir(base)):
            if not (base / shard).is_dir():
                yield f"{folder}/{shard}", (base / shard).stat().st_size
                continue
            with os.scandir(base / shard) as entries:
                for entry in sorted(entries, key=lambda each: each.name):
                    yield f"{folder}/{shard}/{entry.name}", entry.stat().st_size

    def path(self, key: str) -> Path:
        """Return the file itself."""
        return self.root / key

    def open(self, key: str) -> IO[bytes]:
        """Open the file under this key, without a buffer: its readers ask for much at once."""
        return open(f"{self.name}/{key}", "rb", buffering=0)

    def has(self, key: str) -> bool:
        """Return whether there is a file under this key."""
        return (self.root / key).is_file()

    def move_in(self, file: Path, key: str) -> None:
        """Rename a file of the same file system, and make the new name durable."""
        os.replace(file, self._make_room(key))

    def copy_in(self, file: Path, key: str) -> None:
        """Write a copy beside the file, then rename it; the copy is flushed with its folder."""
        target = self._make_room(key)
        part = file.with_suffix(".copy")
        part.unlink(missing_ok=True)
        try:
            os.link(file, part)  # the same bytes, which are on the disk already
        except OSError:  # a file system without hard links
            part.write_bytes(file.read_bytes())
        os.replace(part, target)

    def _make_room(self, key: str) -> Path:
        """Return the place of a key, whose folder is there."""
        target = self.root / key
        if target.parent not in self._made:
            target.parent.mkdir(parents=True, exist_ok=True)
            self._made.add(target.parent)
        return target

    def delete(self, key: str) -> None:
        """Delete the file under this key."""
        (self.root / key).unlink(missing_ok=True)


class _RemoteStorage:
    """Files behind an fsspec URL: S3, HTTP servers that take uploads, memory://, any other."""

    def __init__(self, url: str) -> None:
        """Open the file system of a URL; raises :class:`BadParameter`."""
        self.name = url.rstrip("/")
        self._fs: Any
        self._fs, self._root = open_url(self.name)
        self._root = self._root.rstrip("/")

    def keys(self, folder: str) -> Iterator[tuple[str, int]]:
        """Yield keys below a folder with the sizes of their files, in order."""
        self._fs.invalidate_cache()
        try:
            found = self._fs.find(f"{self._root}/{folder}", detail=True)
        except FileNotFoundError:
            return
        start = len(self._root.strip("/")) + 1
        for path in sorted(found):
            yield path.strip("/")[start:], int(found[path]["size"])

    def path(self, key: str) -> Path:
        """Return the URL of a file, as a path that :func:`open_binary` takes."""
        return Path(f"{self.name}/{key}")

    def open(self, key: str) -> IO[bytes]:
        """Open the file behind the URL."""
        return open_binary(self.path(key))

    def has(self, key: str) -> bool:
        """Return whether there is a file under this key."""
        self._fs.invalidate_cache()
        return bool(self._fs.isfile(f"{self._root}/{key}"))

    def move_in(self, file: Path, key: str) -> None:
        """Upload a file, then delete the local one."""
        self.copy_in(file, key)
        file.unlink()

    def copy_in(self, file: Path, key: str) -> None:
        """Upload a file."""
        try:
            self._fs.makedirs(f"{self._root}/{key.rpartition('/')[0]}", exist_ok=True)
            self._fs.put_file(str(file), f"{self._root}/{key}")
        except Exception as error:  # every protocol has exceptions of its own
            raise BadFile(f"{self.name}/{key}: cannot be written ({error}); check the connection") from error

    def delete(self, key: str) -> None:
        """Delete the file under this key."""
        if self.has(key):
            self._fs.rm_file(f"{self._root}/{key}")


def open_storage(place: str | Path) -> Storage:
    """Return the storage at a folder or at a URL."""
    return _RemoteStorage(get_url(place)) if is_url(place) else FolderStorage(Path(place))


def read_key(storage: Storage, key: str) -> bytes:
    """Return all bytes under a key; raises ``OSError`` or :class:`BadFile`."""
    with storage.open(key) as file:
        return file.read()
