"""Text that a verb writes beside its MCAP files."""

import os
import tempfile
from pathlib import Path

from stillpoint.datasets.errors import BadParameter


def write_text(path: Path, text: str) -> None:
    """UTF-8, the whole file or none of it; raises :class:`BadParameter` when it cannot be written."""
    try:
        if path.exists() and not path.is_file():  # a pipe or a device
            path.write_text(text, encoding="utf-8")
        else:
            _replace(path, text)
    except OSError as error:
        raise BadParameter(f"{path}: cannot be written ({error.strerror}); name another place") from None


def _replace(path: Path, text: str) -> None:
    place = path.resolve()  # a link stays one
    handle, name = tempfile.mkstemp(prefix=f".{place.name}.", suffix=".part", dir=place.parent)
    part = Path(name)
    try:
        with open(handle, "w", encoding="utf-8") as file:
            file.write(text)
        part.chmod(place.stat().st_mode if place.exists() else 0o666 & ~_umask())
        part.replace(place)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def _umask() -> int:
    """What new files of this process lack; the system tells it only by setting it."""
    mask = os.umask(0o077)
    os.umask(mask)
    return mask
