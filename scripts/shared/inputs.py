"""Files, folders and globs on the command line become lists of MCAP files of one kind.

The kind stands in the name: ``NAME.reference.mcap``, ``NAME.estimate.mcap``, ``NAME.calibration.mcap``; any other
``NAME.mcap`` is a recording.
"""

import glob
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar

from stillpoint.datasets.errors import BadParameter, StillpointError
from stillpoint.datasets.files.remote import is_url, list_files
from stillpoint.datasets.mcap.pieces import PieceReader
from stillpoint.datasets.mcap.summary import summarise
from stillpoint.scripts.shared.output import print_line

SUFFIX = ".mcap"
KINDS = {"reference": ".reference.mcap", "estimate": ".estimate.mcap", "calibration": ".calibration.mcap"}
RECORDING = "recording"
_A = {
    RECORDING: "a recording",
    "reference": "a reference",
    "estimate": "an estimate",
    "calibration": "a calibration of a device",
}

Thing = TypeVar("Thing")


def get_kind(path: Path) -> str:
    """Return ``"recording"``, ``"reference"``, ``"estimate"`` or ``"calibration"``, by the name of an MCAP file."""
    return next((kind for kind, suffix in KINDS.items() if path.name.endswith(suffix)), RECORDING)


def is_of_spin(path: Path) -> bool:
    """Return whether a recording is of a spinning body and of nothing else; a file that cannot be read is not."""
    try:
        streams = {one.name for one in summarise(path).streams} if is_url(path) else set(PieceReader(path).head.samples)
    except StillpointError:
        return False
    return "spin" in streams and "imu" not in streams


def find_recordings(paths: Iterable[str | Path]) -> list[Path]:
    """Return MCAP files that are no reference and no estimate; raises :class:`BadParameter` when there is none."""
    return _select_kind(paths, RECORDING)


def find_references(paths: Iterable[str | Path]) -> list[Path]:
    """Return files ``*.reference.mcap``; raises :class:`BadParameter` when there is none."""
    return _select_kind(paths, "reference")


def find_estimates(paths: Iterable[str | Path]) -> list[Path]:
    """Return files ``*.estimate.mcap``; raises :class:`BadParameter` when there is none."""
    return _select_kind(paths, "estimate")


def find_mcap_files(paths: Iterable[str | Path]) -> list[Path]:
    """Return MCAP files of every kind, each once, in the order of ``paths`` and sorted within a folder or glob.

    A folder stands for all MCAP files in it and below. Raises :class:`BadParameter` for a path that is not there,
    names another format, or holds no MCAP file.
    """
    return list(dict.fromkeys(file for path in paths for file in _expand_path(Path(path))))


def make_output_dir(path: str | Path) -> Path:
    """Return the folder to write into, made when it is not there; raises :class:`BadParameter` when that cannot be."""
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise BadParameter(f"{folder}: is a file; name a folder to write into") from None
    except OSError as error:
        raise BadParameter(f"{folder}: cannot be made ({error.strerror}); name a folder you may write into") from None
    return folder


def choose_folder(source: Path, out: Path | None) -> Path:
    """Return the folder for what is made of a file: ``out``, or the file's own folder when that is None."""
    return source.parent if out is None else out


def _select_kind(paths: Iterable[str | Path], kind: str) -> list[Path]:
    """Return the files of this kind among the paths; raises :class:`BadParameter` when there is none."""
    named = [Path(path) for path in paths]
    if not named:
        raise BadParameter(f"no input: name {kind}s as files, folders or globs")
    files = [path for path in named if file_exists(path) and path.name.endswith(SUFFIX)]
    others = [path for path in files if get_kind(path) != kind]
    if others and len(others) == len(files):
        raise BadParameter(f"{others[0]}: is {_A[get_kind(others[0])]} by its name; give {_A[kind]}")
    if others:  # a shell makes them of run/*.mcap
        kinds = " and ".join(sorted({f"{get_kind(path)}s" for path in others}))
        print_line(f"{len(others)} {kinds} among the named files are left out", file=sys.stderr)
    found = [file for file in find_mcap_files(named) if get_kind(file) == kind]
    if not found:
        wanted = KINDS.get(kind, SUFFIX)
        raise BadParameter(f"{', '.join(map(str, named))}: holds no {kind} (*{wanted})")
    return found


def file_exists(path: Path) -> bool:
    """Return whether a path names a file; a URL counts as one, and an error says later where it is not."""
    return is_url(path) or path.is_file()


def _expand_path(path: Path) -> list[Path]:
    """Return the MCAP files that a file, folder, glob or URL stands for; raises :class:`BadParameter` for none."""
    if is_url(path):
        return list_files(path, SUFFIX)
    if path.is_dir():
        found = sorted(file for file in path.rglob(f"*{SUFFIX}") if file.is_file() and not _is_hidden(file, path))
        if not found:
            raise BadParameter(f"{path}: this folder holds no MCAP file; import recordings first: stillpoint import")
        return found
    if path.exists():
        if not path.is_file() or not path.name.endswith(SUFFIX):
            raise BadParameter(f"{path}: is not an MCAP file; turn it into one first: stillpoint import")
        return [path]
    matches = sorted(Path(match) for match in glob.glob(str(path), recursive=True))
    if not matches:
        raise BadParameter(f"{path}: there is no such file or folder; check the name")
    kept = [match for match in matches if match.is_dir() or match.name.endswith(SUFFIX)]
    if not kept:
        raise BadParameter(f"{path}: matches {len(matches)} files, but no MCAP file among them")
    return [file for match in kept for file in _expand_path(match)]


def _is_hidden(file: Path, below: Path) -> bool:
    """Return whether a file is temporary or hidden, and so nobody's input."""
    return any(part.startswith(".") for part in file.relative_to(below).parts)
