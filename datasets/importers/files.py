"""The files of a source: one file, one folder or one zip, opened within limits and named in messages."""

import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from stillpoint.datasets.errors import BadSource, StillpointError
from stillpoint.datasets.files.limits import LARGEST_MEMBER, limit_chunk, raise_limit
from stillpoint.datasets.mcap.store import sha256

_RESTORE = "it may be damaged: restore it from a copy, or export it again"


@contextmanager
def reading(where: Path | str, what: str, remedy: str = _RESTORE) -> Iterator[None]:
    """Turn any failure of a library while it reads a file into one line.

    Libraries raise whatever their parsers stumble over, so that no list of exceptions is complete. Raises
    :class:`BadSource` from the failure, which ``--debug`` shows; errors of stillpoint pass.
    """
    try:
        yield
    except StillpointError:
        raise
    except Exception as error:
        raise BadSource(f"{where}: cannot be read as {what} ({_describe_failure(error)}); {remedy}") from error


def _describe_failure(error: Exception) -> str:
    """Return the first line of an exception, or its type where it has no text."""
    if isinstance(error, MemoryError):
        return "it claims more memory than there is"
    if isinstance(error, RecursionError):
        return "it is nested too deeply"
    text = (error.strerror or "") if isinstance(error, OSError) else str(error)
    first = " ".join(text.split())[:160]
    if type(error) is ValueError and first:
        return first
    return f"{type(error).__name__}: {first}" if first else type(error).__name__


def hash_files(files: Iterable[Path], below: Path) -> dict[str, str]:
    """Return the sha256 of files by their names relative to ``below``."""
    return {file.relative_to(below).as_posix(): sha256(file) for file in files}


def require_existing(source: Path) -> Path:
    """Return the source; raises :class:`BadSource` when it is not there."""
    if not source.exists():
        raise BadSource(f"{source}: there is no such file or folder; check the name")
    return source


def find_itself(source: Path) -> list[Path]:
    """Return the source, which holds one recording; raises :class:`BadSource` when it is not there."""
    return [require_existing(source)]


def find_folders(source: Path, name: str, remedy: str) -> list[Path]:
    """Return the folders at or below a source that hold a file of this name; raises :class:`BadSource` for none."""
    require_existing(source)
    folders = sorted(file.parent for file in source.rglob(name)) if source.is_dir() else []
    if not folders:
        raise BadSource(f"{source}: no folder here or below holds {name}; {remedy}")
    return folders


def read_text(file: Path) -> str:
    """Return the text of a file in UTF-8, UTF-16 or else Latin-1; raises :class:`BadSource`."""
    with reading(file, "text", "check the name"):
        size = file.stat().st_size
        if size > raise_limit(LARGEST_MEMBER):
            raise BadSource(
                f"{file}: has {size} bytes, more than {raise_limit(LARGEST_MEMBER)}; give --large to read it"
            )
        return _decode_text(file.read_bytes(), file)


def _decode_text(data: bytes, file: Path | str) -> str:
    """Return bytes as text in UTF-8, UTF-16 or else Latin-1; raises :class:`BadSource`."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        pass
    try:
        return data.decode("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "latin-1")
    except UnicodeDecodeError:
        raise BadSource(f"{file}: is not text; export it as CSV") from None


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
        """Return the first of these names that holds text, whatever its case; an empty file counts as not there."""
        lower = {name.lower(): name for name, text in self.texts.items() if not _is_empty(text)}
        return next((lower[name.lower()] for name in names if name.lower() in lower), None)

    def find_empty(self, *names: str) -> list[str]:
        """Return those of these names that are there and hold nothing."""
        wanted = {name.lower() for name in names}
        return [name for name, text in self.texts.items() if name.lower() in wanted and _is_empty(text)]

    def where(self, name: str) -> str:
        """Return how to name one of the files in a message."""
        return f"{self.source}/{name}"


def _is_empty(text: str) -> bool:
    """Return whether a text has no line, or only a header."""
    return "\n" not in text.strip()


def open_bundle(source: Path, suffixes: tuple[str, ...] = (".csv",)) -> Bundle:
    """Return all CSV files of a folder or zip; a folder around everything in a zip is ignored.

    Raises :class:`BadSource` when there is none, or the file is no zip.
    """
    require_existing(source)
    if source.is_dir():
        files = sorted(f for f in source.rglob("*") if f.is_file() and f.suffix.lower() in suffixes)
        texts = {file.relative_to(source).as_posix(): read_text(file) for file in files}
        sha256 = hash_files(files, source)
    else:
        texts = _read_zip(source, suffixes)
        sha256 = hash_files([source], source.parent)
    if not texts:
        kinds = " or ".join(suffix.lstrip(".").upper() for suffix in suffixes)
        raise BadSource(f"{source}: holds no {kinds} file; name the zip of one recording, or the folder it unpacks to")
    return Bundle(source, _strip_wrapper(texts), sha256)


def _read_zip(source: Path, suffixes: tuple[str, ...]) -> dict[str, str]:
    """Return the texts of a zip. Its directory may lie about sizes: no more than the limit is unpacked."""
    texts, left = {}, raise_limit(LARGEST_MEMBER)
    with reading(source, "a zip", "export it again, or name a folder"), zipfile.ZipFile(source) as archive:
        for member in archive.infolist():
            if not member.filename.lower().endswith(suffixes) or "__MACOSX" in member.filename:
                continue
            if member.file_size > min(left, limit_chunk(member.compress_size)):
                raise BadSource(
                    f"{source}: {member.filename} claims {member.file_size} bytes, unpacked, from "
                    f"{member.compress_size}; the limit is {raise_limit(LARGEST_MEMBER)} for the whole zip: "
                    "give --large if this is right"
                )
            with archive.open(member) as file:
                data = file.read(member.file_size + 1)
            if len(data) > member.file_size:
                raise BadSource(f"{source}: {member.filename} holds more bytes than it claims; export it again")
            left -= len(data)
            texts[member.filename] = _decode_text(data, source / member.filename)
    return texts


def _strip_wrapper(texts: dict[str, str]) -> dict[str, str]:
    """Return texts by their names without a single folder around all of them."""
    tops = {PurePosixPath(name).parts[0] for name in texts if PurePosixPath(name).parts}
    if len(tops) == 1 and all("/" in name for name in texts):
        return {name.split("/", 1)[1]: text for name, text in texts.items()}
    return texts
