"""Files behind URLs: whatever fsspec reaches (S3, HTTP, memory://), read by ranges, with repeated attempts.

A URL may travel as a ``Path``, which writes ``s3://bucket/key`` as ``s3:/bucket/key``; :func:`get_url` undoes that.
fsspec and the client of the protocol are the extra ``cloud``.
"""

import hashlib
import io
import re
import time
from pathlib import Path
from typing import IO, Any

from stillpoint.datasets.errors import BadFile, BadParameter

_URL = re.compile(r"([a-z][a-z0-9+.-]+):/{1,2}(?!/)", re.IGNORECASE)  # a single letter is a drive of Windows
_ATTEMPTS = 5  # of one range, before a lost connection is an error
_FIRST_WAIT_S = 0.1  # after the first attempt; doubled after each further one
_BLOCK = 1 << 20  # bytes that are hashed at once
_READ_AHEAD = 4 << 20  # bytes that a sequential reader asks for at once


def is_url(path: Path | str) -> bool:
    """Return whether a path is the URL of something that is not in the local file system."""
    match = _URL.match(str(path))
    return match is not None and match[1].lower() != "file"


def get_url(path: Path | str) -> str:
    """Return the URL that a path stands for, with its two slashes."""
    return _URL.sub(lambda match: f"{match[1].lower()}://", str(path), count=1)


def open_url(path: Path | str) -> tuple[Any, str]:
    """Return the fsspec file system of a URL, and the path in it; raises :class:`BadParameter` without fsspec."""
    url = get_url(path)
    try:
        import fsspec

        filesystem, inside = fsspec.core.url_to_fs(url)
    except ImportError as error:
        raise BadParameter(
            f"{url}: reading URLs needs the extra cloud ({error}); install it: pip install 'stillpoint[cloud]'"
        ) from None
    except ValueError as error:
        raise BadParameter(f"{url}: {error}") from None
    return filesystem, str(inside)


def open_binary(path: Path | str) -> IO[bytes]:
    """Open a file to read it from start to end, local or behind a URL; raises ``OSError`` or :class:`BadFile`."""
    if not is_url(path):
        return open(str(path).removeprefix("file://"), "rb")
    return io.BufferedReader(RangedFile(path), _READ_AHEAD)


def hash_file(path: Path | str) -> str:
    """Return the SHA-256 of a file, local or remote; raises ``OSError`` or :class:`BadFile`."""
    digest = hashlib.sha256()
    with open_binary(path) as file:
        while block := file.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()


def list_files(path: Path | str, suffix: str) -> list[Path]:
    """Return the files with this suffix that a URL stands for: one file, a folder with all below it, or a glob.

    Raises :class:`BadParameter` when there is none.
    """
    filesystem, inside = open_url(path)
    start, _, _ = get_url(path).partition("://")
    try:
        if any(letter in inside for letter in "*?["):
            found = filesystem.glob(inside)
        elif inside.endswith(suffix):
            found = [inside] if filesystem.isfile(inside) else []
        else:
            found = filesystem.find(inside)
    except (FileNotFoundError, NotADirectoryError):
        found = []
    except Exception as error:  # each protocol has exceptions of its own
        raise BadFile(f"{get_url(path)}: cannot be listed ({error}); check the connection and your rights") from error
    files = sorted(Path(f"{start}://{one.lstrip('/')}") for one in found if one.endswith(suffix))
    if not files:
        raise BadParameter(f"{get_url(path)}: there is no file *{suffix}")
    return files


class RangedFile(io.RawIOBase):
    """A remote file that fetches exactly the ranges that are read, and counts their bytes."""

    def __init__(self, path: Path | str) -> None:
        """Open a URL, and ask for its size; raises :class:`BadFile`."""
        super().__init__()
        self.url = get_url(path)
        self._fs, self._path = open_url(path)
        self._position = 0
        self.bytes_fetched = 0
        self.requests = 0
        self.size = int(self._retry(lambda: self._fs.info(self._path))["size"])

    def fetch(self, start: int, end: int) -> bytes:
        """Return the bytes from ``start`` to ``end``; raises :class:`BadFile` after five attempts in vain."""
        if end <= start:
            return b""

        def attempt() -> bytes:
            """Ask for the bytes once; raises ``OSError`` where fewer come."""
            self.requests += 1
            data: bytes = self._fs.cat_file(self._path, start=start, end=end)
            self.bytes_fetched += len(data)
            if len(data) != end - start:
                raise OSError(f"{len(data)} bytes came where {end - start} were asked for")
            return data

        result: bytes = self._retry(attempt)
        return result

    def readable(self) -> bool:
        """Return True."""
        return True

    def seekable(self) -> bool:
        """Return True."""
        return True

    def tell(self) -> int:
        """Return the place that is read next."""
        return self._position

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Move to another place; nothing is fetched."""
        base = {io.SEEK_SET: 0, io.SEEK_CUR: self._position, io.SEEK_END: self.size}[whence]
        self._position = max(base + offset, 0)
        return self._position

    def readinto(self, buffer: Any) -> int:
        """Fill the buffer from the current place."""
        data = self.fetch(self._position, min(self._position + len(buffer), self.size))
        buffer[: len(data)] = data
        self._position += len(data)
        return len(data)

    def _retry(self, attempt: Any) -> Any:
        """Return what a call gives, with growing pauses between attempts; raises :class:`BadFile` after the last."""
        for k in range(_ATTEMPTS):
            try:
                return attempt()
            except (FileNotFoundError, PermissionError) as error:
                raise BadFile(f"{self.url}: cannot be opened ({error}); check the name and your rights") from error
            except Exception as error:  # each protocol has exceptions of its own for a lost connection
                if k == _ATTEMPTS - 1:
                    raise BadFile(
                        f"{self.url}: cannot be read after {_ATTEMPTS} attempts ({type(error).__name__}: {error}); "
                        "check the connection"
                    ) from error
                time.sleep(_FIRST_WAIT_S * 2**k)
        raise AssertionError("unreachable")
