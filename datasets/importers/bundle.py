"""The files of a source: one folder or one zip, read the same way."""

import zipfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from stillpoint.datasets.errors import BadSource
from stillpoint.datasets.mcap.store import sha256


def digests(files: Iterable[Path], below: Path) -> dict[str, str]:
    """sha256 of files by their names relative to ``below``."""
    return {file.relative_to(below).as_posix(): sha256(file) for file in files}


def existing(source: Path) -> Path:
    """The source itself; raises :class:`BadSource` when it is not there."""
    if not source.exists():
        raise BadSource(f"{source}: there is no such file or folder")
    return source


def folders_with(source: Path, name: str, remedy: str) -> list[Path]:
    """The folders at or below a source that hold a file of this name; raises :class:`BadSource` when there is none."""
    existing(source)
    folders = sorted(file.parent for file in source.rglob(name)) if source.is_dir() else []
    if not folders:
        raise BadSource(f"{source}: no folder here or below holds {name}; {remedy}")
    return folders


@dataclass(frozen=True)
class Bundle:
    """Named text files of one recording, from a folder or a zip."""

    source: Path
    texts: dict[str, str]  # by name below the source, "meta/time.csv"
    sha256: dict[str, str]

    @property
    def name(self) -> str:
        """The recording's name: that of the zip without its ending, or of the folder."""
        return self.source.name if self.source.is_dir() else self.source.stem

    def find(self, *names: str) -> str | None:
        """The first of these names that is there, whatever its case."""
        lower = {name.lower(): name for name in self.texts}
        return next((lower[name.lower()] for name in names if name.lower() in lower), None)

    def where(self, name: str) -> str:
        """How to name one of the files in a message."""
        return f"{self.source}/{name}"


def open_bundle(source: Path) -> Bundle:
    """All CSV files of a folder or zip; a folder that wraps everything inside a zip is taken off.

    Raises :class:`BadSource` when there is none, or the file is no zip.
    """
    existing(source)
    if source.is_dir():
        files = sorted(file for file in source.rglob("*.csv") if file.is_file())
        texts = {file.relative_to(source).as_posix(): _decode(file.read_bytes(), file) for file in files}
        sha256 = digests(files, source)
    else:
        try:
            with zipfile.ZipFile(source) as archive:
                members = [m for m in archive.namelist() if m.lower().endswith(".csv") and "__MACOSX" not in m]
                texts = {member: _decode(archive.read(member), source / member) for member in members}
        except (zipfile.BadZipFile, NotImplementedError, RuntimeError) as error:
            raise BadSource(f"{source}: cannot be read as a zip ({error}); export it again, or name a folder") from None
        sha256 = digests([source], source.parent)
    if not texts:
        raise BadSource(f"{source}: holds no CSV file; name the zip of one recording, or the folder it unpacks to")
    return Bundle(source, _without_wrapper(texts), sha256)


def _without_wrapper(texts: dict[str, str]) -> dict[str, str]:
    tops = {PurePosixPath(name).parts[0] for name in texts}
    if len(tops) == 1 and all("/" in name for name in texts):
        return {name.split("/", 1)[1]: text for name, text in texts.items()}
    return texts


def _decode(data: bytes, file: Path) -> str:
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        pass
    try:
        return data.decode("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "latin-1")
    except UnicodeDecodeError:
        raise BadSource(f"{file}: is not text; export it as CSV") from None
