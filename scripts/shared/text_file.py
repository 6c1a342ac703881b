"""Text that a verb writes beside its MCAP files."""

from pathlib import Path

from stillpoint.datasets.atomic import write_atomically
from stillpoint.datasets.errors import BadParameter


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text, the whole file or none of it; raises :class:`BadParameter` when it cannot be written."""
    try:
        if path.exists() and not path.is_file():  # a pipe or a device
            path.write_text(text, encoding="utf-8")
        else:
            with write_atomically(path) as file:
                file.write(text.encode())
    except OSError as error:
        raise BadParameter(f"{path}: cannot be written ({error.strerror}); name another place") from None
