"""Write files that appear under their name whole, on disk, or not at all, and remove what dead processes left.

A file is written beside its place under a hidden name that carries the host, the process and the time at which the
process started: ``.NAME.TOKEN.HOST.PID.START.part``. A process that is killed leaves such a part; the next write into
the same folder removes the parts whose process no longer runs on this host. Parts of other hosts are never touched.
"""

import io
import os
import secrets
import shutil
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import IO, Any

_SUFFIX = ".part"
_BUFFER_BYTES = 1 << 20
_STRIDE_BYTES = 16 << 20  # of a long file that are sent to the disk together
_CACHED_BYTES = 64 << 20  # of its end that stay in the system's cache


@contextmanager
def write_atomically(path: Path, leaves_cache: bool = False) -> Iterator[IO[bytes]]:
    """Open a binary file that replaces ``path`` when the block ends without an error.

    The content is on disk before the name is, so that a power cut leaves the old file or the new one. A link stays a
    link: its target is replaced. ``leaves_cache``: all but the end of a long file goes to the disk while it is written,
    and leaves the system's cache. Raises ``OSError`` when the file cannot be written.
    """
    target = path.resolve()
    _remove_stale_parts_once(target.parent)
    part = target.with_name(_make_part_name(target.name))
    try:
        with io.BufferedWriter((_SteadyFile if leaves_cache else io.FileIO)(part, "x"), _BUFFER_BYTES) as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        if target.exists():
            part.chmod(target.stat().st_mode)
        os.replace(part, target)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    _sync(target.parent)


class _SteadyFile(io.FileIO):
    """A file of which all but the end goes to the disk while it is written, and leaves the system's cache.

    Otherwise gigabytes wait for the disk at the end, and the system has to find memory for them: in a virtual machine
    that can take longer than to compute them.
    """

    _sent = 0  # bytes that were sent to the disk, but for those that stay cached

    def write(self, data: Any) -> int:
        """Write bytes; return how many."""
        count = super().write(data)
        end = self.tell() - _CACHED_BYTES
        if end >= self._sent + _STRIDE_BYTES and hasattr(os, "posix_fadvise"):
            os.posix_fadvise(self.fileno(), 0, end, os.POSIX_FADV_DONTNEED)
            self._sent = end
        return count


@contextmanager
def write_folder_atomically(path: Path) -> Iterator[Path]:
    """Make a folder that appears as ``path``, which is not there yet, when the block ends without an error.

    Yields the folder to write into. Its files are on disk before the name is. Raises ``OSError``.
    """
    target = path.resolve()
    _remove_stale_parts_once(target.parent)
    part = target.with_name(_make_part_name(target.name))
    part.mkdir()
    try:
        yield part
        for file in part.rglob("*"):
            _sync(file)
        part.rename(target)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise
    _sync(target.parent)


def remove_stale_parts(folder: Path) -> int:
    """Remove the parts that dead processes of this host left in a folder; return how many there were."""
    removed = 0
    for part in folder.glob(f".*{_SUFFIX}"):
        if _is_stale(part.name):
            try:
                if part.is_dir():
                    shutil.rmtree(part)
                else:
                    part.unlink()
                removed += 1
            except OSError:
                continue  # another process was faster, or the folder is read-only
    return removed


@cache
def _remove_stale_parts_once(folder: Path) -> int:
    """Remove stale parts of a folder, once in this process; return how many there were."""
    return remove_stale_parts(folder)


def _make_part_name(name: str) -> str:
    """Return the name of the part of a file: hidden, unique, and with host and process that write it."""
    pid = os.getpid()
    kept = name[:120]  # the whole must stay within the 255 bytes of a file name
    return f".{kept}.{secrets.token_hex(3)}.{_get_host()}.{pid}.{_read_start(pid)}{_SUFFIX}"


def _is_stale(name: str) -> bool:
    """Return whether the process that wrote the part of this name ran on this host and no longer runs."""
    words = name.removesuffix(_SUFFIX).rsplit(".", 3)
    if len(words) < 4 or words[1] != _get_host() or not (words[2].isdigit() and words[3].isdigit()):
        return False
    pid, start = int(words[2]), int(words[3])
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    except OSError:
        return False  # it runs as another user
    return start != _read_start(pid)  # the number of a dead process was given to another one


@cache
def _get_host() -> str:
    """Return the name of this host without dots."""
    return socket.gethostname().replace(".", "-").replace("/", "-")[:40] or "host"


def _read_start(pid: int) -> int:
    """Return the start of a process in clock ticks since boot; 0 where the system does not tell."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return 0
    return int(stat.rsplit(")", 1)[1].split()[19])


def _sync(path: Path) -> None:
    """Make a file, or the names in a folder, durable, where the system offers it; they are whole in any case."""
    try:
        handle = os.open(path, os.O_RDONLY)
    except OSError:
        return
    try:
        os.fsync(handle)
    except OSError:
        pass
    finally:
        os.close(handle)
