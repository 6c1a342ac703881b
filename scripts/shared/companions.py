"""Find files that belong together: ``NAME.mcap``, ``NAME[.METHOD].reference.mcap``, ``NAME.ESTIMATOR.estimate.mcap``.

Names find the candidates; what settles it is the SHA-256 of the recording that a file says it was made from.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.files.remote import is_url, list_files
from stillpoint.scripts.shared.inputs import KINDS, SUFFIX, get_kind


def get_recording_name(path: Path) -> str:
    """Return NAME of the file of an estimate or a recording, and NAME or NAME.METHOD of a reference."""
    name = path.name.removesuffix(KINDS.get(get_kind(path), SUFFIX))
    return name.rpartition(".")[0] if get_kind(path) == "estimate" else name


def select_files(name: str, kind: str, files: Iterable[Path]) -> list[Path]:
    """Return the references or estimates of the recording NAME among these files, sorted by METHOD or ESTIMATOR."""
    suffix = KINDS[kind]
    found = []
    for file in files:
        label = file.name.removesuffix(suffix).removeprefix(name)
        ours = get_kind(file) == kind and file.name.startswith(name)
        if ours and (label == "" or (label[0] == "." and "." not in label[1:])):
            found.append((label, file))
    return [file for _, file in sorted(found)]


def list_neighbours(path: Path) -> list[Path]:
    """Return all MCAP files in the same folder."""
    if is_url(path):
        return [file for file in list_files(path.parent, SUFFIX) if file.parent == path.parent]
    return sorted(file for file in path.absolute().parent.glob(f"*{SUFFIX}") if not file.name.startswith("."))


def _is_of_same_recording(ours: Mapping[str, str], theirs: Mapping[str, str]) -> bool:
    """Return whether two files were made from one recording, by its SHA-256; True also where one of them does not
    say.
    """
    return not ours or not theirs or bool(set(ours.values()) & set(theirs.values()))


def require_same(path: Path, ours: Mapping[str, str], other: Path, theirs: Mapping[str, str]) -> None:
    """Raise :class:`BadParameter` when the two files were made from different recordings."""
    if not _is_of_same_recording(ours, theirs):
        raise BadParameter(
            f"{path}: was made from another recording than {other} ({', '.join(ours)} of another SHA-256); "
            "make it again from this one"
        )
