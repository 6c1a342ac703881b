"""Write and read bundles as a folder, a zip or a tar; reading never leaves the folder and is bounded in size."""

import io
import json
import os
import re
import shutil
import tarfile
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePosixPath
from typing import IO, Any

from stillpoint.datasets.archive.bundle import CHECKSUMS, FORMAT, MANIFEST
from stillpoint.datasets.archive.incoming import Given
from stillpoint.datasets.archive.record import SHA256
from stillpoint.datasets.errors import BadFile, BadParameter
from stillpoint.datasets.files.atomic import write_atomically, write_folder_atomically
from stillpoint.datasets.files.remote import open_binary

_BLOCK = 1 << 20
_LARGEST_MANIFEST = 256 << 20  # bytes: 600 bytes an object, so 400,000 objects
LARGEST_BUNDLE = 1 << 40  # bytes, unpacked, unless the user says more
_LARGEST_RATIO = 200  # unpacked over packed of a zip's member: MCAP files are packed already, texts reach 20
_FIXED_TIME = (1980, 1, 1, 0, 0, 0)  # the first that zip knows: the same bundle gives the same bytes


@dataclass(frozen=True)
class _Member:
    """One object of a bundle as its manifest describes it."""

    path: str
    sha256: str
    size: int
    file_name: str
    added: str
    tags: tuple[str, ...]
    metadata: Mapping[str, str]


def write_bundle(files: Mapping[str, Path | bytes], target: Path) -> None:
    """Write all files of a bundle to a new folder, or to ``x.zip`` or ``x.tar``, whole or not at all.

    Raises :class:`BadParameter` when the target is there already, :class:`BadFile` when it cannot be written.
    """
    if target.exists():
        raise BadParameter(f"{target}: is there already; name a new folder, .zip or .tar")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.suffix in (".zip", ".tar"):
            with write_atomically(target) as file:
                (_write_zip if target.suffix == ".zip" else _write_tar)(files, file)
        else:
            with write_folder_atomically(target) as folder:
                _write_folder(files, folder)
    except OSError as error:
        raise BadFile(f"{target}: cannot be written ({error.strerror}); check the disk and the folder") from error


def _write_folder(files: Mapping[str, Path | bytes], folder: Path) -> None:
    """Write the files of a bundle below a folder; raises ``FileExistsError`` for one that is there."""
    for path, content in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        with open(folder / path, "xb") as out, _open_content(content) as source:
            shutil.copyfileobj(source, out, _BLOCK)


def _write_zip(files: Mapping[str, Path | bytes], target: IO[bytes]) -> None:
    """Write a bundle as ZIP with fixed times; MCAP files, which are compressed already, are stored as they are."""
    with zipfile.ZipFile(target, "w") as out:
        for path, content in files.items():
            info = zipfile.ZipInfo(path, _FIXED_TIME)
            is_packed = path.endswith(".mcap")
            info.compress_type = zipfile.ZIP_STORED if is_packed else zipfile.ZIP_DEFLATED
            info.external_attr = 0o644 << 16
            with _open_content(content) as source, out.open(info, "w", force_zip64=True) as member:
                shutil.copyfileobj(source, member, _BLOCK)


def _write_tar(files: Mapping[str, Path | bytes], target: IO[bytes]) -> None:
    """Write a bundle as TAR with fixed times and rights."""
    with tarfile.open(fileobj=target, mode="w", format=tarfile.PAX_FORMAT) as out:
        for path, content in files.items():
            info = tarfile.TarInfo(path)
            info.mode = 0o644
            with _open_content(content) as source:
                info.size = source.seek(0, os.SEEK_END)
                source.seek(0)
                out.addfile(info, source)


@contextmanager
def _open_content(content: Path | bytes) -> Iterator[IO[bytes]]:
    """Open a file, or bytes as a file, for reading."""
    with io.BytesIO(content) if isinstance(content, bytes) else open_binary(content) as file:
        yield file


class Bundle:
    """An open bundle; :func:`open_bundle` makes one."""

    def __init__(self, place: Path, read_file: Callable[[str], IO[bytes]], largest: int) -> None:
        self.place = place
        self._open = read_file
        self.members = self._read_manifest(largest)

    def read_objects(self) -> Iterator[Given]:
        """Yield the objects for :meth:`~stillpoint.datasets.archive.archive.Archive.add_given`, which checks hashes."""
        for member in self.members:
            yield Given(
                source=self.place / member.path,
                open=partial(self._open, member.path),
                file_name=member.file_name,
                tags=member.tags,
                metadata=member.metadata,
                added=member.added,
                sha256=member.sha256,
                largest=member.size,
            )

    def _read_manifest(self, largest: int) -> list[_Member]:
        """Return the members that the manifest names; raises :class:`BadFile` for a manifest that is not ours."""
        with self._open(MANIFEST) as file:
            data = file.read(_LARGEST_MANIFEST + 1)
        if len(data) > _LARGEST_MANIFEST:
            raise BadFile(f"{self.place}: its manifest has more than {_LARGEST_MANIFEST} bytes; name a bundle")
        try:
            content = json.loads(data)
            if content["format"] != FORMAT:
                raise BadFile(f"{self.place}: is a bundle of format {content['format']}; install a newer stillpoint")
            members = [_parse_member(one) for one in content["objects"]]
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise BadFile(f"{self.place}: its {MANIFEST} cannot be read ({error}); copy the bundle again") from error
        total = sum(member.size for member in members)
        if total > largest:
            raise BadFile(f"{self.place}: claims {total} bytes, more than {largest}; give --max-bytes if this is right")
        return members


