"""Text that a verb writes beside its MCAP files."""

from pathlib import Path

from stillpoint.datasets.errors import BadParameter


def write_text(path: Path, text: str) -> None:
    """UTF-8; raises :class:`BadParameter` when the file cannot be written."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise BadParameter(f"{path}: cannot be written ({error.strerror}); name another place") from None