def _parse_member(one: Mapping[str, Any]) -> _Member:
    """Return an entry of the manifest; raises ``ValueError`` for a path that leads out, or without hash or size."""
    path = str(one["path"])
    if not is_inside(path):
        raise ValueError(f"{path!r} leads out of the bundle")
    if not SHA256.fullmatch(one["sha256"]) or not isinstance(one["size"], int) or one["size"] < 0:
        raise ValueError(f"{path}: has no hash or no size")
    name = PurePosixPath(str(one["file_name"]).replace("\\", "/")).name
    metadata = {str(key): str(value) for key, value in one["metadata"].items()}
    tags = tuple(str(tag) for tag in one["tags"])
    return _Member(path, one["sha256"], one["size"], name or one["sha256"], str(one["added"]), tags, metadata)


def is_inside(path: str) -> bool:
    """Return whether a path of a bundle stays in the bundle: relative, with no ``..``, no drive and no other
    separator.
    """
    parts = PurePosixPath(path).parts
    plain = bool(parts) and not path.startswith("/") and "\\" not in path and not re.match("[A-Za-z]:", path)
    return plain and ".." not in parts and "\0" not in path


@contextmanager
def open_bundle(place: Path, largest: int = LARGEST_BUNDLE) -> Iterator[Bundle]:
    """Open a bundle in a folder, a zip or a tar; raises :class:`BadFile` for anything else.

    Only members that the manifest lists are ever read, and no link is followed.
    """
    try:
        if place.is_dir():
            yield Bundle(place, lambda path: _open_in_folder(place, path), largest)
        elif zipfile.is_zipfile(place):
            with zipfile.ZipFile(place) as archive:
                yield Bundle(place, lambda path: _open_in_zip(place, archive, path), largest)
        elif place.is_file() and tarfile.is_tarfile(place):
            with tarfile.open(place, "r:") as tar:
                members = {member.name: member for member in tar if member.isreg() and is_inside(member.name)}
                yield Bundle(place, lambda path: _open_in_tar(place, tar, members, path), largest)
        else:
            raise BadParameter(f"{place}: is not a bundle; name a folder, a .zip or a .tar that archive export wrote")
    except (zipfile.BadZipFile, tarfile.TarError, EOFError) as error:
        raise BadFile(f"{place}: is damaged ({error}); copy it again") from error
    except OSError as error:
        raise BadFile(
            f"{place}: cannot be read ({error.strerror or error}); check the name and its permissions"
        ) from error


def _open_in_folder(place: Path, path: str) -> IO[bytes]:
    """Open a file of a bundle in a folder; raises :class:`BadFile` for links and for paths that lead out."""
    file = place / path
    if not file.is_file() or file.is_symlink() or not file.resolve().is_relative_to(place.resolve()):
        raise BadFile(f"{place}: has no file {path} (sha256sum -c {CHECKSUMS} lists all); copy the bundle again")
    return open(file, "rb")


def _open_in_zip(place: Path, archive: zipfile.ZipFile, path: str) -> IO[bytes]:
    """Open a file of a bundle in a ZIP; raises :class:`BadFile` where it would unpack to far more than its size."""
    try:
        info = archive.getinfo(path)
    except KeyError:
        raise BadFile(f"{place}: has no file {path}; copy the bundle again") from None
    if info.file_size > _BLOCK and info.file_size > _LARGEST_RATIO * max(info.compress_size, 1):
        raise BadFile(f"{place}: {path} unpacks to {info.file_size} bytes from {info.compress_size}; do not use it")
    return archive.open(info)


def _open_in_tar(place: Path, tar: tarfile.TarFile, members: Mapping[str, tarfile.TarInfo], path: str) -> IO[bytes]:
    """Open a file of a bundle in a TAR; raises :class:`BadFile` where it is missing."""
    file = tar.extractfile(members[path]) if path in members else None
    if file is None:
        raise BadFile(f"{place}: has no file {path}; copy the bundle again")
    return file
